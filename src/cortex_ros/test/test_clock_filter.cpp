// Exposure stamps under simulated networks. True exposure times are known, so errors are absolute.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <limits>
#include <random>
#include <vector>

#include "cortex_ros/clock_filter.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using std::chrono::milliseconds;

constexpr Time kPeriod = milliseconds(5);
constexpr Time kDelay = milliseconds(3);
constexpr Time kEpoch = std::chrono::seconds(1700000000);  // a realistic wall time
constexpr int kLockedFrom = 400;                           // frames: two blocks of 0.5 s and a margin

// A host with its own clock rate, and a network with delays.
struct Lab {
  double drift = 0.0;  // [s/s] our clock relative to the host's
  Time jitter = std::chrono::microseconds(200);
  Time bunch{0};          // datagrams pass only at multiples of this; 0: at once
  Time step{0};           // our clock jumps by this ...
  int step_at = 1 << 30;  // ... before this frame
  std::mt19937 random{7};

  Time exposure(int frame) const {
    const double elapsed_ns =
        static_cast<double>(frame) * static_cast<double>(kPeriod.count()) * (1.0 + drift);
    return kEpoch + Time(std::llround(elapsed_ns)) + (frame >= step_at ? step : Time{0});
  }

  Time receipt(int frame) {
    std::uniform_int_distribution<std::int64_t> noise(0, jitter.count());
    const Time arrival = exposure(frame) + kDelay + Time(noise(random));
    if (bunch == Time{0}) {
      return arrival;
    }
    const std::int64_t slot = (arrival.count() + bunch.count() - 1) / bunch.count();
    return Time(slot * bunch.count());
  }
};

struct Outcome {
  std::vector<Time> stamps;
  std::vector<Time> errors;  // stamp - true exposure
  bool locked = false;

  Time worst(int from, int to) const {
    Time worst{0};
    for (int i = from; i < to; ++i) {
      worst = std::max(worst, Time(std::abs(errors[static_cast<std::size_t>(i)].count())));
    }
    return worst;
  }
};

Outcome run(ClockFilter& filter, Lab& lab, int frames) {
  Outcome out;
  for (int i = 0; i < frames; ++i) {
    out.stamps.push_back(filter.stamp(i, lab.receipt(i), kDelay));
    out.errors.push_back(out.stamps.back() - lab.exposure(i));
  }
  out.locked = filter.locked();
  return out;
}

ClockFilter filter_at_200_hz() {
  ClockFilter filter;
  filter.set_period(kPeriod);
  return filter;
}

void expect_increasing(const std::vector<Time>& stamps) {
  for (std::size_t i = 1; i < stamps.size(); ++i) {
    ASSERT_GT(stamps[i].count(), stamps[i - 1].count()) << "frame " << i;
  }
}

TEST(ClockFilter, WithoutAPeriodItIsReceiptMinusDelay) {
  ClockFilter filter;
  EXPECT_EQ(filter.stamp(1, kEpoch, kDelay), kEpoch - kDelay);
  EXPECT_EQ(filter.stamp(2, kEpoch + milliseconds(9), milliseconds(1)), kEpoch + milliseconds(8));
  EXPECT_FALSE(filter.locked());
}

TEST(ClockFilter, QuietNetworkGivesTheExposureTime) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  const Outcome result = run(filter, lab, 4000);
  EXPECT_TRUE(result.locked);
  EXPECT_LE(result.worst(0, 4000), lab.jitter);
  // Once locked, the jitter of single frames is gone; what remains is the leak of the envelope between
  // good frames.
  EXPECT_LE(result.worst(kLockedFrom, 4000), std::chrono::microseconds(100));
  expect_increasing(result.stamps);
}

TEST(ClockFilter, BurstsOfTenMillisecondsAreTakenApart) {
  for (double drift : {0.0, 50e-6, -50e-6}) {
    ClockFilter filter = filter_at_200_hz();
    Lab lab;
    lab.drift = drift;
    lab.bunch = milliseconds(10);
    lab.jitter = Time{0};
    const Outcome result = run(filter, lab, 12000);  // a minute
    EXPECT_TRUE(result.locked);
    EXPECT_GE(result.worst(0, 50), milliseconds(4)) << "the bursts are there";
    // The least wait of all frames, up to 5 ms here, cannot be told from a longer delay. It changes when
    // our clock drifts past the end of a slot, at most once a minute at 50 ppm; all other intervals are
    // those of the cameras.
    EXPECT_LE(result.worst(kLockedFrom, 12000), milliseconds(5) + std::chrono::microseconds(100)) << drift;
    int uneven = 0;
    for (std::size_t i = kLockedFrom; i < 12000; ++i) {
      uneven += std::abs((result.stamps[i] - result.stamps[i - 1] - kPeriod).count()) > 100000 ? 1 : 0;
    }
    EXPECT_LE(uneven, drift == 0.0 ? 0 : 1) << drift;
    expect_increasing(result.stamps);
  }
}

