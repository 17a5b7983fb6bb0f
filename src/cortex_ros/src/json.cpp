#include "cortex_ros/json.hpp"

#include <boost/locale/utf.hpp>
#include <cmath>
#include <iterator>
#include <nlohmann/json.hpp>

namespace cortex_ros {
namespace {

using Json = nlohmann::ordered_json;

Json text(const std::string& bytes) {
  namespace utf = boost::locale::utf;
  std::string out;
  for (auto at = bytes.begin(); at != bytes.end();) {
    auto next = at;
    utf::code_point point = utf::utf_traits<char>::decode(next, bytes.end());
    if (!utf::is_valid_codepoint(point)) {
      point = static_cast<unsigned char>(*at);
      next = std::next(at);
    }
    utf::utf_traits<char>::encode(point, std::back_inserter(out));
    at = next;
  }
  return out;
}

// A whole number is printed without a fraction: 1, not 1.0.
Json number(double value) {
  constexpr double kMaxDigits = 1e15;
  const bool whole = value == std::trunc(value) && std::abs(value) < kMaxDigits;
  return whole ? Json(static_cast<std::int64_t>(value)) : Json(value);
}

Json hex(const Bytes& bytes) {
  constexpr char kDigits[] = "0123456789abcdef";
  std::string out;
  for (const std::uint8_t byte : bytes) {
    out += {kDigits[byte >> 4], kDigits[byte & 0x0f]};
  }
  return out;
}

template <typename List, typename ToJson>
Json array(const List& list, ToJson to_json) {
  Json out = Json::array();
  for (const auto& element : list) {
    out.push_back(to_json(element));
  }
  return out;
}

Json numbers(const std::vector<double>& list) {
  return array(list, number);
}

Json texts(const std::vector<std::string>& list) {
  return array(list, text);
}

Json marker_json(const Marker& m) {
  return m.missing() ? Json() : numbers({m.x, m.y, m.z});
}

Json segment_json(const Segment& s) {
  return numbers({s.x, s.y, s.z, s.ax, s.ay, s.az, s.length});
}

Json force_json(const Force& f) {
  return numbers({f.x, f.y, f.z, f.fx, f.fy, f.fz, f.mz});
}

Json body_json(const Body& body) {
  return {{"name", text(body.name)},
          {"markers", array(body.markers, marker_json)},
          {"segments", array(body.segments, segment_json)},
          {"dofs", numbers(body.dofs)}};
}

Json body_def_json(const BodyDef& body) {
  const auto segment = [](const SegmentDef& s) { return Json::array({text(s.name), s.parent}); };
  return {{"name", text(body.name)},
          {"markers", texts(body.markers)},
          {"segments", array(body.segments, segment)},
          {"dofs", texts(body.dofs)}};
}

// One overload a kind of item, then one a kind of packet.
struct ToJson {
  Json operator()(const AngleEncoders& item) const {
    return {{"tag", kTagAngleEncoders},
            {"encoders", item.encoders},
            {"samples", item.sample_count},
            {"data", numbers(item.samples)}};
  }
  Json operator()(const RecordingStatus& item) const {
    return {{"tag", kTagRecordingStatus},
            {"recording", item.recording != 0},
            {"first_frame", item.first_frame},
            {"last_frame", item.last_frame},
            {"capture_file", text(item.capture_file)}};
  }
  Json operator()(const LensEncoders& item) const {
    const auto lens = [](const Lens& l) { return Json{{"zoom", l.zoom}, {"focus", l.focus}}; };
    return {{"tag", kTagLensEncoders}, {"lenses", array(item.lenses, lens)}};
  }
  Json operator()(const UnknownItem& item) const {
    return {{"tag", item.tag}, {"content_hex", hex(item.content)}};
  }

  Json operator()(const HelloWorld& packet) const { return identity("hello_world", packet.identity); }
  Json operator()(const HereIAm& packet) const { return identity("here_i_am", packet.identity); }
  Json operator()(const AreYouThere& packet) const { return payload("are_you_there", packet.payload); }
  Json operator()(const UnrecognizedRequest& packet) const {
    return payload("unrecognized_request", packet.payload);
  }
  Json operator()(const UnrecognizedCommand& packet) const {
    return payload("unrecognized_command", packet.payload);
  }
  Json operator()(const Comment& packet) const { return {{"type", "comment"}, {"text", text(packet.text)}}; }
  Json operator()(const GeneralRequest& packet) const {
    return {{"type", "general_request"}, {"text", text(packet.text)}};
  }
  Json operator()(const RequestBodyDefs&) const { return {{"type", "request_bodydefs"}}; }
  Json operator()(const RequestFrame&) const { return {{"type", "request_frame"}}; }
  Json operator()(const GeneralReply& packet) const {
    Json out = payload("general_reply", packet.payload);
    // What the four bytes mean only the request knows, so both readings are given.
    if (packet.payload.size() == 4) {
      out["as_float"] = number(*as_float(packet));
      out["as_int"] = *as_int(packet);
    }
    return out;
  }
  Json operator()(const BodyDefs& defs) const {
    return {{"type", "bodydefs"},
            {"bodies", array(defs.bodies, body_def_json)},
            {"analog_channels", texts(defs.analog_channels)},
            {"force_plates", defs.force_plates},
            {"trailing_hex", hex(defs.trailing)}};
  }
  Json operator()(const FrameOfData& frame) const {
    const AnalogBlock& analog = frame.analog;
    const ForceBlock& forces = frame.forces;
    return {{"type", "frame"},
            {"frame", frame.frame},
            {"delay_s", frame.delay ? number(frame.delay->delay_s) : Json()},
            {"bodies", array(frame.bodies, body_json)},
            {"unidentified", array(frame.unidentified, marker_json)},
            {"analog",
             {{"channels", analog.channels}, {"samples", analog.sample_count}, {"data", analog.samples}}},
            {"forces",
             {{"plates", forces.plates},
              {"samples", forces.sample_count},
              {"data", array(forces.samples, force_json)}}},
            {"items", array(frame.items, [](const TaggedItem& item) { return std::visit(ToJson(), item); })},
            {"faults", texts(frame.faults)}};
  }
  Json operator()(const PushBasePosition& push) const {
    const auto segment = [](const PushSegment& s) { return Json::array({s.parent, text(s.name)}); };
    return {{"type", "push_baseposition"},
            {"hierarchy", array(push.hierarchy, segment)},
            {"pose", array(push.pose, segment_json)}};
  }
  Json operator()(const UnknownPacket& packet) const {
    return {{"type", "unknown"}, {"command", packet.command}, {"payload_hex", hex(packet.payload)}};
  }

 private:
  static Json identity(const char* type, const Identity& identity) {
    return {{"type", type}, {"name", text(identity.name)}, {"version", identity.version}};
  }
  static Json payload(const char* type, const Bytes& payload) {
    return {{"type", type}, {"payload_hex", hex(payload)}};
  }
};

}  // namespace

std::string to_json(const Packet& packet) {
  return std::visit(ToJson(), packet).dump();
}

std::string error_json(const std::string& message) {
  return Json{{"error", text(message)}}.dump();
}

}  // namespace cortex_ros
