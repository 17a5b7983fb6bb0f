#include "encode.hpp"

#include <cstring>
#include <iterator>
#include <type_traits>

namespace cortex_ros {
namespace {

template <typename To, typename From>
To bits(const From& from) {
  To to;
  static_assert(sizeof to == sizeof from);
  std::memcpy(&to, &from, sizeof to);
  return to;
}

class Writer {
 public:
  void u16(std::uint16_t value) { store(value); }
  void u32(std::uint32_t value) { store(value); }
  void i16(std::int16_t value) { store(static_cast<std::uint16_t>(value)); }
  void i32(std::int32_t value) { store(static_cast<std::uint32_t>(value)); }
  void f32(float value) { store(bits<std::uint32_t>(value)); }
  void f64(double value) { store(bits<std::uint64_t>(value)); }

  void count(std::size_t n) { i32(static_cast<std::int32_t>(n)); }

  template <typename Iterator>
  void raw(Iterator first, Iterator last) {
    bytes_.insert(bytes_.end(), first, last);
  }

  void text(const std::string& value) {
    raw(value.begin(), value.end());
    bytes_.push_back(0);
  }

  Bytes& bytes() { return bytes_; }

 private:
  template <typename Unsigned>
  void store(Unsigned value) {
    for (std::size_t i = 0; i < sizeof(Unsigned); ++i) {
      bytes_.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
    }
  }

