// Time for sources of motion capture: handed in, so that tests need not wait.
#pragma once

#include <chrono>
#include <cmath>
#include <limits>

namespace cortex_ros {

// A duration, or a time since the epoch of the clock that it comes from.
using Time = std::chrono::nanoseconds;

class Clock {
 public:
  virtual ~Clock() = default;
  // For time-outs: never steps.
  virtual Time monotonic() const {
    return std::chrono::duration_cast<Time>(std::chrono::steady_clock::now().time_since_epoch());
  }
  // Since 1970: what ROS stamps are made of.
  virtual Time wall() const {
    return std::chrono::duration_cast<Time>(std::chrono::system_clock::now().time_since_epoch());
  }
};

inline double to_seconds(Time time) {
  return std::chrono::duration<double>(time).count();
}

// The nearest Time, towards zero. What does not fit becomes the longest Time of its sign, NaN becomes zero.
inline Time from_seconds(double seconds) {
  constexpr double kNanosecondsPerSecond = 1e9;
  constexpr double kLimit = -static_cast<double>(std::numeric_limits<Time::rep>::min());  // 2^63 exactly
  const double nanoseconds = seconds * kNanosecondsPerSecond;
  if (std::isnan(nanoseconds)) {
    return Time{0};
  }
  if (nanoseconds >= kLimit) {
    return Time::max();
  }
  return nanoseconds <= -kLimit ? Time::min() : Time(static_cast<Time::rep>(nanoseconds));
}

}  // namespace cortex_ros
