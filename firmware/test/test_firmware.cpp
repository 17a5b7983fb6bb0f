// Unit tests of the firmware's parts; tests/test_firmware_host.py builds them with sanitizers.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "../dueppm/firmware.h"
#include "messages_of_host.h"

namespace {

using namespace dueppm;
using host::Bytes;

struct Six : Configuration {
  static constexpr int kChannels = 6;
  static constexpr int32_t kFrameUs = 22500;
  static constexpr int32_t kPulseUs = 400;
  static constexpr int kThrottleChannel = 1, kRollChannel = 2, kPitchChannel = 3,
                       kYawChannel = 6;  // channel order TAER, with yaw moved to 6
  static constexpr int32_t kPitchTravelUs = -400;
};
struct Eight : Configuration {
  static constexpr int kChannels = 8;
};
struct Holds : Configuration {
  static constexpr bool kFailsafeHolds = true;
};
struct Reversed : Configuration {
  static constexpr int32_t kThrottleTravelUs = -500;
  static constexpr int32_t kFailsafeThrottleUs = 2050;
};
struct OneVehicle : Configuration {
  static constexpr const char* kVehicle = "IRIS";
};

// --- the frame

template <class C>
struct AnyChannels {
  std::mt19937 random{1};
  void step(int32_t (&channels)[C::kChannels]) {
    for (int32_t& channel : channels) {
      const uint32_t pick = random();
      channel = pick % 4 == 0   ? std::numeric_limits<int32_t>::min()
                : pick % 4 == 1 ? std::numeric_limits<int32_t>::max()
                                : static_cast<int32_t>(random());
    }
  }
};

template <class C>
class Frame : public testing::Test {};
using Configurations = testing::Types<Configuration, Six, Eight>;
TYPED_TEST_SUITE(Frame, Configurations);

TYPED_TEST(Frame, IsWellFormedWhateverItIsGiven) {
  using C = TypeParam;
  PpmFrame<C> frame;
  AnyChannels<C> source;
  for (int i = 0; i < 20000; ++i) {
    int64_t sum = 0;
    for (int channel = 0; channel < C::kChannels; ++channel) {
      const uint32_t ticks = frame.next(source);
      ASSERT_GE(ticks, C::kShortestUs * 42u);
      ASSERT_LE(ticks, C::kLongestUs * 42u);
      sum += ticks;
    }
    const uint32_t gap = frame.next(source);
    ASSERT_GE(gap, 3000u * 42);
    ASSERT_EQ(sum + gap, C::kFrameUs * int64_t{42});
  }
}

template <class C>
std::vector<double> frame_us(PpmFrame<C>& frame, Sticks<C>& sticks) {
  std::vector<double> us;
  for (int i = 0; i < C::kChannels; ++i) us.push_back(frame.next(sticks) / 42.0);
  frame.next(sticks);
  return us;
}

TEST(Frame, HasItsSticksInTheOrderOfTheConfiguration) {
  PpmFrame<Six> frame;
  Sticks<Six> sticks;
  const double low[kSticks] = {0, 0, -1, 0};
  const double there[kSticks] = {0.5, 0.25, -0.5, 1.0};  // roll, pitch, throttle, yaw
  sticks.follow(low);
  frame_us(frame, sticks);
  for (int i = 0; i < 20; ++i) {
    sticks.follow(there);
    frame_us(frame, sticks);
  }
  EXPECT_EQ(frame_us(frame, sticks), (std::vector<double>{1250, 1750, 1400, 1500, 1500, 2000}));
}

TEST(Frame, TakesNewSticksOnlyAsItBegins) {
  PpmFrame<Configuration> frame;
  Sticks<Configuration> sticks;
  const double low[kSticks] = {0, 0, -1, 0};
  const double right[kSticks] = {0.1, 0.1, -1, 0.1};
  sticks.follow(low);
  for (int i = 0; i < 5; ++i) frame.next(sticks);  // a whole frame: 4 channels, gap
  EXPECT_EQ(frame.next(sticks), 1500u * 42);
  sticks.follow(right);  // in the middle of the second one
  EXPECT_EQ(frame.next(sticks), 1500u * 42);
  frame.next(sticks);
  EXPECT_EQ(frame.next(sticks), 1500u * 42);
  frame.next(sticks);
  EXPECT_EQ(frame.next(sticks), 1550u * 42);
}

TEST(Frame, ModeOfTheTimerIsThatOfTheThesisWithItsMissingDigit) {
  EXPECT_EQ(timer_mode(false) & ~(3u << 22), 0x9C400u);  // line 28
  EXPECT_EQ(timer_mode(true) & ~(3u << 22), 0x6C400u);   // line 29, "0" appended
  for (bool high : {false, true}) EXPECT_EQ(timer_mode(high) >> 22 & 3, timer_mode(high) >> 18 & 3);
}

// --- slew limit, failsafe, lock

template <class C>
struct Flight {
  Sticks<C> sticks;
  int32_t channels[C::kChannels];
  double throttle_us() const { return channels[C::kThrottleChannel - 1] / 42.0; }
  double roll_us() const { return channels[C::kRollChannel - 1] / 42.0; }
  void frames(int count) {
    for (int i = 0; i < count; ++i) sticks.step(channels);
  }
  void follow(double roll, double throttle, int frames_long = 1) {
    const double fractions[kSticks] = {roll, 0, throttle, 0};
    for (int i = 0; i < frames_long; ++i) {
      sticks.follow(fractions);
      frames(1);
    }
  }
};

TEST(Sticks, WaitAtFailsafeThrottle) {
  Flight<Configuration> flight;
  flight.frames(100);
  EXPECT_EQ(flight.throttle_us(), 950);
  EXPECT_EQ(flight.roll_us(), 1500);
  EXPECT_EQ(flight.sticks.state(), State::kWaiting);
}

TEST(Sticks, AReversedThrottleIsLowestAtItsLongest) {
  Flight<Reversed> flight;
  flight.frames(100);
  EXPECT_EQ(flight.throttle_us(), 2050);
  flight.follow(0, -1, 10);
  EXPECT_EQ(flight.sticks.state(), State::kFlying);
  EXPECT_EQ(flight.throttle_us(), 2000);
  flight.follow(0, 0.2, 20);
  EXPECT_EQ(flight.throttle_us(), 1400);
  flight.frames(50);
  EXPECT_EQ(flight.sticks.state(), State::kFailsafe);
  EXPECT_EQ(flight.throttle_us(), 2050);
}

TEST(Sticks, ThrottleIsLockedUntilItWasLowest) {
  Flight<Configuration> flight;
  flight.follow(0.5, 0.2, 100);
  EXPECT_EQ(flight.sticks.state(), State::kLocked);
  EXPECT_EQ(flight.throttle_us(), 950);
  EXPECT_EQ(flight.roll_us(), 1500);
  flight.follow(0, -1, 1);
  EXPECT_EQ(flight.sticks.state(), State::kFlying);
  flight.follow(0.5, 0.2, 100);
  EXPECT_EQ(flight.throttle_us(), 1600);
  EXPECT_EQ(flight.roll_us(), 1750);
}

TEST(Sticks, NoChannelChangesFasterThanTheSlewLimit) {
  Flight<Configuration> flight;
  flight.follow(0, -1, 10);
  for (int i = 1; i <= 5; ++i) {
    flight.follow(1, 1);
    EXPECT_EQ(flight.roll_us(), 1500 + 100 * i);
    EXPECT_EQ(flight.throttle_us(), 1000 + 100 * i);
  }
  flight.follow(1, 1, 10);
  EXPECT_EQ(flight.roll_us(), 2000);
}

TEST(Sticks, FailsafeComesWithinHalfASecondAndNotBefore480Milliseconds) {
  Flight<Configuration> flight;
  flight.follow(0.5, -1, 10);
  flight.frames(23);
  EXPECT_EQ(flight.sticks.state(), State::kFlying);
  flight.frames(1);  // begins 480 ms after the frame that saw the message
  EXPECT_EQ(flight.sticks.state(), State::kFailsafe);
  flight.frames(10);
  EXPECT_EQ(flight.roll_us(), 1500);
}

TEST(Sticks, AfterAFailsafeTheThrottleDoesNotJumpBack) {
  Flight<Configuration> flight;
  flight.follow(0, -1, 10);
  flight.follow(0, 0.2, 20);
  flight.frames(50);
  EXPECT_EQ(flight.throttle_us(), 950);
  flight.follow(0.5, 0.2, 50);  // the link is back, with the same command as before
  EXPECT_EQ(flight.sticks.state(), State::kLocked);
  EXPECT_EQ(flight.throttle_us(), 950);
  EXPECT_EQ(flight.roll_us(), 1500);
  flight.follow(0, -1);
  flight.follow(0, 0.2);
  EXPECT_EQ(flight.throttle_us(), 1100);  // 950, 1000, then the slew limit
}

TEST(Sticks, AFailsafeThatEndsBeforeTheThrottleIsDownGoesOn) {
  Flight<Configuration> flight;
  flight.follow(0, -1, 10);
  flight.follow(0, 0.2, 20);
  flight.frames(26);  // three of them in failsafe
  EXPECT_EQ(flight.throttle_us(), 1300);
  flight.follow(0, 0.2);
  EXPECT_EQ(flight.sticks.state(), State::kFlying);
  EXPECT_EQ(flight.throttle_us(), 1400);
}

TEST(Sticks, AHeldThrottleStays) {
  Flight<Holds> flight;
  flight.follow(0, -1, 10);
  flight.follow(0.5, 0.2, 20);
  flight.frames(100);
  EXPECT_EQ(flight.sticks.state(), State::kFailsafe);
  EXPECT_EQ(flight.throttle_us(), 1600);
  EXPECT_EQ(flight.roll_us(), 1500);
  flight.follow(0, -0.2);
  EXPECT_EQ(flight.throttle_us(), 1500);
  EXPECT_EQ(flight.sticks.state(), State::kFlying);
}

// --- which messages are accepted

template <class C>
struct Judge {
  ControlsCheck<C> check;
  uint32_t ms = 0;
  typename ControlsCheck<C>::Verdict operator()(const Bytes& bytes, uint32_t later_ms = 22) {
    ms += later_ms;
    return check.judge(bytes.data(), bytes.size(), ms);
  }
  Judge() {
    (*this)(host::controls(0, 0, 0, -1));
    EXPECT_TRUE((*this)(host::controls(0, 0, 0, -1)).accepted);
  }
};

TEST(Check, RefusesWhatIsNotWithinOne) {
  Judge<Configuration> judge;
  for (double bad : {1.01, -1.01, 4.4, 1e300, std::numeric_limits<double>::infinity(),
                     -std::numeric_limits<double>::infinity(), std::nan("")}) {
    for (const Bytes& message : {host::controls(bad, 0, 0, -1), host::controls(0, bad, 0, -1),
                                 host::controls(0, 0, bad, -1), host::controls(0, 0, 0, bad)}) {
      const auto verdict = judge(message, 1);
      EXPECT_FALSE(verdict.accepted) << bad;
      EXPECT_EQ(verdict.refused, Refusal::kRange) << bad;
    }
  }
  EXPECT_TRUE(judge(host::controls(0, 0, 0, -1.0005)).accepted);  // rounding
  EXPECT_EQ(judge.check.fractions()[kThrottle], -1.0);
}

TEST(Check, RefusesWhatIsNotOneObject) {
  Judge<Configuration> judge;
  const Bytes good = host::controls(0, 0, 0, -1);
  Bytes longer = good;
  longer.push_back(0);
  EXPECT_EQ(judge(longer).refused, Refusal::kFormat);
  for (size_t length = 0; length < good.size(); ++length) {
    EXPECT_EQ(judge(Bytes(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(length))).refused,
              Refusal::kFormat);
  }
  EXPECT_EQ(judge(host::controls(0, 0, 0, -1, "IRIS", 0)).refused, Refusal::kFormat);
  EXPECT_EQ(judge(host::controls(0, 0, 0, -1, "IRIS", 2)).refused, Refusal::kFormat);
  EXPECT_EQ(judge(host::controls(0, 0, 0, -1, std::string(65, 'a'))).refused, Refusal::kFormat);
  Bytes endless = good;
  for (size_t i = 12; i < 16; ++i) endless[i] = 0xff;  // length of frame_id
  EXPECT_EQ(judge(endless).refused, Refusal::kFormat);
}

TEST(Check, BelievesAJumpWhenTheNextMessageConfirmsIt) {
  Judge<Configuration> judge;
  EXPECT_FALSE(judge(host::controls(0, 0, 0, 0)).accepted);
  EXPECT_TRUE(judge(host::controls(0.1, 0, 0, 0.1)).accepted);
  EXPECT_EQ(judge.check.fractions()[kThrottle], 0.1);
}

TEST(Check, ForgetsAJumpThatTheNextMessageDoesNotConfirm) {
  Judge<Configuration> judge;
  EXPECT_EQ(judge(host::controls(0.9, 0, 0, -1)).refused, Refusal::kNothing);
  const auto verdict = judge(host::controls(0.1, 0, 0, -1));
  EXPECT_TRUE(verdict.accepted);
  EXPECT_EQ(verdict.refused, Refusal::kJump);
  EXPECT_FALSE(judge(host::controls(0.9, 0, 0, -1)).accepted);
  EXPECT_FALSE(judge(host::controls(0.5, 0, 0, -1)).accepted) << "another jump does not confirm it";
}

TEST(Check, BelievesAFastRampInTheEnd) {
  Judge<Configuration> judge;
  int accepted = 0;
  for (double roll : {0.3, 0.6, 0.9, 1.0, 1.0}) accepted += judge(host::controls(roll, 0, 0, -1)).accepted;
  EXPECT_EQ(accepted, 2);
  EXPECT_EQ(judge.check.fractions()[kRoll], 1.0);
}

TEST(Check, WantsTwoMessagesAfterASilence) {
  Judge<Configuration> judge;
  for (uint32_t silence_ms : {480u, 501u}) {  // failsafe comes after 480 to 500 ms
    EXPECT_FALSE(judge(host::controls(0, 0, 0, -1), silence_ms).accepted);
    EXPECT_TRUE(judge(host::controls(0, 0, 0, -1), 479).accepted);
  }
}

TEST(Check, BelievesNoOtherVehicleUntilTheReset) {
  const Bytes own = host::controls(0, 0, 0, -1), other = host::controls(0, 0, 0, -1, "Raven");
  Judge<Configuration> judge;
  for (int i = 0; i < 5; ++i) EXPECT_EQ(judge(other).refused, Refusal::kVehicle);
  EXPECT_TRUE(judge(own).accepted);
  EXPECT_EQ(judge(other, 5000).refused, Refusal::kVehicle) << "its own is silent: still another one";
  EXPECT_EQ(judge(other).refused, Refusal::kVehicle);
  ControlsCheck<Configuration> reset;
  EXPECT_FALSE(reset.judge(other.data(), other.size(), 0).accepted);
  EXPECT_TRUE(reset.judge(other.data(), other.size(), 22).accepted);
  ControlsCheck<OneVehicle> configured;
  for (uint32_t ms : {0u, 22u})
    EXPECT_EQ(configured.judge(other.data(), other.size(), ms).refused, Refusal::kVehicle);
}

// --- the whole firmware

template <class C = Configuration>
struct Board {
  Firmware<C> firmware;
  uint32_t ms = 0;
  Bytes sent;
  void send(const Bytes& bytes) {
    for (uint8_t byte : bytes) firmware.receive(byte, ms);
    run(0);
  }
  void run(uint32_t for_ms) {
    uint8_t bytes[64];
    for (uint32_t i = 0; i <= for_ms; ++i) {
      firmware.poll(ms);
      while (size_t count = firmware.send(bytes, sizeof bytes)) sent.insert(sent.end(), bytes, bytes + count);
      if (i < for_ms) ++ms;
    }
  }
  size_t packets(unsigned topic) const {
    size_t found = 0;
    for (size_t i = 0; i + 7 < sent.size(); i += 8 + (sent[i + 2] | sent[i + 3] << 8)) {
      EXPECT_EQ(sent[i], 0xff);
      found += (sent[i + 5] | sent[i + 6] << 8) == static_cast<int>(topic);
    }
    return found;
  }
};

const Bytes kAsk = host::packet(0, {});

TEST(Device, IsSilentUntilItIsAskedAndAnswersEveryTime) {
  Board<> board;
  board.run(3000);
  EXPECT_TRUE(board.sent.empty());
  for (size_t times = 1; times < 5; ++times) {
    board.send(kAsk);
    EXPECT_EQ(board.packets(0), times);
    EXPECT_EQ(board.packets(1), times);
    EXPECT_EQ(board.packets(10), times);
    board.run(50);
  }
}

TEST(Device, TellsItsStatusTenTimesASecondUntilItIsToldToStop) {
  Board<> board;
  board.send(kAsk);
  board.sent.clear();
  board.run(1000);
  EXPECT_EQ(board.packets(125), 10u);
  board.send(host::packet(11, {}));
  board.sent.clear();
  board.run(1000);
  EXPECT_TRUE(board.sent.empty());
}

TEST(Device, AsksForTheTimeAndGivesUpAHostThatNeverAnswers) {
  Board<> board;
  board.send(kAsk);
  board.sent.clear();
  board.run(10000);
  EXPECT_EQ(board.packets(10), 4u);
  board.run(1500);
  board.sent.clear();
  board.run(3000);
  EXPECT_TRUE(board.sent.empty());
}

// How many milliseconds the board's clock lags a host's after a time request. The host answers half of
// `round_trip_ms` after the request. With `asks_again` the board sends another request just before the answer
// arrives, and takes the answer for one to that request.
double behind_ms(uint32_t round_trip_ms, bool asks_again) {
  Board<> board;
  board.send(kAsk);
  Bytes time;
  host::put(time, 1700000000u);
  host::put(time, 123000000u + round_trip_ms / 2 * 1000000u);
  board.run(round_trip_ms);
  if (asks_again) board.send(kAsk);
  board.send(host::packet(10, time));
  board.run(500);  // to the next status and beyond
  board.sent.clear();
  const uint32_t begin_ms = board.ms;
  while (board.packets(125) == 0) board.run(1);
  uint32_t stamp[2];
  std::memcpy(stamp, &board.sent[7 + 4], sizeof stamp);
  const double host_ms = 123.0 + round_trip_ms + 500.0 + (board.ms - begin_ms);
  return host_ms - (1000.0 * (stamp[0] - 1700000000.0) + 1e-6 * stamp[1]);
}

TEST(Device, ItsClockIsTheHostsLessWhatAnAnswerTakesToCome) {
  for (uint32_t round_trip_ms : {2u, 30u, 200u, 900u}) {
    EXPECT_NEAR(behind_ms(round_trip_ms, false), 0.0, 0.01);
    EXPECT_NEAR(behind_ms(round_trip_ms, true), round_trip_ms / 2, 0.01) << "the correction does not matter";
  }
}

TEST(Device, TimeWrapsAfter49Days) {
  Board<> board;
  board.ms = 0xffffffffu - 2000;
  board.run(1);
  board.send(kAsk);
  for (int i = 0; i < 40; ++i) {
    board.send(host::packet(10, Bytes(8, 1)));
    board.sent.clear();
    board.run(100);
    EXPECT_EQ(board.packets(125), 1u) << i;
  }
}

TEST(Device, FindsAPacketBehindDamagedOnes) {
  const Bytes good = host::packet(host::kControls, host::controls(0, 0, 0, -1));
  for (size_t damaged = 0; damaged < good.size(); ++damaged) {
    Board<> board;
    board.send(kAsk);
    Bytes bad = good;
    bad[damaged] ^= 0x10;
    board.send(bad);
    board.send(kAsk);
    board.run(25);  // with a damaged length it may wait for more bytes, 20 ms at most
    EXPECT_EQ(board.packets(0), 2u) << damaged;
  }
}

TEST(Device, TakesTheSecondOfTwoSyncBytes) {
  Board<> board;
  board.send({0xff});
  board.send(kAsk);
  EXPECT_EQ(board.packets(0), 1u);
}

TEST(Device, GivesUpAHalfPacketAfterTwentyMilliseconds) {
  Board<> board;
  board.send(kAsk);
  const Bytes good = host::packet(host::kControls, host::controls(0, 0, 0, -1));
  board.send(Bytes(good.begin(), good.begin() + 40));
  board.run(21);
  board.send(kAsk);
  EXPECT_EQ(board.packets(0), 2u);
}

TEST(Device, KeepsWholePacketsWhenNobodyTakesThem) {
  Board<> board;
  for (uint8_t byte : kAsk) board.firmware.receive(byte, 0);
  for (uint32_t ms = 0; ms < 5000; ++ms) board.firmware.poll(ms);
  board.ms = 5000;
  board.run(0);
  EXPECT_EQ(board.packets(0), 1u);
  EXPECT_GT(board.packets(125), 2u);
  EXPECT_LE(board.sent.size(), 512u);
}

TEST(Interrupt, ThatComesTooLateMakesAPeriodLongerAndIsTold) {
  Board<> board;
  EXPECT_EQ(board.firmware.next_period(0), 1500u * 42);
  EXPECT_EQ(board.firmware.next_period(1500 * 42), 1510u * 42) << "never behind the counter";
  board.send(kAsk);
  board.sent.clear();
  board.run(100);
  ASSERT_EQ(board.packets(125), 1u);
  uint32_t late;
  std::memcpy(&late, &board.sent[board.sent.size() - 5], sizeof late);
  EXPECT_EQ(late, 1u);
}

TEST(Led, SaysEveryState) {
  const auto on_ms = [](State state, bool configured, bool refusing) {
    int on = 0;
    for (uint32_t ms = 0; ms < 1000; ++ms) on += led_is_on(state, configured, refusing, ms);
    return on;
  };
  EXPECT_EQ(on_ms(State::kWaiting, false, false), 50);
  EXPECT_EQ(on_ms(State::kWaiting, true, false), 500);
  EXPECT_EQ(on_ms(State::kLocked, true, false), 500);
  EXPECT_EQ(on_ms(State::kFlying, true, false), 1000);
  EXPECT_EQ(on_ms(State::kFlying, true, true), 200);
  EXPECT_EQ(on_ms(State::kFailsafe, true, true), 500);
}

}  // namespace
