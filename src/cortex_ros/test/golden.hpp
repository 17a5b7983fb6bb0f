// The golden packets and their sidecar files.
#pragma once

#include <boost/property_tree/json_parser.hpp>
#include <boost/property_tree/ptree.hpp>
#include <fstream>
#include <iterator>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "cortex_ros/protocol.hpp"

namespace golden {

using Tree = boost::property_tree::ptree;

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

inline Tree sidecar(const std::string& name) {
  Tree tree;
  boost::property_tree::read_json(std::string(GOLDEN_DIR) + "/" + name + ".json", tree);
  return tree;
}

inline Tree parse_json(const std::string& text) {
  Tree tree;
  std::istringstream in(text);
  boost::property_tree::read_json(in, tree);
  return tree;
}

// The elements of a JSON array, which property_tree keeps as children without a name.
template <typename Value>
std::vector<Value> values(const Tree& array) {
  std::vector<Value> out;
  for (const auto& child : array) {
    out.push_back(child.second.get_value<Value>());
  }
  return out;
}

inline std::vector<Tree> elements(const Tree& array) {
  std::vector<Tree> out;
  for (const auto& child : array) {
    out.push_back(child.second);
  }
  return out;
}

}  // namespace golden
