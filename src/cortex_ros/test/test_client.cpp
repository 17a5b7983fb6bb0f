// The client against a fake host on loopback. Every wait has a generous limit, and a time-out is short only
// where the test waits for it, so that a busy machine makes the tests slower but not wrong.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <thread>

#include "cortex_ros/client.hpp"
#include "fake_host.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using std::chrono::milliseconds;

constexpr std::chrono::seconds kPatience{20};
constexpr milliseconds kStall{2000};  // longer than any stall of this computer

bool wait_until(const std::function<bool()>& condition) {
  const auto deadline = std::chrono::steady_clock::now() + kPatience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > deadline) {
      return false;
    }
    std::this_thread::sleep_for(milliseconds(2));
  }
  return true;
}

std::uint16_t free_port() {
  return UdpSocket({Address(), 0}, UdpSocket::Share::kNo).local().port();
}

// Records what the client reports.
class Recorder : public SourceEvents {
 public:
  struct Frame {
    std::int32_t number;
    Time receipt;
    double x_m;  // of its first marker, 0.1 if the host's unit is mm
  };

  void on_frame(const MocapFrame& f) override {
    add(frames_, {f.number, f.receipt, f.bodies.at(0).markers.at(0).x});
  }
  void on_host_up(const MocapHost& host) override { add(ups_, host); }
  void on_host_down(const std::string& why) override { add(downs_, why); }
  void on_log(LogLevel level, const std::string& text) override {
    add(level == LogLevel::kError ? problems_ : feeds_, text);
  }
  void on_frequent_log(LogLevel level, const std::string& text) override {
    add(level == LogLevel::kInfo ? comments_ : malformed_, text);
  }

  std::vector<Frame> frames() const { return copy(frames_); }
  std::vector<MocapHost> ups() const { return copy(ups_); }
  std::vector<std::string> downs() const { return copy(downs_); }
  std::vector<std::string> feeds() const { return copy(feeds_); }
  std::vector<std::string> comments() const { return copy(comments_); }
  std::vector<std::string> malformed() const { return copy(malformed_); }
  std::vector<std::string> problems() const { return copy(problems_); }

 private:
  template <typename T>
  void add(std::vector<T>& list, const T& value) {
    const std::lock_guard<std::mutex> lock(mutex_);
    list.push_back(value);
  }
  template <typename T>
  std::vector<T> copy(const std::vector<T>& list) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return list;
  }

  mutable std::mutex mutex_;
  std::vector<Frame> frames_;
  std::vector<MocapHost> ups_;
  std::vector<std::string> downs_, feeds_, comments_, malformed_, problems_;
};

bool has(const MocapHost& host, const std::string& remark) {
  return std::any_of(host.remarks.begin(), host.remarks.end(),
                     [&](const std::string& text) { return text.find(remark) != std::string::npos; });
}

constexpr const char* kNoUnit = "does not report its length unit";
constexpr const char* kNoAxis = "does not report its up axis";
constexpr const char* kNoRate = "does not report its frame rate";
constexpr const char* kNotLive = "did not accept LiveMode";

// A client in its own thread.
class RunningClient {
 public:
  explicit RunningClient(const ClientOptions& options) : client_(options, events_, clock_) {
    thread_ = std::thread([this] { client_.run(); });
  }
  ~RunningClient() { stop(); }

  void stop() {
    client_.stop();
    if (thread_.joinable()) {
      thread_.join();
    }
  }

  const Recorder& events() const { return events_; }
  SourceStatus status() const { return client_.status(); }
  std::uint64_t count(const std::string& name) const {
    for (const Counter& counter : status().counters) {
      if (counter.name == name) {
        return counter.count;
      }
    }
    throw std::out_of_range(name);
  }
  bool up(std::size_t times = 1) const {
    return wait_until([&] { return events_.ups().size() >= times; });
  }

 private:
  const Clock clock_;
  Recorder events_;
  Client client_;
  std::thread thread_;
};

class ClientTest : public testing::Test {
 protected:
  void start_host(std::uint16_t port = 0) { host_ = std::make_unique<FakeHost>(address_, port); }

  ClientOptions options(std::uint16_t command_port) const {
    ClientOptions options;
    options.host = address_;
    options.command_port = command_port;
    options.stream_port = stream_port_;
    options.hello_interval = milliseconds(10);
    options.hello_interval_max = milliseconds(50);
    options.search_patience = kStall;
    options.request_timeout = kStall;
    options.stream_timeout = kStall;
    options.probe_interval = milliseconds(50);
    options.host_timeout = kStall;
    return options;
  }
  ClientOptions options() const { return options(host_->port()); }

  Endpoint group() const { return {resolve("225.1.1.1"), stream_port_}; }
  Endpoint unicast() const { return {resolve("127.0.0.1"), stream_port_}; }