  Bytes bytes_;
};

void put_names(Writer& out, const std::vector<std::string>& names) {
  out.count(names.size());
  for (const std::string& name : names) {
    out.text(name);
  }
}

void put_markers(Writer& out, const std::vector<Marker>& markers) {
  out.count(markers.size());
  for (const Marker& marker : markers) {
    out.f32(marker.x);
    out.f32(marker.y);
    out.f32(marker.z);
  }
}

void put_segments(Writer& out, const std::vector<Segment>& segments) {
  for (const Segment& segment : segments) {
    for (double field :
         {segment.x, segment.y, segment.z, segment.ax, segment.ay, segment.az, segment.length}) {
      out.f64(field);
    }
  }
}

void put(Writer& out, const Identity& identity) {
  Writer name;
  name.text(identity.name);
  name.bytes().resize(kProgramNameBytes, 0);
  out.raw(name.bytes().begin(), name.bytes().end());
  out.raw(identity.version.begin(), identity.version.end());
}

// A packet that is nothing but its payload.
template <typename Raw>
auto put(Writer& out, const Raw& packet) -> decltype(packet.payload, void()) {
  out.raw(packet.payload.begin(), packet.payload.end());
}
void put(Writer& out, const HereIAm& packet) {
  put(out, packet.identity);
}
void put(Writer& out, const Comment& packet) {
  out.text(packet.text);
}

void put(Writer& out, const BodyDef& body) {
  out.text(body.name);
  put_names(out, body.markers);
  out.count(body.segments.size());
  for (const SegmentDef& segment : body.segments) {
    out.text(segment.name);
    out.i32(segment.parent);
  }
  put_names(out, body.dofs);
}

void put(Writer& out, const BodyDefs& defs) {
  out.count(defs.bodies.size());
  for (const BodyDef& body : defs.bodies) {
    put(out, body);
  }
  put_names(out, defs.analog_channels);
  out.i32(defs.force_plates);
  out.raw(defs.trailing.begin(), defs.trailing.end());
}

void put(Writer& out, const Body& body) {
  out.text(body.name);
  put_markers(out, body.markers);
  out.count(body.segments.size());
  put_segments(out, body.segments);
  out.count(body.dofs.size());
  for (double dof : body.dofs) {
    out.f64(dof);
  }
}

void put(Writer& out, const AnalogBlock& block) {
  out.i32(block.channels);
  out.i32(block.sample_count);
  for (std::int16_t sample : block.samples) {
    out.i16(sample);
  }
}

void put(Writer& out, const ForceBlock& block) {
  out.i32(block.plates);
  out.i32(block.sample_count);
  for (const Force& force : block.samples) {
    for (float field : {force.x, force.y, force.z, force.fx, force.fy, force.fz, force.mz}) {
      out.f32(field);
    }
  }
}

void put(Writer& out, const AngleEncoders& item) {
  out.i32(item.encoders);
  out.i32(item.sample_count);
  for (double sample : item.samples) {
    out.f64(sample);
  }
}

void put(Writer& out, const RecordingStatus& item) {
  out.i32(item.recording);
  out.i32(item.first_frame);
  out.i32(item.last_frame);
  out.text(item.capture_file);
}

void put(Writer& out, const LensEncoders& item) {
  for (const Lens& lens : item.lenses) {
    out.i32(lens.zoom);
    out.i32(lens.focus);
  }
}

void put(Writer& out, const UnknownItem& item) {
  out.raw(item.content.begin(), item.content.end());
}

void put_item(Writer& out, const TaggedItem& item) {
  Writer content;
  std::visit([&](const auto& value) { put(content, value); }, item);
  constexpr std::int32_t kTags[] = {kTagAngleEncoders, kTagRecordingStatus, kTagLensEncoders};
  const auto* unknown = std::get_if<UnknownItem>(&item);
  out.i32(unknown != nullptr ? unknown->tag : kTags[item.index()]);
  out.count(content.bytes().size());
  out.raw(content.bytes().begin(), content.bytes().end());
}

void put(Writer& out, const FrameOfData& frame) {
  out.i32(frame.frame);
  out.count(frame.bodies.size());
  for (const Body& body : frame.bodies) {
    put(out, body);
  }
  put_markers(out, frame.unidentified);
  put(out, frame.analog);
  put(out, frame.forces);
  if (frame.delay) {
    out.u32(frame.delay->ignored_word);
    out.f32(frame.delay->delay_s);
  }
  for (const TaggedItem& item : frame.items) {
    put_item(out, item);
  }
}

void put(Writer& out, const PushBasePosition& push) {
  Writer hierarchy;
  hierarchy.count(push.hierarchy.size());
  for (const PushSegment& segment : push.hierarchy) {
    hierarchy.i32(segment.parent);
    hierarchy.text(segment.name);
  }
  Writer pose;
  put_segments(pose, push.pose);
  pose.raw(push.extra.begin(), push.extra.end());
  out.u16(static_cast<std::uint16_t>(hierarchy.bytes().size()));
  out.u16(static_cast<std::uint16_t>(pose.bytes().size()));
  out.raw(hierarchy.bytes().begin(), hierarchy.bytes().end());
  out.raw(pose.bytes().begin(), pose.bytes().end());
}

// The order of the alternatives of Packet, as far as they have a fixed code.
constexpr Command kCommands[] = {
    Command::kHelloWorld,
    Command::kAreYouThere,
    Command::kHereIAm,
    Command::kComment,
    Command::kRequestBodyDefs,
    Command::kBodyDefs,
    Command::kRequestFrame,
    Command::kFrameOfData,
    Command::kGeneralRequest,
    Command::kGeneralReply,
    Command::kUnrecognizedRequest,
    Command::kPushBasePosition,
    Command::kUnrecognizedCommand,
};
static_assert(std::size(kCommands) + 1 == std::variant_size_v<Packet>,
              "every packet but the unknown one has a code");

template <typename Value, typename... Those>
constexpr bool kIsOneOf = (std::is_same_v<Value, Those> || ...);

template <typename Value>
Bytes encode_value(const Value& value, std::uint16_t command) {
  if constexpr (kIsOneOf<Value, HelloWorld, RequestBodyDefs, RequestFrame, GeneralRequest>) {
    return encode(value);  // the library's own
  } else {
    Writer out;
    out.u16(command);
    out.u16(0);  // the length, known at the end
    put(out, value);
    Bytes& bytes = out.bytes();
    const std::size_t payload = bytes.size() - kHeaderBytes;
    if (payload > kMaxPayloadBytes) {
      throw ProtocolError("too long for a packet");
    }
    bytes[2] = static_cast<std::uint8_t>(payload & 0xff);
    bytes[3] = static_cast<std::uint8_t>(payload >> 8);
    return std::move(bytes);
  }
}

}  // namespace

std::uint16_t command_of(const Packet& packet) {
  const auto* unknown = std::get_if<UnknownPacket>(&packet);
  return unknown != nullptr ? unknown->command : static_cast<std::uint16_t>(kCommands[packet.index()]);
}

Bytes encode(const Packet& packet) {
  return std::visit([&](const auto& value) { return encode_value(value, command_of(packet)); }, packet);
}

}  // namespace cortex_ros
