#include "cortex_ros/frame_sequence.hpp"

namespace cortex_ros {

FrameOrder FrameSequence::accept(std::int32_t frame, FrameOrder order) {
  newest_ = frame;
  late_in_a_row_ = 0;
  return order;
}

FrameOrder FrameSequence::classify(std::int32_t frame) {
  gap_ = 0;
  if (!newest_) {
    return accept(frame, FrameOrder::kNew);
  }
  const std::int64_t step = std::int64_t{frame} - *newest_;
  if (step == 0) {
    return FrameOrder::kDuplicate;
  }
  if (step > kMaxGap + 1) {
    return accept(frame, FrameOrder::kRestart);
  }
  if (step > 0) {
    gap_ = step - 1;
    return accept(frame, FrameOrder::kNew);
  }
  if (step < -kLateWindow || ++late_in_a_row_ >= kLateBeforeRestart) {
    return accept(frame, FrameOrder::kRestart);
  }
  return FrameOrder::kLate;
}

void FrameSequence::reset() {
  *this = FrameSequence();
}

}  // namespace cortex_ros
