#include "cortex_ros/mocap_publisher.hpp"

#include <risc_maap_msgs/MocapStatus.h>
#include <risc_maap_msgs/MocapTime.h>
#include <risc_maap_msgs/UnidentifiedMarkers.h>

#include <algorithm>
#include <boost/algorithm/string/join.hpp>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

namespace cortex_ros {
namespace {

// Frames held up on the network arrive in one burst, faster than roscpp's sending thread empties the queue:
// the queue of ten in the original release overflows after a stall of 50 ms. This is half a second at 200 Hz.
constexpr int kQueueSize = 100;
constexpr double kLogPeriodS = 5.0;
constexpr double kStaleFrameS = 0.5;
constexpr double kMaxMaxDelayS = 10.0;
constexpr double kMinRateHz = 0.1;  // a lower rate counts as unknown
constexpr char kUpAxis = 'z';

ros::console::Level to_ros_level(LogLevel level) {
  return level == LogLevel::kInfo      ? ros::console::levels::Info
         : level == LogLevel::kWarning ? ros::console::levels::Warn
                                       : ros::console::levels::Error;
}

}  // namespace

void fill_markers(const MocapFrame& frame, bool missing_as_nan, risc_msgs::Mocap_data& out) {
  out.Obj.resize(frame.bodies.size());
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    const MocapBody& body = frame.bodies[i];
    risc_msgs::Mocap_markers& object = out.Obj[i];
    object.name = body.name;
    object.residual = body.residual_m;
    object.marker.resize(body.markers.size());
    for (std::size_t k = 0; k < body.markers.size(); ++k) {
      const bool legacy = !missing_as_nan && std::isnan(body.markers[k].x);
      const Position position =
          legacy ? Position{kLegacyMissingM, kLegacyMissingM, kLegacyMissingM} : body.markers[k];
      object.marker[k].x = position.x;
      object.marker[k].y = position.y;
      object.marker[k].z = position.z;
    }
  }
}

std::vector<double> in_a_row(const std::vector<Position>& markers) {
  std::vector<double> row;
  row.reserve(3 * markers.size());
  for (const Position& marker : markers) {
    row.insert(row.end(), {marker.x, marker.y, marker.z});
  }
  return row;
}

ros::Time to_ros_time(Time wall) {
  ros::Time stamp;
  stamp.fromNSec(static_cast<std::uint64_t>(std::max(wall, Time{0}).count()));
  return stamp;
}

