// What a decoder must check, one test per hazard: inputs that crashed, hung or fooled the original client,
// and the limits of every field. Run under the sanitizers these also prove that nothing is read out of
// bounds.

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>

#include "cortex_ros/protocol.hpp"
#include "encode.hpp"
#include "raw_packet.hpp"

namespace {

using namespace cortex_ros;  // NOLINT

constexpr std::uint16_t kBodyDefs = 11;
constexpr std::uint16_t kFrame = 13;
constexpr std::int64_t kInt32Max = std::numeric_limits<std::int32_t>::max();
constexpr std::int64_t kInt32Min = std::numeric_limits<std::int32_t>::min();

Packet decode(const Bytes& bytes) {
  return cortex_ros::decode(bytes.data(), bytes.size());
}

void expect_refused(const Bytes& bytes, const std::string& part_of_message) {
  try {
    decode(bytes);
    FAIL() << "decoded, should have been refused with '" << part_of_message << "'";
  } catch (const ProtocolError& error) {
    EXPECT_NE(std::string(error.what()).find(part_of_message), std::string::npos) << error.what();
  }
}

FrameOfData decode_frame(const Bytes& bytes) {
  return std::get<FrameOfData>(decode(bytes));
}

// frame_start: frame number and body count. no_more: after the bodies, empty lists and blocks up to the
// optional parts.
RawPacket frame_start(std::int64_t bodies) {
  return RawPacket(kFrame).i32(1).i32(bodies);
}
RawPacket& no_more(RawPacket& packet) {
  return packet.i32(0).i32(0).i32(0).i32(0).i32(0);
}
RawPacket empty_frame() {
  RawPacket packet = frame_start(0);
  return no_more(packet);
}
RawPacket frame_with_delay(float delay_s = 0.004f) {
  return empty_frame().i32(0).f32(delay_s);
}
RawPacket one_body_frame() {
  RawPacket packet = frame_start(1).text("A").i32(1).f32(1).f32(2).f32(3).i32(0).i32(0);
  return no_more(packet).i32(0).f32(0.004f);
}

// ---- header

TEST(Header, FewerThanFourBytesAreRefused) {
  for (std::size_t size = 0; size < 4; ++size) {
    expect_refused(Bytes(size, 0), "too few for a packet header");
  }
  EXPECT_THROW(cortex_ros::decode(nullptr, 0), ProtocolError);
}

TEST(Header, DeclaredLengthMustBeTheDatagrams) {
  const RawPacket packet = RawPacket(3).text("abc");
  EXPECT_NO_THROW(decode(packet.bytes()));
  expect_refused(packet.bytes_declaring(5), "declares 5 payload bytes, has 4");
  expect_refused(packet.bytes_declaring(3), "declares 3 payload bytes, has 4");
  expect_refused(packet.bytes_declaring(65535), "declares 65535");
  expect_refused(RawPacket(kFrame).bytes_declaring(200), "has 0");
}

TEST(Header, MoreThanADatagramCanCarryIsRefused) {
  EXPECT_NO_THROW(decode(RawPacket(15).fill(kMaxPayloadBytes, 1).bytes()));
  expect_refused(RawPacket(15).fill(kMaxPayloadBytes + 1, 1).bytes(), "more than a datagram can carry");
}

TEST(Header, UnknownCodesAreKeptWhole) {
  for (unsigned code :
       {1u, 4u, 9u, 10u, 12u, 14u, 17u, 18u, 33u, 34u, 0x0180u, 0x0181u, 0x0200u, 0x5677u, 0xffffu}) {
    const Bytes bytes = RawPacket(static_cast<std::uint16_t>(code)).fill(3, 7).bytes();
    const Packet packet = decode(bytes);
    ASSERT_TRUE(std::holds_alternative<OtherPacket>(packet)) << code;
    EXPECT_EQ(std::get<OtherPacket>(packet).command, code);
    EXPECT_EQ(encode(packet), bytes);
  }
}

// ---- small packets

TEST(Identity, NeedsAllItsBytes) {
  expect_refused(RawPacket(0).bytes(), "program name needs 128 bytes, 0 left");
  expect_refused(RawPacket(2).text("Cortex").bytes(), "program name needs 128 bytes, 7 left");
  expect_refused(RawPacket(2).fill(131, 0).bytes(), "version needs 4 bytes, 3 left");
}

TEST(Identity, NameWithoutNulEndsInsideItsField) {
  const Packet packet = decode(RawPacket(2).fill(128, 'x').fill(4, 'v').bytes());
  EXPECT_EQ(std::get<HereIAm>(packet).identity.name, std::string(127, 'x'));
  EXPECT_EQ(std::get<HereIAm>(packet).identity.version[0], 'v');
}

TEST(Identity, BytesOfANewerHostAfterTheVersionAreIgnored) {
  const Packet packet = decode(RawPacket(2).text("Cortex").fill(121, 0).fill(4, 1).fill(9, 5).bytes());
  EXPECT_EQ(std::get<HereIAm>(packet).identity.name, "Cortex");
}

TEST(Text, NeedsItsNul) {
  expect_refused(RawPacket(3).bytes(), "text has no terminating NUL");
  expect_refused(RawPacket(3).letters("hello").bytes(), "text has no terminating NUL");
  EXPECT_EQ(std::get<Comment>(decode(RawPacket(3).text("").bytes())).text, "");
}

TEST(Answers, WithAPayloadAreTolerated) {
  EXPECT_TRUE(std::holds_alternative<UnrecognizedRequest>(decode(RawPacket(16).fill(6, 3).bytes())));
  EXPECT_TRUE(std::holds_alternative<UnrecognizedCommand>(decode(RawPacket(0x5678).fill(6, 3).bytes())));
}

TEST(Reply, TooShortForANumberIsNoNumber) {
  for (std::size_t size = 0; size < 4; ++size) {
    const GeneralReply reply{Bytes(size, 0xff)};
    EXPECT_FALSE(as_float(reply).has_value());
    EXPECT_FALSE(as_int(reply).has_value());
  }
  EXPECT_EQ(as_int(GeneralReply{{0xfe, 0xff, 0xff, 0xff}}), -2);
}

// ---- body definitions

TEST(BodyDefs, CountsAreChecked) {
  expect_refused(RawPacket(kBodyDefs).bytes(), "body count needs 4 bytes");
  expect_refused(RawPacket(kBodyDefs).i32(-1).bytes(), "body count is negative");
  expect_refused(RawPacket(kBodyDefs).i32(101).fill(101 * 13, 0).bytes(), "above the limit of 100");
  expect_refused(RawPacket(kBodyDefs).i32(3).fill(2 * 13, 0).bytes(),
                 "body count 3 needs at least 13 bytes each");
}

TEST(BodyDefs, HundredBodiesAreFine) {
  RawPacket packet(kBodyDefs);
  packet.i32(100).fill(100 * 13, 0).i32(0).i32(0);
  EXPECT_EQ(std::get<BodyDefs>(decode(packet.bytes())).bodies, 100u);
}

// ---- frame up to the forces

TEST(Frame, BodyCountIsChecked) {
  expect_refused(RawPacket(kFrame).bytes(), "frame number needs 4 bytes");
  expect_refused(RawPacket(kFrame).i32(1).bytes(), "body count needs 4 bytes");
  expect_refused(frame_start(-1).fill(100, 0).bytes(), "body count is negative (-1)");
  expect_refused(frame_start(101).fill(101 * 13 + 20, 0).bytes(), "body count 101 is above the limit of 100");
  expect_refused(frame_start(2).fill(25, 0).bytes(), "body count 2 needs at least 13 bytes each, 25 left");
  expect_refused(frame_start(kInt32Max).fill(25, 0).bytes(), "above the limit");
}

TEST(Frame, HundredEmptyBodiesAreFine) {
  RawPacket packet = frame_start(100).fill(100 * 13, 0);
  EXPECT_EQ(decode_frame(no_more(packet).bytes()).bodies.size(), 100u);
}

Bytes frame_of_a_body(const std::string& name) {
  RawPacket packet = frame_start(1).text(name).fill(12, 0);
  return no_more(packet).bytes();
}

TEST(Frame, NameOfABodyIsUtf8) {
  for (const auto& [sent, read] : std::map<std::string, std::string>{{"Fl\xc3\xbcgel", "Fl\xc3\xbcgel"},
                                                                     {"Fl\xfcgel", "Fl?gel"},
                                                                     {"Raven\xc3", "Raven?"},
                                                                     {"\xed\xa0\x80", "???"},
                                                                     {"\xc0\xaf", "??"}}) {
    EXPECT_EQ(decode_frame(frame_of_a_body(sent)).bodies[0].name, read);
  }
  const Packet packet = decode(RawPacket(2).text("C\xf6rtex").fill(121, 0).fill(4, 1).bytes());
  EXPECT_EQ(std::get<HereIAm>(packet).identity.name, "C?rtex");
}

TEST(Frame, NameOfABodyIsBounded) {
  EXPECT_EQ(decode_frame(frame_of_a_body(std::string(127, 'n'))).bodies[0].name.size(), 127u);
  expect_refused(frame_of_a_body(std::string(128, 'n')), "body name of 128 bytes is above the limit of 127");
  expect_refused(frame_of_a_body(std::string(5000, 'n')), "body name of 5000 bytes");
  expect_refused(frame_start(1).letters(std::string(60, 'n')).bytes(),
                 "body 0: body name has no terminating NUL");
}

// Counts that wrap 32 bits when multiplied by the item size (12, 56 or 8), are negative, or exceed the data.
TEST(Frame, CountsInsideABodyAreChecked) {
  for (std::int64_t count : {std::int64_t{-1}, std::int64_t{1000000}, std::int64_t{0x15555556},
                             std::int64_t{0x04924925}, std::int64_t{0x20000001}, kInt32Max, kInt32Min}) {
    const std::string problem = count < 0 ? "count is negative" : "count " + std::to_string(count);
    expect_refused(frame_start(1).text("A").i32(count).fill(64, 0).bytes(), "marker " + problem);
    expect_refused(frame_start(1).text("A").i32(0).i32(count).fill(64, 0).bytes(), "segment " + problem);
    expect_refused(frame_start(1).text("A").i32(0).i32(0).i32(count).fill(64, 0).bytes(), "dof " + problem);
    expect_refused(frame_start(0).i32(count).fill(64, 0).bytes(), "unidentified marker " + problem);
  }
}

TEST(Frame, BlocksAreChecked) {
  const auto analog = [](std::int64_t channels, std::int64_t samples) {
    return frame_start(0).i32(0).i32(channels).i32(samples).fill(64, 0).bytes();
  };
  expect_refused(analog(-1, 1), "analog channel count is negative");
  expect_refused(analog(1, -1), "analog sample count is negative");
  expect_refused(analog(65536, 65536), "65536 x 65536");  // wraps 32 bits to zero
  expect_refused(analog(kInt32Max, kInt32Max), "analog block");
  expect_refused(analog(33, 1), "analog block: 33 x 1 samples of 2 bytes, 64 left");
  const auto forces = [](std::int64_t plates, std::int64_t samples) {
    return frame_start(0).i32(0).i32(0).i32(0).i32(plates).i32(samples).fill(64, 0).bytes();
  };
  expect_refused(forces(-1, 1), "force plate count is negative");
  expect_refused(forces(1, -1), "force sample count is negative");
  expect_refused(forces(65536, 65536), "force block");
  expect_refused(forces(3, 1), "force block: 3 x 1 samples of 28 bytes, 64 left");
}

TEST(Frame, ZeroTimesAHugeCountIsAnEmptyBlock) {
  const FrameOfData frame = decode_frame(
      frame_start(0).i32(0).i32(0).i32(kInt32Max).i32(kInt32Max).i32(0).i32(0).f32(0.5f).bytes());
  EXPECT_EQ(frame.delay_s, 0.5f);
  EXPECT_TRUE(frame.faults.empty());
}

TEST(Frame, LargestOneFitsADatagram) {
  FrameOfData frame;
  frame.unidentified.resize((kMaxPayloadBytes - 28) / 12);
  EXPECT_EQ(decode_frame(encode(frame)).unidentified.size(), frame.unidentified.size());
  frame.unidentified.resize(frame.unidentified.size() + 1);
  EXPECT_THROW(encode(frame), ProtocolError);
}

TEST(Frame, SentinelAndNonFiniteCoordinatesAreMissing) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  EXPECT_TRUE((Marker{kMissingCoordinate, 0, 0}.missing()));
  EXPECT_TRUE((Marker{nan, 0, 0}.missing()));
  EXPECT_TRUE((Marker{0, infinity, 0}.missing()));
  EXPECT_TRUE((Marker{0, 0, -infinity}.missing()));
  EXPECT_FALSE((Marker{9999998.0f, 0, 0}.missing()));
  EXPECT_FALSE((Marker{0, kMissingCoordinate, 0}.missing())) << "the rule tests x";
}