  // Streams frames, numbered from `number` on, until the client has seen one.
  bool stream_until_seen(const RunningClient& client, const Endpoint& destination, std::int32_t& number) {
    const std::size_t before = client.events().frames().size();
    return wait_until([&] {
      host_->stream(simple_frame(number++), destination);
      std::this_thread::sleep_for(milliseconds(3));
      return client.events().frames().size() > before;
    });
  }

  const std::string address_ = own_loopback_address();
  const std::uint16_t stream_port_ = free_port();
  std::unique_ptr<FakeHost> host_;
};

// ---- connecting

TEST_F(ClientTest, FindsTheHostAndAsksWhatItNeeds) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  const MocapHost host = client.events().ups()[0];
  EXPECT_EQ(host.description, address_ + ":" + std::to_string(host_->port()) +
                                  ", program 'Cortex' 5.3.1, 200 Hz, 3 bodies defined");
  EXPECT_EQ(host.up_axis, 'z');
  EXPECT_EQ(host.frame_rate_hz, 200.0);
  EXPECT_TRUE(host.remarks.empty());
  EXPECT_EQ(host_->received("LiveMode"), 1);
  EXPECT_TRUE(client.status().up);
  EXPECT_TRUE(client.events().downs().empty());
}

TEST_F(ClientTest, LiveModeIsLeftAloneOnRequest) {
  start_host();
  ClientOptions o = options();
  o.live_on_start = false;
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  EXPECT_EQ(host_->received("LiveMode"), 0);
}

TEST_F(ClientTest, FindsAHostByBroadcast) {
  const auto host = std::make_unique<FakeHost>("0.0.0.0");
  ClientOptions o = options(host->port());
  o.host = "";
  o.local_address = "127.0.0.1";
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  EXPECT_EQ(client.events().ups()[0].description.rfind("127.0.0.1:", 0), 0u);
}

TEST_F(ClientTest, WaitsForAHostThatComesLater) {
  const std::uint16_t port = free_port();
  ClientOptions o = options(port);
  o.search_patience = milliseconds(100);
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return !client.events().downs().empty(); }));
  EXPECT_FALSE(client.status().up);
  start_host(port);
  ASSERT_TRUE(client.up());
  EXPECT_EQ(client.events().downs().size(), 1u) << "reported once";
}

TEST_F(ClientTest, ReconnectsWhenTheHostWasAway) {
  start_host();
  const std::uint16_t port = host_->port();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  host_.reset();
  ASSERT_TRUE(wait_until([&] { return !client.events().downs().empty(); }));
  EXPECT_FALSE(client.status().up);
  start_host(port);
  ASSERT_TRUE(client.up(2));
  EXPECT_TRUE(wait_until([&] { return host_->received("LiveMode") >= 1; }))
      << "the new host must be put into live mode again";
  std::int32_t number = 1;
  EXPECT_TRUE(stream_until_seen(client, group(), number));
  EXPECT_EQ(client.events().downs().size(), 1u);
  EXPECT_EQ(client.count("times found"), 2u);
}

TEST_F(ClientTest, ARestartThatIsAnnouncedOnTheStreamIsFollowed) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  EXPECT_TRUE(wait_until([&] {
    host_->stream(HereIAm{{"Cortex", {1, 5, 3, 1}}}, group());
    std::this_thread::sleep_for(milliseconds(20));
    return client.events().ups().size() >= 2;
  }));
  EXPECT_GE(host_->received("LiveMode"), 2);
  EXPECT_TRUE(client.events().downs().empty());
}

// Anyone can send a HELLO in the host's name, and the host may be too busy to answer: no frame may be lost.
TEST_F(ClientTest, NoFrameIsLostWhileAnAnnouncedHostIsAskedAnew) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) {
    b.texts["GetConversionToMillimeters"] = GeneralReply{float_payload(25.4f)};
  });
  ClientOptions o = options();
  o.mode = Mode::kStream;
  o.request_timeout = milliseconds(60);  // times 3 tries, twice, times 4 requests: none is answered
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  std::this_thread::sleep_for(milliseconds(1100));  // a second set-up within 1 s is not made
  std::int32_t number = 1;
  ASSERT_TRUE(stream_until_seen(client, group(), number));
  ASSERT_TRUE(wait_until([&] { return client.events().frames().back().number == number - 1; }));
  const std::size_t before = client.events().frames().size();
  const std::uint64_t early = client.count("before the unit was known");
  host_->change([](FakeHost::Behaviour& b) { b.deaf_to_texts = true; });
  const std::int32_t first = number;
  const auto start = std::chrono::steady_clock::now();
  for (; client.events().ups().size() < 2 || number < first + 100; ++number) {
    ASSERT_LT(std::chrono::steady_clock::now() - start, kPatience) << "the set-up has to end";
    if (number == first + 20) {
      host_->stream(HelloWorld{{"Cortex", {1, 5, 3, 1}}}, group());
    } else if (number % 20 == 0) {
      host_->volunteer(HelloWorld{{"Cortex", {1, 5, 3, 1}}});
    }
    host_->stream(simple_frame(number), group());
    std::this_thread::sleep_for(milliseconds(5));
  }
  ASSERT_TRUE(wait_until([&] { return client.events().frames().back().number == number - 1; }));
  const std::vector<Recorder::Frame> frames = client.events().frames();
  ASSERT_EQ(frames.size() - before, static_cast<std::size_t>(number - first));
  for (std::size_t i = before; i < frames.size(); ++i) {
    EXPECT_EQ(frames[i].number, first + static_cast<std::int32_t>(i - before));
  }
  EXPECT_EQ(client.count("before the unit was known"), early);
  EXPECT_GE(client.count("announcements of the host"), 2u);
  EXPECT_DOUBLE_EQ(frames.back().x_m, frames[before].x_m) << "silence does not change the unit";
  EXPECT_GE(host_->received("GetUpAxis"), 2);
}

