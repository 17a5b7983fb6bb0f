// The device's end of rosserial: finds packets in a stream of bytes, announces topics when the host asks,
// keeps the host's clock, sends logs.
//
// A packet: 0xff, 0xfe, length (2), 255 - sum of these two, topic (2), payload, 255 - sum of topic and
// payload; sums modulo 256. Bytes that do not form a packet are dropped one at a time, so that a packet after
// damaged bytes is found.
#pragma once

#include "bytes.h"

namespace dueppm {

struct Topic {
  uint16_t id;
  const char* name;
  const char* type;
  const char* md5;
};

enum class LogLevel : uint8_t { kDebug = 0, kInfo = 1, kWarn = 2, kError = 3, kFatal = 4 };

class RosserialDevice {
 public:
  static constexpr size_t kBuffer = 512;  // largest payload, and how many bytes may wait to be sent
  static constexpr uint16_t kFirstSubscriber = 100;
  static constexpr uint16_t kFirstPublisher = 125;

  RosserialDevice(Topic published, Topic subscribed) : published_(published), subscribed_(subscribed) {}

  // Handles a byte from the host; calls on_message(payload, length) for each message of the subscribed topic
  // that it completes.
  template <class Handler>
  void receive(uint8_t byte, uint32_t now_ms, Handler& handler) {
    if (length_ == 0) since_ms_ = now_ms;
    in_[length_++] = byte;  // parse() leaves room for it
    parse(now_ms, handler);
  }

  // Drops an incomplete packet 20 ms after its first byte; answers requests for topics; asks for the time.
  template <class Handler>
  void poll(uint32_t now_ms, Handler& handler) {
    if (length_ > 0 && now_ms - since_ms_ > kPacketMs) {
      ++damaged_;
      drop(1, now_ms);
      parse(now_ms, handler);
    }
    if (asked_for_topics_ && waiting_ < kBuffer / 2) announce_all(now_ms);
    if (!configured_) return;
    if (now_ms - answered_ms_ > kSilenceMs) {
      configured_ = false;
    } else if (now_ms - asked_ms_ >= kTimeEveryMs) {
      ask_time(now_ms);
    }
  }

  // Queues a message. False if the host does not know the topic, an answer to the host must be sent first, or
  // there is no room.
  bool publish(const uint8_t* payload, size_t length) {
    return configured_ && !asked_for_topics_ && put(published_.id, payload, length);
  }

  void log(LogLevel level, const char* text) {
    uint8_t payload[128];
    Writer writer(payload, sizeof payload);
    writer.u8(static_cast<uint8_t>(level));
    writer.text(text_of(text));
    if (configured_ && !asked_for_topics_ && writer.good()) put(kLog, payload, writer.length());
  }

  // Takes up to `most` of the bytes that wait to be sent.
  size_t send(uint8_t* bytes, size_t most) {
    size_t taken = 0;
    while (taken < most && waiting_ > 0) {
      bytes[taken++] = out_[first_];
      first_ = (first_ + 1) % kBuffer;
      --waiting_;
    }
    return taken;
  }

  bool configured() const { return configured_; }
  uint32_t damaged() const { return damaged_; }

  // Time of the host's clock; 0 until the host has sent it.
  void now(uint32_t now_ms, uint32_t* seconds, uint32_t* nanoseconds) const {
    *seconds = *nanoseconds = 0;
    if (!synchronised_) return;
    const uint64_t ns = uint64_t{clock_ns_} + uint64_t{now_ms - clock_ms_} * 1000000u;
    *seconds = clock_s_ + static_cast<uint32_t>(ns / 1000000000u);
    *nanoseconds = static_cast<uint32_t>(ns % 1000000000u);
  }

 private:
  enum : uint16_t { kPublisher = 0, kSubscriber = 1, kLog = 7, kTime = 10, kTxStop = 11 };
  static constexpr size_t kOverhead = 8;  // of a packet
  static constexpr uint32_t kPacketMs = 20;
  static constexpr uint32_t kTimeEveryMs = 2500;
  static constexpr uint32_t kTimeAnswerMs = 1000;  // later answers are not used for the clock
  static constexpr uint32_t kSilenceMs = 11000;
  static constexpr uint32_t kVersionEveryMs = 500;

  template <class Handler>
  void parse(uint32_t now_ms, Handler& handler) {
    for (;;) {
      size_t skip = 0;
      while (skip < length_ && in_[skip] != 0xff) ++skip;
      if (skip > 0) drop(skip, now_ms);
      if (length_ < 2) return;
      if (in_[1] != 0xfe) {
        if (in_[1] != 0xff) show_version(now_ms);
        drop(1, now_ms);
        continue;
      }
      if (length_ < 5) return;
      const size_t payload = in_[2] | static_cast<size_t>(in_[3]) << 8;
      if (static_cast<uint8_t>(in_[2] + in_[3] + in_[4]) != 255 || payload > kBuffer) {
        ++damaged_;
        drop(1, now_ms);
        continue;
      }
      if (length_ < payload + kOverhead) return;
      if (sum(in_ + 5, payload + 3) != 255) {
        ++damaged_;
        drop(1, now_ms);
        continue;
      }
      handle(static_cast<uint16_t>(in_[5] | in_[6] << 8), in_ + 7, payload, now_ms, handler);
      drop(payload + kOverhead, now_ms);
    }
  }

