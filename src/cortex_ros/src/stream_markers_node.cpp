// Node MocapStates (executable stream_markers): Cortex frames -> mocap_data and mocap_time. Wiring only.

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>
#include <sensor_msgs/TimeReference.h>

#include <algorithm>
#include <csignal>
#include <memory>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>

#include "cortex_ros/client.hpp"
#include "cortex_ros/clock_filter.hpp"
#include "cortex_ros/conversions.hpp"
#include "risc_msgs/Mocap_data.h"

namespace cortex_ros {
namespace {

// Frames held up on the way arrive in one go, faster than roscpp's sending thread empties the queue: the ten
// places of the original release overflow after a stall of 50 ms. This is half a second at 200 Hz.
constexpr int kQueueSize = 100;
constexpr double kLogPeriodS = 5.0;
constexpr double kStaleFrameS = 0.5;
constexpr double kMaxMaxDelayS = 10.0;
constexpr int kUpAxisZ = 2;

struct Params {
  ClientOptions client;
  double max_delay_s = 0.5;  // a larger reported delay is not believed
  bool missing_as_nan = true;
  bool filter_stamps = true;
  std::string frame_id = "cortex";
};

// Reads private parameters and remembers which ones exist, so that a misspelt one can be reported.
class ParamReader {
 public:
  explicit ParamReader(const ros::NodeHandle& node) : node_(node) {}

  // A parameter by itself, or as one of those that a launch file sets together: ~mocap/KEY.
  template <typename Value>
  void read(const std::string& key, Value& value) {
    const std::string together = "mocap/" + key;
    known_.insert(node_.resolveName(key));
    known_.insert(node_.resolveName(together));
    const std::string& found = node_.hasParam(key) ? key : together;
    if (node_.hasParam(found) && !node_.getParam(found, value)) {
      throw std::invalid_argument("parameter " + node_.resolveName(found) + " has the wrong type");
    }
  }

  void read_port(const std::string& key, std::uint16_t& port) {
    int value = port;
    read(key, value);
    if (value < 1 || value > 65535) {
      throw std::invalid_argument("parameter " + node_.resolveName(key) + " is " + std::to_string(value) +
                                  ", must be a port from 1 to 65535");
    }
    port = static_cast<std::uint16_t>(value);
  }

  void warn_about_unknown() const {
    const std::string prefix = node_.getNamespace() + "/";
    std::vector<std::string> names;
    node_.getParamNames(names);
    for (const std::string& name : names) {
      if (name.compare(0, prefix.size(), prefix) == 0 && known_.count(name) == 0) {
        ROS_WARN("parameter %s is not known to stream_markers and has no effect", name.c_str());
      }
    }
  }

