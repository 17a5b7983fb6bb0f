// The Cortex client as a motion-capture source.
#pragma once

#include "cortex_ros/client.hpp"
#include "cortex_ros/parameters.hpp"

namespace cortex_ros {

// Parameters: config/sources/cortex.yaml. Throws std::invalid_argument for a bad one.
ClientOptions read_client_options(Parameters& parameters);

}  // namespace cortex_ros
