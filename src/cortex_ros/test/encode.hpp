// Packets as a host sends them, and those of a client: what the decoder reads, written. For tests only.
#pragma once

#include "cortex_ros/protocol.hpp"

namespace cortex_ros {

// One datagram of what the value holds, right or wrong. Throws ProtocolError above kMaxPayloadBytes.
Bytes encode(const Packet& packet);

// The command code that a packet has on the wire.
std::uint16_t command_of(const Packet& packet);

}  // namespace cortex_ros
