#include "encode.hpp"

#include <cstring>
#include <type_traits>

namespace cortex_ros {
namespace {

// Writes values one after the other. Tests run on little-endian machines, as the wire is.
class Writer {
 public:
  template <typename... Values>
  Writer& operator()(const Values&... values) {
    (put(values), ...);
    return *this;
  }
  template <typename List>
  Writer& without_count(const List& list) {
    for (const auto& element : list) {
      put(element);
    }
    return *this;
  }
  const Bytes& bytes() const { return bytes_; }

 private:
  template <typename Number, typename = std::enable_if_t<std::is_arithmetic_v<Number>>>
  void put(Number number) {
    std::uint8_t raw[sizeof number];
    std::memcpy(raw, &number, sizeof number);
    bytes_.insert(bytes_.end(), raw, raw + sizeof number);
  }
  template <typename Element>
  void put(const std::vector<Element>& list) {
    put(static_cast<std::int32_t>(list.size()));
    without_count(list);
  }
  void put(const Bytes& raw) { bytes_.insert(bytes_.end(), raw.begin(), raw.end()); }
  void put(const std::string& text) { without_count(text)('\0'); }

  void put(const Identity& identity) {
    std::string name = identity.name;
    name.resize(kProgramNameBytes, '\0');
    without_count(name).without_count(identity.version);
  }
  void put(const SegmentDef& s) { (*this)(s.name, s.parent); }
  void put(const PushSegment& s) { (*this)(s.parent, s.name); }
  void put(const BodyDef& b) { (*this)(b.name, b.markers, b.segments, b.dofs); }
  void put(const Marker& m) { (*this)(m.x, m.y, m.z); }
  void put(const Segment& s) { (*this)(s.x, s.y, s.z, s.ax, s.ay, s.az, s.length); }
  void put(const Body& b) { (*this)(b.name, b.markers, b.segments, b.dofs); }
  void put(const Force& f) { (*this)(f.x, f.y, f.z, f.fx, f.fy, f.fz, f.mz); }
  void put(const Lens& lens) { (*this)(lens.zoom, lens.focus); }
  void put(const AnalogBlock& b) { (*this)(b.channels, b.sample_count).without_count(b.samples); }
  void put(const ForceBlock& b) { (*this)(b.plates, b.sample_count).without_count(b.samples); }
  void put(const DelaySection& d) { (*this)(d.ignored_word, d.delay_s); }

  Bytes bytes_;
};

struct ItemEncoder {
  Bytes operator()(const AngleEncoders& item) const {
    return Writer()(item.encoders, item.sample_count).without_count(item.samples).bytes();
  }
  Bytes operator()(const RecordingStatus& item) const {
    return Writer()(item.recording, item.first_frame, item.last_frame, item.capture_file).bytes();
  }
  Bytes operator()(const LensEncoders& item) const { return Writer().without_count(item.lenses).bytes(); }
  Bytes operator()(const UnknownItem& item) const { return item.content; }
};

std::int32_t tag_of(const TaggedItem& item) {
  constexpr std::int32_t kTags[] = {kTagAngleEncoders, kTagRecordingStatus, kTagLensEncoders};
  const auto* unknown = std::get_if<UnknownItem>(&item);
  return unknown != nullptr ? unknown->tag : kTags[item.index()];
}

// Payloads. What clients send is the library's to write: its packet, less the header.
struct PayloadEncoder {
  template <typename Raw>
  auto operator()(const Raw& packet) const -> decltype(packet.payload) {
    return packet.payload;
  }
  Bytes operator()(const HelloWorld& packet) const { return payload_of(encode(packet)); }
  Bytes operator()(const RequestBodyDefs& packet) const { return payload_of(encode(packet)); }
  Bytes operator()(const RequestFrame& packet) const { return payload_of(encode(packet)); }
  Bytes operator()(const GeneralRequest& packet) const { return payload_of(encode(packet)); }
  Bytes operator()(const HereIAm& packet) const { return Writer()(packet.identity).bytes(); }
  Bytes operator()(const Comment& packet) const { return Writer()(packet.text).bytes(); }
  Bytes operator()(const BodyDefs& d) const {
    return Writer()(d.bodies, d.analog_channels, d.force_plates, d.trailing).bytes();
  }
  Bytes operator()(const FrameOfData& f) const {
    Writer out;
    out(f.frame, f.bodies, f.unidentified, f.analog, f.forces);
    if (f.delay) {
      out(*f.delay);
    }
    for (const TaggedItem& item : f.items) {
      const Bytes content = std::visit(ItemEncoder(), item);
      out(tag_of(item), static_cast<std::int32_t>(content.size()), content);
    }
    return out.bytes();
  }
  Bytes operator()(const PushBasePosition& packet) const {
    const Bytes hierarchy = Writer()(packet.hierarchy).bytes();
    const Bytes pose = Writer().without_count(packet.pose).without_count(packet.extra).bytes();
    const auto size = [](const Bytes& bytes) { return static_cast<std::uint16_t>(bytes.size()); };
    return Writer()(size(hierarchy), size(pose), hierarchy, pose).bytes();
  }

 private:
  static Bytes payload_of(const Bytes& packet) { return {packet.begin() + kHeaderBytes, packet.end()}; }
};

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

}  // namespace

std::uint16_t command_of(const Packet& packet) {
  const auto* unknown = std::get_if<UnknownPacket>(&packet);
  return unknown != nullptr ? unknown->command : static_cast<std::uint16_t>(kCommands[packet.index()]);
}

Bytes encode(const Packet& packet) {
  const Bytes payload = std::visit(PayloadEncoder(), packet);
  if (payload.size() > kMaxPayloadBytes) {
    throw ProtocolError("too long for a packet");
  }
  return Writer()(command_of(packet), static_cast<std::uint16_t>(payload.size()), payload).bytes();
}

}  // namespace cortex_ros
