// fuzz BYTES SEED [--unprotected]: sends that many noisy bytes to the firmware and checks its signal. Noisy
// bytes are noise and messages altered on the line; sound messages between them do not count.
//
// Checked at all times: length and gap of each frame, each channel within its limits and a stick's travel, no
// channel faster than the slew limit. While a host commands constant sticks over a line that damages bytes:
// no channel deviates by more than twice kJump, the most that a damaged message which passes the checks by
// chance can command. Without a host: the firmware waits. Prints statistics; on a violation prints what was
// broken and exits with 1.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>

#include "../dueppm/firmware.h"
#include "messages_of_host.h"

namespace {

using namespace dueppm;
using host::Bytes;

struct Unprotected : Configuration {  // the control arm: every message is accepted at once
  static constexpr double kJump = 2.0;
  static constexpr int32_t kSlewUsPerS = 60000;
};

constexpr uint64_t kByteTicks = 10ull * 42000000 / Configuration::kBaud;
constexpr double kCommand[kSticks] = {0.25, -0.125, 0.0, 0.1};  // roll, pitch, throttle, yaw

[[noreturn]] void broken(const char* what, double value) {
  std::printf("BROKEN: %s: %g\n", what, value);
  std::exit(1);
}

template <class C>
class Fuzz {
 public:
  explicit Fuzz(unsigned seed) : random_(seed) {}

  // Returns the largest deviation of a channel from the command, in microseconds.
  double run(uint64_t bytes) {
    for (int i = 0; i < 3; ++i) {  // no host
      noise(bytes / 64);
      biased_noise(bytes / 64);
    }
    if (firmware_.state() != State::kWaiting) broken("noise alone was believed", static_cast<double>(bytes_));
    while (noisy_ < bytes) {
      take_off();
      for (int i = 0; i < 20; ++i) damaged_messages(200);
      constant_ = false;
      for (int i = 0; i < 10; ++i) {
        switch (random_() % 5) {
          case 0:
            noise(2000);
            break;
          case 1:
            biased_noise(2000);
            break;
          case 2:
            well_formed_packets(60);
            break;
          case 3:
            pause(random_() % 2000);
            break;
          default:
            damaged_messages(60);
        }
      }
    }
    std::printf(
        "%llu noisy bytes of %llu, %llu frames, %u damaged messages that pass the checksums and are "
        "plausible, farthest from the command %.1f us\n",
        static_cast<unsigned long long>(noisy_), static_cast<unsigned long long>(bytes_),
        static_cast<unsigned long long>(frames_), passed_, farthest_us_);
    return farthest_us_;
  }

 private:
  // Receives a byte and runs the timer for its duration.
  void byte(uint8_t value) {
    pass(kByteTicks);
    firmware_.receive(value, now_ms());
    ++bytes_;
  }
  void send(const Bytes& bytes) {
    for (uint8_t value : bytes) byte(value);
  }
  void pause(uint32_t ms) {
    for (uint32_t i = 0; i < ms; ++i) pass(42000);
  }
  uint32_t now_ms() const { return static_cast<uint32_t>(now_ / 42000); }

  void pass(uint64_t ticks) {
    now_ += ticks;
    while (period_end_ <= now_) period();
    firmware_.poll(now_ms());
    firmware_.send(taken_, sizeof taken_);
  }

  void period() {
    const uint32_t ticks = firmware_.next_period(0);
    period_end_ += ticks;
    if (at_ == C::kChannels) {
      if (sum_ + ticks != C::kFrameUs * 42ull)
        broken("length of a frame", static_cast<double>(sum_ + ticks) / 42);
      if (ticks < 3000 * 42) broken("gap", ticks / 42.0);
      at_ = 0;
      sum_ = 0;
      ++frames_;
      return;
    }
    const double us = ticks / 42.0;
    const double least = at_ == C::kThrottleChannel - 1 ? C::kFailsafeThrottleUs : 1000;
    if (us < least || us > 2000) broken("channel", us);
    const double slew_us = C::kSlewUsPerS * 1e-6 * C::kFrameUs + 0.1;
    if (frames_ > 0 && (us - before_us_[at_] > slew_us || before_us_[at_] - us > slew_us))
      broken("slew", us - before_us_[at_]);
    before_us_[at_] = us;
    if (constant_) {
      const int sticks[] = {kRoll, kPitch, kThrottle, kYaw};  // of channels 1 to 4
      const double off = us - 1500 - 500 * kCommand[sticks[at_]];
      if ((off < 0 ? -off : off) > farthest_us_) farthest_us_ = off < 0 ? -off : off;
    }
    sum_ += ticks;
    ++at_;
  }

