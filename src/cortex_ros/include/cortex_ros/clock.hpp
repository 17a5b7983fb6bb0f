// Time for sources of motion capture: handed in, so that tests need not wait.
#pragma once

#include <chrono>

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

// Towards zero. Of less than 292 years.
inline Time from_seconds(double seconds) {
  return std::chrono::duration_cast<Time>(std::chrono::duration<double>(seconds));
}

}  // namespace cortex_ros
