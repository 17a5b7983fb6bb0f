#include "cortex_ros/json.hpp"

#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace cortex_ros {
namespace {

std::string number(std::int64_t value) {
  return std::to_string(value);
}

// The shortest of 15 to 17 digits that reads back as the same double.
std::string number(double value) {
  if (!std::isfinite(value)) {
    return "null";
  }
  char text[40];
  for (int digits : {15, 16, 17}) {
    std::snprintf(text, sizeof text, "%.*g", digits, value);
    if (std::strtod(text, nullptr) == value) {
      break;
    }
  }
  return text;
}

std::string number(float value) {
  return number(static_cast<double>(value));
}

template <typename List, typename ToText>
std::string array(const List& list, ToText to_text) {
  std::string out = "[";
  for (const auto& element : list) {
    if (out.size() > 1) {
      out += ", ";
    }
    out += to_text(element);
  }
  return out + "]";
}

template <typename List>
std::string numbers(const List& list) {
  return array(list, [](const auto& value) { return number(value); });
}

std::string numbers(const std::vector<std::int16_t>& list) {
  return array(list, [](std::int16_t value) { return number(std::int64_t{value}); });
}

std::string strings(const std::vector<std::string>& list) {
  return array(list, json_quote);
}

std::string hex(const Bytes& bytes) {
  static const char kDigits[] = "0123456789abcdef";
  std::string out = "\"";
  for (std::uint8_t byte : bytes) {
    out += kDigits[byte >> 4];
    out += kDigits[byte & 0x0f];
  }
  return out + "\"";
}

// Collects "key": value pairs in the order in which they are added.
class Object {
 public:
  Object& add(const char* key, const std::string& json) {
    out_ += out_.size() > 1 ? ", \"" : "\"";
    out_ += key;
    out_ += "\": ";
    out_ += json;
    return *this;
  }
  std::string text() const { return out_ + "}"; }

