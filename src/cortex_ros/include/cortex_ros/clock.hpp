// Clock interface for motion-capture sources: injected, so that tests need not wait.
#pragma once

#include <chrono>

namespace cortex_ros {

// A duration, or a time since the epoch of its clock.
using Time = std::chrono::nanoseconds;

class Clock {
 public:
  virtual ~Clock() = default;
  // For time-outs: never steps.
  virtual Time monotonic() const {
    return std::chrono::duration_cast<Time>(std::chrono::steady_clock::now().time_since_epoch());
  }
  // Since 1970: the time base of ROS stamps.
  virtual Time wall() const {
    return std::chrono::duration_cast<Time>(std::chrono::system_clock::now().time_since_epoch());
  }
};

inline double to_seconds(Time time) {
  return std::chrono::duration<double>(time).count();
}

// Rounds towards zero. For less than 292 years.
inline Time from_seconds(double seconds) {
  return std::chrono::duration_cast<Time>(std::chrono::duration<double>(seconds));
}

}  // namespace cortex_ros