TEST(ClockFilter, RandomBurstsAreTakenApart) {
  for (double drift : {0.0, 50e-6, -50e-6}) {
    ClockFilter filter = filter_at_200_hz();
    Lab lab;
    lab.drift = drift;
    std::mt19937 random(3);
    std::uniform_int_distribution<int> length(1, 4);
    Outcome result;
    Time held_until{0};
    for (int i = 0, left = 0; i < 12000; ++i) {
      // A burst holds some frames until 10 ms after the exposure of its first one; frames between
      // bursts pass.
      if (left == 0) {
        left = length(random);
        held_until = i % 3 == 0 ? lab.exposure(i) + kDelay + milliseconds(10) : Time{0};
      }
      --left;
      result.stamps.push_back(filter.stamp(i, std::max(lab.receipt(i), held_until), kDelay));
      result.errors.push_back(result.stamps.back() - lab.exposure(i));
    }
    EXPECT_TRUE(filter.locked());
    EXPECT_LE(result.worst(kLockedFrom, 12000), std::chrono::microseconds(250)) << "drift " << drift;
    expect_increasing(result.stamps);
  }
}

TEST(ClockFilter, OneStallIsNotAJump) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  std::vector<Time> stamps;
  for (int i = 0; i < 1200; ++i) {
    Time receipt = lab.receipt(i);
    if (i >= 800 && i < 860) {
      receipt = std::max(receipt, lab.exposure(860) + kDelay);  // nothing for 300 ms, then all at once
    }
    stamps.push_back(filter.stamp(i, receipt, kDelay));
    if (i > kLockedFrom) {
      ASSERT_TRUE(filter.locked()) << i;
      ASSERT_LE(std::abs((stamps.back() - lab.exposure(i)).count()), 500000) << i;
    }
  }
  expect_increasing(stamps);
}

TEST(ClockFilter, ForwardStepIsFollowedSoon) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  lab.step = milliseconds(20);
  lab.step_at = 1000;
  const Outcome result = run(filter, lab, 2000);
  EXPECT_LE(result.worst(kLockedFrom, 1000), std::chrono::microseconds(250));
  EXPECT_LE(result.worst(1000, 1040), milliseconds(21)) << "until the step is believed";
  EXPECT_LE(result.worst(1040, 2000), std::chrono::microseconds(300));
  EXPECT_TRUE(result.locked);
  expect_increasing(result.stamps);
}

TEST(ClockFilter, BackwardStepIsFollowedAtOnce) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  lab.step = -milliseconds(20);
  lab.step_at = 1000;
  const Outcome result = run(filter, lab, 2000);
  EXPECT_LE(result.worst(1006, 2000), milliseconds(1));
  EXPECT_LT(result.stamps[1002], result.stamps[1001]) << "the third frame believes it";
}

TEST(ClockFilter, ClockSetBackFarIsAccepted) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  lab.step = -std::chrono::seconds(3600);
  lab.step_at = 1000;
  const Outcome result = run(filter, lab, 2000);
  EXPECT_LE(result.worst(1002, 2000), milliseconds(1)) << "stamps standing still for an hour would be worse";
}

TEST(ClockFilter, NumbersThatRestartStartTheFilterAnew) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  const Outcome before = run(filter, lab, 1000);
  EXPECT_TRUE(before.locked);
  Time last = before.stamps.back();
  for (int i = 0; i < 1000; ++i) {
    // The take restarts 17 ms after the last frame: no multiple of the period.
    const Time exposure = lab.exposure(999) + milliseconds(17) + i * kPeriod;
    const Time stamp = filter.stamp(i, exposure + kDelay, kDelay);
    ASSERT_GT(stamp, last);
    ASSERT_LE(std::abs((stamp - exposure).count()), 1000);
    ASSERT_EQ(filter.locked(), i >= 200) << "two blocks of half a second must agree first, frame " << i;
    last = stamp;
    if (i == 150) {
      i = 199;  // a gap while unlocked does no harm
    }
  }
}

