#include "cortex_ros/protocol.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

namespace cortex_ros {
namespace {

// Smallest wire size of one list element: a count that needs more bytes than are left is refused before
// anything is allocated for it.
constexpr std::size_t kMarkerBytes = 12;
constexpr std::size_t kSegmentBytes = 56;
constexpr std::size_t kDofBytes = 8;
constexpr std::size_t kForceBytes = 28;
constexpr std::size_t kAnalogBytes = 2;
constexpr std::size_t kEncoderBytes = 8;
constexpr std::size_t kLensBytes = 8;
constexpr std::size_t kMinNameBytes = 1;        // the NUL
constexpr std::size_t kMinSegmentDefBytes = 5;  // empty name, parent
constexpr std::size_t kMinBodyBytes = 13;       // empty name, three counts
constexpr std::size_t kIdentityBytes = kProgramNameBytes + 4;
constexpr std::size_t kMinRecordingBytes = 12;  // three numbers; the file name may be absent
constexpr std::size_t kQuietSpareBytes = 4;  // this many left-over bytes or fewer end a frame without a fault
constexpr std::size_t kNoLimit = std::numeric_limits<std::size_t>::max();

// The wire is little-endian whatever the machine is. Compilers turn these into single loads and stores.
template <typename Unsigned>
Unsigned load(const std::uint8_t* p) {
  Unsigned value = 0;
  for (std::size_t i = 0; i < sizeof(Unsigned); ++i) {
    value = static_cast<Unsigned>(value | static_cast<Unsigned>(static_cast<Unsigned>(p[i]) << (8 * i)));
  }
  return value;
}

template <typename To, typename From>
To same_bits(const From& from) {
  static_assert(sizeof(To) == sizeof(From), "bit copies need equal sizes");
  To to;
  std::memcpy(&to, &from, sizeof to);
  return to;
}

std::int16_t load_i16(const std::uint8_t* p) {
  return same_bits<std::int16_t>(load<std::uint16_t>(p));
}
std::int32_t load_i32(const std::uint8_t* p) {
  return same_bits<std::int32_t>(load<std::uint32_t>(p));
}
float load_f32(const std::uint8_t* p) {
  return same_bits<float>(load<std::uint32_t>(p));
}
double load_f64(const std::uint8_t* p) {
  return same_bits<double>(load<std::uint64_t>(p));
}

[[noreturn]] void fail(const std::string& message) {
  throw ProtocolError(message);
}

// Runs part() and puts the place in front of the message of an error that comes out of it.
template <typename Part>
auto within(const char* place, std::size_t index, Part part) -> decltype(part()) {
  try {
    return part();
  } catch (const ProtocolError& error) {
    fail(std::string(place) + " " + std::to_string(index) + ": " + error.what());
  }
}

// A cursor over (pointer, bytes left). Nothing is read that has not been taken from the bytes left first.
class Reader {
 public:
  Reader(const std::uint8_t* data, std::size_t size) : at_(data), left_(size) {}

  std::size_t left() const { return left_; }

  const std::uint8_t* take(std::size_t size, const char* what) {
    if (size > left_) {
      fail(std::string(what) + " needs " + std::to_string(size) + " bytes, " + std::to_string(left_) +
           " left");
    }
    const std::uint8_t* start = at_;
    at_ += size;
    left_ -= size;
    return start;
  }

  Reader window(std::size_t size, const char* what) { return Reader(take(size, what), size); }

  std::uint16_t u16(const char* what) { return load<std::uint16_t>(take(2, what)); }
  std::uint32_t u32(const char* what) { return load<std::uint32_t>(take(4, what)); }
  std::int32_t i32(const char* what) { return load_i32(take(4, what)); }
  float f32(const char* what) { return load_f32(take(4, what)); }

  // Number of list elements that follow, each at least element_bytes long.
  std::size_t count(const char* what, std::size_t element_bytes, std::size_t limit = kNoLimit) {
    const std::size_t n = non_negative(what);
    if (n > limit) {
      fail(std::string(what) + " " + std::to_string(n) + " is above the limit of " + std::to_string(limit));
    }
    if (n > left_ / element_bytes) {
      fail(std::string(what) + " " + std::to_string(n) + " needs at least " + std::to_string(element_bytes) +
           " bytes each, " + std::to_string(left_) + " left");
    }
    return n;
  }

