// The node's own part, the same for every source: order of the frames, stamps, messages, diagnostics, log.
#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>

#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "cortex_ros/clock_filter.hpp"
#include "cortex_ros/frame_sequence.hpp"
#include "cortex_ros/parameters.hpp"
#include "cortex_ros/sources/mocap_source.hpp"
#include "risc_msgs/Mocap_data.h"

namespace cortex_ros {

// What the original release published for a marker that no camera saw: Cortex' sentinel, taken for
// millimetres.
constexpr double kLegacyMissingM = 9999.999;

// The bodies of the frame in their order, every marker in its place; those that no camera saw are NaN or the
// legacy value. Leaves the header alone.
void fill_markers(const MocapFrame& frame, bool missing_as_nan, risc_msgs::Mocap_data& out);

// x, y, z of each marker after the other.
std::vector<double> in_a_row(const std::vector<Position>& markers);

// Wall time as a ROS stamp; a time before 1970, which a large delay can make of a small clock, becomes zero.
ros::Time to_ros_time(Time wall);

// Frames of the source that the parameter `source` names -> mocap_data, mocap_time and, of those with markers
// of no body, mocap_unidentified; once a second mocap_status.
class MocapPublisher : private SourceEvents {
 public:
  // Throws std::invalid_argument for a bad parameter.
  MocapPublisher(ros::NodeHandle& node, Parameters& parameters);
  ~MocapPublisher() override;

 private:
  // What the frame path knows and the diagnostics show.
  struct Health {
    std::uint64_t frames = 0;  // handed on
    std::uint64_t lost = 0;    // gaps in the frame numbers
    std::uint64_t duplicates = 0;
    std::uint64_t late = 0;      // overtaken by a newer frame, dropped
    std::uint64_t restarts = 0;  // of the frame numbers
    std::optional<Time> last_frame;
    std::size_t unidentified = 0;  // markers of the last frame
    double reported_delay_s = 0.0;
    double stamp_correction_s = 0.0;
    bool stamps_filtered = false;
    std::string remarks;   // on the host's settings; empty: none
    bool refused = false;  // its up axis is not z
  };

  void on_frame(const MocapFrame& frame) override;
  void on_host_up(const MocapHost& host) override;
  void on_host_down(const std::string& why) override;
  void on_log(LogLevel level, const std::string& text) override;
  void on_frequent_log(LogLevel level, const std::string& text) override;

  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  std::string source_name_ = "cortex";
  double max_delay_s_ = 0.5;
  bool missing_as_nan_ = true;
  bool filter_stamps_ = true;
  std::string frame_id_ = "cortex";

  const Clock clock_;
  ros::Publisher markers_;
  ros::Publisher unidentified_;
  ros::Publisher time_;
  ros::Publisher status_;

  // Touched by the source's thread only.
  FrameSequence sequence_;
  ClockFilter stamps_;
  bool is_up_ = false;
  bool was_down_ = false;
  bool refused_ = false;
  std::string logged_remarks_;

  std::mutex health_mutex_;
  Health health_;

  // Touched by the spinner's thread only.
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  std::map<std::string, std::uint64_t> last_counts_;
  Time last_time_{0};

  std::unique_ptr<MocapSource> source_;
  std::thread worker_;
};

}  // namespace cortex_ros
