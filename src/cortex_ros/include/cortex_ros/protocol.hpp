// The Cortex ethernet protocol (SDK2 family), as far as a client of its frames needs it: bytes <-> values. No
// sockets, no clock, no ROS. The complete codec of all packets is cortex_ros.wire (Python).
//
// One datagram is one packet: u16 command, u16 payload length, payload; little-endian, packed, unaligned.
// decode() trusts no input: every length is checked against the available bytes before it is used, and an
// inconsistent packet is refused as a whole with a ProtocolError that names the fault. Only the optional
// parts at the end of a frame may fail on their own (see FrameOfData::faults).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

namespace cortex_ros {

using Bytes = std::vector<std::uint8_t>;

constexpr std::size_t kHeaderBytes = 4;
constexpr std::size_t kMaxPayloadBytes = 65503;  // what a UDP/IPv4 datagram carries, less the header
constexpr std::size_t kMaxBodies = 100;
constexpr std::size_t kMaxBodyNameBytes = 127;  // without the NUL
constexpr std::size_t kProgramNameBytes = 128;  // fixed field, NUL inside
constexpr std::uint8_t kCortexProgramId = 1;    // first version byte of a Cortex host
constexpr float kMissingCoordinate =
    9999999.0f;  // "no camera saw this marker", in x (hosts put it in y, z too)

// A packet that cannot be decoded, or a value that cannot be encoded. what() says which field and why.
class ProtocolError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

enum class Command : std::uint16_t {
  kHelloWorld = 0,
  kHereIAm = 2,
  kComment = 3,
  kRequestBodyDefs = 10,
  kBodyDefs = 11,
  kRequestFrame = 12,
  kFrameOfData = 13,
  kGeneralRequest = 14,
  kGeneralReply = 15,
  kUnrecognizedRequest = 16,
  kUnrecognizedCommand = 0x5678,
};

// Identity of a program: its name and {program id, major, minor, bugfix}.
struct Identity {
  std::string name;
  std::array<std::uint8_t, 4> version{};
};

struct HelloWorld {
  Identity identity;
};
struct HereIAm {
  Identity identity;
};
struct Comment {
  std::string text;
};
struct BodyDefs {
  std::size_t bodies = 0;  // number of bodies that the host defines; the definitions are not decoded
};
// Raw answer; what it means depends on the request. See as_float() and as_int().
struct GeneralReply {
  Bytes payload;
};
// The payload of these is ignored.
struct UnrecognizedRequest {};
struct UnrecognizedCommand {};

// Position in the host's length unit (by default mm) and the host's axes.
struct Marker {
  float x = 0.0f;
  float y = 0.0f;
  float z = 0.0f;
  bool missing() const;  // sentinel in x, or any coordinate not finite
};
struct Body {
  std::string name;
  std::vector<Marker> markers;
};

// One frame of motion capture. Other contents (segments, degrees of freedom, analog samples, forces, tagged
// items) are checked for their length and skipped.
struct FrameOfData {
  std::int32_t frame = 0;
  std::vector<Body> bodies;
  std::vector<Marker> unidentified;
  std::optional<float> delay_s;  // exposure to sending, as reported by the host: may be nonsense, or absent

  // Faults of optional parts, one text each. The bodies in front of them are good. Not on the wire.
  std::vector<std::string> faults;
};

// Any packet that a client does not need.
struct OtherPacket {
  std::uint16_t command = 0;
  Bytes payload;
};

using Packet = std::variant<HelloWorld, HereIAm, Comment, BodyDefs, FrameOfData, GeneralReply,
                            UnrecognizedRequest, UnrecognizedCommand, OtherPacket>;

// Decodes exactly one packet that fills the whole buffer. Throws ProtocolError.
Packet decode(const std::uint8_t* data, std::size_t size);

// Packets that a client sends, one datagram each: hello, a request without arguments (body definitions,
// frame), a text request, e.g. "LiveMode". Throws ProtocolError if the content is too long.
Bytes encode_hello(const Identity& identity);
Bytes encode_request(Command command);
Bytes encode_text_request(const std::string& text);

// The usual contents of a GeneralReply; empty when the payload is too short.
std::optional<float> as_float(const GeneralReply& reply);
std::optional<std::int32_t> as_int(const GeneralReply& reply);

}  // namespace cortex_ros
