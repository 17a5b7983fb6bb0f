// A small Cortex host on loopback for the tests of the client, with faults that a real host may show.
#pragma once

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "cortex_ros/net.hpp"
#include "cortex_ros/protocol.hpp"
#include "encode.hpp"

// Loopback has 16 million addresses: each test takes its own, so that parallel tests do not interfere.
inline std::string own_loopback_address() {
  static std::atomic<unsigned> counter{0};
  const unsigned process = static_cast<unsigned>(getpid());
  return "127." + std::to_string(64 + process % 128) + "." + std::to_string(process / 128 % 256) + "." +
         std::to_string(1 + counter++ % 250);
}

inline cortex_ros::Bytes float_payload(float value) {
  cortex_ros::Bytes bytes(4);
  std::memcpy(bytes.data(), &value, 4);  // tests run on little-endian machines
  return bytes;
}

inline cortex_ros::Bytes int_payload(std::int32_t value) {
  cortex_ros::Bytes bytes(4);
  std::memcpy(bytes.data(), &value, 4);
  return bytes;
}

inline cortex_ros::FrameOfData simple_frame(std::int32_t number) {
  cortex_ros::FrameOfData frame;
  frame.frame = number;
  frame.bodies = {{"fluffy_II", {{100.0f, 200.0f, 300.0f}}}};
  frame.delay_s = 0.003f;
  return frame;
}

inline void send_multicast_over_loopback(cortex_ros::UdpSocket& socket) {
  const in_addr loopback{htonl(INADDR_LOOPBACK)};
  setsockopt(socket.fd(), IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback);
}

class FakeHost {
 public:
  using Answers = std::vector<cortex_ros::Packet>;

  struct Behaviour {
    std::map<std::string, cortex_ros::Packet> texts = {
        {"GetConversionToMillimeters", cortex_ros::GeneralReply{float_payload(1.0f)}},
        {"GetUpAxis", cortex_ros::GeneralReply{int_payload(2)}},
        {"GetContextFrameRate", cortex_ros::GeneralReply{float_payload(200.0f)}},
        {"LiveMode", cortex_ros::GeneralReply{}},
        {"Pause", cortex_ros::GeneralReply{}},
    };
    bool silent = false;         // answers nothing at all
    bool deaf_to_texts = false;  // answers everything but text requests
    int copies = 1;              // number of times each answer is sent
    std::uint8_t program = 1;    // in its identity; 1 is Cortex
    std::chrono::milliseconds delay{0};
    bool advance = true;      // the polled frame gets a new number each time
    bool junk_first = false;  // sends answers of wrong types before the right one
  };

  explicit FakeHost(const std::string& address, std::uint16_t port = 0)
      : socket_({cortex_ros::resolve(address), port}, cortex_ros::UdpSocket::Share::kNo),
        stream_({cortex_ros::resolve(address), 0}, cortex_ros::UdpSocket::Share::kNo),
        thread_([this] { run(); }) {}

  ~FakeHost() {
    stop_ = true;
    thread_.join();
  }

  std::uint16_t port() const { return socket_.local().port(); }

  void change(const std::function<void(Behaviour&)>& change) {
    const std::lock_guard<std::mutex> lock(mutex_);
    change(behaviour_);
  }

  // How often a packet of this kind, or this text, has been received.
  int received(const std::string& what) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = received_.find(what);
    return found == received_.end() ? 0 : found->second;
  }

  void stream(const cortex_ros::Bytes& bytes, const cortex_ros::Endpoint& destination) {
    send_multicast_over_loopback(stream_);
    sent_ = stream_.send(bytes, destination) && sent_;
  }
  void stream(const cortex_ros::Packet& packet, const cortex_ros::Endpoint& destination) {
    stream(cortex_ros::encode(packet), destination);
  }
  bool could_send() const { return sent_; }

  // Sends an unsolicited packet from the command port to the client that last sent a packet.
  void volunteer(const cortex_ros::Packet& packet) {
    cortex_ros::Endpoint client;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      client = client_;
    }
    socket_.send(cortex_ros::encode(packet), client);
  }

  cortex_ros::Endpoint client() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return client_;
  }

 private:
  struct Pending {
    cortex_ros::Time due;
    cortex_ros::Bytes bytes;
    cortex_ros::Endpoint to;
  };

  void run() {
    while (!stop_) {
      pollfd waiting{socket_.fd(), POLLIN, 0};
      poll(&waiting, 1, 1);
      cortex_ros::Datagram datagram;
      while (socket_.receive(datagram)) {
        handle(datagram);
      }
      send_due();
    }
  }

  void handle(const cortex_ros::Datagram& datagram) {
    const cortex_ros::Packet packet = cortex_ros::decode(datagram.data, datagram.size);
    const std::lock_guard<std::mutex> lock(mutex_);
    client_ = datagram.source;
    const auto* request = std::get_if<cortex_ros::OtherPacket>(&packet);
    ++received_[request != nullptr ? name_of(*request) : "hello"];
    if (behaviour_.silent) {
      return;
    }
    for (const cortex_ros::Packet& answer : answers(packet)) {
      for (int i = 0; i < behaviour_.copies; ++i) {
        pending_.push_back(
            {clock_.monotonic() + behaviour_.delay, cortex_ros::encode(answer), datagram.source});
      }
    }
  }

  // The text of a text request, the command number of any other request.
  static std::string name_of(const cortex_ros::OtherPacket& request) {
    return request.command == 14 ? std::string(request.payload.begin(), request.payload.end() - 1)
                                 : std::to_string(request.command);
  }

  Answers answers(const cortex_ros::Packet& packet) {
    using namespace cortex_ros;  // NOLINT
    Answers out;
    if (std::holds_alternative<HelloWorld>(packet)) {
      return {HereIAm{{"Cortex", {behaviour_.program, 5, 3, 1}}}};
    }
    if (behaviour_.junk_first) {
      out = {Comment{"wait for it"}, OtherPacket{33, {}}, BodyDefs()};
    }
    const auto& request = std::get<OtherPacket>(packet);
    if (request.command == 12) {
      frame_ += behaviour_.advance ? 1 : 0;
      out.push_back(simple_frame(frame_));
    } else if (request.command == 10) {
      out = {BodyDefs{3}};
    } else if (!behaviour_.deaf_to_texts) {
      const auto found = behaviour_.texts.find(name_of(request));
      out.push_back(found == behaviour_.texts.end() ? Packet(UnrecognizedRequest()) : found->second);
    }
    return out;
  }

  void send_due() {
    const std::lock_guard<std::mutex> lock(mutex_);
    const cortex_ros::Time now = clock_.monotonic();
    while (!pending_.empty() && pending_.front().due <= now) {
      socket_.send(pending_.front().bytes, pending_.front().to);
      pending_.erase(pending_.begin());
    }
  }

  const cortex_ros::Clock clock_;
  cortex_ros::UdpSocket socket_;
  cortex_ros::UdpSocket stream_;
  bool sent_ = true;
  std::atomic<bool> stop_{false};
  mutable std::mutex mutex_;
  Behaviour behaviour_;
  std::map<std::string, int> received_;
  cortex_ros::Endpoint client_;
  std::vector<Pending> pending_;
  std::int32_t frame_ = 0;
  std::thread thread_;
};
