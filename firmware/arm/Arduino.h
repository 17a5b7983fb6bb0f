// The part of the Arduino core that dueppm.ino uses, on the registers of the SAM3X8E: to run the sketch as
// machine code in an emulator. A real board is loaded with the Arduino IDE, whose core also sets up clocks,
// USB and everything else.
#pragma once

#include <stddef.h>
#include <stdint.h>

#define F_CPU 84000000L
#define HIGH 1
#define LOW 0
#define OUTPUT 1
#define LED_BUILTIN 13

#define DUE_REGISTER(address) (*reinterpret_cast<volatile uint32_t*>(address))
#define REG_PMC_PCER0 DUE_REGISTER(0x400E0610)
#define REG_UART_CR DUE_REGISTER(0x400E0800)
#define REG_UART_MR DUE_REGISTER(0x400E0804)
#define REG_UART_IER DUE_REGISTER(0x400E0808)
#define REG_UART_IDR DUE_REGISTER(0x400E080C)
#define REG_UART_SR DUE_REGISTER(0x400E0814)
#define REG_UART_RHR DUE_REGISTER(0x400E0818)
#define REG_UART_THR DUE_REGISTER(0x400E081C)
#define REG_UART_BRGR DUE_REGISTER(0x400E0820)
#define REG_PIOA_PDR DUE_REGISTER(0x400E0E04)
#define REG_PIOB_PER DUE_REGISTER(0x400E1000)
#define REG_PIOB_PDR DUE_REGISTER(0x400E1004)
#define REG_PIOB_OER DUE_REGISTER(0x400E1010)
#define REG_PIOB_SODR DUE_REGISTER(0x400E1030)
#define REG_PIOB_CODR DUE_REGISTER(0x400E1034)
#define REG_PIOB_ABSR DUE_REGISTER(0x400E1070)
#define REG_TC0_CCR0 DUE_REGISTER(0x40080000)
#define REG_TC0_CMR0 DUE_REGISTER(0x40080004)
#define REG_TC0_CV0 DUE_REGISTER(0x40080010)
#define REG_TC0_RA0 DUE_REGISTER(0x40080014)
#define REG_TC0_RC0 DUE_REGISTER(0x4008001C)
#define REG_TC0_SR0 DUE_REGISTER(0x40080020)
#define REG_TC0_IER0 DUE_REGISTER(0x40080024)
#define REG_TC0_IDR0 DUE_REGISTER(0x40080028)
#define REG_TC0_WPMR DUE_REGISTER(0x400800E4)
#define REG_SYSTICK_CTRL DUE_REGISTER(0xE000E010)
#define REG_SYSTICK_LOAD DUE_REGISTER(0xE000E014)
#define REG_SYSTICK_VAL DUE_REGISTER(0xE000E018)
#define REG_NVIC_ISER DUE_REGISTER(0xE000E100)
#define REG_SCB_SHPR3 DUE_REGISTER(0xE000ED20)

enum IRQn_Type { UART_IRQn = 8, TC0_IRQn = 27, UOTGHS_IRQn = 40 };

inline void NVIC_EnableIRQ(IRQn_Type irq) {
  (&REG_NVIC_ISER)[irq / 32] = 1u << (irq % 32);
}
inline void NVIC_SetPriority(IRQn_Type irq, uint32_t priority) {  // 4 bits, the upper ones of a byte
  reinterpret_cast<volatile uint8_t*>(0xE000E400)[irq] = static_cast<uint8_t>(priority << 4);
}

extern "C" void TC0_Handler(void);
void setup();
void loop();

uint32_t millis();
void pinMode(uint32_t pin, uint32_t mode);  // for the LED only
void digitalWrite(uint32_t pin, uint32_t level);

// The UART behind the programming port, with interrupts and two buffers of 128 bytes as in the Arduino core.
class UartSerial {
 public:
  void begin(uint32_t baud);
  int available() const;
  int availableForWrite() const;
  int read();
  size_t write(const uint8_t* bytes, size_t count);
};

extern UartSerial Serial;
extern UartSerial SerialUSB;  // declared only: the native port does not run here
