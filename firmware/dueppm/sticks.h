// From accepted commands to the channels of a frame: slew limit, failsafe, throttle lock. The timer's
// interrupt does one step a frame, so the failsafe also works when loop() hangs.
#pragma once

#include "bytes.h"

namespace dueppm {

constexpr int32_t kTicksPerUs = 42;  // timer counter 0 runs at MCK / 2 = 42 MHz

enum Stick { kRoll, kPitch, kThrottle, kYaw, kSticks };

enum class State : uint8_t { kWaiting = 0, kLocked = 1, kFlying = 2, kFailsafe = 3 };  // numbers of PpmStatus

inline int32_t within(int32_t value, int32_t least, int32_t most) {
  return value < least ? least : value > most ? most : value;
}

template <class C>
class Sticks {
 public:
  static_assert(C::kRollChannel >= 1 && C::kRollChannel <= C::kChannels, "kRollChannel: 1 to kChannels");
  static_assert(C::kPitchChannel >= 1 && C::kPitchChannel <= C::kChannels, "kPitchChannel: 1 to kChannels");
  static_assert(C::kThrottleChannel >= 1 && C::kThrottleChannel <= C::kChannels,
                "kThrottleChannel: 1 to kChannels");
  static_assert(C::kYawChannel >= 1 && C::kYawChannel <= C::kChannels, "kYawChannel: 1 to kChannels");
  static_assert(C::kRollChannel != C::kPitchChannel && C::kRollChannel != C::kThrottleChannel &&
                    C::kRollChannel != C::kYawChannel && C::kPitchChannel != C::kThrottleChannel &&
                    C::kPitchChannel != C::kYawChannel && C::kThrottleChannel != C::kYawChannel,
                "two sticks on one channel");
  static_assert(C::kFailsafeMs * 1000 >= 4 * C::kFrameUs, "kFailsafeMs: at least four frames");
  static_assert(C::kFailsafeMs <= 2000, "kFailsafeMs: at most 2000");
  static_assert(C::kSlewUsPerS >= 500 && C::kSlewUsPerS <= 60000, "kSlewUsPerS: 500 to 60000");
  static_assert(C::kFailsafeThrottleUs >= C::kShortestUs && C::kFailsafeThrottleUs <= C::kLongestUs,
                "kFailsafeThrottleUs: kShortestUs to kLongestUs");
  // Otherwise the failsafe, and a board that waits for its first message, would command thrust.
  static_assert(C::kThrottleTravelUs > 0 ? C::kFailsafeThrottleUs <= C::kCentreUs - C::kThrottleTravelUs
                                         : C::kThrottleTravelUs < 0 &&
                                               C::kFailsafeThrottleUs >= C::kCentreUs - C::kThrottleTravelUs,
                "kFailsafeThrottleUs: at the throttle's lowest end or beyond it; with a reversed throttle "
                "(negative kThrottleTravelUs) that is at least kCentreUs - kThrottleTravelUs");

  static constexpr int32_t kSlewTicks =
      static_cast<int32_t>(int64_t{C::kSlewUsPerS} * kTicksPerUs * C::kFrameUs / 1000000);
  // One frame less than in kFailsafeMs, because a message arrives up to one frame before a frame uses it.
  static constexpr int32_t kFailsafeFrames = C::kFailsafeMs * 1000 / C::kFrameUs - 1;
  static constexpr double kLowest = -0.95;  // a throttle at or below this unlocks the throttle

  Sticks() : goals_(), published_(0), seen_(0), silent_frames_(0), locked_(true), state_(State::kWaiting) {
    for (int i = 0; i < kSticks; ++i) now_[i] = rest(i);
  }

  // Called by loop(): takes new commands, fractions of the sticks' travel.
  void follow(const double (&fractions)[kSticks]) {
    const uint32_t next = published_ + 1;  // only written here
    Goal& goal = goals_[next & 1];         // not the one that the interrupt may read now
    for (int i = 0; i < kSticks; ++i) goal.ticks[i] = ticks(i, fractions[i]);
    goal.lowest = fractions[kThrottle] <= kLowest;
    __atomic_store_n(&published_, next, __ATOMIC_RELEASE);  // from here on the interrupt uses it, as a whole
  }

  // Called by the interrupt when a frame begins: computes its channels, in ticks.
  void step(int32_t (&channels)[C::kChannels]) {
    const uint32_t published = __atomic_load_n(&published_, __ATOMIC_ACQUIRE);
    const Goal& goal = goals_[published & 1];
    if (published != seen_) {
      seen_ = published;
      silent_frames_ = 0;
    } else if (silent_frames_ < kFailsafeFrames) {
      ++silent_frames_;
    }
    state_ = next_state(goal.lowest);
    for (int i = 0; i < kSticks; ++i) {
      int32_t wanted = state_ == State::kFlying ? goal.ticks[i] : rest(i);
      if (state_ == State::kFailsafe && C::kFailsafeHolds && i == kThrottle) wanted = now_[i];
      now_[i] += within(wanted - now_[i], -kSlewTicks, kSlewTicks);
    }
    // The vehicle may have fallen or landed by now: lock until a message commands the lowest throttle.
    if (state_ == State::kFailsafe && !C::kFailsafeHolds && now_[kThrottle] == rest(kThrottle))
      locked_ = true;
    for (int i = 0; i < C::kChannels; ++i) channels[i] = C::kCentreUs * kTicksPerUs;
    for (int i = 0; i < kSticks; ++i) channels[channel(i)] = now_[i];
  }

  State state() const { return state_; }

  // Channel time, in ticks, of a stick at a fraction of its travel.
  static int32_t ticks(int stick, double fraction) {
    const double offset = fraction * (travel_us(stick) * kTicksPerUs);
    return C::kCentreUs * kTicksPerUs + static_cast<int32_t>(offset < 0 ? offset - 0.5 : offset + 0.5);
  }

 private:
  struct Goal {
    int32_t ticks[kSticks];
    bool lowest;
  };

  State next_state(bool lowest) {
    if (seen_ == 0) return State::kWaiting;
    if (silent_frames_ >= kFailsafeFrames) return State::kFailsafe;
    if (lowest) locked_ = false;
    return locked_ ? State::kLocked : State::kFlying;
  }

  static int32_t rest(int stick) {
    return (stick == kThrottle ? C::kFailsafeThrottleUs : C::kCentreUs) * kTicksPerUs;
  }

  static int channel(int stick) {
    return (stick == kRoll       ? C::kRollChannel
            : stick == kPitch    ? C::kPitchChannel
            : stick == kThrottle ? C::kThrottleChannel
                                 : C::kYawChannel) -
           1;
  }

  static int32_t travel_us(int stick) {
    return stick == kRoll       ? C::kRollTravelUs
           : stick == kPitch    ? C::kPitchTravelUs
           : stick == kThrottle ? C::kThrottleTravelUs
                                : C::kYawTravelUs;
  }

  Goal goals_[2];       // written by loop()
  uint32_t published_;  // number of goals so far; the newest is goals_[published_ & 1]
  uint32_t seen_;       // this and all below are written by the interrupt
  int32_t silent_frames_;
  int32_t now_[kSticks];
  bool locked_;
  volatile State state_;  // one byte, so that loop() reads it atomically
};

}  // namespace dueppm
