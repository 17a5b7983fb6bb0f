// Decides which messages are accepted. rosserial's checksums are 8-bit sums: one damaged packet in 256 passes
// them.
//
// An implausible message is refused, never repaired. A message that differs from the last accepted one by
// more than kJump waits: it is accepted when the next message agrees with it. So is the first one after a
// silence. A damaged message that is plausible therefore moves a channel by at most kJump of its travel and
// by at most what the slew limit lets through until the next message, and cannot end a failsafe. Until the
// reset only messages for the vehicle of the first accepted message are accepted: no other publisher gets the
// sticks.
#pragma once

#include "messages.h"
#include "sticks.h"

namespace dueppm {

enum class Refusal : uint8_t {
  kNothing = 0,
  kFormat = 1,
  kVehicle = 2,
  kRange = 3,
  kJump = 4
};  // numbers of PpmStatus

template <class C>
class ControlsCheck {
 public:
  static_assert(C::kFractionMax >= 1.0 && C::kFractionMax <= 1.1, "kFractionMax: 1 to 1.1");
  static_assert(C::kJump > 0.0 && C::kJump <= 2.0, "kJump: above 0, at most 2");

  static constexpr size_t kLongestName = 64;
  // After a silence of this length the failsafe may have begun, up to a frame before kFailsafeMs.
  static constexpr uint32_t kSilenceMs = Sticks<C>::kFailsafeFrames * C::kFrameUs / 1000;

  struct Verdict {
    bool accepted;    // fractions() are those of this message
    Refusal refused;  // why this message is refused; kJump: the one before, which this one does not confirm
  };

  Verdict judge(const uint8_t* bytes, size_t length, uint32_t now_ms) {
    Controls message;
    if (!message.read(bytes, length) || message.name.length > kLongestName) return {false, Refusal::kFormat};
    const Text vehicle = accepted_.there ? accepted_.text() : text_of(C::kVehicle);
    if ((accepted_.there || vehicle.length > 0) && !equal(message.name, vehicle))
      return {false, Refusal::kVehicle};
    const double values[kSticks] = {message.phi, message.theta, message.T,
                                    message.psi};  // in the order of Stick
    for (int i = 0; i < kSticks; ++i) {
      // written so that a NaN is refused
      if (!(values[i] >= -C::kFractionMax && values[i] <= C::kFractionMax)) return {false, Refusal::kRange};
    }
    const bool confirms = doubted_.agrees(message.name, values, now_ms);
    const bool accepted = confirms || accepted_.agrees(message.name, values, now_ms);
    const bool jumped = doubted_.there && !confirms;
    doubted_.there = false;
    (accepted ? accepted_ : doubted_).keep(message.name, values, now_ms);
    return {accepted, jumped ? Refusal::kJump : Refusal::kNothing};
  }

  const double (&fractions() const)[kSticks] { return accepted_.values; }  // within [-1, 1]

 private:
  struct Seen {
    bool there = false;
    uint32_t ms = 0;
    uint8_t name[kLongestName];
    size_t name_length = 0;
    double values[kSticks];

    Text text() const { return {name, name_length}; }
    bool agrees(Text other, const double (&others)[kSticks], uint32_t now_ms) const {
      if (!there || now_ms - ms >= kSilenceMs) return false;
      if (!equal(text(), other)) return false;
      for (int i = 0; i < kSticks; ++i) {
        const double change = others[i] - values[i];
        if (change > C::kJump || change < -C::kJump) return false;
      }
      return true;
    }
    void keep(Text other, const double (&others)[kSticks], uint32_t now_ms) {
      there = true;
      ms = now_ms;
      name_length = other.length;
      for (size_t i = 0; i < other.length; ++i) name[i] = other.bytes[i];
      for (int i = 0; i < kSticks; ++i)
        values[i] = others[i] > 1.0 ? 1.0 : others[i] < -1.0 ? -1.0 : others[i];
    }
  };

  Seen accepted_;
  Seen doubted_;
};

}  // namespace dueppm