TEST_F(ClientTest, PollingGoesOnWhileAnAnnouncedHostIsAskedAnew) {
  start_host();
  ClientOptions o = options();
  o.mode = Mode::kPoll;
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  std::this_thread::sleep_for(milliseconds(1100));
  host_->change([](FakeHost::Behaviour& b) { b.deaf_to_texts = true; });
  ASSERT_TRUE(wait_until([&] {
    host_->volunteer(HelloWorld{{"Cortex", {1, 5, 3, 1}}});
    std::this_thread::sleep_for(milliseconds(5));
    return host_->received("GetConversionToMillimeters") >= 2;
  }));
  // The unanswered requests take 24 s or more; these polls take 0.1 s.
  const std::size_t before = client.events().frames().size();
  ASSERT_TRUE(wait_until([&] { return client.events().frames().size() >= before + 20; }));
  EXPECT_EQ(client.events().ups().size(), 1u) << "still being asked";
}

TEST_F(ClientTest, FramesOfAHostThatIsBackAreReadByWhatWasKnown) {
  start_host();
  ClientOptions o = options();
  o.mode = Mode::kStream;
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  host_->change([](FakeHost::Behaviour& b) { b.silent = true; });
  ASSERT_TRUE(wait_until([&] { return !client.events().downs().empty(); }));
  host_->change([](FakeHost::Behaviour& b) {
    b.silent = false;
    b.deaf_to_texts = true;
  });
  std::int32_t number = 1;
  ASSERT_TRUE(stream_until_seen(client, group(), number));
  const std::vector<MocapHost> ups = client.events().ups();
  ASSERT_EQ(ups.size(), 2u) << "up at once, and again when it was asked";
  EXPECT_TRUE(ups[1].remarks.empty()) << "the unit is that of before, and so is the rest";
  EXPECT_EQ(client.count("before the unit was known"), 0u);
}

TEST_F(ClientTest, FramesBeforeTheUnitIsKnownAreCounted) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) { b.deaf_to_texts = true; });
  ClientOptions o = options();
  o.stream_group = "";
  RunningClient client(o);
  std::int32_t number = 1;
  ASSERT_TRUE(wait_until([&] {
    host_->stream(simple_frame(number++), unicast());
    std::this_thread::sleep_for(milliseconds(3));
    return client.count("before the unit was known") >= 5;
  }));
  EXPECT_TRUE(client.events().frames().empty());
}

TEST_F(ClientTest, OnlyCortexIsTakenByDiscovery) {
  const auto stranger = std::make_unique<FakeHost>("0.0.0.0");
  stranger->change([](FakeHost::Behaviour& b) { b.program = 7; });
  ClientOptions o = options(stranger->port());
  o.host = "";
  o.local_address = "127.0.0.1";
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return !client.events().problems().empty(); }));
  EXPECT_NE(client.events().problems()[0].find("number 7"), std::string::npos);
  EXPECT_GT(client.count("foreign datagrams"), 0u);
  EXPECT_TRUE(client.events().ups().empty());
  stranger->change([](FakeHost::Behaviour& b) { b.program = 1; });
  EXPECT_TRUE(client.up());
}

TEST_F(ClientTest, AConfiguredHostMayBeAnyProgram) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) { b.program = 7; });
  RunningClient client(options());
  EXPECT_TRUE(client.up());
}

TEST_F(ClientTest, ASecondHostThatAnswersTheSearchIsPointedOut) {
  const auto first = std::make_unique<FakeHost>("0.0.0.0");
  ClientOptions o = options(first->port());
  o.host = "";
  o.local_address = "127.0.0.1";
  o.search_patience = kPatience;
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  const std::string elsewhere = own_loopback_address();
  UdpSocket second({resolve(elsewhere), 0}, UdpSocket::Share::kNo);
  second.send(encode(HereIAm{{"Cortex", {1, 5, 3, 1}}}), first->client());
  ASSERT_TRUE(wait_until([&] { return !client.events().problems().empty(); }));
  for (const std::string& fact : {std::string("127.0.0.1"), elsewhere, std::string("'host'")}) {
    EXPECT_NE(client.events().problems()[0].find(fact), std::string::npos) << fact;
  }
  EXPECT_EQ(client.events().ups().size(), 1u);
}

