// libFuzzer target. Any bytes either decode or raise ProtocolError, and what decodes survives the round trip.
//
// Build and run with run.sh, under the address and undefined-behaviour sanitizers.

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>

#include "cortex_ros/json.hpp"
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

std::optional<Packet> try_decode(const std::uint8_t* data, std::size_t size) {
  try {
    return cortex_ros::decode(data, size);
  } catch (const cortex_ros::ProtocolError& error) {
    require(error.what()[0] != '\0', "an error has a message");
    return std::nullopt;
  }
}

// Counts that a consumer would loop over agree with what is stored.
void check_counts(const cortex_ros::FrameOfData& frame) {
  const auto product = [](std::int32_t a, std::int32_t b) {
    require(a >= 0 && b >= 0, "counts are not negative");
    return static_cast<std::uint64_t>(a) * static_cast<std::uint64_t>(b);
  };
  require(frame.bodies.size() <= cortex_ros::kMaxBodies, "number of bodies");
  require(product(frame.analog.channels, frame.analog.sample_count) == frame.analog.samples.size(),
          "analog samples");
  require(product(frame.forces.plates, frame.forces.sample_count) == frame.forces.samples.size(),
          "force samples");
  require(frame.delay || frame.items.empty(), "items only after a delay");
}

void check_round_trip(Packet packet) {
  if (auto* frame = std::get_if<cortex_ros::FrameOfData>(&packet)) {
    check_counts(*frame);
    frame->faults.clear();  // what was dropped is not encoded, so it cannot come back
  }
  const Bytes bytes = cortex_ros::encode(packet);
  const Packet again = cortex_ros::decode(bytes);  // a ProtocolError here ends the run: a finding
  require(cortex_ros::to_json(packet) == cortex_ros::to_json(again),
          "decode, encode, decode gives the same values");
  require(cortex_ros::encode(again) == bytes, "encoding is stable to the bit");
}

void check(const Bytes& bytes) {
  if (const std::optional<Packet> packet = try_decode(bytes.data(), bytes.size())) {
    check_round_trip(*packet);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // A copy on the heap, as long as the packet: reading one byte too many is seen.
  Bytes bytes(data, data + size);
  check(bytes);
  // Nearly every mutation breaks the length field. With the right one the inner parts are reached as well.
  const bool repairable = size >= cortex_ros::kHeaderBytes && size <= cortex_ros::kMaxDatagramBytes;
  if (repairable && cortex_ros::declared_size(data, size) != size) {
    const std::size_t payload = size - cortex_ros::kHeaderBytes;
    bytes[2] = static_cast<std::uint8_t>(payload & 0xff);
    bytes[3] = static_cast<std::uint8_t>(payload >> 8);
    check(bytes);
  }
  return 0;
}
