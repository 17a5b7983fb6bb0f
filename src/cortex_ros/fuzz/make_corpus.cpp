// make_corpus DIR: writes seed packets that the golden ones do not cover, one file each.

#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "encode.hpp"

namespace {

using namespace cortex_ros;  // NOLINT: a main program of this library only

FrameOfData frame_with_bodies(std::size_t bodies, std::size_t markers) {
  FrameOfData frame;
  frame.frame = std::numeric_limits<std::int32_t>::max();
  for (std::size_t i = 0; i < bodies; ++i) {
    Body body;
    body.name = "body" + std::to_string(i);
    body.markers.assign(markers, {1.0f, -2.0f, 3.5f});
    frame.bodies.push_back(body);
  }
  return frame;
}

FrameOfData frame_with_items() {
  FrameOfData frame = frame_with_bodies(2, 1);
  frame.delay = DelaySection{7, std::numeric_limits<float>::quiet_NaN()};
  frame.items = {AngleEncoders{1, 2, {1.0, 2.0}}, RecordingStatus{1, 2, 3, "take.cap"},
                 LensEncoders{{{1, 2}, {3, 4}}}, UnknownItem{-5, {1, 2, 3}}, UnknownItem{99, {}}};
  return frame;
}

// Zero times something huge is a legal empty block.
FrameOfData frame_with_hollow_blocks() {
  FrameOfData frame;
  frame.analog = {0, std::numeric_limits<std::int32_t>::max(), {}};
  frame.forces = {std::numeric_limits<std::int32_t>::max(), 0, {}};
  frame.unidentified = {{kMissingCoordinate, 0.0f, 0.0f}};
  return frame;
}

std::vector<std::pair<std::string, Packet>> seeds() {
  PushBasePosition push;
  push.hierarchy = {{-1, "root"}, {0, "arm"}};
  push.pose.resize(2);
  BodyDefs empty_defs;
  return {{"frame_empty", FrameOfData()},
          {"frame_large", frame_with_bodies(100, 2)},
          {"frame_items", frame_with_items()},
          {"frame_hollow", frame_with_hollow_blocks()},
          {"bodydefs_empty", empty_defs},
          {"push", push},
          {"unknown", UnknownPacket{0x0180, {1, 2, 3}}},
          {"unrecognized_command", UnrecognizedCommand()},
          {"are_you_there", AreYouThere()},
          {"comment_not_utf8", Comment{"\xff\xfe \xc3\xa9 \xed\xa0\x80"}},
          {"reply_nan", GeneralReply{{0x00, 0x00, 0xc0, 0x7f}}}};
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: make_corpus DIR" << std::endl;
    return 2;
  }
  for (const auto& [name, packet] : seeds()) {
    const std::string path = std::string(argv[1]) + "/" + name + ".bin";
    const Bytes bytes = encode(packet);
    std::ofstream out(path, std::ios::binary);
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    if (!out.flush()) {
      std::cerr << "make_corpus: cannot write " << path << std::endl;
      return 1;
    }
  }
  return 0;
}
