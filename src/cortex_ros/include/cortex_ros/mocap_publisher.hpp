// The part of the node that is common to all sources: frame order, stamps, messages, diagnostics, log.
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

// Coordinate that the original release published for a marker that no camera saw: Cortex' sentinel, taken as
// millimetres.
constexpr double kLegacyMissingM = 9999.999;

// Writes the bodies and markers of the frame in their order; markers that no camera saw are NaN or the legacy
// value. Does not change the header.
void fill_markers(const MocapFrame& frame, bool missing_as_nan, risc_msgs::Mocap_data& out);

// Flat list of the coordinates: x, y, z of the first marker, then of the next.
std::vector<double> in_a_row(const std::vector<Position>& markers);

// Wall time as a ROS stamp; a time before 1970 (a large delay taken off a small clock value) becomes zero.
ros::Time to_ros_time(Time wall);

// Publishes the frames of the source named by the parameter `source` on mocap_data and mocap_time, markers of
// no body on mocap_unidentified, and mocap_status once a second.
class MocapPublisher : private SourceEvents {
 public:
  // Throws std::invalid_argument for a bad parameter.
  MocapPublisher(ros::NodeHandle& node, Parameters& parameters);
  ~MocapPublisher() override;

 private:
  // Written by the frame path, shown by the diagnostics.
  struct Health {
    std::uint64_t frames = 0;  // received, without duplicates and late ones
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
