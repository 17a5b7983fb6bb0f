#!/bin/sh
# build.sh SKETCH_FOLDER OUTPUT.elf: the sketch as machine code of the SAM3X8E, for an emulator.
# build.sh SKETCH_FOLDER OUTPUT.o -c: the sketch alone, not linked.
set -eu
here=$(dirname "$0")
set -- "$1" "$2" "${3:-}" "$1/$(basename "$1").ino"
# flags of the Arduino core for the Due; every warning is an error
compile() {
  arm-none-eabi-g++ -mcpu=cortex-m3 -mthumb -std=gnu++11 -Os -ffunction-sections -fdata-sections -ffreestanding \
    -fno-threadsafe-statics -fno-rtti -fno-exceptions -Wall -Wextra -Werror -I "$here" -include Arduino.h "$@"
}
if [ "$3" = -c ]; then
  compile -c -o "$2" -x c++ "$4"
else
  compile -nostdlib -Wl,--gc-sections,--fatal-warnings -T "$here/due.ld" -o "$2" "$here/board.cpp" -x c++ "$4" -lgcc
fi
