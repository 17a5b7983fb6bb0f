// State of the board's LED; README.md has the table.
#pragma once

#include "sticks.h"

namespace dueppm {

inline bool led_is_on(State state, bool configured, bool refusing, uint32_t now_ms) {
  const uint32_t in_second = now_ms % 1000;
  if (state == State::kFailsafe) return in_second % 200 < 100;        // five flashes a second
  if (refusing) return in_second < 300 && in_second % 200 < 100;      // two flashes a second
  if (state == State::kFlying) return true;                           // on
  if (configured || state == State::kLocked) return in_second < 500;  // half on, half off
  return in_second < 50;                                              // one short flash a second
}

}  // namespace dueppm
