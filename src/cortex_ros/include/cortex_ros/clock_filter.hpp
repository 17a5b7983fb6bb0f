// Exposure time of a frame, with network delays filtered out. Pure: no clock of its own.
#pragma once

#include <cstdint>
#include <optional>

#include "cortex_ros/clock.hpp"

namespace cortex_ros {

// The delay reported by the host, or 0 when it is absent, not finite, negative or above max_s.
double believed_delay_s(std::optional<double> reported_s, double max_s);

// The host reports the time from exposure to sending, so  receipt - delay  is the exposure time plus the time
// on the network. On a quiet network that is about 0.1 ms. When frames are bunched (a switch, a busy kernel,
// radio) it is many milliseconds, and a velocity computed from such stamps is nonsense.
//
// But cameras run on a crystal: frame n is exposed at  t0 + n * period.  Per frame
//     offset(n) = (receipt - delay) - n * period  =  t0 + (time on the network, >= 0)
// so the frames that were not held up form the lower envelope of the offsets, and
//     stamp(n) = n * period + envelope(n).
// The envelope is the least offset of the last one to two blocks, raised by max_drift per second so that it
// can follow a host whose clock runs slower than ours (a faster one lowers the minimum by itself).
//
// This holds only while the frame numbers count exposures at the announced rate. Therefore the filter is
// "locked" only while the minima of successive blocks agree. Until two blocks have agreed, after a restart of
// the numbers or a silence, and without a period, the stamp is simply  receipt - delay.
//
// When no frame comes near the envelope for longer than `patience`, one of the clocks has jumped (or the
// fastest path through the network has become slower; the two cannot be distinguished): the envelope restarts
// from the least offset since then. Patience is counted in receipt time: frames that were held up together
// arrive together, so a long stall does not look like a jump. A jump downwards needs no patience: no network
// delivers early.
//
// A stamp is never later than receipt - delay, except to keep stamps strictly increasing.
class ClockFilter {
 public:
  struct Options {
    double max_drift = 3e-4;                         // [s/s] crystals stay well below
    Time block = std::chrono::milliseconds(500);     // the envelope remembers one to two of these
    Time agreement = std::chrono::milliseconds(1);   // minima of successive blocks differ by less when locked
    Time held_up = std::chrono::milliseconds(2);     // frames further above the envelope do not support it
    Time patience = std::chrono::milliseconds(150);  // time without support after which a clock has jumped
    Time far_up = std::chrono::milliseconds(50);     // further above the envelope than this, the patience is
    Time far_up_patience = std::chrono::milliseconds(20);  // shorter: a host that paused looks like this
    Time max_silence = std::chrono::seconds(1);            // after a longer silence the filter restarts
  };

  ClockFilter() : ClockFilter(Options()) {}
  explicit ClockFilter(const Options& options) : options_(options) {}

  // Time between two consecutive frames; zero: unknown, no filtering. A change restarts the filter.
  void set_period(Time period);

  // Exposure time of a frame that was received at `receipt` (wall time) and reported `delay` (>= 0). Strictly
  // increasing from call to call, except when three stamps in a row fall back: our own clock was set back.
  Time stamp(std::int32_t frame, Time receipt, Time delay);

  bool locked() const { return locked_; }

 private:
  // Frames in a row that were all well above the envelope.
  struct Unsupported {
    Time since{0};
    double least_offset_ns = 0.0;
  };

  void start(std::int32_t frame, Time direct);
  double frame_time_ns(std::int32_t frame) const;
  void close_block();
  double envelope_ns() const;
  void check_support(Time direct, double offset_ns);
  Time filtered(std::int32_t frame, Time direct);

  Options options_;
  double period_ns_ = 0.0;

  bool started_ = false;
  bool locked_ = false;
  std::int32_t reference_frame_ = 0;
  Time reference_{0};
  std::int32_t last_frame_ = 0;
  Time last_direct_{0};
  std::optional<Unsupported> unsupported_;
  // Envelopes of the previous and the current block. Like frame times they are nanoseconds since the
  // reference, as doubles: exact over days, and they can be multiplied by a drift.
  std::optional<double> previous_ns_, current_ns_;
  double block_end_ns_ = 0.0;

  std::optional<Time> last_stamp_;
  int fallen_back_ = 0;  // stamps that fell back in a row, each later than the one before
  Time last_fallen_back_{0};
};

}  // namespace cortex_ros
