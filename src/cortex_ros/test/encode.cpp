#include "encode.hpp"

#include "raw_packet.hpp"

namespace cortex_ros {
namespace {

RawPacket start(Command command) {
  return RawPacket(static_cast<std::uint16_t>(command));
}

void put_markers(RawPacket& out, const std::vector<Marker>& markers) {
  out.i32(static_cast<std::int64_t>(markers.size()));
  for (const Marker& m : markers) {
    out.f32(m.x).f32(m.y).f32(m.z);
  }
}

struct Encoder {
  Bytes operator()(const HelloWorld& packet) const { return encode_hello(packet.identity); }
  Bytes operator()(const HereIAm& packet) const {
    Bytes bytes = encode_hello(packet.identity);
    bytes[0] = static_cast<std::uint8_t>(Command::kHereIAm);
    return bytes;
  }
  Bytes operator()(const Comment& packet) const { return start(Command::kComment).text(packet.text).bytes(); }
  Bytes operator()(const BodyDefs& defs) const {  // without names
    const auto bodies = static_cast<std::int64_t>(defs.bodies);
    return start(Command::kBodyDefs).i32(bodies).fill(13 * defs.bodies, 0).i32(0).i32(0).bytes();
  }
  Bytes operator()(const GeneralReply& packet) const {
    return start(Command::kGeneralReply).raw(packet.payload).bytes();
  }
  Bytes operator()(const UnrecognizedRequest&) const { return start(Command::kUnrecognizedRequest).bytes(); }
  Bytes operator()(const UnrecognizedCommand&) const { return start(Command::kUnrecognizedCommand).bytes(); }
  Bytes operator()(const OtherPacket& packet) const {
    return RawPacket(packet.command).raw(packet.payload).bytes();
  }
  Bytes operator()(const FrameOfData& frame) const {
    RawPacket out = start(Command::kFrameOfData);
    out.i32(frame.frame).i32(static_cast<std::int64_t>(frame.bodies.size()));
    for (const Body& body : frame.bodies) {
      out.text(body.name);
      put_markers(out, body.markers);
      out.i32(0).i32(0);
    }
    put_markers(out, frame.unidentified);
    out.i32(0).i32(0).i32(0).i32(0);
    if (frame.delay_s) {
      out.i32(0).f32(*frame.delay_s);
    }
    return out.bytes();
  }
};

}  // namespace

Bytes encode(const Packet& packet) {
  Bytes bytes = std::visit(Encoder(), packet);
  if (bytes.size() > kHeaderBytes + kMaxPayloadBytes) {
    throw ProtocolError("too long for a packet");
  }
  return bytes;
}

}  // namespace cortex_ros
