"""An Arduino Due that runs dueppm as machine code: a Cortex-M3 in unicorn, and around it the parts of the SAM3X8E that
the sketch uses, from the facts of its data sheet: timer counter 0 with its pin, the UART, the interrupt controller and
the system timer.

Time is counted in cycles of 84 MHz. An instruction takes CYCLES of them, more than a Cortex-M3 takes on average from
flash at that clock: what is slow here is faster on the board.
"""

import pathlib
import re
import shutil
import struct
import subprocess

from unicorn import UC_ARCH_ARM, UC_HOOK_BLOCK, UC_HOOK_CODE, UC_HOOK_INTR, UC_MODE_MCLASS, UC_MODE_THUMB, Uc, UcError
from unicorn import arm_const as arm

FIRMWARE = pathlib.Path(__file__).resolve().parents[1] / "firmware"

CYCLES_PER_US = 84
TICKS_PER_US = 42  # of the timer
CYCLES = 3  # of an instruction
EXCEPTION_CYCLES = 12  # from an interrupt's request to the first instruction of its handler
NEVER = 1 << 62

FLASH, RAM, STACK_TOP = 0x00080000, 0x20070000, 0x20088000
TC0, PERIPHERALS, CORE = 0x40080000, 0x400E0000, 0xE000E000
PAGE = 0x1000
SYSTICK, UART, TIMER = 15 - 16, 8, 27  # interrupts
THREAD, NESTED = 0xFFFFFFF9, 0xFFFFFFF1  # exception returns
REGISTERS = [arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3, arm.UC_ARM_REG_R12]
TIOA0_PIN = 1 << 25  # of PIOB
LED_PIN = 1 << 27
SET, CLEAR, TOGGLE = 1, 2, 3


