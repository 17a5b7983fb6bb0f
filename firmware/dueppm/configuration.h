// All settings that a lab may want to change. Inconsistent settings do not compile.
#pragma once

#include <stdint.h>

namespace dueppm {

struct Configuration {
  // The signal. Times in microseconds; the frame length is constant, the sync gap fills what the channels
  // leave.
  static constexpr int kChannels = 4;          // 4 to 8
  static constexpr int32_t kFrameUs = 20000;   // 20000 to 22500
  static constexpr int32_t kPulseUs = 250;     // 250 to 400, part of each channel time
  static constexpr bool kPulseHigh = false;    // false: pulses are low, the line idles high
  static constexpr int32_t kShortestUs = 900;  // no channel is ever shorter ...
  static constexpr int32_t kLongestUs = 2100;  // ... or longer

  // Channel number of each stick, from 1. Channels without a stick stay at kCentreUs.
  static constexpr int kRollChannel = 1;
  static constexpr int kPitchChannel = 2;
  static constexpr int kThrottleChannel = 3;
  static constexpr int kYawChannel = 4;

  // The channel time of a stick at the fraction f is kCentreUs + f * its travel. A negative travel reverses
  // the channel; a reversed throttle needs another kFailsafeThrottleUs.
  static constexpr int32_t kCentreUs = 1500;
  static constexpr int32_t kRollTravelUs = 500;
  static constexpr int32_t kPitchTravelUs = 500;
  static constexpr int32_t kThrottleTravelUs = 500;
  static constexpr int32_t kYawTravelUs = 500;

  // Which messages are accepted.
  static constexpr const char* kVehicle = "";    // the `name` in controls; "": the one in the first accepted
                                                 // message, until the reset
  static constexpr double kFractionMax = 1.001;  // a message with a larger fraction is refused
  static constexpr double kJump = 0.25;  // a larger change is accepted when the next message confirms it
  static constexpr int32_t kSlewUsPerS = 5000;  // no channel changes faster
  static constexpr int32_t kFailsafeMs = 500;   // time without an accepted message until the failsafe

  // The throttle in failsafe and before the first message; the other sticks go to their centre. An autopilot
  // treats a throttle below its own limit (ArduCopter's FS_THR_VALUE: 975 us) as a lost radio, and lands.
  // Must be at the throttle's lowest end or beyond it: 2050 if the throttle is reversed.
  static constexpr int32_t kFailsafeThrottleUs = 950;
  static constexpr bool kFailsafeHolds = false;  // true: the throttle stays where it was

  // The line to the host computer.
  static constexpr uint32_t kBaud = 57600;
  static constexpr uint32_t kStatusMs = 100;  // between two messages on ppm_status
};

}  // namespace dueppm
