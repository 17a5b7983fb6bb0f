#!/bin/sh
# build.sh SKETCH_FOLDER OUTPUT.elf: the sketch as machine code of the SAM3X8E, for an emulator.
set -eu
here=$(dirname "$0")
# flags of the Arduino core for the Due; every warning is an error
arm-none-eabi-g++ -mcpu=cortex-m3 -mthumb -std=gnu++11 -Os -ffunction-sections -fdata-sections -ffreestanding \
  -fno-threadsafe-statics -fno-rtti -fno-exceptions -Wall -Wextra -Werror \
  -nostdlib -Wl,--gc-sections,--fatal-warnings -T "$here/due.ld" -I "$here" -I "$1" -include Arduino.h \
  -o "$2" "$here/board.cpp" -x c++ "$1/$(basename "$1").ino" -lgcc
