// Every golden packet decodes to the values of its sidecar file and encodes to the same bytes.

#include <gtest/gtest.h>

#include "encode.hpp"
#include "golden.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using golden::Json;

template <typename Item>
const Item* find_item(const FrameOfData& frame) {
  for (const TaggedItem& item : frame.items) {
    if (const auto* found = std::get_if<Item>(&item)) {
      return found;
    }
  }
  return nullptr;
}

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
  ASSERT_EQ(body.segments.size(), expected["segments"].size());
  for (std::size_t i = 0; i < body.segments.size(); ++i) {
    const Segment& s = body.segments[i];
    EXPECT_EQ(Json({s.x, s.y, s.z, s.ax, s.ay, s.az, s.length}), expected["segments"][i]);
  }
  EXPECT_EQ(Json(body.dofs), expected["dofs"]);
}

void expect_lenses(const FrameOfData& frame, const Json& bodies) {
  const auto* lenses = find_item<LensEncoders>(frame);
  if (lenses == nullptr) {
    return;
  }
  ASSERT_EQ(lenses->lenses.size(), bodies.size());
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    EXPECT_EQ(lenses->lenses[i].zoom, bodies[i]["zoom"]);
    EXPECT_EQ(lenses->lenses[i].focus, bodies[i]["focus"]);
  }
}

void expect_forces(const ForceBlock& forces, const Json& expected) {
  EXPECT_EQ(forces.plates, expected["nPlates"]);
  EXPECT_EQ(forces.sample_count, expected["nSamples"]);
  ASSERT_EQ(forces.samples.size(), expected["data"].size());
  for (std::size_t i = 0; i < forces.samples.size(); ++i) {
    const Force& f = forces.samples[i];
    EXPECT_EQ(Json({f.x, f.y, f.z, f.fx, f.fy, f.fz, f.mz}), expected["data"][i]);
  }
}

void expect_frame(const FrameOfData& frame, const Json& expected) {
  EXPECT_EQ(frame.frame, expected["frame"]);
  EXPECT_EQ(Json(frame.delay ? frame.delay->delay_s : 0.0f), expected["delay"]);
  ASSERT_EQ(frame.bodies.size(), expected["nBodies"]);
  ASSERT_EQ(frame.bodies.size(), expected["bodies"].size());
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    expect_body(frame.bodies[i], expected["bodies"][i]);
  }
  expect_lenses(frame, expected["bodies"]);
  expect_markers(frame.unidentified, expected["unidentified"]);
  EXPECT_EQ(frame.analog.channels, expected["analog"]["nChannels"]);
  EXPECT_EQ(frame.analog.sample_count, expected["analog"]["nSamples"]);
  EXPECT_EQ(Json(frame.analog.samples), expected["analog"]["samples"]);
  expect_forces(frame.forces, expected["forces"]);

  const auto* encoders = find_item<AngleEncoders>(frame);
  EXPECT_EQ(encoders ? encoders->encoders : 0, expected["encoders"]["nEncoders"]);
  EXPECT_EQ(encoders ? encoders->sample_count : 0, expected["encoders"]["nSamples"]);
  EXPECT_EQ(Json(encoders ? encoders->samples : std::vector<double>()), expected["encoders"]["data"]);
  const auto* recording = find_item<RecordingStatus>(frame);
  EXPECT_EQ(recording ? recording->recording : 0, expected["recording"]["active"]);
  EXPECT_EQ(recording ? recording->first_frame : 0, expected["recording"]["first"]);
  EXPECT_EQ(recording ? recording->last_frame : 0, expected["recording"]["last"]);
  EXPECT_EQ(recording ? recording->capture_file : "", expected["recording"]["filename"]);
  EXPECT_TRUE(frame.faults.empty());
}

void expect_body_defs(const BodyDefs& defs, const Json& expected) {
  ASSERT_EQ(defs.bodies.size(), expected["bodies"].size());
  for (std::size_t i = 0; i < defs.bodies.size(); ++i) {
    const BodyDef& body = defs.bodies[i];
    const Json& wanted = expected["bodies"][i];
    EXPECT_EQ(body.name, wanted["name"]);
    EXPECT_EQ(Json(body.markers), wanted["markers"]);
    EXPECT_EQ(Json(body.dofs), wanted["dofs"]);
    ASSERT_EQ(body.segments.size(), wanted["segments"].size());
    for (std::size_t k = 0; k < body.segments.size(); ++k) {
      EXPECT_EQ(Json::array({body.segments[k].name, body.segments[k].parent}), wanted["segments"][k]);
    }
  }
  EXPECT_EQ(Json(defs.analog_channels), expected["analogChannels"]);
  EXPECT_EQ(defs.force_plates, expected["nForcePlates"]);
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
  const Packet packet = decode(bytes_);
  EXPECT_EQ(command_of(packet), expected_["command"]);
  EXPECT_EQ(bytes_.size(), expected_["datagram_bytes"]);
  EXPECT_EQ(declared_size(bytes_.data(), bytes_.size()),
            kHeaderBytes + expected_["payload_bytes"].get<std::size_t>());
  if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    expect_frame(*frame, expected_["frame_of_data"]);
  } else if (const auto* defs = std::get_if<BodyDefs>(&packet)) {
    expect_body_defs(*defs, expected_["bodydefs"]);
  } else if (const auto* hello = std::get_if<HelloWorld>(&packet)) {
    expect_identity(hello->identity, expected_);
  } else if (const auto* here = std::get_if<HereIAm>(&packet)) {
    expect_identity(here->identity, expected_);
  } else if (const auto* comment = std::get_if<Comment>(&packet)) {
    EXPECT_EQ(comment->text, expected_["string"]);
  } else if (const auto* request = std::get_if<GeneralRequest>(&packet)) {
    EXPECT_EQ(request->text, expected_["string"]);
  } else if (const auto* reply = std::get_if<GeneralReply>(&packet)) {
    EXPECT_EQ(as_float(*reply).has_value(), expected_.contains("as_float"));
    EXPECT_EQ(as_float(*reply).value_or(0.0f), expected_.value("as_float", 0.0f));
  }
}

TEST_P(Golden, EncodesToTheSameBytes) {
  EXPECT_EQ(encode(decode(bytes_)), bytes_);
}

TEST_P(Golden, EveryTruncationIsRefusedOrQuietlyShorter) {
  // With a correct header a cut packet is refused, unless the cut takes nothing but optional parts away.
  for (std::size_t size = kHeaderBytes; size < bytes_.size(); ++size) {
    Bytes cut(bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(size));
    EXPECT_THROW(decode(cut), ProtocolError) << "declared length above the datagram's, " << size << " bytes";
    cut[2] = static_cast<std::uint8_t>((size - kHeaderBytes) & 0xff);
    cut[3] = static_cast<std::uint8_t>((size - kHeaderBytes) >> 8);
    try {
      decode(cut);
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
        decode(changed);
      } catch (const ProtocolError& error) {
        EXPECT_STRNE(error.what(), "");
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, Golden, testing::ValuesIn(golden::names()),
                         [](const auto& info) { return info.param; });

}  // namespace