  std::size_t non_negative(const char* what) {
    const std::int32_t n = i32(what);
    if (n < 0) {
      fail(std::string(what) + " is negative (" + std::to_string(n) + ")");
    }
    return static_cast<std::size_t>(n);
  }

  std::string text(const char* what, std::size_t limit = kNoLimit) {
    // memchr must not be called with a null pointer, which an empty buffer may have.
    const void* nul = left_ == 0 ? nullptr : std::memchr(at_, 0, left_);
    if (nul == nullptr) {
      fail(std::string(what) + " has no terminating NUL");
    }
    const auto length = static_cast<std::size_t>(static_cast<const std::uint8_t*>(nul) - at_);
    if (length > limit) {
      fail(std::string(what) + " of " + std::to_string(length) + " bytes is above the limit of " +
           std::to_string(limit));
    }
    const std::uint8_t* start = take(length + 1, what);
    return std::string(reinterpret_cast<const char*>(start), length);
  }

  Bytes rest() {
    const std::size_t size = left_;
    const std::uint8_t* start = take(size, "rest");
    return size == 0 ? Bytes() : Bytes(start, start + size);
  }

  void expect_end(const char* what) const {
    if (left_ != 0) {
      fail(std::to_string(left_) + " bytes too many after " + what);
    }
  }

