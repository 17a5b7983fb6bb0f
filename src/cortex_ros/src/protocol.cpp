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
constexpr std::size_t kForceBytes = 28;
constexpr std::size_t kAnalogBytes = 2;
constexpr std::size_t kEncoderBytes = 8;
constexpr std::size_t kMinNameBytes = 1;        // the NUL
constexpr std::size_t kMinSegmentDefBytes = 5;  // empty name, parent
constexpr std::size_t kMinBodyBytes = 13;       // empty name, three counts
constexpr std::size_t kQuietSpareBytes = 4;  // this many left-over bytes or fewer end a frame without a fault
constexpr std::size_t kNoLimit = std::numeric_limits<std::size_t>::max();

// The wire is little-endian whatever the machine is. Compilers turn this into a single load.
template <typename Number>
Number load(const std::uint8_t* p) {
  using Bits = std::conditional_t<sizeof(Number) == 8, std::uint64_t,
                                  std::conditional_t<sizeof(Number) == 4, std::uint32_t, std::uint16_t>>;
  static_assert(sizeof(Number) == sizeof(Bits));
  Bits bits = 0;
  for (std::size_t i = 0; i < sizeof bits; ++i) {
    bits = static_cast<Bits>(bits | static_cast<Bits>(Bits{p[i]} << (8 * i)));
  }
  Number number;
  std::memcpy(&number, &bits, sizeof number);
  return number;
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

  template <typename Number>
  Number get(const char* what) {
    return load<Number>(take(sizeof(Number), what));
  }
  std::int32_t i32(const char* what) { return get<std::int32_t>(what); }

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

// A count, then that many elements of at least min_bytes.
template <typename Read>
auto decode_list(Reader& in, const char* count_name, std::size_t min_bytes, Read read) {
  std::vector<decltype(read())> list(in.count(count_name, min_bytes));
  for (auto& element : list) {
    element = read();
  }
  return list;
}

std::vector<std::string> decode_names(Reader& in, const char* count_name, const char* name) {
  return decode_list(in, count_name, kMinNameBytes, [&] { return in.text(name); });
}

template <typename Body>
std::vector<Body> decode_bodies(Reader& in, Body (*decode_one)(Reader&)) {
  std::vector<Body> bodies(in.count("body count", kMinBodyBytes, kMaxBodies));
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    bodies[i] = within("body", i, [&] { return decode_one(in); });
  }
  return bodies;
}

template <typename Number>
std::vector<Number> decode_numbers(Reader& in, std::size_t n, const char* what) {
  const std::uint8_t* p = in.take(n * sizeof(Number), what);
  std::vector<Number> numbers(n);
  for (Number& number : numbers) {
    number = load<Number>(p);
    p += sizeof(Number);
  }
  return numbers;
}

// n elements that are nothing but these numbers.
template <typename Element, typename... Numbers>
std::vector<Element> decode_elements(Reader& in, std::size_t n, const char* what,
                                     Numbers Element::*... members) {
  const std::uint8_t* p = in.take(n * (sizeof(Numbers) + ...), what);
  std::vector<Element> elements(n);
  for (Element& element : elements) {
    ((element.*members = load<Numbers>(p), p += sizeof(Numbers)), ...);
  }
  return elements;
}

BodyDef decode_body_def(Reader& in) {
  BodyDef body;
  body.name = in.text("body name", kMaxBodyNameBytes);
  body.markers = decode_names(in, "marker count", "marker name");
  body.segments = decode_list(in, "segment count", kMinSegmentDefBytes, [&] {
    std::string name = in.text("segment name");
    return SegmentDef{std::move(name), in.i32("segment parent")};
  });
  body.dofs = decode_names(in, "dof count", "dof name");
  return body;
}

BodyDefs decode_body_defs(Reader& in) {
  BodyDefs defs;
  defs.bodies = decode_bodies(in, decode_body_def);
  defs.analog_channels = decode_names(in, "analog channel count", "analog channel name");
  defs.force_plates = static_cast<std::int32_t>(in.non_negative("force plate count"));
  defs.trailing = in.rest();
  return defs;
}

std::vector<Marker> decode_markers(Reader& in, const char* what) {
  return decode_elements(in, in.count(what, kMarkerBytes), what, &Marker::x, &Marker::y, &Marker::z);
}

std::vector<Segment> decode_segments(Reader& in, std::size_t n) {
  return decode_elements(in, n, "segments", &Segment::x, &Segment::y, &Segment::z, &Segment::ax, &Segment::ay,
                         &Segment::az, &Segment::length);
}