// During the search anyone can answer, from any port and address: this must fill neither log nor memory.
TEST_F(ClientTest, HintsAboutStrangersAreFew) {
  const std::uint16_t port = free_port();
  UdpSocket called({resolve(address_), port}, UdpSocket::Share::kNo);
  RunningClient client(options(port));
  Datagram hello;
  ASSERT_TRUE(wait_until([&] { return called.receive(hello); }));
  const Bytes answer = encode(HereIAm{{"Cortex", {1, 5, 3, 1}}});
  const std::string elsewhere = own_loopback_address();
  std::uint64_t sent = 0;
  const auto answer_from = [&](const std::string& address) {
    UdpSocket({resolve(address), 0}, UdpSocket::Share::kNo).send(answer, hello.source);
    ++sent;
    return wait_until([&] { return client.count("foreign datagrams") >= sent; });
  };
  for (int i = 0; i < 10; ++i) {
    ASSERT_TRUE(answer_from(elsewhere));  // a new port each time
  }
  EXPECT_EQ(client.events().problems().size(), 1u);
  for (int i = 0; i < 30; ++i) {
    ASSERT_TRUE(answer_from(own_loopback_address()));
  }
  EXPECT_EQ(client.events().problems().size(), 16u);
}

TEST_F(ClientTest, NumbersOutsideTheirLimitsAreNotBelieved) {
  using Limits = std::numeric_limits<float>;
  const auto learned = [&](float unit, float rate_hz) {
    start_host();
    host_->change([&](FakeHost::Behaviour& b) {
      b.texts["GetConversionToMillimeters"] = GeneralReply{float_payload(unit)};
      b.texts["GetContextFrameRate"] = GeneralReply{float_payload(rate_hz)};
    });
    RunningClient client(options());
    EXPECT_TRUE(client.up());
    return client.events().ups().at(0);
  };
  for (float bad : {Limits::denorm_min(), Limits::min(), 0.00099f, -1.0f, 1.1e6f, Limits::max(),
                    Limits::infinity(), -Limits::infinity(), Limits::quiet_NaN()}) {
    const MocapHost host = learned(bad, bad);
    EXPECT_TRUE(has(host, kNoUnit)) << bad;
    EXPECT_TRUE(has(host, kNoRate)) << bad;
  }
  EXPECT_TRUE(has(learned(1.0f, 0.99f), kNoRate));
  EXPECT_TRUE(has(learned(1.0f, 10001.0f), kNoRate));
  const MocapHost least = learned(0.001f, 1.0f);
  EXPECT_TRUE(has(least, "length unit is 0.001000 mm"));
  EXPECT_EQ(least.frame_rate_hz, 1.0);
  const MocapHost most = learned(1e6f, 1e4f);
  EXPECT_TRUE(has(most, "length unit is 1000000.000000 mm"));
  EXPECT_EQ(most.frame_rate_hz, 1e4);
}

TEST_F(ClientTest, NonsenseAboutItselfIsNotBelieved) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) {
    b.texts["GetContextFrameRate"] = GeneralReply{float_payload(std::numeric_limits<float>::quiet_NaN())};
    b.texts["GetConversionToMillimeters"] = GeneralReply{float_payload(0.0f)};
    b.texts["GetUpAxis"] = GeneralReply{int_payload(7)};
    b.texts["LiveMode"] = UnrecognizedRequest();
  });
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  const MocapHost host = client.events().ups()[0];
  for (const char* remark : {kNoUnit, kNoAxis, kNoRate, kNotLive}) {
    EXPECT_TRUE(has(host, remark)) << remark;
  }
  EXPECT_EQ(host.frame_rate_hz, options().frame_rate_hz);
  EXPECT_EQ(host.up_axis, 'z');
}

TEST_F(ClientTest, AnswersTooShortForANumberAreNotBelieved) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) { b.texts["GetContextFrameRate"] = GeneralReply{{0, 0, 0x48}}; });
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  EXPECT_TRUE(has(client.events().ups()[0], kNoRate));
}

TEST_F(ClientTest, AHostThatKnowsNoTextsStillStreams) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) { b.deaf_to_texts = true; });
  ClientOptions o = options();
  o.request_timeout = milliseconds(20);
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  EXPECT_EQ(host_->received("GetUpAxis"), 3) << "three tries";
  std::int32_t number = 1;
  EXPECT_TRUE(stream_until_seen(client, group(), number));
}

// ---- faulty answers