 private:
  const std::uint8_t* at_;
  std::size_t left_;
};

Identity decode_identity(Reader& in) {
  Identity identity;
  const std::uint8_t* name = in.take(kProgramNameBytes, "program name");
  // A field without NUL is cut at its last byte, where the NUL should have been.
  const auto* end = std::find(name, name + kProgramNameBytes - 1, std::uint8_t{0});
  identity.name.assign(reinterpret_cast<const char*>(name), static_cast<std::size_t>(end - name));
  const std::uint8_t* version = in.take(identity.version.size(), "version");
  std::copy(version, version + identity.version.size(), identity.version.begin());
  return identity;
}

std::vector<std::string> decode_names(Reader& in, const char* count_name, const char* name) {
  std::vector<std::string> names(in.count(count_name, kMinNameBytes));
  for (std::string& entry : names) {
    entry = in.text(name);
  }
  return names;
}

std::vector<SegmentDef> decode_segment_defs(Reader& in) {
  std::vector<SegmentDef> segments(in.count("segment count", kMinSegmentDefBytes));
  for (SegmentDef& segment : segments) {
    segment.name = in.text("segment name");
    segment.parent = in.i32("segment parent");
  }
  return segments;
}

BodyDef decode_body_def(Reader& in) {
  BodyDef body;
  body.name = in.text("body name", kMaxBodyNameBytes);
  body.markers = decode_names(in, "marker count", "marker name");
  body.segments = decode_segment_defs(in);
  body.dofs = decode_names(in, "dof count", "dof name");
  return body;
}

BodyDefs decode_body_defs(Reader& in) {
  BodyDefs defs;
  defs.bodies.resize(in.count("body count", kMinBodyBytes, kMaxBodies));
  for (std::size_t i = 0; i < defs.bodies.size(); ++i) {
    defs.bodies[i] = within("body", i, [&] { return decode_body_def(in); });
  }
  defs.analog_channels = decode_names(in, "analog channel count", "analog channel name");
  defs.force_plates = static_cast<std::int32_t>(in.non_negative("force plate count"));
  defs.trailing = in.rest();
  return defs;
}

std::vector<Marker> decode_markers(Reader& in, const char* what) {
  const std::size_t n = in.count(what, kMarkerBytes);
  const std::uint8_t* p = in.take(n * kMarkerBytes, what);
  std::vector<Marker> markers(n);
  for (Marker& marker : markers) {
    marker.x = load_f32(p);
    marker.y = load_f32(p + 4);
    marker.z = load_f32(p + 8);
    p += kMarkerBytes;
  }
  return markers;
}

std::vector<Segment> decode_segments(Reader& in, std::size_t n) {
  const std::uint8_t* p = in.take(n * kSegmentBytes, "segments");
  std::vector<Segment> segments(n);
  for (Segment& segment : segments) {
    for (double* field :
         {&segment.x, &segment.y, &segment.z, &segment.ax, &segment.ay, &segment.az, &segment.length}) {
      *field = load_f64(p);
      p += 8;
    }
  }
  return segments;
}

std::vector<double> decode_doubles(Reader& in, std::size_t n, const char* what) {
  const std::uint8_t* p = in.take(n * sizeof(double), what);
  std::vector<double> values(n);
  for (double& value : values) {
    value = load_f64(p);
    p += sizeof(double);
  }
  return values;
}

Body decode_body(Reader& in) {
  Body body;
  body.name = in.text("body name", kMaxBodyNameBytes);
  body.markers = decode_markers(in, "marker count");
  body.segments = decode_segments(in, in.count("segment count", kSegmentBytes));
  body.dofs = decode_doubles(in, in.count("dof count", kDofBytes), "dofs");
  return body;
}

// rows * columns elements. The product of two i32 fits 64 bits; a zero factor makes any other factor legal.
std::size_t element_count(Reader& in, std::size_t rows, std::size_t columns, std::size_t element_bytes,
                          const char* what) {
  const std::uint64_t n = static_cast<std::uint64_t>(rows) * static_cast<std::uint64_t>(columns);
  if (n > in.left() / element_bytes) {
    fail(std::string(what) + ": " + std::to_string(rows) + " x " + std::to_string(columns) + " samples of " +
         std::to_string(element_bytes) + " bytes, " + std::to_string(in.left()) + " left");
  }
  return static_cast<std::size_t>(n);
}

AnalogBlock decode_analog(Reader& in) {
  const std::size_t channels = in.non_negative("analog channel count");
  const std::size_t sample_count = in.non_negative("analog sample count");
  const std::size_t n = element_count(in, channels, sample_count, kAnalogBytes, "analog block");
  AnalogBlock block{static_cast<std::int32_t>(channels), static_cast<std::int32_t>(sample_count), {}};
  const std::uint8_t* p = in.take(n * kAnalogBytes, "analog block");
  block.samples.resize(n);
  for (std::int16_t& sample : block.samples) {
    sample = load_i16(p);
    p += kAnalogBytes;
  }
  return block;
}

ForceBlock decode_forces(Reader& in) {
  const std::size_t plates = in.non_negative("force plate count");
  const std::size_t sample_count = in.non_negative("force sample count");
  const std::size_t n = element_count(in, plates, sample_count, kForceBytes, "force block");
  ForceBlock block{static_cast<std::int32_t>(plates), static_cast<std::int32_t>(sample_count), {}};
  const std::uint8_t* p = in.take(n * kForceBytes, "force block");
  block.samples.resize(n);
  for (Force& force : block.samples) {
    for (float* field : {&force.x, &force.y, &force.z, &force.fx, &force.fy, &force.fz, &force.mz}) {
      *field = load_f32(p);
      p += 4;
    }
  }
  return block;
}

AngleEncoders decode_angle_encoders(Reader in) {
  const std::size_t encoders = in.non_negative("encoder count");
  const std::size_t sample_count = in.non_negative("encoder sample count");
  const std::size_t n = element_count(in, encoders, sample_count, kEncoderBytes, "encoder block");
  AngleEncoders item{static_cast<std::int32_t>(encoders), static_cast<std::int32_t>(sample_count), {}};
  item.samples = decode_doubles(in, n, "encoder block");
  in.expect_end("the encoder block");
  return item;
}

RecordingStatus decode_recording_status(Reader in) {
  RecordingStatus item;
  item.recording = in.i32("recording state");
  item.first_frame = in.i32("first frame");
  item.last_frame = in.i32("last frame");
  if (in.left() > 0) {
    item.capture_file = in.text("capture file name", kMaxCaptureNameBytes);
  }
  return item;
}

LensEncoders decode_lens_encoders(Reader in, std::size_t bodies) {
  const std::uint8_t* p = in.take(bodies * kLensBytes, "lens encoders");
  LensEncoders item;
  item.lenses.resize(bodies);
  for (Lens& lens : item.lenses) {
    lens.zoom = load_i32(p);
    lens.focus = load_i32(p + 4);
    p += kLensBytes;
  }
  return item;
}

// content holds the item's own L bytes and nothing behind them.
TaggedItem decode_item(std::int32_t tag, Reader content, std::size_t bodies) {
  switch (tag) {
    case kTagAngleEncoders:
      return decode_angle_encoders(content);
    case kTagRecordingStatus:
      return decode_recording_status(content);
    case kTagLensEncoders:
      return decode_lens_encoders(content, bodies);
    default:
      return UnknownItem{tag, content.rest()};
  }
}

void decode_delay(Reader& in, FrameOfData& frame) {
  DelaySection section;
  section.ignored_word = in.u32("word before the delay");
  section.delay_s = in.f32("delay");
  frame.delay = section;
}

void decode_next_item(Reader& in, FrameOfData& frame) {
  const std::int32_t tag = in.i32("item tag");
  const std::int32_t length = in.i32("item length");
  if (length < 0 || static_cast<std::size_t>(length) > in.left()) {
    const std::size_t left = in.rest().size();  // without a length there is no finding the next item
    fail("item with tag " + std::to_string(tag) + ": length " + std::to_string(length) + ", " +
         std::to_string(left) + " bytes left");
  }
  const Reader content = in.window(static_cast<std::size_t>(length), "item");
  try {
    frame.items.push_back(decode_item(tag, content, frame.bodies.size()));
  } catch (const ProtocolError& error) {
    fail("item with tag " + std::to_string(tag) + ": " + error.what());
  }
}

// Delay and tagged items: a fault here costs the faulty part, never the bodies. Every turn takes at least
// four bytes.
void decode_optional_sections(Reader& in, FrameOfData& frame) {
  while (in.left() > kQuietSpareBytes) {
    try {
      if (!frame.delay) {
        decode_delay(in, frame);
      } else {
        decode_next_item(in, frame);
      }
    } catch (const ProtocolError& error) {
      frame.faults.emplace_back(error.what());
    }
  }
}

FrameOfData decode_frame(Reader& in) {
  FrameOfData frame;
  frame.frame = in.i32("frame number");
  frame.bodies.resize(in.count("body count", kMinBodyBytes, kMaxBodies));
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    frame.bodies[i] = within("body", i, [&] { return decode_body(in); });
  }
  frame.unidentified = decode_markers(in, "unidentified marker count");
  frame.analog = decode_analog(in);
  frame.forces = decode_forces(in);
  decode_optional_sections(in, frame);
  return frame;
}

PushBasePosition decode_push(Reader& in) {
  const std::uint16_t hierarchy_bytes = in.u16("hierarchy size");
  const std::uint16_t pose_bytes = in.u16("pose size");
  Reader hierarchy = in.window(hierarchy_bytes, "hierarchy");
  Reader pose = in.window(pose_bytes, "pose");
  in.expect_end("the pose");

  PushBasePosition push;
  push.hierarchy.resize(hierarchy.count("segment count", kMinSegmentDefBytes));
  for (PushSegment& segment : push.hierarchy) {
    segment.parent = hierarchy.i32("segment parent");
    segment.name = hierarchy.text("segment name");
  }
  hierarchy.expect_end("the hierarchy");

  push.pose = decode_segments(pose, push.hierarchy.size());
  const std::uint8_t* extra = pose.take(push.extra.size(), "bytes after the pose");
  std::copy(extra, extra + push.extra.size(), push.extra.begin());
  pose.expect_end("the pose");
  return push;
}

template <typename EmptyPacket>
EmptyPacket decode_empty(const Reader& in) {
  if (in.left() != 0) {
    fail("has " + std::to_string(in.left()) + " payload bytes, must have none");
  }
  return EmptyPacket();
}

Packet decode_payload(std::uint16_t command, Reader& in) {
  switch (static_cast<Command>(command)) {
    case Command::kHelloWorld:
      return HelloWorld{decode_identity(in)};
    case Command::kAreYouThere:
      return AreYouThere{in.rest()};
    case Command::kHereIAm:
      return HereIAm{decode_identity(in)};
    case Command::kComment:
      return Comment{in.text("text")};
    case Command::kRequestBodyDefs:
      return decode_empty<RequestBodyDefs>(in);
    case Command::kBodyDefs:
      return decode_body_defs(in);
    case Command::kRequestFrame:
      return decode_empty<RequestFrame>(in);
    case Command::kFrameOfData:
      return decode_frame(in);
    case Command::kGeneralRequest:
      return GeneralRequest{in.text("text")};
    case Command::kGeneralReply:
      return GeneralReply{in.rest()};
    case Command::kUnrecognizedRequest:
      return UnrecognizedRequest{in.rest()};
    case Command::kPushBasePosition:
      return decode_push(in);
    case Command::kUnrecognizedCommand:
      return UnrecognizedCommand{in.rest()};
  }
  return UnknownPacket{command, in.rest()};
}

void append(Bytes& out, const std::string& text, const char* what, std::size_t limit = kNoLimit) {
  if (text.find('\0') != std::string::npos) {
    fail(std::string(what) + " has a NUL inside");
  }
  if (text.size() > limit) {
    fail(std::string(what) + " of " + std::to_string(text.size()) + " bytes is above the limit of " +
         std::to_string(limit));
  }
  out.insert(out.end(), text.begin(), text.end());
}

Bytes packet(Command command, const Bytes& payload = {}) {
  if (payload.size() > kMaxPayloadBytes) {
    fail("payload of " + std::to_string(payload.size()) + " bytes is above the limit of " +
         std::to_string(kMaxPayloadBytes));
  }
  Bytes out;
  for (const std::size_t value : {static_cast<std::size_t>(command), payload.size()}) {
    out.push_back(static_cast<std::uint8_t>(value & 0xff));
    out.push_back(static_cast<std::uint8_t>(value >> 8));
  }
  out.insert(out.end(), payload.begin(), payload.end());
  return out;
}

}  // namespace

