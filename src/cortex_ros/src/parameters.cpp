#include "cortex_ros/parameters.hpp"

namespace cortex_ros {

using XmlRpc::XmlRpcValue;

Parameters::Parameters(const XmlRpcValue& values) {
  if (values.getType() != XmlRpcValue::TypeStruct) {
    return;
  }
  for (const auto& [key, value] : values) {
    values_[key] = value;
  }
  const auto together = values_.extract("mocap");
  if (together && together.mapped().getType() == XmlRpcValue::TypeStruct) {
    for (const auto& [key, value] : together.mapped()) {
      values_.emplace(key, value);
    }
  }
}

void Parameters::read_port(const std::string& key, std::uint16_t& port) {
  int value = port;
  read(key, value);
  if (value < 1 || value > 65535) {
    throw std::invalid_argument("parameter " + key + " is " + std::to_string(value) +
                                ", must be a port from 1 to 65535");
  }
  port = static_cast<std::uint16_t>(value);
}

std::vector<std::string> Parameters::unread() const {
  std::vector<std::string> keys;
  for (const auto& [key, value] : values_) {
    if (read_.count(key) == 0) {
      keys.push_back(key);
    }
  }
  return keys;
}

}  // namespace cortex_ros
