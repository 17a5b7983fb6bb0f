// The golden packets and their sidecar files.
#pragma once

#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "cortex_ros/protocol.hpp"

namespace golden {

using Json = nlohmann::json;

inline std::vector<std::string> names() {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(GOLDEN_DIR)) {
    if (entry.path().extension() == ".bin") {
      names.push_back(entry.path().stem());
    }
  }
  return names;
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
