#include "cortex_ros/protocol.hpp"

#include <algorithm>
#include <boost/endian/conversion.hpp>
#include <boost/locale/utf.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <sstream>

namespace cortex_ros {
namespace {

// Smallest wire size of one list element: a count that needs more bytes than are left is refused before
// anything is allocated for it.
constexpr std::size_t kMarkerBytes = 12;
constexpr std::size_t kSegmentBytes = 56;
constexpr std::size_t kForceBytes = 28;
constexpr std::size_t kAnalogBytes = 2;
constexpr std::size_t kMinBodyBytes = 13;    // empty name, three counts
constexpr std::size_t kQuietSpareBytes = 4;  // up to this many spare bytes at the end of a frame are no fault
constexpr std::size_t kNoLimit = std::numeric_limits<std::size_t>::max();

template <typename Number>
Number load(const std::uint8_t* p) {
  return boost::endian::endian_load<Number, sizeof(Number), boost::endian::order::little>(p);
}

template <typename... Parts>
[[noreturn]] void fail(const Parts&... parts) {
  std::ostringstream message;
  (message << ... << parts);
  throw ProtocolError(message.str());
}

// Runs part(); puts the place in front of the message of an error that it throws.
template <typename Part>
auto within(const char* place, std::size_t index, Part part) -> decltype(part()) {
  try {
    return part();
  } catch (const ProtocolError& error) {
    fail(place, " ", index, ": ", error.what());
  }
}

// The text with a question mark in place of each byte that is not UTF-8, because readers of ROS messages fail
// on invalid UTF-8.
template <typename Iterator>
std::string utf8(Iterator at, Iterator end) {
  namespace utf = boost::locale::utf;
  std::string text;
  while (at != end) {
    Iterator next = at;
    const bool valid = utf::is_valid_codepoint(utf::utf_traits<char>::decode(next, end));
    valid ? text.append(at, next) : text.append(1, '?');
    at = valid ? next : at + 1;
  }
  return text;
}

// A cursor over (pointer, bytes left). Every read first checks and reduces the bytes left.
class Reader {
 public:
  Reader(const std::uint8_t* data, std::size_t size) : at_(data), left_(size) {}

  std::size_t left() const { return left_; }

  const std::uint8_t* take(std::size_t size, const char* what) {
    if (size > left_) {
      fail(what, " needs ", size, " bytes, ", left_, " left");
    }
    const std::uint8_t* start = at_;
    at_ += size;
    left_ -= size;
    return start;
  }

  template <typename Number>
  Number get(const char* what) {
    return load<Number>(take(sizeof(Number), what));
  }
  std::int32_t i32(const char* what) { return get<std::int32_t>(what); }

  // Number of list elements that follow, each at least element_bytes long.
  std::size_t count(const char* what, std::size_t element_bytes, std::size_t limit = kNoLimit) {
    const std::size_t n = non_negative(what);
    if (n > limit) {
      fail(what, " ", n, " is above the limit of ", limit);
    }
    if (n > left_ / element_bytes) {
      fail(what, " ", n, " needs at least ", element_bytes, " bytes each, ", left_, " left");
    }
    return n;
  }

  std::size_t non_negative(const char* what) {
    const std::int32_t n = i32(what);
    if (n < 0) {
      fail(what, " is negative (", n, ")");
    }
    return static_cast<std::size_t>(n);
  }

  std::string text(const char* what, std::size_t limit = kNoLimit) {
    // memchr must not be called with a null pointer, which an empty buffer may have.
    const void* nul = left_ == 0 ? nullptr : std::memchr(at_, 0, left_);
    if (nul == nullptr) {
      fail(what, " has no terminating NUL");
    }
    const auto length = static_cast<std::size_t>(static_cast<const std::uint8_t*>(nul) - at_);
    if (length > limit) {
      fail(what, " of ", length, " bytes is above the limit of ", limit);
    }
    const std::uint8_t* start = take(length + 1, what);
    return utf8(start, start + length);
  }

