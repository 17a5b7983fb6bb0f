// Frames of data to ROS messages: the one place where host units become metres.
#pragma once

#include <ros/time.h>

#include "cortex_ros/clock.hpp"
#include "cortex_ros/protocol.hpp"
#include "risc_msgs/Mocap_data.h"

namespace cortex_ros {

constexpr double kMetresPerMillimetre = 0.001;
// What the original release published for a marker that no camera saw: the host's sentinel, taken for
// millimetres.
constexpr double kLegacyMissingM = 9999.999;

enum class MissingMarkers { kNan, kLegacyValue };

// The bodies of the frame in their order, every marker in its place. Host axes are kept. Leaves the header
// alone. The product is taken in double precision: 1000.5 mm is 1.0005 m (the original release multiplied in
// single precision and published 1.0005000829696655).
void fill_markers(const FrameOfData& frame, double metres_per_unit, MissingMarkers missing,
                  risc_msgs::Mocap_data& out);

// Wall time as a ROS stamp; a time before 1970, which a large delay can make of a small clock, becomes zero.
ros::Time to_ros_time(Time wall);

}  // namespace cortex_ros
