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

// A ProtocolError that comes out of here ends the run: a finding.
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
  // A copy on the heap, as long as the packet: reading one byte too many is seen.
  Bytes bytes(data, data + size);
  check(bytes);
  // Nearly every mutation breaks the length field. With the right one the inner parts are reached as well.
  if (size >= cortex_ros::kHeaderBytes) {
    const std::size_t payload = size - cortex_ros::kHeaderBytes;
    bytes[2] = static_cast<std::uint8_t>(payload & 0xff);
    bytes[3] = static_cast<std::uint8_t>(payload >> 8);
    check(bytes);
  }
  return 0;
}
