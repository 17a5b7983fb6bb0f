// Detects lost, duplicate, late and restarted frames from the frame number. Pure.
#pragma once

#include <cstdint>
#include <optional>

namespace cortex_ros {

enum class FrameOrder {
  kNew,        // the next one, or one after a gap
  kDuplicate,  // the number of the newest frame again
  kLate,       // overtaken by a newer frame on the network
  kRestart,  // the host starts counting again (new take, live mode off and on), or jumped too far for a loss
};

// A frame number counts exposures and may restart at any time, so a step back is ambiguous: a short one is
// taken for reordering by the network, unless several occur in a row.
class FrameSequence {
 public:
  static constexpr std::int64_t kLateWindow = 8;   // frames; further back is a restart
  static constexpr int kLateBeforeRestart = 3;     // this many late ones in a row are a restart
  static constexpr std::int64_t kMaxGap = 100000;  // frames; a larger step ahead is a jump, not a loss

  FrameOrder classify(std::int32_t frame) {
    const std::int64_t step = newest_ ? std::int64_t{frame} - *newest_ : 1;
    gap_ = 0;
    if (step == 0) {
      return FrameOrder::kDuplicate;
    }
    if (step < 0 && step >= -kLateWindow && ++late_in_a_row_ < kLateBeforeRestart) {
      return FrameOrder::kLate;
    }
    newest_ = frame;
    late_in_a_row_ = 0;
    if (step < 0 || step > kMaxGap + 1) {
      return FrameOrder::kRestart;
    }
    gap_ = step - 1;
    return FrameOrder::kNew;
  }

  // Number of frames missing immediately before the last frame if that was kNew; else 0.
  std::int64_t gap() const { return gap_; }

  void reset() { *this = FrameSequence(); }

 private:
  std::optional<std::int64_t> newest_;
  std::int64_t gap_ = 0;
  int late_in_a_row_ = 0;
};

}  // namespace cortex_ros