// The operator pauses the host for a moment; afterwards the numbers continue.
TEST(ClockFilter, APauseIsNoticedWithinAFewFrames) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  lab.step = milliseconds(800);
  lab.step_at = 1000;
  const Outcome result = run(filter, lab, 2000);
  EXPECT_LE(result.worst(1006, 2000), milliseconds(1));
  EXPECT_TRUE(result.locked);
  expect_increasing(result.stamps);
}

TEST(ClockFilter, SilenceStartsTheFilterAnew) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  run(filter, lab, 1000);
  EXPECT_TRUE(filter.locked());
  const Time receipt = lab.receipt(999) + std::chrono::seconds(5);
  EXPECT_EQ(filter.stamp(1001, receipt, kDelay), receipt - kDelay);
  EXPECT_FALSE(filter.locked());
}

TEST(ClockFilter, WrongRateFallsBackToReceiptMinusDelay) {
  for (Time period : {milliseconds(10), milliseconds(2)}) {
    ClockFilter filter;
    filter.set_period(period);  // the host really runs at 200 Hz
    Lab lab;
    const Outcome result = run(filter, lab, 4000);
    EXPECT_LE(result.worst(0, 4000), lab.jitter);
    EXPECT_FALSE(result.locked);
    expect_increasing(result.stamps);
  }
}

TEST(ClockFilter, SlightlyWrongRateStaysClose) {
  for (double error : {-0.005, -0.002, -0.001, 0.001, 0.002, 0.005}) {
    ClockFilter filter;
    filter.set_period(Time(std::llround(5e6 * (1.0 + error))));
    Lab lab;
    const Outcome result = run(filter, lab, 6000);
    EXPECT_LE(result.worst(0, 6000), milliseconds(3)) << error;
    expect_increasing(result.stamps);
  }
}

TEST(ClockFilter, LostFramesDoNoHarm) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  std::mt19937 random(11);
  for (int i = 0; i < 4000; ++i) {
    if (random() % 3 == 0) {
      continue;
    }
    const Time stamp = filter.stamp(i, lab.receipt(i), kDelay);
    if (i > kLockedFrom) {
      ASSERT_LE(std::abs((stamp - lab.exposure(i)).count()), 200000) << i;
    }
  }
  EXPECT_TRUE(filter.locked());
}

TEST(ClockFilter, AFalseDelayIsForgotten) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  for (int i = 0; i < 3000; ++i) {
    const Time delay = i == 1000 ? kDelay + milliseconds(40) : kDelay;
    const Time stamp = filter.stamp(i, lab.receipt(i), delay);
    if (i > 1040) {
      ASSERT_LE(std::abs((stamp - lab.exposure(i)).count()), 500000) << i;
    }
  }
  EXPECT_TRUE(filter.locked());
}

TEST(ClockFilter, LargestFrameNumbersAreExact) {
  ClockFilter filter = filter_at_200_hz();
  const std::int32_t first = 2147483647 - 2000;
  for (int i = 0; i <= 2000; ++i) {
    const Time exposure = kEpoch + i * kPeriod;
    ASSERT_LE(std::abs((filter.stamp(first + i, exposure + kDelay, kDelay) - exposure).count()), 1000);
  }
  EXPECT_TRUE(filter.locked());
}

TEST(ClockFilter, TheSamePeriodAgainChangesNothing) {
  ClockFilter filter = filter_at_200_hz();
  Lab lab;
  run(filter, lab, 1000);
  ASSERT_TRUE(filter.locked());
  filter.set_period(kPeriod);
  EXPECT_TRUE(filter.locked());
  filter.set_period(2 * kPeriod);
  EXPECT_FALSE(filter.locked());
}

TEST(FromSeconds, IsInNanoseconds) {
  EXPECT_EQ(from_seconds(0.005), Time(5000000));
  EXPECT_EQ(from_seconds(-1.5), Time(-1500000000));
}

TEST(BelievedDelay, NonsenseIsZero) {
  const double infinity = std::numeric_limits<double>::infinity();
  for (double delay_s : {std::nan(""), infinity, -infinity, -0.001, 0.6, 1e30}) {
    EXPECT_EQ(believed_delay_s(delay_s, 0.5), 0.0) << delay_s;
  }
  EXPECT_EQ(believed_delay_s(0.25, 0.5), 0.25);
  EXPECT_EQ(believed_delay_s(std::nullopt, 0.5), 0.0);
}

}  // namespace
