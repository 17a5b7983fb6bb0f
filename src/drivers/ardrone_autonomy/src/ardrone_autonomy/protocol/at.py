"""AT commands: ASCII lines from the client to the aircraft, UDP port 5556.

Form: ``AT*NAME=sequence[,argument...]`` + carriage return.  Several commands may share one datagram, a command never
spans two.  Arguments: signed decimal integers; strings in double quotes; floats as the decimal value of their 32-bit
pattern read as a signed integer (0.3 -> 1050253722).

One table (`SIGNATURES`) serves both directions: the client encodes strictly by it, the virtual aircraft
(risc_simulator) parses tolerantly by it.
"""

import math
import struct
from enum import IntEnum, IntFlag

MAX_COMMAND_CHARS = 1024  # a longer command is refused by the aircraft

# Types of the arguments after the sequence number: i integer, f float (-1..1 for sticks), s string.
SIGNATURES = {
    "REF": "i",  # bits, see Ref
    "PCMD": "iffff",  # flags, roll, pitch, gaz, yaw
    "PCMD_MAG": "iffffff",  # as PCMD, then psi, psi_accuracy
    "FTRIM": "",
    "CONFIG": "ss",  # key, value
    "CONFIG_IDS": "sss",  # session, user, application
    "COMWDG": "",
    "CTRL": "ii",  # CtrlMode, 0
    "CALIB": "i",  # device: 0 magnetometer
    "ANIM": "ii",  # animation, duration [ms]
    "LED": "ifi",  # animation, frequency [Hz], duration [s]
    "PMODE": "i",
    "MISC": "iiii",
}
OPTIONAL_TAIL = {"CTRL": 1, "ANIM": 1}  # number of trailing arguments that some clients leave out; they read 0

# Legacy and factory commands that a 2.0 accepts without visible effect.
IGNORED = frozenset(["ZAP", "CAD", "GAIN", "MTRIM", "VISP", "VISO", "CAP", "POL", "PWM", "AFLIGHT", "VICON", "RC"])


class Ref(IntFlag):
    """Bits of the REF argument."""

    PADDING = 0x11540000  # bits 18, 20, 22, 24, 28: always one
    SELECT = 0x100  # bit 8: a rising edge toggles the emergency state
    START = 0x200  # bit 9, a level: 1 take off / keep flying, 0 land / stay on the ground


class PcmdFlag(IntFlag):
    """Bits of the first PCMD argument."""

    PROGRESSIVE = 1  # 0: hover by optical flow, the four sticks are ignored
    COMBINED_YAW = 2  # roll and yaw make a coordinated turn
    ABSOLUTE = 4  # roll and pitch are in the frame of the pilot's heading (PCMD_MAG)


class CtrlMode(IntEnum):
    """First argument of CTRL."""

    NONE = 0
    SEND_CONFIG = 4  # configuration text on TCP 5559
    CLEAR_ACK = 5  # clear the command-ack bit of the state
    SEND_CUSTOM_IDS = 6  # list of multi-configuration ids on TCP 5559


# Default duration [ms] by flight animation id: phi -30, phi 30, theta -30, theta 30, theta 20 yaw 200, theta 20 yaw
# -200; turnaround, turnaround down; yaw shake; dances in yaw, phi, theta, vz, a wave, two mixed ones; four flips.
FLIGHT_ANIMATIONS_MS = 6 * (1000,) + 2 * (5000,) + (2000,) + 7 * (5000,) + 4 * (15,)

_UINT32 = struct.Struct("<I")
_FLOAT32 = struct.Struct("<f")
# The arguments of commands without strings as numbers, and the same bytes as integers.
_NUMBERS = {
    name: (
        struct.Struct("<" + kinds),
        struct.Struct("<%di" % len(kinds)),
        b"AT*%s=%%d%s\r" % (name.encode(), b",%d" * len(kinds)),
    )
    for name, kinds in SIGNATURES.items()
    if "s" not in kinds
}
_PADDING, _START, _SELECT = map(int, (Ref.PADDING, Ref.START, Ref.SELECT))  # IntFlag's operators are slow


def int_to_float(pattern):
    """Float with the given 32-bit pattern, signed or unsigned. ValueError outside 32 bits or if not finite."""
    if not -(2**31) <= pattern < 2**32:
        raise ValueError("%d is not a 32-bit pattern" % pattern)
    value = _FLOAT32.unpack(_UINT32.pack(pattern & 0xFFFFFFFF))[0]
    if not math.isfinite(value):
        raise ValueError("the pattern %d is not a finite float" % pattern)
    return value + 0.0


# --- client side -----------------------------------------------------------------------------------------------------
def encode(name, sequence, *arguments):
    """Encode one command as bytes, carriage return included.

    name: key of SIGNATURES.  sequence: one count for all commands of a socket; 1 resets the aircraft's count.
    arguments: ints, floats and strings as in the signature.  ValueError on a wrong count, type or length.
    """
    if name not in _NUMBERS:
        return _encode_strings(name, sequence, arguments)
    numbers, integers, text = _NUMBERS[name]
    try:
        if not all(map(math.isfinite, arguments)):
            raise ValueError("not a finite number")
        packed = numbers.pack(*[argument + 0 for argument in arguments])  # + 0 turns -0.0 into 0.0
    except (struct.error, OverflowError, TypeError, ValueError) as error:
        raise ValueError("the AT command %s cannot carry %r: %s" % (name, arguments, error)) from None
    return text % (sequence, *integers.unpack(packed))


def _encode_strings(name, sequence, arguments):
    if len(arguments) != len(SIGNATURES[name]) or any(c in '"\r\n\0' for argument in arguments for c in argument):
        raise ValueError(
            "%s takes %d strings without quotes, line ends or zeros, got %r" % (name, len(SIGNATURES[name]), arguments)
        )
    text = "AT*%s=%d%s\r" % (name, sequence, "".join(',"%s"' % argument for argument in arguments))
    if not text.isascii() or len(text) > MAX_COMMAND_CHARS:
        raise ValueError("an AT command has at most %d characters of ASCII, got %r" % (MAX_COMMAND_CHARS, text))
    return text.encode()


def ref(sequence, start=False, select=False):
    """Encode REF. start: take off / keep flying, else land; a rising edge of select toggles the emergency state."""
    return encode("REF", sequence, _PADDING + _START * bool(start) + _SELECT * bool(select))


def pcmd_mag(sequence, flags=0, roll=0.0, pitch=0.0, gaz=0.0, yaw=0.0):
    """Encode PCMD_MAG. Sticks in [-1, 1]: roll + right, pitch + nose up (backward), gaz + up, yaw + clockwise from
    above.
    """
    return encode("PCMD_MAG", sequence, flags, roll, pitch, gaz, yaw, 0.0, 0.0)