 private:
  const ros::NodeHandle& node_;
  std::set<std::string> known_;
};

Params load_params(const ros::NodeHandle& node) {
  Params params;
  ParamReader reader(node);
  std::string mode = "auto";
  double diagnostic_period_s = 1.0;  // belongs to diagnostic_updater, which reads it itself
  reader.read("host", params.client.host);
  reader.read("local_address", params.client.local_address);
  reader.read_port("command_port", params.client.command_port);
  reader.read("stream_group", params.client.stream_group);
  reader.read_port("stream_port", params.client.stream_port);
  reader.read("mode", mode);
  reader.read("live_on_start", params.client.live_on_start);
  reader.read("pause_on_exit", params.client.pause_on_exit);
  reader.read("frame_rate", params.client.frame_rate_hz);
  reader.read("max_delay", params.max_delay_s);
  reader.read("missing_as_nan", params.missing_as_nan);
  reader.read("filter_stamps", params.filter_stamps);
  reader.read("frame_id", params.frame_id);
  reader.read("diagnostic_period", diagnostic_period_s);
  reader.warn_about_unknown();
  params.client.mode = mode_from_text(mode);
  if (!(params.max_delay_s >= 0.0 && params.max_delay_s <= kMaxMaxDelayS)) {
    throw std::invalid_argument("parameter max_delay must be from 0 to 10 s");
  }
  return params;
}

// The original program was called with its own address and the host's.
void apply_legacy_arguments(int argc, char** argv, Params& params) {
  if (argc > 3) {
    throw std::invalid_argument("usage: stream_markers [local address [host address]] (and _param:=value)");
  }
  if (argc > 1) {
    params.client.local_address = argv[1];
  }
  if (argc > 2) {
    params.client.host = argv[2];
  }
  params.client.host = host_from_text(params.client.host);
}

const char* to_text(Source source) {
  return source == Source::kStream ? "stream" : "poll";
}

class StreamMarkers : public ClientEvents {
 public:
  StreamMarkers(ros::NodeHandle& node, const Params& params)
      : params_(params),
        markers_(node.advertise<risc_msgs::Mocap_data>("mocap_data", kQueueSize)),
        time_(node.advertise<sensor_msgs::TimeReference>("mocap_time", kQueueSize)),
        client_(params.client, *this, clock_) {
    diagnostics_.setHardwareID("cortex " + client_.statistics().host);
    diagnostics_.add("mocap stream", this, &StreamMarkers::diagnose);
    diagnostics_timer_ = node.createWallTimer(
        ros::WallDuration(1.0), [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
    // The receive thread publishes by itself: a frame waits for no spinner and no rate.
    worker_ = std::thread([this] { client_.run(); });
  }

  ~StreamMarkers() override {
    client_.stop();
    worker_.join();
  }

  void on_frame(const ReceivedFrame& received) override {
    if (is_turned_) {
      return;
    }
    const FrameOfData& frame = received.frame;
    const Time delay = from_seconds(frame.sane_delay_s(params_.max_delay_s));
    const Time exposure = stamps_.stamp(frame.frame, received.receipt, delay);
    publish_markers(frame, exposure);
    publish_time(frame, exposure, received.receipt);
    const std::lock_guard<std::mutex> lock(health_mutex_);
    health_.reported_delay_s = to_seconds(delay);
    health_.stamp_correction_s = to_seconds(received.receipt - delay - exposure);
    health_.stamps_filtered = stamps_.locked();
  }

  void on_host_up(const HostInfo& info) override {
    metres_per_unit_ = kMetresPerMillimetre * info.millimetres_per_unit.value_or(1.0);
    const double rate_hz = info.frame_rate_hz.value_or(params_.client.frame_rate_hz);
    stamps_.set_period(params_.filter_stamps ? from_seconds(1.0 / rate_hz) : Time{0});
    const std::string text = describe(info, rate_hz);
    if (is_up_) {
      // This thread receives the frames: packets that anyone can send must not keep it busy with logging.
      ROS_INFO_THROTTLE(kLogPeriodS, "Cortex was asked anew: %s", text.c_str());
    } else {
      ROS_INFO("Cortex host is %s: %s", was_down_ ? "back" : "there", text.c_str());
    }
    is_up_ = true;
    was_down_ = false;
    is_turned_ = info.up_axis.value_or(kUpAxisZ) != kUpAxisZ;
    report_oddities(info, rate_hz);
  }

  void on_host_down(const std::string& why) override {
    is_up_ = false;
    was_down_ = true;
    ROS_ERROR(
        "Cortex host is down: %s. Cure: start Cortex, check cable and network, compare the parameters host, "
        "local_address and command_port with Cortex' network settings, let UDP port %u through its firewall. "
        "Trying on.",
        why.c_str(), static_cast<unsigned>(params_.client.command_port));
  }

  void on_source(Source source) override {
    if (source == Source::kStream) {
      ROS_INFO("the stream is back, polling ends");
    } else {
      ROS_WARN("no stream on %s:%u: polling. Is the host live, and do group, port and local_address fit?",
               params_.client.stream_group.c_str(), static_cast<unsigned>(params_.client.stream_port));
    }
  }

  void on_comment(const std::string& text) override {
    ROS_INFO_THROTTLE(kLogPeriodS, "Cortex says: %s", text.c_str());
  }
  void on_malformed(const std::string& what) override {
    ROS_WARN_THROTTLE(kLogPeriodS, "refused from the Cortex host: %s", what.c_str());
  }
  void on_problem(const std::string& text) override { ROS_ERROR("%s", text.c_str()); }

 private:
  // What the frame path knows and the diagnostics show.
  struct Health {
    double reported_delay_s = 0.0;
    double stamp_correction_s = 0.0;
    bool stamps_filtered = false;
    std::string oddity;      // of the host's settings; empty: none
    bool is_turned = false;  // its up axis is not z
  };

  static std::string describe(const HostInfo& info, double rate_hz) {
    const auto& version = info.identity.version;
    std::ostringstream text;
    text << to_string(info.endpoint) << ", program '" << info.identity.name << "' " << int{version[1]} << '.'
         << int{version[2]} << '.' << int{version[3]} << ", " << rate_hz << " Hz, "
         << (info.body_defs ? info.body_defs->bodies.size() : 0) << " bodies defined";
    return text.str();
  }

  void publish_markers(const FrameOfData& frame, Time exposure) {
    const auto message = boost::make_shared<risc_msgs::Mocap_data>();
    message->header.stamp = to_ros_time(exposure);
    message->header.frame_id = params_.frame_id;
    fill_markers(frame, metres_per_unit_,
                 params_.missing_as_nan ? MissingMarkers::kNan : MissingMarkers::kLegacyValue, *message);
    markers_.publish(message);
  }

  void publish_time(const FrameOfData& frame, Time exposure, Time receipt) {
    const auto message = boost::make_shared<sensor_msgs::TimeReference>();
    message->header.stamp = to_ros_time(exposure);
    message->header.frame_id = params_.frame_id;
    message->time_ref = to_ros_time(receipt);
    message->source = std::to_string(frame.frame);
    time_.publish(message);
  }

  void report_oddities(const HostInfo& info, double rate_hz) {
    std::string oddity;
    const auto note = [&](const std::string& text) { oddity += (oddity.empty() ? "" : "; ") + text; };
    if (!info.millimetres_per_unit) {
      note("the host does not tell its length unit: taken for millimetres");
    } else if (*info.millimetres_per_unit != 1.0) {
      note("the host's length unit is " + std::to_string(*info.millimetres_per_unit) +
           " mm: converted to metres");
    }
    if (!info.up_axis) {
      note("the host does not tell its up axis: taken for z");
    } else if (*info.up_axis != kUpAxisZ) {
      note(std::string("the host's up axis is ") + "xyz"[*info.up_axis] +
           ": nothing is published, for every vehicle would lie on its side; set z up in Cortex");
    }
    if (!info.frame_rate_hz) {
      note("the host does not tell its frame rate: taken for " + std::to_string(rate_hz) +
           " Hz (parameter frame_rate)");
    }
    if (params_.client.live_on_start && !info.live_mode_accepted) {
      note("the host did not accept LiveMode: start live mode in Cortex");
    }
    if (!oddity.empty() && oddity != logged_oddity_) {
      ROS_LOG((is_turned_ ? ros::console::levels::Error : ros::console::levels::Warn),
              ROSCONSOLE_DEFAULT_NAME, "%s", oddity.c_str());
    }
    logged_oddity_ = oddity;
    const std::lock_guard<std::mutex> lock(health_mutex_);
    health_.oddity = oddity;
    health_.is_turned = is_turned_;
  }

  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
    const Statistics now = client_.statistics();
    const ros::WallTime time = ros::WallTime::now();
    const double interval_s = last_time_.isZero() ? 0.0 : (time - last_time_).toSec();
    const double rate_hz =
        interval_s > 0.0 ? static_cast<double>(now.frames - last_.frames) / interval_s : 0.0;
    Health health;
    {
      const std::lock_guard<std::mutex> lock(health_mutex_);
      health = health_;
    }
    summarize(status, now, health, rate_hz);
    status.add("host", now.host);
    status.add("mode", to_text(now.source));
    status.addf("rate [Hz]", "%.1f", rate_hz);
    status.add("age of last frame [s]",
               now.last_frame_age ? std::to_string(to_seconds(*now.last_frame_age)) : "none");
    status.add("frames", now.frames);
    status.add("lost", now.lost);
    status.add("duplicates", now.duplicates);
    status.add("late", now.late);
    status.add("before the unit was known", now.early);
    status.add("frame number restarts", now.restarts);
    status.add("malformed", now.malformed);
    status.add("faulty optional parts", now.faulty_items);
    status.add("foreign datagrams", now.foreign);
    status.add("stale answers", now.stale);
    status.add("poll time-outs", now.poll_timeouts);
    status.add("times found", now.connects);
    status.add("announcements of the host", now.announcements);
    status.addf("reported delay [s]", "%.6f", health.reported_delay_s);
    status.addf("stamp correction [s]", "%.6f", health.stamp_correction_s);
    status.add("stamps filtered", health.stamps_filtered ? "yes" : "no");
    last_ = now;
    last_time_ = time;
  }

  void summarize(diagnostic_updater::DiagnosticStatusWrapper& status, const Statistics& now,
                 const Health& health, double rate_hz) const {
    using Level = diagnostic_msgs::DiagnosticStatus;
    if (!now.host_up) {
      const std::string why = now.obstacle.empty() ? "no answer from " + now.host : now.obstacle;
      status.summary(Level::ERROR, "host down: " + why);
      return;
    }
    status.summaryf(Level::OK, "%.0f Hz by %s", rate_hz, to_text(now.source));
    if (!health.oddity.empty()) {
      status.mergeSummary(health.is_turned ? Level::ERROR : Level::WARN, health.oddity);
    }
    if (now.source == Source::kPoll && params_.client.mode != Mode::kPoll) {
      status.mergeSummary(Level::WARN, "no stream, polling");
    }
    if (now.malformed != last_.malformed || now.faulty_items != last_.faulty_items) {
      status.mergeSummary(Level::WARN, "malformed packets");
    }
    if (now.announcements != last_.announcements) {
      status.mergeSummary(Level::WARN, "host announced itself anew");
    }
    if (now.lost != last_.lost) {
      status.mergeSummary(Level::WARN, "frames lost");
    }
    if (!now.last_frame_age || to_seconds(*now.last_frame_age) > kStaleFrameS) {
      status.mergeSummary(Level::WARN, "no new frames: host paused?");
    }
  }

  const Params params_;
  const SystemClock clock_;
  ros::Publisher markers_;
  ros::Publisher time_;

  // Touched by the client's thread only.
  ClockFilter stamps_;
  double metres_per_unit_ = kMetresPerMillimetre;
  bool is_up_ = false;
  bool is_turned_ = false;  // another axis than z points up
  bool was_down_ = false;
  std::string logged_oddity_;

  std::mutex health_mutex_;
  Health health_;

  // Touched by the spinner's thread only.
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  Statistics last_;
  ros::WallTime last_time_;

  Client client_;
  std::thread worker_;
};

// roscpp handles SIGINT; process managers send SIGTERM, which shall end the node in the same orderly way.
void on_terminate(int) {
  ros::requestShutdown();
}

int run_node(int argc, char** argv) {
  ros::init(argc, argv, "MocapStates");
  std::signal(SIGTERM, on_terminate);
  ros::NodeHandle node;  // outlives the try block: with the last node handle the logging ends too
  try {
    Params params = load_params(ros::NodeHandle("~"));
    apply_legacy_arguments(argc, argv, params);
    StreamMarkers stream_markers(node, params);
    ros::spin();
    return 0;
  } catch (const std::exception& error) {
    ROS_FATAL("stream_markers: %s", error.what());
    return 1;
  }
}

}  // namespace
}  // namespace cortex_ros

int main(int argc, char** argv) {
  return cortex_ros::run_node(argc, argv);
}
