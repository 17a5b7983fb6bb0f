// Encodes packets as a host sends them; the counterpart of the decoder. For tests only.
#pragma once

#include "cortex_ros/protocol.hpp"

namespace cortex_ros {

// Encodes a packet as one datagram, without checking its values. Throws ProtocolError above kMaxPayloadBytes.
Bytes encode(const Packet& packet);

}  // namespace cortex_ros
