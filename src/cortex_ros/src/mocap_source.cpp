#include "cortex_ros/sources/mocap_source.hpp"

#include <boost/algorithm/string/join.hpp>
#include <boost/range/adaptor/map.hpp>
#include <map>
#include <stdexcept>

namespace cortex_ros {
namespace {

// Created by the first file that registers a source, because the order of static initialisation is not fixed.
std::map<std::string, MakeSource>& registry() {
  static std::map<std::string, MakeSource> sources;
  return sources;
}

}  // namespace

RegisteredSource::RegisteredSource(const std::string& name, MakeSource make) {
  registry()[name] = make;
}

std::unique_ptr<MocapSource> make_source(const std::string& name, Parameters& parameters,
                                         SourceEvents& events, const Clock& clock) {
  const auto found = registry().find(name);
  if (found == registry().end()) {
    throw std::invalid_argument("parameter source is '" + name + "'; must be one of: " +
                                boost::algorithm::join(registry() | boost::adaptors::map_keys, ", "));
  }
  return found->second(parameters, events, clock);
}

}  // namespace cortex_ros
