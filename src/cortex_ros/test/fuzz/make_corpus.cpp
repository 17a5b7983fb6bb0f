// make_corpus DIR: writes seed packets that the golden ones do not cover, one file each.

#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "encode.hpp"
#include "raw_packet.hpp"

namespace {

using namespace cortex_ros;  // NOLINT: a main program of this library only

constexpr std::int64_t kMost = std::numeric_limits<std::int32_t>::max();
constexpr std::uint16_t kFrame = 13;

FrameOfData frame_with_bodies(std::size_t bodies, std::size_t markers) {
  FrameOfData frame;
  frame.frame = std::numeric_limits<std::int32_t>::max();
  for (std::size_t i = 0; i < bodies; ++i) {
    frame.bodies.push_back({"body" + std::to_string(i), {markers, {1.0f, -2.0f, 3.5f}}});
  }
  return frame;
}

std::vector<std::pair<std::string, Bytes>> seeds() {
  const RawPacket none = RawPacket(kFrame).i32(1).i32(0).i32(0).i32(0).i32(0).i32(0).i32(0);
  return {
      {"frame_empty", encode(FrameOfData())},
      {"frame_large", encode(frame_with_bodies(100, 2))},
      {"frame_items", RawPacket(none)
                          .i32(7)
                          .f32(std::numeric_limits<float>::quiet_NaN())
                          .i32(12)
                          .i32(17)
                          .fill(17, 0)
                          .i32(-5)
                          .i32(3)
                          .fill(3, 1)
                          .i32(99)
                          .i32(0)
                          .bytes()},
      // Zero times a huge count is a legal empty block.
      {"frame_hollow", RawPacket(kFrame).i32(1).i32(0).i32(0).i32(0).i32(kMost).i32(kMost).i32(0).bytes()},
      {"bodydefs_empty", encode(BodyDefs())},
      {"other", encode(OtherPacket{0x0180, {1, 2, 3}})},
      {"unrecognized_command", encode(UnrecognizedCommand())},
      {"comment_not_utf8", encode(Comment{"\xff\xfe \xc3\xa9 \xed\xa0\x80"})},
      {"reply_nan", encode(GeneralReply{{0x00, 0x00, 0xc0, 0x7f}})}};
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: make_corpus DIR" << std::endl;
    return 2;
  }
  for (const auto& [name, bytes] : seeds()) {
    const std::string path = std::string(argv[1]) + "/" + name + ".bin";
    std::ofstream out(path, std::ios::binary);
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    if (!out.flush()) {
      std::cerr << "make_corpus: cannot write " << path << std::endl;
      return 1;
    }
  }
  return 0;
}
