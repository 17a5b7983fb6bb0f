// The Cortex ethernet protocol (SDK2 family): bytes <-> values. No sockets, no clock, no ROS.
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
constexpr std::size_t kMaxDatagramBytes = kHeaderBytes + kMaxPayloadBytes;
constexpr std::size_t kMaxBodies = 100;
constexpr std::size_t kMaxBodyNameBytes = 127;     // without the NUL
constexpr std::size_t kMaxCaptureNameBytes = 255;  // without the NUL
constexpr std::size_t kProgramNameBytes = 128;     // fixed field, NUL inside
constexpr std::int32_t kTagAngleEncoders = 11;     // of the items that may follow a frame
constexpr std::int32_t kTagRecordingStatus = 12;
constexpr std::int32_t kTagLensEncoders = 13;
constexpr std::uint8_t kCortexProgramId = 1;  // first version byte of a Cortex host
constexpr float kMissingCoordinate =
    9999999.0f;  // "no camera saw this marker", in x (hosts put it in y, z too)

// A packet that cannot be decoded, or a value that cannot be encoded. what() says which field and why.
class ProtocolError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

enum class Command : std::uint16_t {
  kHelloWorld = 0,
  kAreYouThere = 1,
  kHereIAm = 2,
  kComment = 3,
  kRequestBodyDefs = 10,
  kBodyDefs = 11,
  kRequestFrame = 12,
  kFrameOfData = 13,
  kGeneralRequest = 14,
  kGeneralReply = 15,
  kUnrecognizedRequest = 16,
  kPushBasePosition = 17,
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
// The document knows no payload for the next one, nor for the two "unrecognized" answers. Whatever a host
// sends along is kept, not judged.
struct AreYouThere {
  Bytes payload;
};
struct UnrecognizedRequest {
  Bytes payload;
};
struct UnrecognizedCommand {
  Bytes payload;
};
struct Comment {
  std::string text;
};
struct RequestBodyDefs {};
struct RequestFrame {};

// Text command, e.g. "LiveMode" or "SetOutputName=take_7".
struct GeneralRequest {
  std::string text;
};
// Raw answer; what it means depends on the request. See as_float() and as_int().
struct GeneralReply {
  Bytes payload;
};

struct SegmentDef {
  std::string name;
  std::int32_t parent = -1;  // index into the same list; -1: root
};
struct BodyDef {
  std::string name;
  std::vector<std::string> markers;
  std::vector<SegmentDef> segments;
  std::vector<std::string> dofs;
};
struct BodyDefs {
  std::vector<BodyDef> bodies;
  std::vector<std::string> analog_channels;
  std::int32_t force_plates = 0;
  Bytes trailing;  // newer hosts append fields whose layout is not public: tolerated, kept, not interpreted
};

// Position in the host's length unit (by default mm) and the host's axes.
struct Marker {
  float x = 0.0f;
  float y = 0.0f;
  float z = 0.0f;
  bool missing() const;  // sentinel in x, or any coordinate not finite
};
// Position (host unit), Euler angles about x, y, z [deg] relative to the parent, length (host unit).
struct Segment {
  double x = 0.0, y = 0.0, z = 0.0;
  double ax = 0.0, ay = 0.0, az = 0.0;
  double length = 0.0;
};
struct Body {
  std::string name;
  std::vector<Marker> markers;
  std::vector<Segment> segments;
  std::vector<double> dofs;  // usually degrees
};
// samples.size() == channels * sample_count. Either count may be huge while the other is zero, so loop over
// `samples`, never over one count alone. The order inside the block is not documented.
struct AnalogBlock {
  std::int32_t channels = 0;
  std::int32_t sample_count = 0;
  std::vector<std::int16_t> samples;
};
struct Force {
  float x = 0.0f, y = 0.0f, z = 0.0f;
  float fx = 0.0f, fy = 0.0f, fz = 0.0f;
  float mz = 0.0f;
};
// samples.size() == plates * sample_count; the warning at AnalogBlock holds here too.
struct ForceBlock {
  std::int32_t plates = 0;
  std::int32_t sample_count = 0;
  std::vector<Force> samples;
};

// Tagged items that may follow the delay.
struct AngleEncoders {  // tag 11; samples.size() == encoders * sample_count
  std::int32_t encoders = 0;
  std::int32_t sample_count = 0;
  std::vector<double> samples;
};
struct RecordingStatus {  // tag 12
  std::int32_t recording = 0;
  std::int32_t first_frame = 0;
  std::int32_t last_frame = 0;
  std::string capture_file;
};
struct Lens {
  std::int32_t zoom = 0;
  std::int32_t focus = 0;
};
struct LensEncoders {  // tag 13; one entry per body of the frame, in order
  std::vector<Lens> lenses;
};
struct UnknownItem {
  std::int32_t tag = 0;
  Bytes content;
};
using TaggedItem = std::variant<AngleEncoders, RecordingStatus, LensEncoders, UnknownItem>;

struct DelaySection {
  std::uint32_t ignored_word = 0;  // no known meaning
  float delay_s = 0.0f;            // camera exposure to sending, as the host says it: may be nonsense
};

// One frame of motion capture. Absent optional sections are empty; nothing stands over from an earlier frame.
struct FrameOfData {
  std::int32_t frame = 0;
  std::vector<Body> bodies;
  std::vector<Marker> unidentified;
  AnalogBlock analog;
  ForceBlock forces;
  std::optional<DelaySection> delay;  // absent in the oldest generation
  std::vector<TaggedItem> items;      // only with a delay: the wire cannot say otherwise

  // Optional parts that were dropped because they do not hold together, one text each. The bodies in front of
  // them are good. Not on the wire.
  std::vector<std::string> faults;
};

struct PushSegment {
  std::int32_t parent = -1;
  std::string name;
};
struct PushBasePosition {
  std::vector<PushSegment> hierarchy;
  std::vector<Segment> pose;            // one per entry of the hierarchy
  std::array<std::uint8_t, 4> extra{};  // the original client sends four arbitrary bytes after the pose
};

struct UnknownPacket {
  std::uint16_t command = 0;
  Bytes payload;
};

using Packet = std::variant<HelloWorld, AreYouThere, HereIAm, Comment, RequestBodyDefs, BodyDefs,
                            RequestFrame, FrameOfData, GeneralRequest, GeneralReply, UnrecognizedRequest,
                            PushBasePosition, UnrecognizedCommand, UnknownPacket>;

// Decodes exactly one packet that fills the whole buffer. Throws ProtocolError.
Packet decode(const std::uint8_t* data, std::size_t size);
Packet decode(const Bytes& datagram);

// What a client sends, one datagram each. Throws ProtocolError when the value has no wire form: NUL inside a
// string, name too long, more than kMaxPayloadBytes.
Bytes encode(const HelloWorld& hello);
Bytes encode(const RequestBodyDefs& request);
Bytes encode(const RequestFrame& request);
Bytes encode(const GeneralRequest& request);

// Length of the packet that starts at data (header included), as its header declares it; for files that hold
// several packets one after the other. Throws ProtocolError when there are fewer than kHeaderBytes bytes.
std::size_t declared_size(const std::uint8_t* data, std::size_t size);

// The usual contents of a GeneralReply; empty when the payload is too short.
std::optional<float> as_float(const GeneralReply& reply);
std::optional<std::int32_t> as_int(const GeneralReply& reply);

}  // namespace cortex_ros