Body decode_body(Reader& in) {
  Body body;
  body.name = in.text("body name", kMaxBodyNameBytes);
  body.markers = decode_markers(in, "marker count");
  body.segments = decode_segments(in, in.count("segment count", kSegmentBytes));
  body.dofs = decode_numbers<double>(in, in.count("dof count", sizeof(double)), "dofs");
  return body;
}

// The head of a block of rows * columns samples.
struct BlockSize {
  std::int32_t rows;
  std::int32_t columns;
  std::size_t samples;
};

// The product of two i32 fits 64 bits; a zero factor makes any other factor legal.
BlockSize decode_block_size(Reader& in, const char* rows_name, const char* columns_name,
                            std::size_t sample_bytes, const char* what) {
  const std::size_t rows = in.non_negative(rows_name);
  const std::size_t columns = in.non_negative(columns_name);
  const std::uint64_t n = static_cast<std::uint64_t>(rows) * static_cast<std::uint64_t>(columns);
  if (n > in.left() / sample_bytes) {
    fail(std::string(what) + ": " + std::to_string(rows) + " x " + std::to_string(columns) + " samples of " +
         std::to_string(sample_bytes) + " bytes, " + std::to_string(in.left()) + " left");
  }
  return {static_cast<std::int32_t>(rows), static_cast<std::int32_t>(columns), static_cast<std::size_t>(n)};
}

AnalogBlock decode_analog(Reader& in) {
  const BlockSize size =
      decode_block_size(in, "analog channel count", "analog sample count", kAnalogBytes, "analog block");
  return {size.rows, size.columns, decode_numbers<std::int16_t>(in, size.samples, "analog block")};
}

ForceBlock decode_forces(Reader& in) {
  const BlockSize size =
      decode_block_size(in, "force plate count", "force sample count", kForceBytes, "force block");
  return {size.rows, size.columns,
          decode_elements(in, size.samples, "force block", &Force::x, &Force::y, &Force::z, &Force::fx,
                          &Force::fy, &Force::fz, &Force::mz)};
}

AngleEncoders decode_angle_encoders(Reader in) {
  const BlockSize size =
      decode_block_size(in, "encoder count", "encoder sample count", kEncoderBytes, "encoder block");
  AngleEncoders item{size.rows, size.columns, decode_numbers<double>(in, size.samples, "encoder block")};
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

// content holds the item's own L bytes and nothing behind them.
TaggedItem decode_item(std::int32_t tag, Reader content, std::size_t bodies) {
  switch (tag) {
    case kTagAngleEncoders:
      return decode_angle_encoders(content);
    case kTagRecordingStatus:
      return decode_recording_status(content);
    case kTagLensEncoders:
      return LensEncoders{decode_elements(content, bodies, "lens encoders", &Lens::zoom, &Lens::focus)};
    default:
      return UnknownItem{tag, content.rest()};
  }
}

void decode_delay(Reader& in, FrameOfData& frame) {
  const auto ignored_word = in.get<std::uint32_t>("word before the delay");
  frame.delay = DelaySection{ignored_word, in.get<float>("delay")};
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
  frame.bodies = decode_bodies(in, decode_body);
  frame.unidentified = decode_markers(in, "unidentified marker count");
  frame.analog = decode_analog(in);
  frame.forces = decode_forces(in);
  decode_optional_sections(in, frame);
  return frame;
}

PushBasePosition decode_push(Reader& in) {
  const std::uint16_t hierarchy_bytes = in.get<std::uint16_t>("hierarchy size");
  const std::uint16_t pose_bytes = in.get<std::uint16_t>("pose size");
  Reader hierarchy = in.window(hierarchy_bytes, "hierarchy");
  Reader pose = in.window(pose_bytes, "pose");
  in.expect_end("the pose");

  PushBasePosition push;
  push.hierarchy = decode_list(hierarchy, "segment count", kMinSegmentDefBytes, [&] {
    const std::int32_t parent = hierarchy.i32("segment parent");
    return PushSegment{parent, hierarchy.text("segment name")};
  });
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
  return reply.payload.size() < 4 ? std::nullopt : std::make_optional(load<float>(reply.payload.data()));
}

std::optional<std::int32_t> as_int(const GeneralReply& reply) {
  return reply.payload.size() < 4 ? std::nullopt
                                  : std::make_optional(load<std::int32_t>(reply.payload.data()));
}

}  // namespace cortex_ros