// Each answer comes twice, and so late that the request was repeated. The values all differ, so that a
// mix-up would show.
TEST_F(ClientTest, LateAndDuplicateAnswersAreNotMixedUp) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) {
    b.delay = milliseconds(90);
    b.copies = 2;
    b.texts["GetConversionToMillimeters"] = GeneralReply{float_payload(25.4f)};
    b.texts["GetContextFrameRate"] = GeneralReply{float_payload(120.0f)};
    b.texts["GetUpAxis"] = GeneralReply{int_payload(1)};
  });
  ClientOptions o = options();
  o.request_timeout = milliseconds(60);
  o.request_tries = 30;  // enough even if the host stalls
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  const MocapHost host = client.events().ups()[0];
  EXPECT_TRUE(has(host, "length unit is 25.4"));
  EXPECT_EQ(host.up_axis, 'y');
  EXPECT_EQ(host.frame_rate_hz, 120.0);
  EXPECT_NE(host.description.find("3 bodies"), std::string::npos);
  EXPECT_GT(client.count("stale answers"), 0u);
}

TEST_F(ClientTest, AnswersOfAWrongTypeArePassedOver) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) { b.junk_first = true; });
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  EXPECT_EQ(client.events().ups()[0].frame_rate_hz, 200.0);
  EXPECT_NE(client.events().ups()[0].description.find("3 bodies"), std::string::npos);
  ASSERT_FALSE(client.events().comments().empty());
  EXPECT_EQ(client.events().comments()[0], "Cortex says: wait for it");
}

TEST_F(ClientTest, PacketsOfOthersAreIgnored) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  const std::uint64_t before = client.count("foreign datagrams");
  UdpSocket other_address({resolve(own_loopback_address()), 0}, UdpSocket::Share::kNo);
  UdpSocket other_port({resolve(address_), 0}, UdpSocket::Share::kNo);
  const Bytes frame = encode(simple_frame(77));
  send_multicast_over_loopback(other_address);
  other_address.send(frame, host_->client());
  other_address.send(frame, group());
  other_address.send(frame, unicast());
  other_port.send(frame, host_->client());
  EXPECT_TRUE(wait_until([&] { return client.count("foreign datagrams") >= before + 4; }));
  EXPECT_TRUE(client.events().frames().empty());
  host_->stream(simple_frame(77), unicast());  // the same frame, from the host
  EXPECT_TRUE(wait_until([&] { return client.events().frames().size() == 1; }));
}

// While the socket is not read, a stranger sends more than its buffer holds, then the host sends a little.
TEST(Socket, TheKernelRefusesStrangersBeforeTheyTakeRoom) {
  const auto from_host = [](bool hear_only) {
    UdpSocket ours({resolve(own_loopback_address()), 0}, UdpSocket::Share::kNo);
    UdpSocket host({resolve(own_loopback_address()), 0}, UdpSocket::Share::kNo);
    UdpSocket stranger({resolve(own_loopback_address()), 0}, UdpSocket::Share::kNo);
    if (hear_only) {
      EXPECT_TRUE(ours.hear_only(host.local().address().to_v4()));
    }
    for (int i = 0; i < 20000; ++i) {
      stranger.send(Bytes(9, 1), ours.local());
    }
    for (int i = 0; i < 20; ++i) {
      host.send(Bytes(9, 2), ours.local());
    }
    int count = 0;
    Datagram datagram;
    while (ours.receive(datagram)) {
      count += datagram.source == host.local() ? 1 : 0;
    }
    EXPECT_EQ(ours.newly_refused() > 19000u, hear_only);
    ours.hear_all();
    stranger.send(Bytes(9, 1), ours.local());
    EXPECT_TRUE(ours.receive(datagram) && datagram.source == stranger.local());
    return count;
  };
  EXPECT_EQ(from_host(true), 20);
  EXPECT_LT(from_host(false), 20);  // the control arm
}

TEST_F(ClientTest, AFloodOfAStrangerIsCountedAndNamedOnce) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  const std::string elsewhere = own_loopback_address();
  UdpSocket stranger({resolve(elsewhere), 0}, UdpSocket::Share::kNo);
  send_multicast_over_loopback(stranger);
  const Bytes frame = encode(simple_frame(1000000));
  for (std::uint64_t sent = 1; sent <= 200; ++sent) {
    stranger.send(frame, sent % 2 == 0 ? group() : unicast());
    ASSERT_TRUE(wait_until([&] { return client.count("foreign datagrams") >= sent; }));
  }
  std::int32_t number = 1;
  EXPECT_TRUE(stream_until_seen(client, group(), number));
  EXPECT_TRUE(stream_until_seen(client, unicast(), number));
  const std::vector<std::string> told = client.events().feeds();
  EXPECT_EQ(std::count_if(told.begin(), told.end(),
                          [&](const std::string& text) { return text.find(elsewhere) != std::string::npos; }),
            1);
  for (const auto& seen : client.events().frames()) {
    EXPECT_LT(seen.number, 1000000);
  }
}

