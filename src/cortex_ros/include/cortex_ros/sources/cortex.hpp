// The Cortex client as a source of motion capture: the parts that have tests of their own.
#pragma once

#include "cortex_ros/client.hpp"
#include "cortex_ros/parameters.hpp"
#include "cortex_ros/protocol.hpp"
#include "cortex_ros/sources/mocap_source.hpp"

namespace cortex_ros {

constexpr double kMetresPerMillimetre = 0.001;

// Parameters: config/sources/cortex.yaml. Throws std::invalid_argument for a bad one.
ClientOptions read_client_options(Parameters& parameters);

// The one place where host units become metres. Overwrites number, delay, bodies and unidentified markers.
// Host axes are kept. The product is taken in double precision: 1000.5 mm is 1.0005 m (the original release
// multiplied in single precision and published 1.0005000829696655).
void to_mocap_frame(const FrameOfData& frame, double metres_per_unit, MocapFrame& out);

}  // namespace cortex_ros