 private:
  std::string out_ = "{";
};

Object typed(const char* type) {
  Object object;
  object.add("type", json_quote(type));
  return object;
}

// Declared ahead because objects() calls them for element types that are defined further down.
std::string json(const Body& body);
std::string json(const BodyDef& body);
std::string json(const Force& force);
std::string json(const Lens& lens);
std::string json(const Marker& marker);
std::string json(const PushSegment& segment);
std::string json(const Segment& segment);
std::string json(const SegmentDef& segment);
std::string json(const TaggedItem& item);

template <typename List>
std::string objects(const List& list) {
  return array(list, [](const auto& element) { return json(element); });
}

std::string json(const Marker& marker) {
  return marker.missing() ? "null" : numbers(std::vector<float>{marker.x, marker.y, marker.z});
}

std::string json(const Segment& s) {
  return numbers(std::vector<double>{s.x, s.y, s.z, s.ax, s.ay, s.az, s.length});
}

std::string json(const Force& f) {
  return numbers(std::vector<float>{f.x, f.y, f.z, f.fx, f.fy, f.fz, f.mz});
}

std::string json(const Body& body) {
  return Object()
      .add("name", json_quote(body.name))
      .add("markers", objects(body.markers))
      .add("segments", objects(body.segments))
      .add("dofs", numbers(body.dofs))
      .text();
}

std::string json(const AnalogBlock& block) {
  return Object()
      .add("channels", number(std::int64_t{block.channels}))
      .add("samples", number(std::int64_t{block.sample_count}))
      .add("data", numbers(block.samples))
      .text();
}

std::string json(const ForceBlock& block) {
  return Object()
      .add("plates", number(std::int64_t{block.plates}))
      .add("samples", number(std::int64_t{block.sample_count}))
      .add("data", objects(block.samples))
      .text();
}

std::string json(const AngleEncoders& item) {
  return Object()
      .add("tag", "11")
      .add("encoders", number(std::int64_t{item.encoders}))
      .add("samples", number(std::int64_t{item.sample_count}))
      .add("data", numbers(item.samples))
      .text();
}

std::string json(const RecordingStatus& item) {
  return Object()
      .add("tag", "12")
      .add("recording", item.recording != 0 ? "true" : "false")
      .add("first_frame", number(std::int64_t{item.first_frame}))
      .add("last_frame", number(std::int64_t{item.last_frame}))
      .add("capture_file", json_quote(item.capture_file))
      .text();
}

std::string json(const Lens& lens) {
  return Object()
      .add("zoom", number(std::int64_t{lens.zoom}))
      .add("focus", number(std::int64_t{lens.focus}))
      .text();
}

std::string json(const LensEncoders& item) {
  return Object().add("tag", "13").add("lenses", objects(item.lenses)).text();
}

std::string json(const UnknownItem& item) {
  return Object().add("tag", number(std::int64_t{item.tag})).add("content_hex", hex(item.content)).text();
}

std::string json(const TaggedItem& item) {
  return std::visit([](const auto& value) { return json(value); }, item);
}

std::string json(const SegmentDef& segment) {
  return "[" + json_quote(segment.name) + ", " + number(std::int64_t{segment.parent}) + "]";
}

std::string json(const PushSegment& segment) {
  return "[" + number(std::int64_t{segment.parent}) + ", " + json_quote(segment.name) + "]";
}

std::string json(const BodyDef& body) {
  return Object()
      .add("name", json_quote(body.name))
      .add("markers", strings(body.markers))
      .add("segments", objects(body.segments))
      .add("dofs", strings(body.dofs))
      .text();
}

std::string identity_json(const char* type, const Identity& identity) {
  return typed(type)
      .add("name", json_quote(identity.name))
      .add("version", array(identity.version, [](std::uint8_t v) { return number(std::int64_t{v}); }))
      .text();
}

std::string payload_json(const char* type, const Bytes& payload) {
  return typed(type).add("payload_hex", hex(payload)).text();
}

std::string text_json(const char* type, const std::string& text) {
  return typed(type).add("text", json_quote(text)).text();
}

std::string packet_json(const HelloWorld& packet) {
  return identity_json("hello_world", packet.identity);
}
std::string packet_json(const HereIAm& packet) {
  return identity_json("here_i_am", packet.identity);
}
std::string packet_json(const AreYouThere& packet) {
  return payload_json("are_you_there", packet.payload);
}
std::string packet_json(const Comment& packet) {
  return text_json("comment", packet.text);
}
std::string packet_json(const RequestBodyDefs&) {
  return typed("request_bodydefs").text();
}
std::string packet_json(const RequestFrame&) {
  return typed("request_frame").text();
}
std::string packet_json(const GeneralRequest& packet) {
  return text_json("general_request", packet.text);
}
std::string packet_json(const UnrecognizedRequest& packet) {
  return payload_json("unrecognized_request", packet.payload);
}
std::string packet_json(const UnrecognizedCommand& packet) {
  return payload_json("unrecognized_command", packet.payload);
}

std::string packet_json(const GeneralReply& packet) {
  Object object = typed("general_reply");
  object.add("payload_hex", hex(packet.payload));
  // What the four bytes mean only the request knows, so both readings are given.
  if (packet.payload.size() == 4) {
    object.add("as_float", number(*as_float(packet)));
    object.add("as_int", number(std::int64_t{*as_int(packet)}));
  }
  return object.text();
}

std::string packet_json(const BodyDefs& defs) {
  return typed("bodydefs")
      .add("bodies", objects(defs.bodies))
      .add("analog_channels", strings(defs.analog_channels))
      .add("force_plates", number(std::int64_t{defs.force_plates}))
      .add("trailing_hex", hex(defs.trailing))
      .text();
}

std::string packet_json(const FrameOfData& frame) {
  return typed("frame")
      .add("frame", number(std::int64_t{frame.frame}))
      .add("delay_s", frame.delay ? number(frame.delay->delay_s) : "null")
      .add("bodies", objects(frame.bodies))
      .add("unidentified", objects(frame.unidentified))
      .add("analog", json(frame.analog))
      .add("forces", json(frame.forces))
      .add("items", objects(frame.items))
      .add("faults", strings(frame.faults))
      .text();
}

std::string packet_json(const PushBasePosition& push) {
  return typed("push_baseposition")
      .add("hierarchy", objects(push.hierarchy))
      .add("pose", objects(push.pose))
      .text();
}

std::string packet_json(const UnknownPacket& packet) {
  return typed("unknown")
      .add("command", number(std::int64_t{packet.command}))
      .add("payload_hex", hex(packet.payload))
      .text();
}

// Length of the well-formed UTF-8 sequence (RFC 3629: no overlong forms, no surrogates) at
// text[i]; 0 if there is none.
std::size_t utf8_length(const std::string& text, std::size_t i) {
  const auto byte = [&](std::size_t k) -> unsigned { return static_cast<unsigned char>(text[i + k]); };
  const unsigned lead = byte(0);
  if (lead < 0x80) {
    return 1;
  }
  const std::size_t length = lead < 0xc2 ? 0 : lead < 0xe0 ? 2 : lead < 0xf0 ? 3 : lead < 0xf5 ? 4 : 0;
  if (length == 0 || text.size() - i < length) {
    return 0;
  }
  for (std::size_t k = 1; k < length; ++k) {
    if ((byte(k) & 0xc0) != 0x80) {
      return 0;
    }
  }
  const bool overlong = (lead == 0xe0 && byte(1) < 0xa0) || (lead == 0xf0 && byte(1) < 0x90);
  const bool surrogate = lead == 0xed && byte(1) >= 0xa0;
  const bool beyond_unicode = lead == 0xf4 && byte(1) >= 0x90;
  return overlong || surrogate || beyond_unicode ? 0 : length;
}

std::string escape(unsigned char byte) {
  char text[8];
  std::snprintf(text, sizeof text, "\\u%04x", static_cast<unsigned>(byte));
  return text;
}

}  // namespace

std::string json_quote(const std::string& bytes) {
  std::string out = "\"";
  for (std::size_t i = 0; i < bytes.size();) {
    const auto byte = static_cast<unsigned char>(bytes[i]);
    const std::size_t length = utf8_length(bytes, i);
    if (byte == '"' || byte == '\\') {
      out += '\\';
      out += bytes[i];
    } else if (byte < 0x20 || byte == 0x7f || length == 0) {
      out += escape(byte);
    } else {
      out.append(bytes, i, length);
    }
    i += length == 0 ? 1 : length;
  }
  return out + "\"";
}

std::string to_json(const Packet& packet) {
  return std::visit([](const auto& value) { return packet_json(value); }, packet);
}

std::string error_json(const std::string& message) {
  return Object().add("error", json_quote(message)).text();
}

}  // namespace cortex_ros
