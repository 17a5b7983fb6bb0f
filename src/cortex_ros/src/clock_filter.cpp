#include "cortex_ros/clock_filter.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace cortex_ros {
namespace {

constexpr Time kLeastStep = std::chrono::microseconds(1);
constexpr int kAgreeing = 3;  // this many increasing stamps in a row that fell back mean: our clock was set

double as_ns(Time time) {
  return static_cast<double>(time.count());
}

}  // namespace

double believed_delay_s(std::optional<double> reported_s, double max_s) {
  const double delay_s = reported_s.value_or(0.0);
  return delay_s >= 0.0 && delay_s <= max_s ? delay_s : 0.0;  // a NaN fails both comparisons
}

void ClockFilter::set_period(Time period) {
  if (as_ns(period) == period_ns_) {
    return;  // a host that reports its rate again must not restart the filter
  }
  period_ns_ = as_ns(period);
  started_ = false;
  locked_ = false;
}

void ClockFilter::start(std::int32_t frame, Time direct) {
  started_ = true;
  locked_ = false;
  reference_frame_ = last_frame_ = frame;
  reference_ = last_direct_ = direct;
  unsupported_.reset();
  previous_ns_.reset();
  current_ns_ = 0.0;  // the first frame's own offset
  block_end_ns_ = as_ns(options_.block);
}

double ClockFilter::frame_time_ns(std::int32_t frame) const {
  return static_cast<double>(std::int64_t{frame} - reference_frame_) * period_ns_;
}

void ClockFilter::close_block() {
  if (previous_ns_ && current_ns_) {
    const double allowed = as_ns(options_.agreement) + options_.max_drift * as_ns(options_.block);
    locked_ = std::abs(*current_ns_ - *previous_ns_) <= allowed;
  }
  previous_ns_ = std::exchange(current_ns_, std::nullopt);
}

double ClockFilter::envelope_ns() const {
  return std::min(previous_ns_.value_or(*current_ns_), *current_ns_);
}

void ClockFilter::check_support(Time direct, double offset_ns) {
  const double excess_ns = offset_ns - envelope_ns();
  if (excess_ns <= as_ns(options_.held_up)) {
    unsupported_.reset();
    return;
  }
  if (!unsupported_) {
    unsupported_ = Unsupported{direct, offset_ns};
  }
  unsupported_->least_offset_ns = std::min(unsupported_->least_offset_ns, offset_ns);
  const Time patience = excess_ns > as_ns(options_.far_up) ? options_.far_up_patience : options_.patience;
  if (direct - unsupported_->since > patience) {
    previous_ns_.reset();
    current_ns_ = unsupported_->least_offset_ns;
    unsupported_.reset();
  }
}

Time ClockFilter::filtered(std::int32_t frame, Time direct) {
  if (!started_ || frame <= last_frame_ || direct - last_direct_ > options_.max_silence) {
    start(frame, direct);
    return direct;
  }
  const double now_ns = frame_time_ns(frame);
  const double raise_ns = options_.max_drift * (now_ns - frame_time_ns(last_frame_));
  for (std::optional<double>* envelope : {&previous_ns_, &current_ns_}) {
    if (*envelope) {
      **envelope += raise_ns;
    }
  }
  last_frame_ = frame;
  last_direct_ = direct;
  if (now_ns >= block_end_ns_) {
    close_block();
    block_end_ns_ = now_ns + as_ns(options_.block);
  }
  const double offset_ns = as_ns(direct - reference_) - now_ns;
  current_ns_ = std::min(current_ns_.value_or(offset_ns), offset_ns);
  check_support(direct, offset_ns);
  return locked_ ? reference_ + Time(std::llround(now_ns + envelope_ns())) : direct;
}

Time ClockFilter::stamp(std::int32_t frame, Time receipt, Time delay) {
  Time stamp = receipt - delay;
  if (period_ns_ > 0.0) {
    stamp = filtered(frame, stamp);
  }
  if (last_stamp_ && stamp <= *last_stamp_) {
    fallen_back_ = fallen_back_ > 0 && stamp > last_fallen_back_ ? fallen_back_ + 1 : 1;
    last_fallen_back_ = stamp;
    if (fallen_back_ < kAgreeing) {
      return *(last_stamp_ = *last_stamp_ + kLeastStep);
    }
  }
  fallen_back_ = 0;
  return *(last_stamp_ = stamp);
}

}  // namespace cortex_ros
