// Packets as JSON text, one object each, in the wire's own units. Nothing flies on it.
#pragma once

#include <string>

#include "cortex_ros/protocol.hpp"

namespace cortex_ros {

// One line without a newline. "type" names the packet. A missing marker is null, and so is a number that JSON
// cannot hold (NaN, infinity). Single-precision values are printed with the digits of their exact value. In
// strings valid UTF-8 passes; a byte that is not part of it becomes the code point of the same number (U+0080
// to U+00FF), so that the result is valid JSON whatever the wire brought.
std::string to_json(const Packet& packet);

// {"error": message}
std::string error_json(const std::string& message);

}  // namespace cortex_ros