  void noise(uint64_t count) {
    noisy_ += count;
    for (uint64_t i = 0; i < count; ++i) byte(static_cast<uint8_t>(random_()));
  }
  void biased_noise(uint64_t count) {  // bytes that are frequent in packets
    noisy_ += count;
    static const uint8_t some[] = {0xff, 0xfe, 0, 100, 74, 1, 4, 255 - 74, 10, 8, 0xf7, 11, 125};
    for (uint64_t i = 0; i < count; ++i)
      byte(random_() % 16 == 0 ? static_cast<uint8_t>(random_()) : some[random_() % sizeof some]);
  }
  void well_formed_packets(int count) {  // correct checksums, wrong contents
    for (int i = 0; i < count; ++i) {
      Bytes payload = host::controls(any(), any(), any(), any(), random_() % 4 == 0 ? "Raven" : "IRIS",
                                     random_() % 8 == 0 ? 2 : 1);
      if (random_() % 2 == 0) payload[random_() % payload.size()] = static_cast<uint8_t>(random_());
      send(host::packet(random_() % 8 == 0 ? random_() % 130 : host::kControls, payload));
    }
  }
  double any() {
    const uint32_t pick = random_() % 8;
    double value;
    uint64_t bits = static_cast<uint64_t>(random_()) << 32 | random_();
    std::memcpy(&value, &bits, sizeof value);
    return pick == 0 ? value
                     : (static_cast<double>(random_()) / 4294967295.0 * 2 - 1) * (pick == 1 ? 1.1 : 1.0);
  }

  void take_off() {
    const double low = -1;
    send(host::packet(0, {}));
    constant_ = false;
    for (int i = 0; i < 10; ++i) send(host::packet(host::kControls, host::controls(0, 0, 0, low)));
    for (int i = 0; i < 100; ++i) send(command());
    constant_ = true;
  }
  static Bytes command() {
    return host::packet(host::kControls, host::controls(kCommand[kRoll], kCommand[kPitch], kCommand[kYaw],
                                                        kCommand[kThrottle]));
  }

  // Messages of one command over a line that damages about half of them: bits, bursts, lost and inserted
  // bytes.
  void damaged_messages(int count) {
    for (int i = 0; i < count; ++i) {
      Bytes bytes = command();
      if (random_() % 8 == 0) {  // damage that the checksum does not detect, in one message
        const auto change = static_cast<uint8_t>(1 + random_() % 255);
        uint8_t& more = bytes[7 + random_() % (bytes.size() - 8)];
        uint8_t& less = bytes[7 + random_() % (bytes.size() - 8)];
        more = static_cast<uint8_t>(more + change);
        less = static_cast<uint8_t>(less - change);
        send_damaged(bytes);
        send(command());
        continue;
      }
      const uint32_t hurts = random_() % 4 == 0 ? 1 + random_() % 8 : random_() % 2;
      for (uint32_t hurt = 0; hurt < hurts; ++hurt) {
        const size_t at = random_() % bytes.size();
        const auto there = bytes.begin() + static_cast<std::ptrdiff_t>(at);
        switch (random_() % 4) {
          case 0:
            bytes[at] = static_cast<uint8_t>(bytes[at] ^ 1 << random_() % 8);
            break;
          case 1:
            for (size_t j = at; j < bytes.size() && j < at + 4; ++j)
              bytes[j] = static_cast<uint8_t>(random_());
            break;
          case 2:
            bytes.erase(there);
            break;
          default:
            bytes.insert(there, static_cast<uint8_t>(random_()));
        }
        if (bytes.empty()) break;
      }
      send_damaged(bytes);
      if (random_() % 50 == 0) {  // avoids the failsafe: even a link as bad as this has good messages
        for (int j = 0; j < 3; ++j) send(command());
      }
    }
  }
  void send_damaged(const Bytes& bytes) {  // the message may be undamaged
    if (bytes != command()) {
      noisy_ += bytes.size();
      if (passes(bytes)) ++passed_;
    }
    send(bytes);
  }
  // Whether the damaged bytes are still a valid message, of another command.
  static bool passes(const Bytes& bytes) {
    const Bytes good = command();
    if (bytes.size() != good.size()) return false;
    if (!std::equal(good.begin(), good.begin() + 7, bytes.begin())) return false;
    if (host::check(bytes, 5, bytes.size() - 1) != bytes.back()) return false;
    ControlsCheck<C> fresh;
    fresh.judge(bytes.data() + 7, bytes.size() - 8, 0);
    return fresh.judge(bytes.data() + 7, bytes.size() - 8, 0).accepted;
  }

  std::mt19937 random_;
  Firmware<C> firmware_;
  uint64_t now_ = 0;
  uint64_t period_end_ = 0;
  uint64_t bytes_ = 0;
  uint64_t noisy_ = 0;
  uint64_t frames_ = 0;
  uint64_t sum_ = 0;
  int at_ = 0;
  double before_us_[C::kChannels] = {};
  bool constant_ = false;
  uint32_t passed_ = 0;
  double farthest_us_ = 0;
  uint8_t taken_[64];
};

}  // namespace

int main(int count, char** words) {
  if (count < 3) {
    std::fputs("usage: fuzz BYTES SEED [--unprotected]\n", stderr);
    return 2;
  }
  const uint64_t bytes = std::strtoull(words[1], nullptr, 10);
  const unsigned seed = static_cast<unsigned>(std::strtoul(words[2], nullptr, 10));
  const bool unprotected = count > 3 && std::strcmp(words[3], "--unprotected") == 0;
  const double us = unprotected ? Fuzz<Unprotected>(seed).run(bytes) : Fuzz<Configuration>(seed).run(bytes);
  if (us > 2 * Configuration::kJump * 500) broken("us from the command", us);
  return 0;
}
