// Every golden packet decodes to the values of its sidecar file; only values that a client uses are compared.

#include <gtest/gtest.h>

#include "golden.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using golden::Json;

void expect_markers(const std::vector<Marker>& markers, const Json& expected) {
  ASSERT_EQ(markers.size(), expected.size());
  for (std::size_t i = 0; i < markers.size(); ++i) {
    EXPECT_EQ(Json({markers[i].x, markers[i].y, markers[i].z}), expected[i]);
  }
}

void expect_body(const Body& body, const Json& expected) {
  EXPECT_EQ(body.name, expected["name"]);
  expect_markers(body.markers, expected["markers"]);
  std::vector<std::size_t> missing;
  for (std::size_t i = 0; i < body.markers.size(); ++i) {
    if (body.markers[i].missing()) {
      missing.push_back(i);
    }
  }
  EXPECT_EQ(Json(missing), expected["missing_markers"]);
}

void expect_frame(const FrameOfData& frame, const Json& expected) {
  EXPECT_EQ(frame.frame, expected["frame"]);
  EXPECT_EQ(Json(frame.delay_s.value_or(0.0f)), expected["delay"]);
  ASSERT_EQ(frame.bodies.size(), expected["nBodies"]);
  ASSERT_EQ(frame.bodies.size(), expected["bodies"].size());
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    expect_body(frame.bodies[i], expected["bodies"][i]);
  }
  expect_markers(frame.unidentified, expected["unidentified"]);
  EXPECT_TRUE(frame.faults.empty());
}

void expect_identity(const Identity& identity, const Json& expected) {
  EXPECT_EQ(identity.name, expected["name"]);
  EXPECT_EQ(Json(identity.version), expected["version"]);
}

class Golden : public testing::TestWithParam<std::string> {
 protected:
  const Bytes bytes_ = golden::bytes(GetParam());
  const Json expected_ = golden::sidecar(GetParam());
};

TEST_P(Golden, DecodesToTheSidecar) {
  const Packet packet = decode(bytes_.data(), bytes_.size());
  EXPECT_EQ(bytes_.size(), expected_["datagram_bytes"]);
  if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    expect_frame(*frame, expected_["frame_of_data"]);
  } else if (const auto* defs = std::get_if<BodyDefs>(&packet)) {
    EXPECT_EQ(defs->bodies, expected_["bodydefs"]["bodies"].size());
  } else if (const auto* hello = std::get_if<HelloWorld>(&packet)) {
    expect_identity(hello->identity, expected_);
  } else if (const auto* here = std::get_if<HereIAm>(&packet)) {
    expect_identity(here->identity, expected_);
  } else if (const auto* comment = std::get_if<Comment>(&packet)) {
    EXPECT_EQ(comment->text, expected_["string"]);
  } else if (const auto* other = std::get_if<OtherPacket>(&packet)) {
    EXPECT_EQ(other->command, expected_["command"]);
    EXPECT_EQ(other->payload.size(), expected_["payload_bytes"]);
  } else if (const auto* reply = std::get_if<GeneralReply>(&packet)) {
    EXPECT_EQ(as_float(*reply).has_value(), expected_.contains("as_float"));
    EXPECT_EQ(as_float(*reply).value_or(0.0f), expected_.value("as_float", 0.0f));
  }
}

TEST_P(Golden, WhatAClientSendsIsEncodedToTheSameBytes) {
  const std::uint16_t command = expected_["command"];
  if (command == 0) {
    EXPECT_EQ(encode_hello({expected_["name"], expected_["version"]}), bytes_);
  } else if (command == 10 || command == 12) {
    EXPECT_EQ(encode_request(static_cast<Command>(command)), bytes_);
  } else if (command == 14) {
    EXPECT_EQ(encode_text_request(expected_["string"]), bytes_);
  }
}

TEST_P(Golden, EveryTruncationIsRefusedOrQuietlyShorter) {
  // With a correct header a cut packet is refused, unless the cut removes only optional parts.
  for (std::size_t size = kHeaderBytes; size < bytes_.size(); ++size) {
    Bytes cut(bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(size));
    EXPECT_THROW(decode(cut.data(), cut.size()), ProtocolError)
        << "declared length above the datagram's, " << size << " bytes";
    cut[2] = static_cast<std::uint8_t>((size - kHeaderBytes) & 0xff);
    cut[3] = static_cast<std::uint8_t>((size - kHeaderBytes) >> 8);
    try {
      decode(cut.data(), cut.size());
    } catch (const ProtocolError& error) {
      EXPECT_STRNE(error.what(), "");
    }
  }
}

TEST_P(Golden, EverySingleByteChangeIsHandled) {
  for (std::size_t i = 0; i < bytes_.size(); ++i) {
    for (int value : {0x00, 0x01, 0x7f, 0x80, 0xff}) {
      Bytes changed = bytes_;
      changed[i] = static_cast<std::uint8_t>(value);
      try {
        decode(changed.data(), changed.size());
      } catch (const ProtocolError& error) {
        EXPECT_STRNE(error.what(), "");
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, Golden, testing::ValuesIn(golden::names()),
                         [](const auto& info) { return info.param; });

}  // namespace
