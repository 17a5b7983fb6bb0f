// The golden packets and their sidecar files.
#pragma once

#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "cortex_ros/protocol.hpp"

namespace golden {

using Json = nlohmann::json;

inline const std::vector<std::string>& names() {
  static const std::vector<std::string> kNames = {
      "bodydefs_2",
      "bodydefs_2_trailing",
      "comment",
      "frame_2bodies",
      "frame_2bodies_base_layout",
      "frame_all_sections",
      "general_reply_empty",
      "general_reply_framerate",
      "general_request_framerate",
      "general_request_livemode",
      "hello_world_client",
      "here_i_am_host",
      "request_bodydefs",
      "request_frame",
      "unrecognized_request",
  };
  return kNames;
}

inline cortex_ros::Bytes bytes(const std::string& name) {
  const std::string path = std::string(GOLDEN_DIR) + "/" + name + ".bin";
  std::ifstream in(path, std::ios::binary);
  if (!in) {
    throw std::runtime_error("cannot open " + path);
  }
  return cortex_ros::Bytes(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
}

inline Json sidecar(const std::string& name) {
  return Json::parse(std::ifstream(std::string(GOLDEN_DIR) + "/" + name + ".json"));
}

}  // namespace golden