bool Marker::missing() const {
  return x == kMissingCoordinate || !std::isfinite(x) || !std::isfinite(y) || !std::isfinite(z);
}

std::size_t declared_size(const std::uint8_t* data, std::size_t size) {
  if (size < kHeaderBytes) {
    fail(std::to_string(size) + " bytes are too few for a packet header");
  }
  return kHeaderBytes + load<std::uint16_t>(data + 2);
}

Packet decode(const std::uint8_t* data, std::size_t size) {
  const std::size_t declared = declared_size(data, size);
  const std::uint16_t command = load<std::uint16_t>(data);
  return within("packet with code", command, [&] {
    if (declared != size) {
      fail("declares " + std::to_string(declared - kHeaderBytes) + " payload bytes, has " +
           std::to_string(size - kHeaderBytes));
    }
    if (size > kMaxDatagramBytes) {
      fail(std::to_string(size) + " bytes are more than a datagram can carry");
    }
    Reader in(data + kHeaderBytes, size - kHeaderBytes);
    return decode_payload(command, in);
  });
}

Packet decode(const Bytes& datagram) {
  return decode(datagram.data(), datagram.size());
}

Bytes encode(const HelloWorld& hello) {
  Bytes payload;
  append(payload, hello.identity.name, "program name", kProgramNameBytes - 1);
  payload.resize(kProgramNameBytes, 0);
  payload.insert(payload.end(), hello.identity.version.begin(), hello.identity.version.end());
  return packet(Command::kHelloWorld, payload);
}

Bytes encode(const RequestBodyDefs&) {
  return packet(Command::kRequestBodyDefs);
}

Bytes encode(const RequestFrame&) {
  return packet(Command::kRequestFrame);
}

Bytes encode(const GeneralRequest& request) {
  Bytes payload;
  append(payload, request.text, "text");
  payload.push_back(0);
  return packet(Command::kGeneralRequest, payload);
}

std::optional<float> as_float(const GeneralReply& reply) {
  return reply.payload.size() < 4 ? std::nullopt : std::make_optional(load_f32(reply.payload.data()));
}

std::optional<std::int32_t> as_int(const GeneralReply& reply) {
  return reply.payload.size() < 4 ? std::nullopt : std::make_optional(load_i32(reply.payload.data()));
}

}  // namespace cortex_ros