class MachineCode:
    """An emulated board that runs the sketch as shipped, with the methods of risc_simulator's Board."""

    def __init__(self, program):
        """program: as `build` returns it."""
        self._due, self._sent, self._edges = Due(*program), 0, 0

    def receive(self, data):
        self._due.uart.receive(data)

    def advance(self, time_s):
        self._due.run(max(0, int(1e6 * time_s) - self._due.now // CYCLES_PER_US))

    def sent(self):
        data = bytes(self._due.uart.sent[self._sent :])
        self._sent += len(data)
        return data

    def edges(self):
        found = self._due.edges[self._edges :]
        self._edges += len(found)
        return found

    def close(self):
        """Do nothing: there is nothing to close."""


def configured(folder, changes=(), **constants):
    """A copy of the sketch with other constants in its configuration.h, as a person would edit it.

    changes: [(file, text in it, text instead)], for a sketch that lacks a protection.
    """
    sketch = pathlib.Path(folder) / "dueppm"
    shutil.copytree(FIRMWARE / "dueppm", sketch)
    file = sketch / "configuration.h"
    text = file.read_text(encoding="utf-8")
    for name, value in constants.items():
        value = str(value).lower() if isinstance(value, bool) else value
        text, found = re.subn(r"(\b%s =\s*)[^;]+;" % name, r"\g<1>%s;" % value, text)
        assert found == 1, name
    file.write_text(text, encoding="utf-8")
    for name, old, new in changes:
        text = (sketch / name).read_text(encoding="utf-8")
        assert text.count(old) == 1, old
        (sketch / name).write_text(text.replace(old, new), encoding="utf-8")
    return sketch


def build(sketch, folder):
    """(image, address of loop()) of a sketch, compiled for the board."""
    assert shutil.which("arm-none-eabi-g++"), "gcc-arm-none-eabi is missing: ./maap setup installs it"
    elf = pathlib.Path(folder) / "dueppm.elf"
    subprocess.run([str(FIRMWARE / "arm/build.sh"), str(sketch), str(elf)], check=True)
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", str(elf), str(elf.with_suffix(".bin"))], check=True)
    names = subprocess.run(["arm-none-eabi-nm", "-C", str(elf)], stdout=subprocess.PIPE, text=True, check=True).stdout
    (loop,) = re.findall(r"^(\w+) T loop\(\)$", names, re.M)
    return elf.with_suffix(".bin").read_bytes(), int(loop, 16)


def compile_only(sketch, folder):
    """Compile without linking: the functions of the native port are in the Arduino core."""
    subprocess.run(
        [str(FIRMWARE / "arm/build.sh"), str(sketch), str(pathlib.Path(folder) / "dueppm.o"), "-c"], check=True
    )


class Timer:
    """Channel 0 of timer counter 0 in waveform mode; its output is on the pin once the pin is given to it."""

    def __init__(self, due):
        self.due = due
        self.clocked = self.running = False
        self.mode = self.ra = self.rc = self.status = self.mask = 0
        self.zero = 0  # [cycles] when the counter was 0
        self.level = 0
        self.ra_at = self.rc_at = NEVER
        self.matches = []  # [ticks] of RC

    def counter(self):
        return (self.due.now - self.zero) // 2 % (1 << 32) if self.running else 0

    def schedule(self):
        """Set when RA and RC match next. A value that the counter has passed matches after a full round of 102 s."""
        if not self.running:
            return
        counter = self.counter()
        for name in ("ra", "rc"):
            value = getattr(self, name)
            rounds = 0 if value > counter else 1 << 32
            setattr(self, name + "_at", self.zero + 2 * (value + rounds))
        self.due.sooner(self.due_at())

    def output(self, effect, at):
        self.level = {SET: 1, CLEAR: 0, TOGGLE: 1 - self.level}.get(effect, self.level)
        self.due.show_pin(at)

    def write(self, offset, value):
        if not self.clocked:
            return  # without a clock the timer takes no writes
        if offset == 0x00:
            if value & 2:
                self.running = False
                self.ra_at = self.rc_at = NEVER
            elif value & 1:
                assert self.mode & 0xE007 == 0xC000, "waveform mode, up to RC, MCK / 2: %#x" % self.mode
                self.running = True
            if value & 4 and self.running:
                self.zero = self.due.now
                self.matches.append(self.zero // 2)
                self.output(self.mode >> 22 & 3, self.zero)
                self.schedule()
        elif offset == 0x04:
            self.mode = value
        elif offset == 0x14:
            self.ra = value
            self.schedule()
        elif offset == 0x1C:
            self.rc = value
            self.schedule()
            self.due.period_told()
        elif offset == 0x24:
            self.mask |= value
        elif offset == 0x28:
            self.mask &= ~value

    def read(self, offset):
        if offset == 0x10:
            return self.counter()
        if offset == 0x20:
            status, self.status = self.status, 0
            return status
        return {0x04: self.mode, 0x14: self.ra, 0x1C: self.rc, 0x2C: self.mask}.get(offset, 0)

    def due_at(self):
        return min(self.ra_at, self.rc_at)

    def happen(self):
        """Carry out the match that is due."""
        if self.ra_at < self.rc_at:
            at, self.ra_at = self.ra_at, NEVER
            self.output(self.mode >> 16 & 3, at)
            return
        self.zero = self.rc_at
        self.status |= 1 << 4
        self.matches.append(self.zero // 2)
        self.output(self.mode >> 18 & 3, self.zero)
        self.schedule()

    def requests(self):
        return self.status & self.mask


class Uart:
    """Receiver and transmitter, one byte at a time at the rate that BRGR says."""

    def __init__(self, due):
        self.due = due
        self.divisor = self.mask = self.held = 0
        self.on = self.ready = self.overrun = False
        self.to_come = []  # bytes of the host, the next one last
        self.next_at = NEVER
        self.waiting = None  # byte in THR
        self.shifting_until = 0
        self.sent = bytearray()
        self.lost = 0

    def byte_cycles(self):
        return 16 * self.divisor * 10

    def receive(self, data):
        if not self.to_come:
            self.next_at = self.due.now + self.byte_cycles()
        self.to_come[:0] = reversed(data)

    def status(self):
        ready, empty = self.waiting is None, self.waiting is None and self.due.now >= self.shifting_until
        return self.ready | ready << 1 | self.overrun << 5 | empty << 9

    def write(self, offset, value):
        if offset == 0x00:
            self.on = self.on or bool(value & 1 << 4)
            self.overrun = self.overrun and not value & 1 << 8
        elif offset == 0x08:
            self.mask |= value
        elif offset == 0x0C:
            self.mask &= ~value
        elif offset == 0x1C:
            assert self.waiting is None, "THR written while it is full"
            self.waiting = value & 0xFF
            self.shift()
        elif offset == 0x20:
            self.divisor = value

    def read(self, offset):
        if offset == 0x14:
            return self.status()
        if offset == 0x18:
            self.ready = False
            return self.held
        return 0

    def shift(self):
        if self.waiting is not None and self.due.now >= self.shifting_until:
            self.sent.append(self.waiting)
            self.waiting = None
            self.shifting_until = self.due.now + self.byte_cycles()
        elif self.waiting is not None:
            self.due.sooner(self.shifting_until)

    def due_at(self):
        return min(self.next_at, self.shifting_until if self.waiting is not None else NEVER)

    def happen(self):
        if self.next_at <= self.due.now:
            if self.ready:
                self.overrun, self.lost = True, self.lost + 1
            self.held, self.ready = self.to_come.pop(), True
            self.next_at = self.next_at + self.byte_cycles() if self.to_come else NEVER
        self.shift()

    def requests(self):
        return self.status() & self.mask


class Due:
    """One board.

    rng: draws where in loop() the next interrupt comes; None = at the end of loop().
    priorities=False: an interrupt controller without priorities, where each handler waits for the others.
    fine: interrupts between any two instructions, five times slower; otherwise only where a jump ends or begins.
    """

    def __init__(self, image, loop, rng=None, priorities=True, fine=False):
        self.now = 0  # [cycles]
        self.rng = rng
        self.priorities = priorities
        self.loop = loop
        self.timer, self.uart = Timer(self), Uart(self)
        self.systick_at, self.systick_cycles, self.systick_pending = NEVER, 0, False
        self.enabled, self.priority = set(), {TIMER: 0, UART: 0, SYSTICK: 0}
        self.masked_until = 0  # [cycles] all interrupts are masked until then
        self.active = []  # exceptions whose handlers run, the outermost first
        self.pio = {"peripheral": 0, "b": 0, "output": 0, "data": 0}
        self.edges, self.pin = [], None  # (ticks, level)
        self.told_after = []  # [cycles] from each RC match to its handler's write of RC
        self.entered_after = []  # [cycles] from each RC match to the handler's first instruction
        self.deadline, self.idle, self.leaving, self.rounds = 0, False, False, 0
        self.cycles = {}  # {(address, size [bytes]): cycles of that code}
        uc = self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M3)
        uc.mem_map(FLASH, 512 << 10)
        uc.mem_write(FLASH, image)
        self.image = image
        uc.mem_map(RAM, 96 << 10)
        for start, read, write in (
            (TC0, self.read_timer, self.write_timer),
            (PERIPHERALS, self.read_peripheral, self.write_peripheral),
            (PERIPHERALS + PAGE, self.read_pio, self.write_pio),
            (CORE, self.read_core, self.write_core),
        ):
            uc.mmio_map(start, PAGE, read, None, write, None)
        uc.hook_add(UC_HOOK_INTR, self.on_exception)
        uc.hook_add(UC_HOOK_CODE if fine else UC_HOOK_BLOCK, self.on_code)
        stack, self.pc = struct.unpack_from("<II", image)
        self.vectors = struct.unpack_from("<61I", image)
        uc.reg_write(arm.UC_ARM_REG_SP, stack)

    # --- registers

    def read_timer(self, uc, offset, size, data):
        return self.timer.read(offset)

    def write_timer(self, uc, offset, size, value, data):
        self.timer.write(offset, value)

    def read_peripheral(self, uc, offset, size, data):
        return self.uart.read(offset - 0x800) if 0x800 <= offset < 0x900 else 0

    def write_peripheral(self, uc, offset, size, value, data):
        if offset == 0x610:
            self.timer.clocked = self.timer.clocked or bool(value & 1 << 27)
        elif 0x800 <= offset < 0x900:
            self.uart.write(offset - 0x800, value)

    def read_pio(self, uc, offset, size, data):
        return self.pio["b"] if offset == 0x70 else 0

    def write_pio(self, uc, offset, size, value, data):
        pio = self.pio
        if offset == 0x00:
            pio["peripheral"] &= ~value
        elif offset == 0x04:
            pio["peripheral"] |= value
        elif offset == 0x10:
            pio["output"] |= value
        elif offset == 0x30:
            pio["data"] |= value
        elif offset == 0x34:
            pio["data"] &= ~value
        elif offset == 0x70:
            pio["b"] = value
        self.show_pin(self.now)

    def read_core(self, uc, offset, size, data):
        return 0

    def write_core(self, uc, offset, size, value, data):
        if offset == 0x010:
            self.systick_at = self.now + self.systick_cycles if value & 3 == 3 else NEVER
            self.sooner(self.systick_at)
        elif offset == 0x014:
            self.systick_cycles = value + 1
        elif 0x100 <= offset < 0x108:
            first = (offset - 0x100) * 8
            self.enabled |= {first + bit for bit in range(32) if value >> bit & 1}
        elif 0x400 <= offset < 0x440:
            self.priority[offset - 0x400] = value >> 4 & 0xF
        elif offset == 0xD20:
            self.priority[SYSTICK] = value >> 28

    # --- what is on the outside

    def show_pin(self, at):
        timers = self.pio["peripheral"] & self.pio["b"] & TIOA0_PIN
        level = self.timer.level if timers else 1  # an input, pulled up
        if level != self.pin:
            self.pin = level
            self.edges.append((at // 2, level))

    def led(self):
        return bool(self.pio["data"] & self.pio["output"] & LED_PIN)

    def sooner(self, cycle):
        """Stop the running instructions at this cycle already: they have caused an event that comes first."""
        self.deadline = min(self.deadline, cycle)

    def period_told(self):
        if self.active and self.active[-1] == TIMER:
            self.told_after.append(self.now - self.timer.zero)

    # --- the core

    def on_code(self, uc, address, size, data):
        """Count the cycles of an instruction (or run without a jump) that begins, or stop if an event is due first."""
        if address == self.loop and not self.active:
            self.rounds += 1
            if self.rounds > 2:  # two passes without an interrupt: a third one would do the same
                self.idle = True
                uc.emu_stop()
                return
        cycles = self.cycles.get((address, size))
        if cycles is None:
            cycles = self.cycles[address, size] = CYCLES * self.instructions(address, size)
        if self.now + cycles > self.deadline:
            uc.emu_stop()
            return
        self.now += cycles

    def instructions(self, address, size):
        count, at = 0, address - FLASH
        while at < address - FLASH + size:
            at += 4 if self.image[at + 1] >> 3 in (0b11101, 0b11110, 0b11111) else 2
            count += 1
        return count

    def on_exception(self, uc, number, data):
        assert number == 8, "exception %d at %#x" % (number, uc.reg_read(arm.UC_ARM_REG_PC))  # 8: an exception's end
        uc.emu_stop()
        self.leaving = True

    def execute(self, until):
        """Run instructions until that cycle, the next event, the end of a handler, or a loop() with nothing to do."""
        self.deadline, self.leaving, self.idle = until, False, False
        try:
            self.uc.emu_start(self.pc | 1, 0xFFFFFFFE)
        except UcError as error:
            raise AssertionError("%s at %#x" % (error, self.uc.reg_read(arm.UC_ARM_REG_PC))) from error
        self.pc = self.uc.reg_read(arm.UC_ARM_REG_PC)
        if not self.leaving and not self.idle:
            self.now = max(self.now, self.deadline)

    def enter(self, irq):
        uc = self.uc
        sp = uc.reg_read(arm.UC_ARM_REG_SP)
        aligned = (sp - 32) & ~7
        frame = [uc.reg_read(register) for register in REGISTERS]
        frame += [uc.reg_read(arm.UC_ARM_REG_LR), self.pc | 1]
        frame += [uc.reg_read(arm.UC_ARM_REG_XPSR) & 0xF80F0000 | 1 << 24 | ((sp - 32) != aligned) << 9]
        uc.mem_write(aligned, struct.pack("<8I", *frame))
        uc.reg_write(arm.UC_ARM_REG_SP, aligned)
        uc.reg_write(arm.UC_ARM_REG_LR, NESTED if self.active else THREAD)
        self.pc = self.vectors[16 + irq] & ~1
        self.now += EXCEPTION_CYCLES
        self.active.append(irq)
        self.rounds = 0
        if irq == TIMER:
            self.entered_after.append(self.now - self.timer.zero)

    def leave(self):
        uc = self.uc
        sp = uc.reg_read(arm.UC_ARM_REG_SP)
        *values, lr, pc, xpsr = struct.unpack("<8I", uc.mem_read(sp, 32))
        for register, value in zip(REGISTERS, values, strict=True):
            uc.reg_write(register, value)
        uc.reg_write(arm.UC_ARM_REG_LR, lr)
        uc.reg_write(arm.UC_ARM_REG_SP, sp + 32 + (4 if xpsr >> 9 & 1 else 0))
        uc.reg_write(arm.UC_ARM_REG_APSR_NZCVQ, xpsr & 0xF8000000)
        self.pc = pc & ~1
        self.now += EXCEPTION_CYCLES
        self.active.pop()

    def pending(self):
        """The interrupt that the core takes now, or None."""
        if self.now < self.masked_until:
            return None
        wanted = [SYSTICK] if self.systick_pending else []
        wanted += [irq for irq, part in ((TIMER, self.timer), (UART, self.uart)) if part.requests()]
        wanted = [irq for irq in wanted if irq == SYSTICK or irq in self.enabled]
        if not wanted:
            return None
        irq = min(wanted, key=lambda irq: (self.priority[irq], irq))
        if not self.active:
            return irq
        return irq if self.priorities and self.priority[irq] < self.priority[self.active[-1]] else None

    def run(self, us):
        end = self.now + int(us * CYCLES_PER_US)
        while self.now < end:
            irq = self.pending()
            if irq is not None:
                if irq == SYSTICK:
                    self.systick_pending = False
                self.enter(irq)
            event = min(self.timer.due_at(), self.uart.due_at(), self.systick_at)
            if event > self.now:
                self.execute(min(event, end))
                if self.leaving:
                    self.leave()
                elif self.idle:
                    self.rounds = 0
                    # the next interrupt comes anywhere in loop()
                    early = self.rng.randrange(3000) if self.rng is not None else 0
                    self.now = max(self.now, self.deadline - early)
                continue
            for part in (self.timer, self.uart):
                while part.due_at() <= self.now:
                    part.happen()
            if self.systick_at <= self.now:
                self.systick_at += self.systick_cycles
                self.systick_pending = True
