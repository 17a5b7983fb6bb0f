// Start-up code, and the functions that Arduino.h declares.
#include "Arduino.h"

extern "C" {

extern uint32_t _data_load, _data_start, _data_end, _bss_start, _bss_end, _stack_top;
extern void (*_constructors_start[])();
extern void (*_constructors_end[])();

// The compiler generates calls of these three.
void* memset(void* to, int value, size_t count) {
  for (size_t i = 0; i < count; ++i) static_cast<volatile uint8_t*>(to)[i] = static_cast<uint8_t>(value);
  return to;
}
void* memcpy(void* to, const void* from, size_t count) {
  for (size_t i = 0; i < count; ++i)
    static_cast<volatile uint8_t*>(to)[i] = static_cast<const uint8_t*>(from)[i];
  return to;
}
void* memmove(void* to, const void* from, size_t count) {
  if (to <= from) return memcpy(to, from, count);
  for (size_t i = count; i > 0; --i)
    static_cast<volatile uint8_t*>(to)[i - 1] = static_cast<const uint8_t*>(from)[i - 1];
  return to;
}

void Reset_Handler();
void Default_Handler() {
  for (;;) {
  }
}
void SysTick_Handler();
void UART_Handler();

// 16 entries of the core, 45 of the peripherals
__attribute__((section(".vectors"), used)) void (*const vectors[16 + 45])() = {
    reinterpret_cast<void (*)()>(&_stack_top),
    Reset_Handler,
    Default_Handler,  // NMI
    Default_Handler,  // hard fault
    Default_Handler,  // memory management
    Default_Handler,  // bus fault
    Default_Handler,  // usage fault
    nullptr,
    nullptr,
    nullptr,
    nullptr,
    Default_Handler,  // SVC
    Default_Handler,  // debug monitor
    nullptr,
    Default_Handler,  // PendSV
    SysTick_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    UART_Handler,  // 8
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    Default_Handler,
    TC0_Handler,  // 27
};

void Reset_Handler() {
  uint32_t* load = &_data_load;
  for (uint32_t* to = &_data_start; to < &_data_end;) *to++ = *load++;
  for (uint32_t* to = &_bss_start; to < &_bss_end;) *to++ = 0;
  for (void (**constructor)() = _constructors_start; constructor < _constructors_end; ++constructor)
    (*constructor)();
  REG_SYSTICK_LOAD = F_CPU / 1000 - 1;
  REG_SYSTICK_VAL = 0;
  REG_SCB_SHPR3 = 0xF0000000;  // the lowest priority
  REG_SYSTICK_CTRL = 7;        // on, with interrupt, clock of the core
  setup();
  for (;;) loop();
}

}  // extern "C"

static volatile uint32_t milliseconds;

extern "C" void SysTick_Handler() {
  milliseconds = milliseconds + 1;
}

uint32_t millis() {
  return milliseconds;
}

void pinMode(uint32_t pin, uint32_t mode) {
  if (pin != LED_BUILTIN || mode != OUTPUT) return;
  REG_PIOB_PER = 1u << 27;
  REG_PIOB_OER = 1u << 27;
}

void digitalWrite(uint32_t pin, uint32_t level) {
  if (pin == LED_BUILTIN) (level ? REG_PIOB_SODR : REG_PIOB_CODR) = 1u << 27;
}

namespace {

class Ring {
 public:
  static constexpr uint32_t kSize = 128;

  uint32_t used() const { return head_ - tail_; }
  bool put(uint8_t byte) {  // one side writes head_, the other tail_
    if (used() == kSize) return false;
    bytes_[head_ % kSize] = byte;
    head_ = head_ + 1;
    return true;
  }
  uint8_t take() {
    const uint8_t byte = bytes_[tail_ % kSize];
    tail_ = tail_ + 1;
    return byte;
  }

 private:
  volatile uint8_t bytes_[kSize];
  volatile uint32_t head_;
  volatile uint32_t tail_;
};

Ring received;
Ring to_send;

enum : uint32_t { kRxReady = 1u << 0, kTxReady = 1u << 1, kOverrun = 1u << 5, kFraming = 1u << 6 };

}  // namespace

UartSerial Serial;

extern "C" void UART_Handler() {
  const uint32_t status = REG_UART_SR;
  if (status & kRxReady) received.put(static_cast<uint8_t>(REG_UART_RHR));
  if (status & kTxReady) {
    if (to_send.used() > 0) {
      REG_UART_THR = to_send.take();
    } else {
      REG_UART_IDR = kTxReady;
    }
  }
  if (status & (kOverrun | kFraming)) REG_UART_CR = 1u << 8;  // clear these errors
}

void UartSerial::begin(uint32_t baud) {
  REG_PMC_PCER0 = 1u << UART_IRQn;
  REG_PIOA_PDR = 3u << 8;  // PA8, PA9
  REG_UART_MR = 4u << 9;   // no parity
  REG_UART_BRGR = static_cast<uint32_t>(F_CPU) / 16 / baud;
  REG_UART_IER = kRxReady | kOverrun | kFraming;
  NVIC_EnableIRQ(UART_IRQn);
  REG_UART_CR = 1u << 4 | 1u << 6;  // receiver and transmitter on
}

int UartSerial::available() const {
  return static_cast<int>(received.used());
}

int UartSerial::availableForWrite() const {
  return static_cast<int>(Ring::kSize - to_send.used());
}

int UartSerial::read() {
  return received.used() > 0 ? received.take() : -1;
}

size_t UartSerial::write(const uint8_t* bytes, size_t count) {
  for (size_t i = 0; i < count; ++i) {
    while (!to_send.put(bytes[i])) {
    }
    REG_UART_IER = kTxReady;
  }
  return count;
}