TEST_F(ClientTest, AHostThatAnswersFromAnotherAddressIsPointedOut) {
  const std::string elsewhere = own_loopback_address();
  const std::uint16_t port = free_port();
  RunningClient client(options(port));
  UdpSocket called({resolve(address_), port}, UdpSocket::Share::kNo);
  UdpSocket answering({resolve(elsewhere), 0}, UdpSocket::Share::kNo);
  EXPECT_TRUE(wait_until([&] {
    Datagram hello;
    if (called.receive(hello)) {
      answering.send(encode(HereIAm{{"Cortex", {1, 5, 3, 1}}}), hello.source);
    }
    return !client.events().problems().empty();
  }));
  EXPECT_NE(client.events().problems()[0].find("'host' to " + elsewhere), std::string::npos);
  EXPECT_TRUE(client.events().ups().empty());
}

TEST_F(ClientTest, MalformedPacketsAreCountedAndChangeNothing) {
  start_host();
  ClientOptions o = options();
  o.mode = Mode::kStream;
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  std::int32_t number = 1;
  ASSERT_TRUE(stream_until_seen(client, group(), number));
  const Bytes good = encode(simple_frame(500000));
  Bytes cut(good.begin(), good.end() - 3);
  Bytes longer = good;
  longer.push_back(0);
  host_->stream(cut, group());
  host_->stream(longer, group());
  host_->stream(Bytes{1, 2}, group());
  host_->stream(Bytes(), group());
  EXPECT_TRUE(wait_until([&] { return client.count("malformed") == 4; }));
  EXPECT_TRUE(wait_until([&] { return client.events().malformed().size() == 4u; }));
  EXPECT_LT(client.events().frames().back().number, 500000);
  EXPECT_TRUE(stream_until_seen(client, group(), number));
}

TEST_F(ClientTest, FaultyOptionalPartsAreCountedAndTheFrameIsUsed) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  Bytes bytes = encode(simple_frame(1));
  const Bytes item = {12, 0, 0, 0, 0xf8, 0xff, 0xff, 0xff};  // length -8
  bytes.insert(bytes.end(), item.begin(), item.end());
  bytes[2] = static_cast<std::uint8_t>(bytes.size() - kHeaderBytes);
  EXPECT_TRUE(wait_until([&] {
    host_->stream(bytes, group());
    std::this_thread::sleep_for(milliseconds(5));
    return !client.events().frames().empty();
  }));
  EXPECT_TRUE(wait_until([&] { return client.count("faulty optional parts") >= 1u; }));
  EXPECT_EQ(client.count("malformed"), 0u);
}

// ---- frames

TEST_F(ClientTest, MulticastStreamReachesSeveralClients) {
  start_host();
  RunningClient first(options());
  RunningClient second(options());
  ASSERT_TRUE(first.up());
  ASSERT_TRUE(second.up());
  std::int32_t number = 1;
  ASSERT_TRUE(stream_until_seen(first, group(), number));
  EXPECT_TRUE(stream_until_seen(second, group(), number));  // it may have joined later
  EXPECT_TRUE(wait_until([&] { return first.status().mode == "stream"; }));
  EXPECT_TRUE(host_->could_send());
}

TEST_F(ClientTest, UnicastStreamIsTakenToo) {
  start_host();
  ClientOptions o = options();
  o.stream_group = "";
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  std::int32_t number = 1;
  EXPECT_TRUE(stream_until_seen(client, unicast(), number));
}

TEST_F(ClientTest, GroupsOfOtherProgramsAreNotHeard) {
  start_host();
  UdpSocket neighbour({Address(), stream_port_}, UdpSocket::Share::kYes);
  neighbour.join(resolve("225.1.1.9"), resolve("127.0.0.1"));
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  for (int i = 0; i < 20; ++i) {
    host_->stream(simple_frame(9000 + i), {resolve("225.1.1.9"), stream_port_});
  }
  std::int32_t number = 1;
  ASSERT_TRUE(stream_until_seen(client, group(), number));
  for (const Recorder::Frame& frame : client.events().frames()) {
    EXPECT_LT(frame.number, 9000);
  }
}

TEST_F(ClientTest, FramesAreHandedOnAsTheyCame) {
  start_host();
  ClientOptions o = options();
  o.mode = Mode::kStream;
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  std::int32_t number = 1000;
  ASSERT_TRUE(stream_until_seen(client, group(), number));
  const std::vector<std::int32_t> numbers = {5000, 5001, 5001, 5004, 5003, 5005, 12, 13};
  for (std::int32_t i : numbers) {
    host_->stream(simple_frame(i), group());
  }
  ASSERT_TRUE(wait_until([&] { return client.events().frames().back().number == 13; }));
  std::vector<std::int32_t> handed_on;
  for (const Recorder::Frame& frame : client.events().frames()) {
    handed_on.push_back(frame.number);
  }
  ASSERT_GE(handed_on.size(), numbers.size());
  handed_on.erase(handed_on.begin(), handed_on.end() - static_cast<std::ptrdiff_t>(numbers.size()));
  EXPECT_EQ(handed_on, numbers);
}

