// JSON text of packets: valid whatever the wire brought, and with the documented fields.

#include <gtest/gtest.h>

#include <limits>
#include <map>

#include "cortex_ros/json.hpp"
#include "golden.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using golden::elements;
using golden::parse_json;
using golden::Tree;
using golden::values;

TEST(JsonQuote, EscapesWhatJsonDemands) {
  EXPECT_EQ(json_quote("plain"), "\"plain\"");
  EXPECT_EQ(json_quote("a\"b\\c"), "\"a\\\"b\\\\c\"");
  EXPECT_EQ(json_quote("\n\t\x01\x7f"), "\"\\u000a\\u0009\\u0001\\u007f\"");
  EXPECT_EQ(json_quote(std::string("\0", 1)), "\"\\u0000\"");
}

TEST(JsonQuote, PassesUtf8AndTranscribesOtherBytes) {
  EXPECT_EQ(json_quote("\xc3\xa9 \xe2\x82\xac \xf0\x9f\x9a\x81"),
            "\"\xc3\xa9 \xe2\x82\xac \xf0\x9f\x9a\x81\"");
  const std::map<std::string, std::string> cases = {
      {"\xff", "\"\\u00ff\""},                                   // never part of UTF-8
      {"\xe9t\xe9", "\"\\u00e9t\\u00e9\""},                      // Latin-1
      {"\xc3", "\"\\u00c3\""},                                   // cut
      {"\xc0\xaf", "\"\\u00c0\\u00af\""},                        // overlong
      {"\xe0\x80\xaf", "\"\\u00e0\\u0080\\u00af\""},             // overlong
      {"\xed\xa0\x80", "\"\\u00ed\\u00a0\\u0080\""},             // surrogate
      {"\xf4\x90\x80\x80", "\"\\u00f4\\u0090\\u0080\\u0080\""},  // beyond Unicode
  };
  for (const auto& [bytes, expected] : cases) {
    EXPECT_EQ(json_quote(bytes), expected);
  }
}

TEST(Json, ErrorIsAnObject) {
  EXPECT_EQ(parse_json(error_json("bad \"thing\"")).get<std::string>("error"), "bad \"thing\"");
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
    EXPECT_EQ(parse_json(text).get<std::string>("type"), types.at(name));
  }
  EXPECT_EQ(parse_json(to_json(AreYouThere())).get<std::string>("type"), "are_you_there");
  EXPECT_EQ(parse_json(to_json(UnrecognizedCommand())).get<std::string>("type"), "unrecognized_command");
  EXPECT_EQ(parse_json(to_json(PushBasePosition())).get<std::string>("type"), "push_baseposition");
  const Tree unknown = parse_json(to_json(UnknownPacket{33, {0xab, 0x01}}));
  EXPECT_EQ(unknown.get<std::string>("type"), "unknown");
  EXPECT_EQ(unknown.get<int>("command"), 33);
  EXPECT_EQ(unknown.get<std::string>("payload_hex"), "ab01");
}

TEST(Json, FrameEqualsTheSidecar) {
  const Tree json = parse_json(to_json(decode(golden::bytes("frame_all_sections"))));
  const Tree expected = golden::sidecar("frame_all_sections").get_child("frame_of_data");
  EXPECT_EQ(json.get<int>("frame"), expected.get<int>("frame"));
  EXPECT_EQ(json.get<double>("delay_s"), expected.get<double>("delay"));
  const std::vector<Tree> bodies = elements(json.get_child("bodies"));
  const std::vector<Tree> expected_bodies = elements(expected.get_child("bodies"));
  ASSERT_EQ(bodies.size(), expected_bodies.size());
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    EXPECT_EQ(bodies[i].get<std::string>("name"), expected_bodies[i].get<std::string>("name"));
    EXPECT_EQ(values<double>(bodies[i].get_child("dofs")),
              values<double>(expected_bodies[i].get_child("dofs")));
    EXPECT_EQ(elements(bodies[i].get_child("segments")).size(),
              elements(expected_bodies[i].get_child("segments")).size());
  }
  const std::vector<Tree> markers = elements(bodies[0].get_child("markers"));
  ASSERT_EQ(markers.size(), 3u);
  EXPECT_EQ(values<double>(markers[0]), (std::vector<double>{1.5, 2.5, 3.5}));
  EXPECT_EQ(markers[1].get_value<std::string>(), "null");
  EXPECT_EQ(values<double>(elements(json.get_child("unidentified"))[1]),
            (std::vector<double>{-7.5, -8.5, -9.5}));
  EXPECT_EQ(values<int>(json.get_child("analog.data")), (std::vector<int>{0, 1, -1, 32767, -32768, 123}));
  std::vector<int> tags;
  for (const Tree& item : elements(json.get_child("items"))) {
    tags.push_back(item.get<int>("tag"));
  }
  EXPECT_EQ(tags, (std::vector<int>{11, 777, 12, 13}));
}

TEST(Json, AbsentDelayAndNonFiniteNumbersAreNull) {
  FrameOfData frame;
  EXPECT_EQ(parse_json(to_json(frame)).get<std::string>("delay_s"), "null");
  frame.delay = DelaySection{0, std::numeric_limits<float>::infinity()};
  frame.bodies.resize(1);
  frame.bodies[0].dofs = {std::numeric_limits<double>::quiet_NaN(), 0.1};
  frame.faults = {"something"};
  const Tree json = parse_json(to_json(frame));
  EXPECT_EQ(json.get<std::string>("delay_s"), "null");
  const Tree dofs = elements(json.get_child("bodies"))[0].get_child("dofs");
  EXPECT_EQ(values<std::string>(dofs), (std::vector<std::string>{"null", "0.1"}));
  EXPECT_EQ(values<std::string>(json.get_child("faults")), (std::vector<std::string>{"something"}));
}

}  // namespace
