// Private parameters of the node: read once, checked for type and range; at the end those that were not read
// are known.
#pragma once

#include <xmlrpcpp/XmlRpcException.h>
#include <xmlrpcpp/XmlRpcValue.h>

#include <cstdint>
#include <map>
#include <set>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace cortex_ros {

class Parameters {
 public:
  // `values`: a struct {key: value}, or nothing. Those of the struct "mocap", which a launch file sets
  // together, count as if they stood beside it; a parameter of its own wins.
  explicit Parameters(const XmlRpc::XmlRpcValue& values);

  void set(const std::string& key, const std::string& value) { values_[key] = XmlRpc::XmlRpcValue(value); }

  // Leaves `value` alone when the parameter is not set. Throws std::invalid_argument for a wrong type.
  template <typename Value>
  void read(const std::string& key, Value& value) {
    read_.insert(key);
    const auto found = values_.find(key);
    if (found == values_.end()) {
      return;
    }
    try {
      if constexpr (std::is_same_v<Value, double>) {
        if (found->second.getType() == XmlRpc::XmlRpcValue::TypeInt) {
          value = static_cast<int&>(found->second);
          return;
        }
      }
      value = static_cast<Value&>(found->second);
    } catch (const XmlRpc::XmlRpcException&) {
      throw std::invalid_argument("parameter " + key + " has the wrong type");
    }
  }

  void read_port(const std::string& key, std::uint16_t& port);  // 1 to 65535

  // Set, but not read: misspelt, most likely.
  std::vector<std::string> unread() const;

 private:
  std::map<std::string, XmlRpc::XmlRpcValue> values_;
  std::set<std::string> read_;
};

}  // namespace cortex_ros