TEST_F(ClientTest, FramesCarryTheKernelsReceiptTime) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  std::int32_t number = 1;
  const Time before = Clock().wall();
  ASSERT_TRUE(stream_until_seen(client, group(), number));
  const Recorder::Frame frame = client.events().frames()[0];
  EXPECT_GE(frame.receipt, before);
  EXPECT_LE(frame.receipt, Clock().wall());
}

TEST_F(ClientTest, PollsWhileNoStreamComesAndReturnsToIt) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  ASSERT_TRUE(wait_until([&] { return client.events().frames().size() >= 5; }));
  EXPECT_EQ(client.status().mode, "poll");
  EXPECT_FALSE(client.status().warnings.empty());
  EXPECT_NE(client.events().feeds().at(0).find("polling"), std::string::npos);
  std::int32_t number = 100000;
  ASSERT_TRUE(wait_until([&] {
    host_->stream(simple_frame(number++), group());
    std::this_thread::sleep_for(milliseconds(3));
    return client.events().feeds().size() >= 2;
  }));
  EXPECT_EQ(client.status().mode, "stream");
}

TEST_F(ClientTest, PollModeUsesNoStream) {
  start_host();
  ClientOptions o = options();
  o.mode = Mode::kPoll;
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return client.events().frames().size() >= 5; }));
  EXPECT_EQ(client.status().mode, "poll");
  EXPECT_NO_THROW(UdpSocket({Address(), stream_port_}, UdpSocket::Share::kNo)) << "the port was not touched";
}

TEST_F(ClientTest, AHostThatStandsStillIsPolledLess) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) { b.advance = false; });
  ClientOptions o = options();
  o.mode = Mode::kPoll;
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return host_->received("12") >= 22; }));
  const auto start = std::chrono::steady_clock::now();
  const int before = host_->received("12");
  std::this_thread::sleep_for(milliseconds(500));
  const int polls = host_->received("12") - before;
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
  EXPECT_LE(polls, 3.0 + 10.0 * elapsed.count()) << "200 Hz would be 100 polls and more";
  EXPECT_EQ(client.events().frames().size(), 1u) << "a poll without news is no frame";
}

TEST_F(ClientTest, PollsThatAreNotAnsweredAreCounted) {
  start_host();
  ClientOptions o = options();
  o.mode = Mode::kPoll;
  o.poll_timeout = milliseconds(20);
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return !client.events().frames().empty(); }));
  host_->change([](FakeHost::Behaviour& b) { b.silent = true; });
  EXPECT_TRUE(wait_until([&] { return client.count("poll time-outs") > 0; }));
  EXPECT_TRUE(wait_until([&] { return !client.events().downs().empty(); }));
  host_->change([](FakeHost::Behaviour& b) { b.silent = false; });
  const std::size_t before = client.events().frames().size();
  EXPECT_TRUE(wait_until([&] { return client.events().frames().size() > before; }));
}

TEST_F(ClientTest, ATakenStreamPortIsExplainedAndPollingGoesOn) {
  start_host();
  const UdpSocket taken({Address(), stream_port_}, UdpSocket::Share::kNo);
  ClientOptions o = options();
  o.mode = Mode::kStream;
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return client.events().frames().size() >= 3; }));
  ASSERT_EQ(client.events().problems().size(), 1u);
  EXPECT_NE(client.events().problems()[0].find(std::to_string(stream_port_)), std::string::npos);
  EXPECT_EQ(client.status().mode, "poll");
}

TEST_F(ClientTest, AStreamThatRunsAlreadyIsEvidenceOfTheHost) {
  start_host();
  host_->change([](FakeHost::Behaviour& b) { b.silent = true; });
  ClientOptions o = options();
  o.request_timeout = milliseconds(10);
  o.local_address = "127.0.0.1";
  o.stream_group = "";
  RunningClient client(o);
  std::int32_t number = 1;
  EXPECT_TRUE(stream_until_seen(client, unicast(), number));
  EXPECT_TRUE(has(client.events().ups()[0], kNoRate));
}

// ---- a network that is not there yet

// 192.0.2.0/24 is reserved for documentation: no computer has an address in it.
TEST_F(ClientTest, AnOwnAddressThatIsMissingIsReportedAndTriedAgain) {
  start_host();
  ClientOptions o = options();
  o.search_patience = milliseconds(100);
  o.local_address = "192.0.2.77";
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return !client.events().downs().empty(); }));
  const std::string problem = client.events().problems().at(0);
  EXPECT_NE(problem.find("192.0.2.77"), std::string::npos) << problem;
  EXPECT_NE(problem.find("'local_address'"), std::string::npos) << problem;
  EXPECT_NE(client.events().downs()[0].find("192.0.2.77"), std::string::npos);
  EXPECT_NE(client.status().why_down.find("192.0.2.77"), std::string::npos);
  EXPECT_FALSE(client.status().up);
  // Meanwhile a stream can be received, but no request can be sent.
  for (int i = 0; i < 20; ++i) {
    host_->stream(simple_frame(i), unicast());
    std::this_thread::sleep_for(milliseconds(5));
  }
  EXPECT_TRUE(wait_until([&] { return client.count("before the unit was known") > 0u; }));
  EXPECT_EQ(client.events().problems().size(), 1u) << "reported once";
  EXPECT_TRUE(client.events().ups().empty());
}

