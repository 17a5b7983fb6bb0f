// The frame: channel times one after the other, then the sync gap. For any input the frame has its length,
// the channels are within their limits, and the gap is long enough to be distinguished from a channel.
#pragma once

#include "sticks.h"

namespace dueppm {

template <class C>
class PpmFrame {
 public:
  static constexpr int32_t kShortestGapUs = 3000;

  static_assert(C::kChannels >= 4 && C::kChannels <= 8, "kChannels: 4 to 8");
  static_assert(C::kFrameUs >= 20000 && C::kFrameUs <= 22500, "kFrameUs: 20000 to 22500");
  static_assert(C::kPulseUs >= 250 && C::kPulseUs <= 400, "kPulseUs: 250 to 400");
  static_assert(C::kShortestUs >= 800 && C::kShortestUs < C::kCentreUs && C::kCentreUs < C::kLongestUs &&
                    C::kLongestUs <= 2200,
                "800 <= kShortestUs < kCentreUs < kLongestUs <= 2200");
  static_assert(C::kChannels * C::kLongestUs + kShortestGapUs <= C::kFrameUs,
                "the channels do not fit: a longer frame, fewer channels, or a smaller kLongestUs");

  PpmFrame() : at_(0), gap_(0) {
    for (int i = 0; i < C::kChannels; ++i) channels_[i] = C::kCentreUs * kTicksPerUs;
  }

  // Called by the interrupt: returns the length, in ticks, of the period that has just begun. Reads the
  // sticks once a frame.
  template <class Source>
  uint32_t next(Source& sticks) {
    if (at_ >= C::kChannels) {
      at_ = 0;
      return static_cast<uint32_t>(gap_);
    }
    if (at_ == 0) {
      sticks.step(channels_);
      gap_ = C::kFrameUs * kTicksPerUs;
      for (int i = 0; i < C::kChannels; ++i) {
        channels_[i] = within(channels_[i], C::kShortestUs * kTicksPerUs, C::kLongestUs * kTicksPerUs);
        gap_ -= channels_[i];
      }
    }
    return static_cast<uint32_t>(channels_[at_++]);
  }

  // Called by loop(): channel time of the newest frame, rounded. Each read is atomic, but two channels may be
  // from different frames.
  int32_t channel_us(int i) const {
    return (__atomic_load_n(&channels_[i], __ATOMIC_RELAXED) + kTicksPerUs / 2) / kTicksPerUs;
  }

 private:
  int at_;
  int32_t gap_;
  int32_t channels_[C::kChannels];
};

// The timer's channel mode: waveform mode, up to RC and again from 0 (WAVSEL 2), MCK / 2, EEVT XC0. A pulse
// begins with each period (ACPC, and ASWTRG for the first one) and ends at RA (ACPA).
constexpr uint32_t timer_mode(bool pulse_high) {
  return 1u << 15 | 2u << 13 | 1u << 10 | (pulse_high ? 2u : 1u) << 16 | (pulse_high ? 1u : 2u) << 18 |
         (pulse_high ? 1u : 2u) << 22;
}

}  // namespace dueppm
