// Frames of motion capture to ROS messages.
#pragma once

#include <ros/time.h>

#include "cortex_ros/clock.hpp"
#include "cortex_ros/sources/mocap_source.hpp"
#include "risc_msgs/Mocap_data.h"

namespace cortex_ros {

// What the original release published for a marker that no camera saw: Cortex' sentinel, taken for
// millimetres.
constexpr double kLegacyMissingM = 9999.999;

enum class MissingMarkers { kNan, kLegacyValue };

// The bodies of the frame in their order, every marker in its place. Leaves the header alone.
void fill_markers(const MocapFrame& frame, MissingMarkers missing, risc_msgs::Mocap_data& out);

// Wall time as a ROS stamp; a time before 1970, which a large delay can make of a small clock, becomes zero.
ros::Time to_ros_time(Time wall);

}  // namespace cortex_ros
