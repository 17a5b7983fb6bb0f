// Private parameters of the node: read once, checked for type and range. Parameters that nothing has read are
// listed at the end.
#pragma once

#include <xmlrpcpp/XmlRpcException.h>
#include <xmlrpcpp/XmlRpcValue.h>

#include <cstdint>
#include <set>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace cortex_ros {

class Parameters {
 public:
  // `values`: a struct {key: value}, or nothing. Members of the struct "mocap", which a launch file sets as a
  // whole, count as top-level parameters; a top-level parameter of the same name wins.
  explicit Parameters(XmlRpc::XmlRpcValue values) : values_(std::move(values)) {
    if (values_.hasMember("mocap") && values_["mocap"].getType() == XmlRpc::XmlRpcValue::TypeStruct) {
      for (const auto& [key, value] : XmlRpc::XmlRpcValue(values_["mocap"])) {
        if (!values_.hasMember(key)) {
          values_[key] = value;
        }
      }
      read_.insert("mocap");
    }
  }

  void set(const std::string& key, const std::string& value) { values_[key] = value; }

  // Leaves `value` unchanged when the parameter is not set. Throws std::invalid_argument for a wrong type or
  // an invalid port.
  template <typename Value>
  void read(const std::string& key, Value& value) {
    read_.insert(key);
    if (!values_.hasMember(key)) {
      return;
    }
    try {
      XmlRpc::XmlRpcValue& given = values_[key];
      if constexpr (std::is_same_v<Value, std::uint16_t>) {
        const int port = given;
        if (port < 1 || port > 65535) {
          throw std::invalid_argument("parameter " + key + " is " + std::to_string(port) +
                                      ", must be a port from 1 to 65535");
        }
        value = static_cast<Value>(port);
      } else if constexpr (std::is_same_v<Value, double>) {
        value = given.getType() == XmlRpc::XmlRpcValue::TypeInt ? static_cast<int&>(given)
                                                                : static_cast<double&>(given);
      } else {
        value = static_cast<Value&>(given);
      }
    } catch (const XmlRpc::XmlRpcException&) {
      throw std::invalid_argument("parameter " + key + " has the wrong type");
    }
  }

  // Parameters that are set but were not read: most likely misspelt.
  std::vector<std::string> unread() {
    std::vector<std::string> keys;
    for (const auto& [key, value] : values_) {
      if (read_.count(key) == 0) {
        keys.push_back(key);
      }
    }
    return keys;
  }

 private:
  XmlRpc::XmlRpcValue values_;
  std::set<std::string> read_;
};

}  // namespace cortex_ros
