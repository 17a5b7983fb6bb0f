// Interface between a motion-capture source and the node: frames, host settings, status. No ROS, no vendor.
//
// A vendor is one file in src/sources, which registers itself by name, and config/sources/NAME.yaml with its
// parameters. The node does sequence, stamps, messages, diagnostics and log (mocap_publisher.hpp).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "cortex_ros/clock.hpp"

namespace cortex_ros {

class Parameters;

// [m] in the host's axes. NaN: no camera saw the marker.
struct Position {
  double x, y, z;
};

struct MocapBody {
  std::string name;
  std::vector<Position> markers;  // in the order of the body's template
  double residual_m = 0.0;        // of the host's own fit; 0: not reported
};

struct MocapFrame {
  std::int32_t number = 0;        // counts exposures; may restart
  Time receipt{0};                // wall time at which it arrived
  std::optional<double> delay_s;  // exposure to sending, as reported by the host: may be nonsense
  std::vector<MocapBody> bodies;
  std::vector<Position> unidentified;  // markers of no body
};

struct MocapHost {
  std::string description;           // one line
  double frame_rate_hz = 0.0;        // 0: unknown, stamps are not filtered
  char up_axis = 'z';                // frames with another axis up are not published
  std::vector<std::string> remarks;  // settings that the user should look at
};

struct Counter {
  std::string name;
  std::uint64_t count;
  std::string warning = "";  // shown in the diagnostics while the count grows; empty: none
};

struct SourceStatus {
  bool up = false;
  std::string host;                   // its address, or the address that is searched for
  std::string why_down;               // when it is not up
  std::string mode;                   // how frames arrive
  std::vector<std::string> warnings;  // when it is up
  std::vector<Counter> counters;
};

enum class LogLevel { kInfo, kWarning, kError };

// All calls come from the thread that runs the source. References are valid during the call only.
class SourceEvents {
 public:
  virtual ~SourceEvents() = default;
  virtual void on_frame(const MocapFrame& frame) = 0;
  // Frames follow. Called again, without an on_host_down() in between, when the host's settings were reread.
  virtual void on_host_up(const MocapHost& host) = 0;
  virtual void on_host_down(const std::string& why) = 0;  // once per absence
  virtual void on_log(LogLevel level, const std::string& text) = 0;
  // Throttled log, for messages that packets from the network cause.
  virtual void on_frequent_log(LogLevel level, const std::string& text) = 0;
};

class MocapSource {
 public:
  virtual ~MocapSource() = default;
  virtual void run() = 0;                   // until stop()
  virtual void stop() noexcept = 0;         // from any thread
  virtual SourceStatus status() const = 0;  // from any thread
};

// Makes a source from its parameters; throws std::invalid_argument for a bad one. `events` and `clock` must
// outlive the source.
using MakeSource = std::unique_ptr<MocapSource> (*)(Parameters& parameters, SourceEvents& events,
                                                    const Clock& clock);

// Define one constant of this type in a source's file to add the source to the registry.
struct RegisteredSource {
  RegisteredSource(const std::string& name, MakeSource make);
};

// Throws std::invalid_argument when no source has that name.
std::unique_ptr<MocapSource> make_source(const std::string& name, Parameters& parameters,
                                         SourceEvents& events, const Clock& clock);

}  // namespace cortex_ros