// ---- frame, optional parts

TEST(Optional, UpToFourSpareBytesEndQuietly) {
  for (std::size_t spare = 0; spare <= 4; ++spare) {
    const FrameOfData base = decode_frame(empty_frame().fill(spare, 1).bytes());
    EXPECT_FALSE(base.delay_s.has_value());
    EXPECT_TRUE(base.faults.empty());
    const FrameOfData delayed = decode_frame(frame_with_delay().fill(spare, 1).bytes());
    EXPECT_TRUE(delayed.delay_s.has_value());
    EXPECT_TRUE(delayed.faults.empty());
  }
}

TEST(Optional, CutDelayIsDroppedAndCounted) {
  for (std::size_t spare = 5; spare <= 7; ++spare) {
    const FrameOfData frame = decode_frame(empty_frame().fill(spare, 0).bytes());
    EXPECT_FALSE(frame.delay_s.has_value());
    ASSERT_EQ(frame.faults.size(), 1u);
    EXPECT_NE(frame.faults[0].find("delay"), std::string::npos);
  }
}

TEST(Optional, ItemLengthsAreChecked) {
  // A length of -8 put the original client into an infinite loop.
  for (std::int64_t length : {std::int64_t{-8}, std::int64_t{-1}, kInt32Min, std::int64_t{9}, kInt32Max}) {
    const FrameOfData frame = decode_frame(one_body_frame().i32(777).i32(length).fill(8, 0).bytes());
    EXPECT_EQ(frame.bodies.at(0).markers.size(), 1u) << "the bodies are kept";
    EXPECT_TRUE(frame.delay_s.has_value());
    ASSERT_EQ(frame.faults.size(), 1u);
    EXPECT_NE(frame.faults[0].find("777: length " + std::to_string(length)), std::string::npos);
  }
  const FrameOfData cut = decode_frame(one_body_frame().i32(777).fill(3, 0).bytes());
  EXPECT_EQ(cut.faults.size(), 1u);
}

