// Private parameters of the node: read once, checked for type and range; at the end those that were not read
// are known.
#pragma once

#include <xmlrpcpp/XmlRpcValue.h>

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

namespace cortex_ros {

class Parameters {
 public:
  // `values`: a struct {key: value}, or nothing. Those of the struct "mocap", which a launch file sets
  // together, count as if they stood beside it; a parameter of its own wins.
  explicit Parameters(const XmlRpc::XmlRpcValue& values);

  void set(const std::string& key, const std::string& value) { values_[key] = XmlRpc::XmlRpcValue(value); }

  // Leaves `value` alone when the parameter is not set. Throws std::invalid_argument for a wrong type.
  void read(const std::string& key, bool& value);
  void read(const std::string& key, double& value);
  void read(const std::string& key, std::string& value);
  void read_port(const std::string& key, std::uint16_t& port);  // 1 to 65535

  // Set, but not read: misspelt, most likely.
  std::vector<std::string> unread() const;

 private:
  XmlRpc::XmlRpcValue* find(const std::string& key);
  template <typename Value>
  void read_as(const std::string& key, XmlRpc::XmlRpcValue::Type type, Value& value);

  std::map<std::string, XmlRpc::XmlRpcValue> values_;
  std::set<std::string> read_;
};

}  // namespace cortex_ros
