// Packets as a host sends them: what the decoder reads, written. For tests only.
#pragma once

#include "cortex_ros/protocol.hpp"

namespace cortex_ros {

// One datagram of what the value holds, right or wrong. Throws ProtocolError above kMaxPayloadBytes.
Bytes encode(const Packet& packet);

}  // namespace cortex_ros
