// Every golden packet decodes to the values of its sidecar file and encodes to the same bytes.

#include <gtest/gtest.h>

#include <algorithm>

#include "golden.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using golden::elements;
using golden::Tree;
using golden::values;

std::vector<double> coordinates(const Marker& m) {
  return {m.x, m.y, m.z};
}

template <typename Item>
const Item* find_item(const FrameOfData& frame) {
  for (const TaggedItem& item : frame.items) {
    if (const auto* found = std::get_if<Item>(&item)) {
      return found;
    }
  }
  return nullptr;
}

void expect_markers(const std::vector<Marker>& markers, const Tree& expected) {
  const std::vector<Tree> list = elements(expected);
  ASSERT_EQ(markers.size(), list.size());
  for (std::size_t i = 0; i < list.size(); ++i) {
    EXPECT_EQ(coordinates(markers[i]), values<double>(list[i]));
  }
}

void expect_body(const Body& body, const Tree& expected) {
  EXPECT_EQ(body.name, expected.get<std::string>("name"));
  expect_markers(body.markers, expected.get_child("markers"));
  const std::vector<int> missing = values<int>(expected.get_child("missing_markers"));
  for (std::size_t i = 0; i < body.markers.size(); ++i) {
    const bool listed = std::find(missing.begin(), missing.end(), static_cast<int>(i)) != missing.end();
    EXPECT_EQ(body.markers[i].missing(), listed) << "marker " << i;
  }
  const std::vector<Tree> segments = elements(expected.get_child("segments"));
  ASSERT_EQ(body.segments.size(), segments.size());
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const Segment& s = body.segments[i];
    EXPECT_EQ((std::vector<double>{s.x, s.y, s.z, s.ax, s.ay, s.az, s.length}), values<double>(segments[i]));
  }
  EXPECT_EQ(body.dofs, values<double>(expected.get_child("dofs")));
}

void expect_lenses(const FrameOfData& frame, const std::vector<Tree>& bodies) {
  const auto* lenses = find_item<LensEncoders>(frame);
  if (lenses == nullptr) {
    return;
  }
  ASSERT_EQ(lenses->lenses.size(), bodies.size());
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    EXPECT_EQ(lenses->lenses[i].zoom, bodies[i].get<int>("zoom"));
    EXPECT_EQ(lenses->lenses[i].focus, bodies[i].get<int>("focus"));
  }
}

void expect_forces(const ForceBlock& forces, const Tree& expected) {
  EXPECT_EQ(forces.plates, expected.get<int>("nPlates"));
  EXPECT_EQ(forces.sample_count, expected.get<int>("nSamples"));
  const std::vector<Tree> rows = elements(expected.get_child("data"));
  ASSERT_EQ(forces.samples.size(), rows.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Force& f = forces.samples[i];
    EXPECT_EQ((std::vector<double>{f.x, f.y, f.z, f.fx, f.fy, f.fz, f.mz}), values<double>(rows[i]));
  }
}

void expect_frame(const FrameOfData& frame, const Tree& expected) {
  EXPECT_EQ(frame.frame, expected.get<int>("frame"));
  EXPECT_EQ(frame.delay ? static_cast<double>(frame.delay->delay_s) : 0.0, expected.get<double>("delay"));
  const std::vector<Tree> bodies = elements(expected.get_child("bodies"));
  ASSERT_EQ(frame.bodies.size(), expected.get<std::size_t>("nBodies"));
  ASSERT_EQ(frame.bodies.size(), bodies.size());
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    expect_body(frame.bodies[i], bodies[i]);
  }
  expect_lenses(frame, bodies);
  expect_markers(frame.unidentified, expected.get_child("unidentified"));
  EXPECT_EQ(frame.analog.channels, expected.get<int>("analog.nChannels"));
  EXPECT_EQ(frame.analog.sample_count, expected.get<int>("analog.nSamples"));
  EXPECT_EQ(frame.analog.samples, values<std::int16_t>(expected.get_child("analog.samples")));
  expect_forces(frame.forces, expected.get_child("forces"));

  const auto* encoders = find_item<AngleEncoders>(frame);
  EXPECT_EQ(encoders ? encoders->encoders : 0, expected.get<int>("encoders.nEncoders"));
  EXPECT_EQ(encoders ? encoders->sample_count : 0, expected.get<int>("encoders.nSamples"));
  EXPECT_EQ(encoders ? encoders->samples : std::vector<double>(),
            values<double>(expected.get_child("encoders.data")));
  const auto* recording = find_item<RecordingStatus>(frame);
  EXPECT_EQ(recording ? recording->recording : 0, expected.get<int>("recording.active"));
  EXPECT_EQ(recording ? recording->first_frame : 0, expected.get<int>("recording.first"));
  EXPECT_EQ(recording ? recording->last_frame : 0, expected.get<int>("recording.last"));
  EXPECT_EQ(recording ? recording->capture_file : "", expected.get<std::string>("recording.filename"));
  EXPECT_TRUE(frame.faults.empty());
}

