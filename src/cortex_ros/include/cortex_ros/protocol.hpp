// The Cortex ethernet protocol (SDK2 family) as a client of its frames needs it: bytes <-> values. No
// sockets, no clock, no ROS. Every packet with all that is in it: cortex_ros.wire (Python).
//
// One datagram is one packet: u16 command, u16 payload length, payload; little-endian, packed, unaligned.
// decode() believes nothing: every length is checked against the bytes that are there before it is used, and
// a packet that does not hold together is refused whole with a ProtocolError that names what is wrong. The
// only parts that may fail on their own are the optional ones at the end of a frame (see
// FrameOfData::faults).
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

// Who speaks: program name and {program id, major, minor, bugfix}.
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
  std::size_t bodies = 0;  // that the host defines; their definitions are not looked at
};
// Raw answer; what it means depends on the request. See as_float() and as_int().
struct GeneralReply {
  Bytes payload;
};
// Whatever a host sends along with these is not judged.
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

// One frame of motion capture. What else it may hold (segments, degrees of freedom, analog samples, forces,
// tagged items) is checked for its length and passed over.
struct FrameOfData {
  std::int32_t frame = 0;
  std::vector<Body> bodies;
  std::vector<Marker> unidentified;
  std::optional<float> delay_s;  // exposure to sending, as the host says it: may be nonsense, or absent

  // Optional parts that do not hold together, one text each. The bodies in front of them are good. Not on the
  // wire.
  std::vector<std::string> faults;
};

// What a client does not ask for.
struct OtherPacket {
  std::uint16_t command = 0;
  Bytes payload;
};

using Packet = std::variant<HelloWorld, HereIAm, Comment, BodyDefs, FrameOfData, GeneralReply,
                            UnrecognizedRequest, UnrecognizedCommand, OtherPacket>;

// Decodes exactly one packet that fills the whole buffer. Throws ProtocolError.
Packet decode(const std::uint8_t* data, std::size_t size);

// What a client sends, one datagram each: hello, a request without arguments (body definitions, frame), a
// text request, e.g. "LiveMode". Throws ProtocolError for what is too long.
Bytes encode_hello(const Identity& identity);
Bytes encode_request(Command command);
Bytes encode_text_request(const std::string& text);

// The usual contents of a GeneralReply; empty when the payload is too short.
std::optional<float> as_float(const GeneralReply& reply);
std::optional<std::int32_t> as_int(const GeneralReply& reply);

}  // namespace cortex_ros
