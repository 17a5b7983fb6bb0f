#include "cortex_ros/sources/cortex.hpp"

namespace cortex_ros {
namespace {

const RegisteredSource kCortex("cortex",
                               [](Parameters& parameters, SourceEvents& events,
                                  const Clock& clock) -> std::unique_ptr<MocapSource> {
                                 return std::make_unique<Client>(read_client_options(parameters), events,
                                                                 clock);
                               });

}  // namespace

ClientOptions read_client_options(Parameters& parameters) {
  ClientOptions options;
  std::string mode = "auto";
  parameters.read("host", options.host);
  parameters.read("local_address", options.local_address);
  parameters.read("command_port", options.command_port);
  parameters.read("stream_group", options.stream_group);
  parameters.read("stream_port", options.stream_port);
  parameters.read("mode", mode);
  parameters.read("live_on_start", options.live_on_start);
  parameters.read("pause_on_exit", options.pause_on_exit);
  parameters.read("frame_rate", options.frame_rate_hz);
  options.host = host_from_text(options.host);
  options.mode = mode_from_text(mode);
  return options;
}

}  // namespace cortex_ros