TEST(Optional, ItemsAreSkippedByTheirLength) {
  // The client ignores their contents, valid or not.
  const FrameOfData frame = decode_frame(
      one_body_frame().i32(777).i32(5).fill(5, 1).i32(-3).i32(0).i32(11).i32(8).i32(-1).i32(-1).bytes());
  EXPECT_EQ(frame.bodies.size(), 1u);
  EXPECT_TRUE(frame.faults.empty());
}

// ---- encoding

TEST(Encode, RefusesWhatIsTooLong) {
  EXPECT_THROW(encode_text_request(std::string(kMaxPayloadBytes, 'x')), ProtocolError);
  EXPECT_THROW(encode_hello({std::string(128, 'n'), {}}), ProtocolError);
  EXPECT_NO_THROW(encode_hello({std::string(127, 'n'), {}}));
}

TEST(Encode, NotANumberKeepsItsBits) {
  Bytes bytes = empty_frame().i32(0).bytes();
  const Bytes signalling_nan = {0x01, 0x00, 0xa0, 0x7f};
  bytes.insert(bytes.end(), signalling_nan.begin(), signalling_nan.end());
  bytes[2] = static_cast<std::uint8_t>(bytes.size() - kHeaderBytes);
  EXPECT_EQ(encode(decode(bytes)), bytes);
}

}  // namespace
