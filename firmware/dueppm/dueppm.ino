// PPM for the trainer port of a transmitter, driven over rosserial: Arduino Due. README.md has wiring and
// loading; configuration.h has the settings.
//
// Timer counter 0, channel 0 makes the edges in hardware on TIOA0 = PB25 = pin 2; its interrupt only sets the
// length of each period, after the period has begun. So no edge waits for software.

#include "firmware.h"

// The computer is on the programming port (next to the power jack). For the native port remove the slashes.
// #define USE_USBCON
#ifdef USE_USBCON
#define HOST SerialUSB
#define HOST_ROOM 32  // write() blocks while the computer reads nothing; the interrupt and its failsafe go on
#else
#define HOST Serial
#define HOST_ROOM Serial.availableForWrite()
#endif

using dueppm::Configuration;

static dueppm::Firmware<Configuration> firmware;

void TC0_Handler() {
  (void)REG_TC0_SR0;  // reading clears the flag: without this the handler would run again and again
  REG_TC0_RC0 = firmware.next_period(REG_TC0_CV0);
}

void setup() {
  static_assert(F_CPU == 84000000L, "the timer's ticks are counted at 84 MHz / 2");
  const uint32_t pb25 = 1u << 25;
  pinMode(LED_BUILTIN, OUTPUT);
  HOST.begin(Configuration::kBaud);

  REG_PMC_PCER0 = 1u << TC0_IRQn;  // clock: without it the timer ignores writes
  REG_TC0_WPMR = 0x54494D00;       // "TIM": write protection off
  REG_TC0_CCR0 = 2;                // stop
  REG_TC0_IDR0 = 0xFF;             // no interrupts except ...
  REG_TC0_IER0 = 1u << 4;          // ... the one at RC
  REG_TC0_CMR0 = dueppm::timer_mode(Configuration::kPulseHigh);
  REG_TC0_RA0 = Configuration::kPulseUs * dueppm::kTicksPerUs;
  REG_TC0_RC0 = firmware.next_period(0);

  NVIC_SetPriority(TC0_IRQn, 0);  // highest priority: also interrupts other handlers
  NVIC_SetPriority(UART_IRQn, 1);
  NVIC_SetPriority(UOTGHS_IRQn, 1);
  NVIC_EnableIRQ(TC0_IRQn);

  REG_PIOB_ABSR |= pb25;  // peripheral B: TIOA0; the other pins are not changed
  REG_PIOB_PDR = pb25;    // the timer controls the pin
  REG_TC0_CCR0 = 5;       // start, from 0
}

void loop() {
  for (int i = 0; i < 64 && HOST.available() > 0; ++i) {
    firmware.receive(static_cast<uint8_t>(HOST.read()), millis());
  }
  firmware.poll(millis());

  uint8_t bytes[32];
  size_t room = static_cast<size_t>(HOST_ROOM);
  if (room > sizeof bytes) room = sizeof bytes;
  const size_t count = firmware.send(bytes, room);
  if (count > 0) HOST.write(bytes, count);  // by UART never more than fits: write() would block

  digitalWrite(LED_BUILTIN, firmware.led_is_on(millis()) ? HIGH : LOW);
}
