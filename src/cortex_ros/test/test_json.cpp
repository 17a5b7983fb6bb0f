// JSON text of packets: valid whatever the wire brought, and with the documented fields.

#include <gtest/gtest.h>

#include <limits>
#include <map>

#include "cortex_ros/json.hpp"
#include "golden.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using golden::Json;

Json parsed(const Packet& packet) {
  return Json::parse(to_json(packet));
}

TEST(Json, TextIsValidWhateverTheWireBrought) {
  const std::map<std::string, std::string> cases = {
      {"plain", "plain"},
      {"a\"b\\c", "a\"b\\c"},
      {"\n\t\x01\x7f", "\n\t\x01\x7f"},
      {"\xc3\xa9 \xe2\x82\xac \xf0\x9f\x9a\x81", "\xc3\xa9 \xe2\x82\xac \xf0\x9f\x9a\x81"},
      {"\xff", "\u00ff"},                                // never part of UTF-8
      {"\xe9t\xe9", "\u00e9t\u00e9"},                    // Latin-1
      {"\xc3", "\u00c3"},                                // cut
      {"\xc0\xaf", "\u00c0\u00af"},                      // overlong
      {"\xe0\x80\xaf", "\u00e0\u0080\u00af"},            // overlong
      {"\xed\xa0\x80", "\u00ed\u00a0\u0080"},            // surrogate
      {"\xf4\x90\x80\x80", "\u00f4\u0090\u0080\u0080"},  // beyond Unicode
  };
  for (const auto& [bytes, expected] : cases) {
    EXPECT_EQ(parsed(Comment{bytes})["text"], expected);
  }
  EXPECT_EQ(Json::parse(error_json("bad \"\xff\"")), Json({{"error", "bad \"\u00ff\""}}));
}

TEST(Json, NumbersHaveTheDigitsOfTheirExactValue) {
  FrameOfData frame;
  frame.bodies.resize(1);
  frame.bodies[0].dofs = {1.0, -2.5, 0.1, double{0.008f}, 1e300};
  EXPECT_NE(to_json(frame).find("[1,-2.5,0.1,0.00800000037997961,1e+300]"), std::string::npos)
      << to_json(frame);
}

TEST(Json, TypesOfTheGoldenPackets) {
  const std::map<std::string, std::string> types = {
      {"bodydefs_2", "bodydefs"},
      {"bodydefs_2_trailing", "bodydefs"},
      {"comment", "comment"},
      {"frame_2bodies", "frame"},
      {"frame_2bodies_base_layout", "frame"},
      {"frame_all_sections", "frame"},
      {"general_reply_empty", "general_reply"},
      {"general_reply_framerate", "general_reply"},
      {"general_request_framerate", "general_request"},
      {"general_request_livemode", "general_request"},
      {"hello_world_client", "hello_world"},
      {"here_i_am_host", "here_i_am"},
      {"request_bodydefs", "request_bodydefs"},
      {"request_frame", "request_frame"},
      {"unrecognized_request", "unrecognized_request"},
  };
  for (const std::string& name : golden::names()) {
    const std::string text = to_json(decode(golden::bytes(name)));
    EXPECT_EQ(text.find('\n'), std::string::npos) << "one line";
    EXPECT_EQ(Json::parse(text)["type"], types.at(name));
  }
  EXPECT_EQ(parsed(AreYouThere())["type"], "are_you_there");
  EXPECT_EQ(parsed(UnrecognizedCommand())["type"], "unrecognized_command");
  EXPECT_EQ(parsed(PushBasePosition())["type"], "push_baseposition");
  EXPECT_EQ(to_json(UnknownPacket{33, {0xab, 0x01}}),
            R"({"type":"unknown","command":33,"payload_hex":"ab01"})");
}

TEST(Json, FrameEqualsTheSidecar) {
  const Json json = parsed(decode(golden::bytes("frame_all_sections")));
  const Json expected = golden::sidecar("frame_all_sections")["frame_of_data"];
  EXPECT_EQ(json["frame"], expected["frame"]);
  EXPECT_EQ(json["delay_s"], expected["delay"]);
  ASSERT_EQ(json["bodies"].size(), expected["bodies"].size());
  for (std::size_t i = 0; i < json["bodies"].size(); ++i) {
    for (const char* key : {"name", "dofs", "segments"}) {
      EXPECT_EQ(json["bodies"][i][key], expected["bodies"][i][key]);
    }
  }
  const Json markers = json["bodies"][0]["markers"];
  ASSERT_EQ(markers.size(), 3u);
  EXPECT_EQ(markers[0], Json({1.5, 2.5, 3.5}));
  EXPECT_TRUE(markers[1].is_null());
  EXPECT_EQ(json["unidentified"], expected["unidentified"]);
  EXPECT_EQ(json["analog"]["data"], expected["analog"]["samples"]);
  EXPECT_EQ(json["forces"]["data"], expected["forces"]["data"]);
  std::vector<int> tags;
  for (const Json& item : json["items"]) {
    tags.push_back(item["tag"]);
  }
  EXPECT_EQ(tags, (std::vector<int>{11, 777, 12, 13}));
}

TEST(Json, AbsentDelayAndNonFiniteNumbersAreNull) {
  FrameOfData frame;
  EXPECT_TRUE(parsed(frame)["delay_s"].is_null());
  frame.delay = DelaySection{0, std::numeric_limits<float>::infinity()};
  frame.bodies.resize(1);
  frame.bodies[0].dofs = {std::numeric_limits<double>::quiet_NaN(), 0.1};
  frame.faults = {"something"};
  const Json json = parsed(frame);
  EXPECT_TRUE(json["delay_s"].is_null());
  EXPECT_EQ(json["bodies"][0]["dofs"], Json({nullptr, 0.1}));
  EXPECT_EQ(json["faults"], Json({"something"}));
}

}  // namespace