MocapPublisher::MocapPublisher(ros::NodeHandle& node, Parameters& parameters)
    : markers_(node.advertise<risc_msgs::Mocap_data>("mocap_data", kQueueSize)),
      unidentified_(node.advertise<risc_maap_msgs::UnidentifiedMarkers>("mocap_unidentified", kQueueSize)),
      time_(node.advertise<risc_maap_msgs::MocapTime>("mocap_time", kQueueSize)),
      status_(node.advertise<risc_maap_msgs::MocapStatus>("mocap_status", kQueueSize)) {
  double diagnostic_period_s = 1.0;  // belongs to diagnostic_updater, which reads it itself
  parameters.read("diagnostic_period", diagnostic_period_s);
  parameters.read("source", source_name_);
  parameters.read("max_delay", max_delay_s_);
  parameters.read("missing_as_nan", missing_as_nan_);
  parameters.read("filter_stamps", filter_stamps_);
  parameters.read("frame_id", frame_id_);
  if (!(max_delay_s_ >= 0.0 && max_delay_s_ <= kMaxMaxDelayS)) {
    throw std::invalid_argument("parameter max_delay must be from 0 to 10 s");
  }
  source_ = make_source(source_name_, parameters, *this, clock_);
  for (const std::string& key : parameters.unread()) {
    ROS_WARN("parameter %s is unknown to stream_markers with source '%s' and has no effect", key.c_str(),
             source_name_.c_str());
  }
  diagnostics_.setHardwareID(source_name_ + " " + source_->status().host);
  diagnostics_.add("mocap stream", this, &MocapPublisher::diagnose);
  diagnostics_timer_ = node.createWallTimer(
      ros::WallDuration(1.0), [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
  // The receive thread publishes directly: a frame does not wait for a spinner or a loop rate.
  worker_ = std::thread([this] { source_->run(); });
}

MocapPublisher::~MocapPublisher() {
  source_->stop();
  worker_.join();
}

void MocapPublisher::on_frame(const MocapFrame& frame) {
  const FrameOrder order = sequence_.classify(frame.number);
  {
    const std::lock_guard<std::mutex> lock(health_mutex_);
    if (order == FrameOrder::kDuplicate || order == FrameOrder::kLate) {
      ++(order == FrameOrder::kLate ? health_.late : health_.duplicates);
      return;
    }
    ++health_.frames;
    health_.lost += static_cast<std::uint64_t>(sequence_.gap());
    health_.restarts += order == FrameOrder::kRestart ? 1 : 0;
    health_.last_frame = clock_.monotonic();
    health_.unidentified = frame.unidentified.size();
  }
  if (refused_) {
    return;
  }
  const Time delay = from_seconds(believed_delay_s(frame.delay_s, max_delay_s_));
  const Time exposure = stamps_.stamp(frame.number, frame.receipt, delay);
  const auto markers = boost::make_shared<risc_msgs::Mocap_data>();
  markers->header.stamp = to_ros_time(exposure);
  markers->header.frame_id = frame_id_;
  fill_markers(frame, missing_as_nan_, *markers);
  if (!frame.unidentified.empty()) {
    const auto unidentified = boost::make_shared<risc_maap_msgs::UnidentifiedMarkers>();
    unidentified->header = markers->header;
    unidentified->positions = in_a_row(frame.unidentified);
    unidentified_.publish(unidentified);
  }
  markers_.publish(markers);

  const auto time = boost::make_shared<risc_maap_msgs::MocapTime>();
  time->header = markers->header;
  time->frame = frame.number;
  time->receipt = to_ros_time(frame.receipt);
  time->delay = to_seconds(delay);
  time->filtered = stamps_.locked();
  time_.publish(time);

  const std::lock_guard<std::mutex> lock(health_mutex_);
  health_.reported_delay_s = to_seconds(delay);
  health_.stamp_correction_s = to_seconds(frame.receipt - delay - exposure);
  health_.stamps_filtered = stamps_.locked();
}

void MocapPublisher::on_host_up(const MocapHost& host) {
  const bool filter = filter_stamps_ && host.frame_rate_hz >= kMinRateHz;
  stamps_.set_period(filter ? from_seconds(1.0 / host.frame_rate_hz) : Time{0});
  if (is_up_) {
    // This thread receives the frames: packets that anyone can forge must not keep it busy with logging.
    on_frequent_log(LogLevel::kInfo, "the host's settings were read again: " + host.description);
  } else {
    on_log(LogLevel::kInfo,
           source_name_ + " host " + (was_down_ ? "is back: " : "found: ") + host.description);
  }
  is_up_ = true;
  was_down_ = false;
  refused_ = host.up_axis != kUpAxis;

  std::vector<std::string> parts = host.remarks;
  if (refused_) {
    parts.push_back(
        std::string("the host's up axis is ") + host.up_axis +
        ": nothing is published, because every vehicle would lie on its side; set z up in the host");
  }
  const std::string remarks = boost::algorithm::join(parts, "; ");
  if (!remarks.empty() && remarks != logged_remarks_) {
    on_log(refused_ ? LogLevel::kError : LogLevel::kWarning, remarks);
  }
  logged_remarks_ = remarks;
  const std::lock_guard<std::mutex> lock(health_mutex_);
  health_.remarks = remarks;
  health_.refused = refused_;
}

void MocapPublisher::on_host_down(const std::string& why) {
  is_up_ = false;
  was_down_ = true;
  sequence_.reset();
  on_log(LogLevel::kError, source_name_ + " host is down: " + why + ". Still trying.");
}

void MocapPublisher::on_log(LogLevel level, const std::string& text) {
  ROS_LOG(to_ros_level(level), ROSCONSOLE_DEFAULT_NAME, "%s", text.c_str());
}

void MocapPublisher::on_frequent_log(LogLevel level, const std::string& text) {
  // Each of these macros is throttled on its own.
  if (level == LogLevel::kInfo) {
    ROS_INFO_THROTTLE(kLogPeriodS, "%s", text.c_str());
  } else {
    ROS_WARN_THROTTLE(kLogPeriodS, "%s", text.c_str());
  }
}

void MocapPublisher::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  using Level = diagnostic_msgs::DiagnosticStatus;
  const SourceStatus source = source_->status();
  const Health health = [this] {
    const std::lock_guard<std::mutex> lock(health_mutex_);
    return health_;
  }();
  std::vector<Counter> counters = {{"frames", health.frames},
                                   {"lost", health.lost, "frames lost"},
                                   {"duplicates", health.duplicates},
                                   {"late", health.late},
                                   {"frame number restarts", health.restarts}};
  counters.insert(counters.end(), source.counters.begin(), source.counters.end());

  const Time now = clock_.monotonic();
  risc_maap_msgs::MocapStatus told;
  told.header.stamp = ros::Time::now();
  told.up = source.up;
  told.rate_hz = last_time_ == Time{0} ? 0.0
                                       : static_cast<double>(health.frames - last_counts_["frames"]) /
                                             to_seconds(now - last_time_);
  told.age_s =
      health.last_frame ? to_seconds(now - *health.last_frame) : std::numeric_limits<double>::quiet_NaN();
  told.frames = health.frames;
  last_time_ = now;

  if (source.up) {
    status.summaryf(Level::OK, "%.0f Hz by %s", told.rate_hz, source.mode.c_str());
    if (!health.remarks.empty()) {
      status.mergeSummary(health.refused ? Level::ERROR : Level::WARN, health.remarks);
    }
    for (const std::string& warning : source.warnings) {
      status.mergeSummary(Level::WARN, warning);
    }
    if (!(told.age_s <= kStaleFrameS)) {  // NaN: no frame yet
      status.mergeSummary(Level::WARN, "no new frames: is the host paused?");
    }
  } else {
    status.summary(Level::ERROR, "host down: " + source.why_down);
  }
  status.add("host", source.host);
  status.add("mode", source.mode);
  status.addf("rate [Hz]", "%.1f", told.rate_hz);
  status.add("age of last frame [s]", health.last_frame ? std::to_string(told.age_s) : "none");
  for (const Counter& counter : counters) {
    status.add(counter.name, counter.count);
    if (source.up && !counter.warning.empty() && counter.count != last_counts_[counter.name]) {
      status.mergeSummary(Level::WARN, counter.warning);
    }
    last_counts_[counter.name] = counter.count;
    if (counter.name != "frames") {
      told.counters.emplace_back();
      told.counters.back().name = counter.name;
      told.counters.back().count = counter.count;
    }
  }
  status.add("unidentified markers", health.unidentified);
  status.addf("reported delay [s]", "%.6f", health.reported_delay_s);
  status.addf("stamp correction [s]", "%.6f", health.stamp_correction_s);
  status.add("stamps filtered", health.stamps_filtered ? "yes" : "no");
  status_.publish(told);
}

}  // namespace cortex_ros
