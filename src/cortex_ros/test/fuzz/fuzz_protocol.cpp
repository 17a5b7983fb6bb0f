// libFuzzer target. Any bytes either decode or raise ProtocolError, and what decodes survives the round trip.
//
// Build and run with run.sh, under the address and undefined-behaviour sanitizers.

#include <cstdint>
#include <cstdio>
#include <cstdlib>

#include "cortex_ros/protocol.hpp"
#include "encode.hpp"

namespace {

using cortex_ros::Bytes;
using cortex_ros::Packet;

void require(bool condition, const char* what) {
  if (!condition) {
    std::fprintf(stderr, "property violated: %s\n", what);
    std::abort();
  }
}

// A ProtocolError thrown here ends the run as a finding.
void check_round_trip(const Packet& packet) {
  if (const auto* frame = std::get_if<cortex_ros::FrameOfData>(&packet)) {
    require(frame->bodies.size() <= cortex_ros::kMaxBodies, "number of bodies");
  }
  const Bytes bytes = cortex_ros::encode(packet);
  require(cortex_ros::encode(cortex_ros::decode(bytes.data(), bytes.size())) == bytes,
          "decode, encode, decode gives the same values to the bit");
}

void check(const Bytes& bytes) {
  Packet packet;
  try {
    packet = cortex_ros::decode(bytes.data(), bytes.size());
  } catch (const cortex_ros::ProtocolError& error) {
    require(error.what()[0] != '\0', "an error has a message");
    return;
  }
  check_round_trip(packet);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // A heap copy of exactly the packet's size: the sanitizer detects reading past its end.
  Bytes bytes(data, data + size);
  check(bytes);
  // Nearly every mutation breaks the length field; with a correct one the inner parts are reached, too.
  if (size >= cortex_ros::kHeaderBytes) {
    const std::size_t payload = size - cortex_ros::kHeaderBytes;
    bytes[2] = static_cast<std::uint8_t>(payload & 0xff);
    bytes[3] = static_cast<std::uint8_t>(payload >> 8);
    check(bytes);
  }
  return 0;
}
