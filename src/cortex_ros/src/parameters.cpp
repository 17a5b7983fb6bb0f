#include "cortex_ros/parameters.hpp"

#include <stdexcept>

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

XmlRpcValue* Parameters::find(const std::string& key) {
  read_.insert(key);
  const auto found = values_.find(key);
  return found == values_.end() ? nullptr : &found->second;
}

template <typename Value>
void Parameters::read_as(const std::string& key, XmlRpcValue::Type type, Value& value) {
  if (XmlRpcValue* found = find(key)) {
    if (found->getType() != type) {
      throw std::invalid_argument("parameter " + key + " has the wrong type");
    }
    value = static_cast<Value&>(*found);
  }
}

void Parameters::read(const std::string& key, bool& value) {
  read_as(key, XmlRpcValue::TypeBoolean, value);
}

void Parameters::read(const std::string& key, std::string& value) {
  read_as(key, XmlRpcValue::TypeString, value);
}

void Parameters::read(const std::string& key, double& value) {
  if (XmlRpcValue* found = find(key); found && found->getType() == XmlRpcValue::TypeInt) {
    value = static_cast<int&>(*found);
  } else {
    read_as(key, XmlRpcValue::TypeDouble, value);
  }
}

void Parameters::read_port(const std::string& key, std::uint16_t& port) {
  int value = port;
  read_as(key, XmlRpcValue::TypeInt, value);
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