TEST_F(ClientTest, ANameThatDoesNotResolveIsReportedAndTriedAgain) {
  ClientOptions o = options(free_port());
  o.search_patience = milliseconds(100);
  o.host = "cortex.invalid";  // RFC 2606: never resolves
  RunningClient client(o);
  ASSERT_TRUE(wait_until([&] { return !client.events().downs().empty(); }));
  EXPECT_NE(client.events().problems().at(0).find("cortex.invalid"), std::string::npos);
  EXPECT_EQ(client.status().host, "cortex.invalid:" + std::to_string(o.command_port));
}

TEST(Resolve, NumbersAreADottedQuadOrNothing) {
  EXPECT_EQ(resolve("127.0.0.1").to_string(), "127.0.0.1");
  for (const char* text : {"192.168.1.300", "10.1", "10.0.0", "3232235521"}) {
    EXPECT_THROW(resolve(text), NetworkError) << text;
  }
}

// ---- ending, options

TEST_F(ClientTest, StopsPromptly) {
  start_host();
  for (std::uint16_t port : {host_->port(), free_port()}) {
    RunningClient client(options(port));
    std::this_thread::sleep_for(milliseconds(30));
    const auto start = std::chrono::steady_clock::now();
    client.stop();
    EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(5))
        << "no time-out is waited for";
  }
}

TEST_F(ClientTest, PausesTheHostAtTheEndOnRequest) {
  start_host();
  ClientOptions o = options();
  o.pause_on_exit = true;
  RunningClient client(o);
  ASSERT_TRUE(client.up());
  client.stop();
  EXPECT_TRUE(wait_until([&] { return host_->received("Pause") >= 1; }));
}

TEST_F(ClientTest, DoesNotPauseTheHostUnasked) {
  start_host();
  RunningClient client(options());
  ASSERT_TRUE(client.up());
  client.stop();
  EXPECT_EQ(host_->received("Pause"), 0);
}

TEST_F(ClientTest, BadOptionsAreRefusedWithAReason) {
  const Clock clock;
  Recorder events;
  const auto refuse = [&](const std::function<void(ClientOptions&)>& spoil,
                          const std::string& part_of_message) {
    ClientOptions o = options(free_port());
    spoil(o);
    try {
      Client client(o, events, clock);
      ADD_FAILURE() << "accepted: " << part_of_message;
    } catch (const std::exception& error) {
      EXPECT_NE(std::string(error.what()).find(part_of_message), std::string::npos) << error.what();
    }
  };
  refuse([](ClientOptions& o) { o.stream_group = "10.0.0.1"; }, "not a multicast address");
  refuse([](ClientOptions& o) { o.stream_group = "group.invalid"; }, "not a multicast address");
  const double infinity = std::numeric_limits<double>::infinity();
  for (double rate_hz : {0.0, 0.999, 5e-324, 10001.0, 1e300, -200.0, infinity, -infinity, std::nan("")}) {
    refuse([rate_hz](ClientOptions& o) { o.frame_rate_hz = rate_hz; }, "frame rate");
  }
  EXPECT_EQ(mode_from_text("poll"), Mode::kPoll);
  EXPECT_THROW(mode_from_text("steam"), std::invalid_argument);
  EXPECT_EQ(host_from_text("cortex-pc"), "cortex-pc");
  EXPECT_EQ(host_from_text("broadcast"), ClientOptions().host) << "which discovers";
  EXPECT_THROW(host_from_text(""), std::invalid_argument);
}

// In simulated time: the hello is repeated with growing pauses.
TEST_F(ClientTest, HellosAreSentWithBackOff) {
  class HandClock : public Clock {
   public:
    Time monotonic() const override { return now; }
    Time wall() const override { return now; }
    Time now = std::chrono::seconds(100);
  };
  const std::uint16_t port = free_port();
  UdpSocket nobody({resolve(address_), port}, UdpSocket::Share::kNo);
  HandClock clock;
  Recorder events;
  ClientOptions o = options(port);
  o.hello_interval = milliseconds(100);
  o.hello_interval_max = milliseconds(1600);
  o.search_patience = milliseconds(1500);
  Client client(o, events, clock);
  std::vector<std::int64_t> sent_ms;
  for (int ms = 0; ms <= 6500; ms += 10) {
    clock.now = std::chrono::seconds(100) + milliseconds(ms);
    client.step(Time{0});
    Datagram hello;
    while (nobody.receive(hello)) {
      sent_ms.push_back(ms);
    }
    EXPECT_EQ(events.downs().size(), ms < 1500 ? 0u : 1u) << ms;
  }
  EXPECT_EQ(sent_ms, (std::vector<std::int64_t>{0, 100, 300, 700, 1500, 3100, 4700, 6300}));
}

}  // namespace