void expect_body_defs(const BodyDefs& defs, const Tree& expected) {
  const std::vector<Tree> bodies = elements(expected.get_child("bodies"));
  ASSERT_EQ(defs.bodies.size(), bodies.size());
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    const BodyDef& body = defs.bodies[i];
    EXPECT_EQ(body.name, bodies[i].get<std::string>("name"));
    EXPECT_EQ(body.markers, values<std::string>(bodies[i].get_child("markers")));
    EXPECT_EQ(body.dofs, values<std::string>(bodies[i].get_child("dofs")));
    const std::vector<Tree> segments = elements(bodies[i].get_child("segments"));
    ASSERT_EQ(body.segments.size(), segments.size());
    for (std::size_t k = 0; k < segments.size(); ++k) {
      const std::vector<std::string> pair = values<std::string>(segments[k]);
      EXPECT_EQ(body.segments[k].name, pair.at(0));
      EXPECT_EQ(std::to_string(body.segments[k].parent), pair.at(1));
    }
  }
  EXPECT_EQ(defs.analog_channels, values<std::string>(expected.get_child("analogChannels")));
  EXPECT_EQ(defs.force_plates, expected.get<int>("nForcePlates"));
}

void expect_identity(const Identity& identity, const Tree& expected) {
  EXPECT_EQ(identity.name, expected.get<std::string>("name"));
  const std::vector<int> version = values<int>(expected.get_child("version"));
  EXPECT_EQ(std::vector<int>(identity.version.begin(), identity.version.end()), version);
}

class Golden : public testing::TestWithParam<std::string> {
 protected:
  const Bytes bytes_ = golden::bytes(GetParam());
  const Tree expected_ = golden::sidecar(GetParam());
};

TEST_P(Golden, DecodesToTheSidecar) {
  const Packet packet = decode(bytes_);
  EXPECT_EQ(command_of(packet), expected_.get<unsigned>("command"));
  EXPECT_EQ(bytes_.size(), expected_.get<std::size_t>("datagram_bytes"));
  EXPECT_EQ(declared_size(bytes_.data(), bytes_.size()),
            kHeaderBytes + expected_.get<std::size_t>("payload_bytes"));
  if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    expect_frame(*frame, expected_.get_child("frame_of_data"));
  } else if (const auto* defs = std::get_if<BodyDefs>(&packet)) {
    expect_body_defs(*defs, expected_.get_child("bodydefs"));
  } else if (const auto* hello = std::get_if<HelloWorld>(&packet)) {
    expect_identity(hello->identity, expected_);
  } else if (const auto* here = std::get_if<HereIAm>(&packet)) {
    expect_identity(here->identity, expected_);
  } else if (const auto* comment = std::get_if<Comment>(&packet)) {
    EXPECT_EQ(comment->text, expected_.get<std::string>("string"));
  } else if (const auto* request = std::get_if<GeneralRequest>(&packet)) {
    EXPECT_EQ(request->text, expected_.get<std::string>("string"));
  } else if (const auto* reply = std::get_if<GeneralReply>(&packet)) {
    const auto number = expected_.get_optional<float>("as_float");
    EXPECT_EQ(as_float(*reply).has_value(), number.has_value());
    EXPECT_EQ(as_float(*reply).value_or(0.0f), number.value_or(0.0f));
  }
}

TEST_P(Golden, EncodesToTheSameBytes) {
  EXPECT_EQ(encode(decode(bytes_)), bytes_);
}

TEST_P(Golden, EveryTruncationIsRefusedOrQuietlyShorter) {
  // With an honest header a cut packet is refused, unless the cut takes nothing but optional parts away.
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