  template <class Handler>
  void handle(uint16_t topic, const uint8_t* payload, size_t length, uint32_t now_ms, Handler& handler) {
    if (topic == subscribed_.id) {
      handler.on_message(payload, length);
    } else if (topic == kPublisher && length == 0) {
      asked_for_topics_ = true;
    } else if (topic == kTxStop && length == 0) {
      configured_ = false;
    } else if (topic == kTime && length == 8) {
      set_clock(payload, now_ms);
    } else {
      ++damaged_;  // no host sends this
    }
  }

  void announce_all(uint32_t now_ms) {
    asked_for_topics_ = false;
    answered_ms_ = now_ms;
    ask_time(now_ms);
    announce(kSubscriber, subscribed_);  // first, because commands wait for it
    announce(kPublisher, published_);
    configured_ = true;
  }

  void announce(uint16_t kind, const Topic& topic) {
    uint8_t payload[128];
    Writer writer(payload, sizeof payload);
    writer.u16(topic.id);
    writer.text(text_of(topic.name));
    writer.text(text_of(topic.type));
    writer.text(text_of(topic.md5));
    writer.u32(kBuffer);
    put(kind, payload, writer.length());
  }

  void ask_time(uint32_t now_ms) {
    const uint8_t nothing[8] = {};
    asked_ms_ = now_ms;
    asking_ = put(kTime, nothing, sizeof nothing);
  }

  void show_version(uint32_t now_ms) {
    if (configured_ || (version_shown_ && now_ms - asked_ms_ < kVersionEveryMs)) return;
    version_shown_ = true;
    ask_time(now_ms);
  }

  void set_clock(const uint8_t* payload, uint32_t now_ms) {
    Reader reader(payload, 8);
    const uint32_t seconds = reader.u32();
    const uint32_t nanoseconds = reader.u32();
    const uint32_t round_trip_ms = now_ms - asked_ms_;
    if (!asking_ || nanoseconds >= 1000000000u) return;
    asking_ = false;
    answered_ms_ = now_ms;
    if (round_trip_ms > kTimeAnswerMs) return;
    synchronised_ = true;
    clock_s_ = seconds;
    clock_ns_ = nanoseconds;
    clock_ms_ = now_ms - round_trip_ms / 2;  // the host sent its time about half a round trip ago
  }

  bool put(uint16_t topic, const uint8_t* payload, size_t length) {
    if (length > kBuffer || waiting_ + length + kOverhead > kBuffer) return false;
    const uint8_t head[7] = {0xff,
                             0xfe,
                             static_cast<uint8_t>(length),
                             static_cast<uint8_t>(length >> 8),
                             static_cast<uint8_t>(255 - (length & 0xff) - (length >> 8)),
                             static_cast<uint8_t>(topic),
                             static_cast<uint8_t>(topic >> 8)};
    for (size_t i = 0; i < sizeof head; ++i) put_byte(head[i]);
    for (size_t i = 0; i < length; ++i) put_byte(payload[i]);
    put_byte(static_cast<uint8_t>(255 - sum(head + 5, 2) - sum(payload, length)));
    return true;
  }

  void put_byte(uint8_t byte) {
    out_[(first_ + waiting_) % kBuffer] = byte;
    ++waiting_;
  }

  static uint8_t sum(const uint8_t* bytes, size_t length) {
    uint8_t sum = 0;
    for (size_t i = 0; i < length; ++i) sum = static_cast<uint8_t>(sum + bytes[i]);
    return sum;
  }

  void drop(size_t count, uint32_t now_ms) {
    length_ -= count;
    for (size_t i = 0; i < length_; ++i) in_[i] = in_[i + count];
    since_ms_ = now_ms;
  }

  Topic published_;
  Topic subscribed_;
  uint8_t in_[kBuffer + kOverhead];
  size_t length_ = 0;
  uint32_t since_ms_ = 0;  // when the first byte in in_ arrived, or became the first
  uint8_t out_[kBuffer];
  size_t first_ = 0;
  size_t waiting_ = 0;
  bool asked_for_topics_ = false;
  bool configured_ = false;
  bool version_shown_ = false;
  bool asking_ = false;
  bool synchronised_ = false;
  uint32_t asked_ms_ = 0;
  uint32_t answered_ms_ = 0;
  uint32_t clock_s_ = 0;
  uint32_t clock_ns_ = 0;
  uint32_t clock_ms_ = 0;
  uint32_t damaged_ = 0;
};

}  // namespace dueppm
