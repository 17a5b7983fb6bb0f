#include "cortex_ros/sources/cortex.hpp"

#include <limits>
#include <sstream>

namespace cortex_ros {
namespace {

std::string to_text(Feed feed) {
  return feed == Feed::kStream ? "stream" : "poll";
}

std::vector<Position> to_positions(const std::vector<Marker>& markers, double metres_per_unit) {
  constexpr double kMissing = std::numeric_limits<double>::quiet_NaN();
  std::vector<Position> positions;
  positions.reserve(markers.size());
  for (const Marker& marker : markers) {
    if (marker.missing()) {
      positions.push_back({kMissing, kMissing, kMissing});
    } else {
      positions.push_back({double{marker.x} * metres_per_unit, double{marker.y} * metres_per_unit,
                           double{marker.z} * metres_per_unit});
    }
  }
  return positions;
}

class CortexSource : public MocapSource, private ClientEvents {
 public:
  CortexSource(const ClientOptions& options, SourceEvents& events, const Clock& clock)
      : options_(options), events_(events), client_(options, *this, clock) {}

  void run() override { client_.run(); }
  void stop() noexcept override { client_.stop(); }

  SourceStatus status() const override {
    const Statistics now = client_.statistics();
    SourceStatus status;
    status.up = now.host_up;
    status.host = now.host;
    status.why_down = now.obstacle.empty() ? "no answer from " + now.host : now.obstacle;
    status.mode = to_text(now.feed);
    if (now.feed == Feed::kPoll && options_.mode != Mode::kPoll) {
      status.warnings.emplace_back("no stream, polling");
    }
    status.counters = {{"before the unit was known", now.early},
                       {"malformed", now.malformed, "malformed packets"},
                       {"faulty optional parts", now.faulty_items, "malformed packets"},
                       {"foreign datagrams", now.foreign},
                       {"stale answers", now.stale},
                       {"poll time-outs", now.poll_timeouts},
                       {"times found", now.connects},
                       {"announcements of the host", now.announcements, "the host announced itself again"}};
    return status;
  }

 private:
  void on_frame(const ReceivedFrame& received) override {
    to_mocap_frame(received.frame, metres_per_unit_, frame_);
    frame_.receipt = received.receipt;
    events_.on_frame(frame_);
  }

  void on_host_up(const HostInfo& info) override {
    metres_per_unit_ = kMetresPerMillimetre * info.millimetres_per_unit.value_or(1.0);
    MocapHost host;
    host.frame_rate_hz = info.frame_rate_hz.value_or(options_.frame_rate_hz);
    host.up_axis = "xyz"[info.up_axis.value_or(2)];
    host.remarks = remarks(info);
    const auto& version = info.identity.version;
    std::ostringstream text;
    text << to_string(info.endpoint) << ", program '" << info.identity.name << "' " << int{version[1]} << '.'
         << int{version[2]} << '.' << int{version[3]} << ", " << host.frame_rate_hz << " Hz, "
         << info.bodies.value_or(0) << " bodies defined";
    host.description = text.str();
    events_.on_host_up(host);
  }

  std::vector<std::string> remarks(const HostInfo& info) const {
    std::vector<std::string> out;
    if (!info.millimetres_per_unit) {
      out.emplace_back("the host does not report its length unit: millimetres are assumed");
    } else if (*info.millimetres_per_unit != 1.0) {
      out.push_back("the host's length unit is " + std::to_string(*info.millimetres_per_unit) +
                    " mm: converted to metres");
    }
    if (!info.up_axis) {
      out.emplace_back("the host does not report its up axis: z is assumed");
    }
    if (!info.frame_rate_hz) {
      out.push_back("the host does not report its frame rate: " + std::to_string(options_.frame_rate_hz) +
                    " Hz is assumed (parameter frame_rate)");
    }
    if (options_.live_on_start && !info.live_mode_accepted) {
      out.emplace_back("the host did not accept LiveMode: start live mode in Cortex");
    }
    return out;
  }

  void on_host_down(const std::string& why) override {
    events_.on_host_down(
        why +
        ". Check that Cortex runs, the cable and the network; that the parameters host, "
        "local_address and command_port match Cortex' network settings; and that its firewall "
        "lets UDP port " +
        std::to_string(options_.command_port) + " through");
  }

  void on_feed(Feed feed) override {
    if (feed == Feed::kStream) {
      events_.on_log(LogLevel::kInfo, "the stream is back, polling ends");
    } else {
      events_.on_log(LogLevel::kWarning, "no stream on " + options_.stream_group + ":" +
                                             std::to_string(options_.stream_port) +
                                             ": polling. Is Cortex in live mode, and do group, "
                                             "port and local_address match its settings?");
    }
  }

  void on_comment(const std::string& text) override {
    events_.on_frequent_log(LogLevel::kInfo, "Cortex says: " + text);
  }
  void on_malformed(const std::string& what) override {
    events_.on_frequent_log(LogLevel::kWarning, "malformed packet from the Cortex host: " + what);
  }
  void on_problem(const std::string& text) override { events_.on_log(LogLevel::kError, text); }

  const ClientOptions options_;
  SourceEvents& events_;
  double metres_per_unit_ = kMetresPerMillimetre;
  MocapFrame frame_;
  Client client_;
};

const RegisteredSource kCortex("cortex",
                               [](Parameters& parameters, SourceEvents& events,
                                  const Clock& clock) -> std::unique_ptr<MocapSource> {
                                 return std::make_unique<CortexSource>(read_client_options(parameters),
                                                                       events, clock);
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

void to_mocap_frame(const FrameOfData& frame, double metres_per_unit, MocapFrame& out) {
  out.number = frame.frame;
  out.delay_s = frame.delay_s;
  out.bodies.resize(frame.bodies.size());
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    out.bodies[i].name = frame.bodies[i].name;
    out.bodies[i].markers = to_positions(frame.bodies[i].markers, metres_per_unit);
  }
  out.unidentified = to_positions(frame.unidentified, metres_per_unit);
}

}  // namespace cortex_ros