  Bytes rest() {
    const std::size_t size = left_;
    const std::uint8_t* start = take(size, "rest");
    return size == 0 ? Bytes() : Bytes(start, start + size);
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
  identity.name = utf8(name, end);
  const std::uint8_t* version = in.take(identity.version.size(), "version");
  std::copy(version, version + identity.version.size(), identity.version.begin());
  return identity;
}

std::vector<Marker> decode_markers(Reader& in, const char* what) {
  std::vector<Marker> markers(in.count(what, kMarkerBytes));
  const std::uint8_t* p = in.take(markers.size() * kMarkerBytes, what);
  for (Marker& marker : markers) {
    marker = {load<float>(p), load<float>(p + 4), load<float>(p + 8)};
    p += kMarkerBytes;
  }
  return markers;
}

void skip_list(Reader& in, const char* count_name, std::size_t element_bytes) {
  in.take(in.count(count_name, element_bytes) * element_bytes, count_name);
}

// A block of rows * columns samples. The product of two i32 fits 64 bits; a zero factor makes any other
// factor legal.
void skip_block(Reader& in, const char* rows_name, const char* columns_name, std::size_t sample_bytes,
                const char* what) {
  const std::uint64_t rows = in.non_negative(rows_name);
  const std::uint64_t columns = in.non_negative(columns_name);
  if (rows * columns > in.left() / sample_bytes) {
    fail(what, ": ", rows, " x ", columns, " samples of ", sample_bytes, " bytes, ", in.left(), " left");
  }
  in.take(rows * columns * sample_bytes, what);
}

Body decode_body(Reader& in) {
  Body body;
  body.name = in.text("body name", kMaxBodyNameBytes);
  body.markers = decode_markers(in, "marker count");
  skip_list(in, "segment count", kSegmentBytes);
  skip_list(in, "dof count", sizeof(double));
  return body;
}

void skip_item(Reader& in) {
  const std::int32_t tag = in.i32("item tag");
  const std::int32_t length = in.i32("item length");
  if (length < 0 || static_cast<std::size_t>(length) > in.left()) {
    const std::size_t left = in.rest().size();  // without a length the next item cannot be found
    fail("item with tag ", tag, ": length ", length, ", ", left, " bytes left");
  }
  in.take(static_cast<std::size_t>(length), "item");
}

// Delay and tagged items: a fault here drops only the faulty part, never the bodies. Every iteration takes at
// least four bytes.
void decode_optional_sections(Reader& in, FrameOfData& frame) {
  while (in.left() > kQuietSpareBytes) {
    try {
      if (!frame.delay_s) {
        in.i32("word before the delay");
        frame.delay_s = in.get<float>("delay");
      } else {
        skip_item(in);
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
  skip_block(in, "analog channel count", "analog sample count", kAnalogBytes, "analog block");
  skip_block(in, "force plate count", "force sample count", kForceBytes, "force block");
  decode_optional_sections(in, frame);
  return frame;
}

Packet decode_payload(std::uint16_t command, Reader& in) {
  switch (static_cast<Command>(command)) {
    case Command::kHelloWorld:
      return HelloWorld{decode_identity(in)};
    case Command::kHereIAm:
      return HereIAm{decode_identity(in)};
    case Command::kComment:
      return Comment{in.text("text")};
    case Command::kBodyDefs:
      return BodyDefs{in.count("body count", kMinBodyBytes, kMaxBodies)};
    case Command::kFrameOfData:
      return decode_frame(in);
    case Command::kGeneralReply:
      return GeneralReply{in.rest()};
    case Command::kUnrecognizedRequest:
      return UnrecognizedRequest();
    case Command::kUnrecognizedCommand:
      return UnrecognizedCommand();
    default:
      return OtherPacket{command, in.rest()};
  }
}

Bytes packet(Command command, const Bytes& payload) {
  if (payload.size() > kMaxPayloadBytes) {
    fail("payload of ", payload.size(), " bytes is above the limit of ", kMaxPayloadBytes);
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

Packet decode(const std::uint8_t* data, std::size_t size) {
  if (size < kHeaderBytes) {
    fail(size, " bytes are too few for a packet header");
  }
  const std::uint16_t command = load<std::uint16_t>(data);
  const std::size_t declared = load<std::uint16_t>(data + 2);
  return within("packet with code", command, [&] {
    if (declared != size - kHeaderBytes) {
      fail("declares ", declared, " payload bytes, has ", size - kHeaderBytes);
    }
    if (declared > kMaxPayloadBytes) {
      fail(size, " bytes are more than a datagram can carry");
    }
    Reader in(data + kHeaderBytes, declared);
    return decode_payload(command, in);
  });
}

Bytes encode_hello(const Identity& identity) {
  Bytes payload(identity.name.begin(), identity.name.end());
  if (payload.size() >= kProgramNameBytes) {
    fail("program name of ", payload.size(), " bytes is above the limit of ", kProgramNameBytes - 1);
  }
  payload.resize(kProgramNameBytes, 0);
  payload.insert(payload.end(), identity.version.begin(), identity.version.end());
  return packet(Command::kHelloWorld, payload);
}

Bytes encode_request(Command command) {
  return packet(command, {});
}

Bytes encode_text_request(const std::string& text) {
  Bytes payload(text.begin(), text.end());
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
