// The firmware without its board. Input: bytes from the host; output: bytes to the host and the lengths of
// the timer's periods.
#pragma once

#include "configuration.h"
#include "controls_check.h"
#include "led.h"
#include "ppm_frame.h"
#include "rosserial_device.h"

namespace dueppm {

template <class C>
class Firmware {
 public:
  Firmware()
      : device_(Topic{RosserialDevice::kFirstPublisher, PpmStatus::kTopic, PpmStatus::kType, PpmStatus::kMd5},
                Topic{RosserialDevice::kFirstSubscriber, Controls::kTopic, Controls::kType, Controls::kMd5}) {
  }

  // Called by loop(): handles a byte from the host.
  void receive(uint8_t byte, uint32_t now_ms) {
    Handler handler = {*this, now_ms};
    device_.receive(byte, now_ms, handler);
  }

  // Called by loop() as often as possible: does what is due.
  void poll(uint32_t now_ms) {
    Handler handler = {*this, now_ms};
    device_.poll(now_ms, handler);
    if (now_ms - status_ms_ >= C::kStatusMs) {
      status_ms_ = now_ms - status_ms_ < 2 * C::kStatusMs ? status_ms_ + C::kStatusMs : now_ms;
      tell_status(now_ms);
    }
    const State state = sticks_.state();
    if (state != told_state_) tell_state(state);
    if (refused_ != told_refused_ && now_ms - told_refused_ms_ >= 1000) tell_refusal(now_ms);
  }

  // Called by loop(): takes up to `most` bytes for the host.
  size_t send(uint8_t* bytes, size_t most) { return device_.send(bytes, most); }

  State state() const { return sticks_.state(); }

  uint32_t accepted() const { return accepted_; }  // messages since the reset

  bool led_is_on(uint32_t now_ms) const {
    const bool refusing = refused_ > 0 && now_ms - refused_ms_ < 1000;
    return dueppm::led_is_on(sticks_.state(), device_.configured(), refusing, now_ms);
  }

  // Called by the interrupt: returns the length, in ticks, of the period that began `delay` ticks ago.
  uint32_t next_period(uint32_t delay) {
    uint32_t period = frame_.next(sticks_);
    if (delay > longest_delay_) longest_delay_ = delay;
    if (delay + kMargin > period) {  // the counter would run past RC and on to its end: 102 s
      period = delay + kMargin;
      ++late_periods_;
    }
    return period;
  }

 private:
  static constexpr uint32_t kMargin = 10 * kTicksPerUs;  // from reading the counter to writing RC

  struct Handler {
    Firmware& firmware;
    uint32_t now_ms;
    void on_message(const uint8_t* payload, size_t length) { firmware.on_controls(payload, length, now_ms); }
  };

  void on_controls(const uint8_t* payload, size_t length, uint32_t now_ms) {
    const typename ControlsCheck<C>::Verdict verdict = check_.judge(payload, length, now_ms);
    if (verdict.accepted) {
      ++accepted_;
      accepted_ms_ = now_ms;
      sticks_.follow(check_.fractions());
    }
    if (verdict.refused != Refusal::kNothing) {
      ++refused_;
      refused_ms_ = now_ms;
      refusal_ = verdict.refused;
    }
  }

  void tell_status(uint32_t now_ms) {
    PpmStatus status;
    device_.now(now_ms, &status.stamp_s, &status.stamp_ns);
    status.seq = seq_++;
    status.state = static_cast<uint8_t>(sticks_.state());
    status.channels = C::kChannels;
    for (int i = 0; i < C::kChannels; ++i)
      status.channels_us[i] = static_cast<uint16_t>(frame_.channel_us(i));
    status.accepted = accepted_;
    status.refused = refused_;
    status.last_refusal = static_cast<uint8_t>(refusal_);
    status.age_s = accepted_ > 0 ? static_cast<float>(now_ms - accepted_ms_) * 1e-3f : -1.0f;
    status.damaged_packets = device_.damaged();
    status.interrupt_delay_us = static_cast<float>(longest_delay_) / kTicksPerUs;
    status.late_periods = late_periods_;
    uint8_t payload[128];
    device_.publish(payload, status.write(payload, sizeof payload));
  }

  void tell_state(State state) {
    told_state_ = state;
    if (state == State::kLocked)
      device_.log(LogLevel::kInfo, "ppm: messages accepted; the throttle is locked until one has it lowest");
    if (state == State::kFlying) device_.log(LogLevel::kInfo, "ppm: the channels follow the messages");
    if (state == State::kFailsafe)
      device_.log(LogLevel::kWarn, "ppm: failsafe: no accepted message for too long");
  }

  void tell_refusal(uint32_t now_ms) {
    told_refused_ = refused_;
    told_refused_ms_ = now_ms;
    device_.log(LogLevel::kWarn,
                refusal_ == Refusal::kFormat ? "controls refused: not exactly one object, or damaged"
                : refusal_ == Refusal::kVehicle
                    ? "controls refused: for another vehicle; a reset lets it fly another one"
                : refusal_ == Refusal::kRange
                    ? "controls refused: a stick is not within -1 and 1"
                    : "controls refused: a jump that the next message did not confirm");
  }

  RosserialDevice device_;
  ControlsCheck<C> check_;
  Sticks<C> sticks_;
  PpmFrame<C> frame_;
  uint32_t longest_delay_ = 0;  // this and the next one are written by the interrupt
  uint32_t late_periods_ = 0;
  uint32_t seq_ = 0;
  uint32_t status_ms_ = 0;
  uint32_t accepted_ = 0;
  uint32_t accepted_ms_ = 0;
  uint32_t refused_ = 0;
  uint32_t refused_ms_ = 0;
  Refusal refusal_ = Refusal::kNothing;
  State told_state_ = State::kWaiting;
  uint32_t told_refused_ = 0;
  uint32_t told_refused_ms_ = 0;
};

}  // namespace dueppm
