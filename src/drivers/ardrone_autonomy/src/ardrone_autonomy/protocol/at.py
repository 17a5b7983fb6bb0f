"""AT commands: ASCII lines from the client to the aircraft, UDP port 5556.

Form: ``AT*NAME=sequence[,argument...]`` + carriage return.  Several commands may share one datagram, a command never
spans two.  Arguments: signed decimal integers; strings in double quotes; floats as the decimal value of their 32-bit
pattern read as a signed integer (0.3 -> 1050253722).

One table (`SIGNATURES`) serves both directions: the client encodes strictly from it, the virtual aircraft
(risc_simulator) parses tolerantly with it.
"""

import math
import struct
from enum import IntEnum, IntFlag

MAX_COMMAND_CHARS = 1024  # a longer command is refused by the aircraft

# Kinds of the arguments behind the sequence number: i integer, f float (-1..1 where it is a stick), s string.
SIGNATURES = {
    "REF": "i",  # bits, see Ref
    "PCMD": "iffff",  # flags, roll, pitch, gaz, yaw
    "PCMD_MAG": "iffffff",  # the same, psi, psi_accuracy
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
OPTIONAL_TAIL = {"CTRL": 1, "ANIM": 1}  # trailing arguments that some clients leave out; they read 0

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


class LedAnimation(IntEnum):
    """Ids of AT*LED."""

    BLINK_GREEN_RED = 0
    BLINK_GREEN = 1
    BLINK_RED = 2
    BLINK_ORANGE = 3
    SNAKE_GREEN_RED = 4
    FIRE = 5
    STANDARD = 6
    RED = 7
    GREEN = 8
    RED_SNAKE = 9
    BLANK = 10
    RIGHT_MISSILE = 11
    LEFT_MISSILE = 12
    DOUBLE_MISSILE = 13
    FRONT_LEFT_GREEN_OTHERS_RED = 14
    FRONT_RIGHT_GREEN_OTHERS_RED = 15
    REAR_RIGHT_GREEN_OTHERS_RED = 16
    REAR_LEFT_GREEN_OTHERS_RED = 17
    LEFT_GREEN_RIGHT_RED = 18
    LEFT_RED_RIGHT_GREEN = 19
    BLINK_STANDARD = 20


# (name, default duration [ms]) by flight animation id.
FLIGHT_ANIMATIONS = (
    ("PHI_M30_DEG", 1000),
    ("PHI_30_DEG", 1000),
    ("THETA_M30_DEG", 1000),
    ("THETA_30_DEG", 1000),
    ("THETA_20DEG_YAW_200DEG", 1000),
    ("THETA_20DEG_YAW_M200DEG", 1000),
    ("TURNAROUND", 5000),
    ("TURNAROUND_GODOWN", 5000),
    ("YAW_SHAKE", 2000),
    ("YAW_DANCE", 5000),
    ("PHI_DANCE", 5000),
    ("THETA_DANCE", 5000),
    ("VZ_DANCE", 5000),
    ("WAVE", 5000),
    ("PHI_THETA_MIXED", 5000),
    ("DOUBLE_PHI_THETA_MIXED", 5000),
    ("FLIP_AHEAD", 15),
    ("FLIP_BEHIND", 15),
    ("FLIP_LEFT", 15),
    ("FLIP_RIGHT", 15),
)

_INT32 = struct.Struct("<i")
_UINT32 = struct.Struct("<I")
_FLOAT32 = struct.Struct("<f")
_STICKS, _PATTERNS = struct.Struct("<6f"), struct.Struct("<6i")  # the same bytes as floats and as integers
_REF = {
    (start, select): int(Ref.PADDING | (Ref.START if start else 0) | (Ref.SELECT if select else 0))
    for start in (False, True)
    for select in (False, True)
}


def float_to_int(value):
    """Signed integer with the bit pattern of a single-precision float; -0.0 becomes 0. ValueError if not finite."""
    if not math.isfinite(value):
        raise ValueError("an AT command cannot carry the float %r: send a finite number" % (value,))
    try:
        return _INT32.unpack(_FLOAT32.pack(value + 0.0))[0]  # + 0.0 turns -0.0 into 0.0
    except OverflowError:
        raise ValueError("%r does not fit a 32-bit float" % (value,)) from None


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
    """One command as bytes, carriage return included.

    name: key of SIGNATURES.  sequence: >= 0, see SequenceCounter.  arguments: ints, floats and strings as the
    signature says.  ValueError on a wrong name, count, kind or length.
    """
    kinds = SIGNATURES.get(name)
    if kinds is None:
        raise ValueError("unknown AT command %r, known are %s" % (name, ", ".join(sorted(SIGNATURES))))
    if len(arguments) != len(kinds):
        raise ValueError("AT*%s takes %d arguments, got %d" % (name, len(kinds), len(arguments)))
    if sequence < 0:
        raise ValueError("the sequence number must be >= 0, got %d" % sequence)
    fields = ["%d" % sequence]
    for kind, argument in zip(kinds, arguments):
        if kind == "s":
            if any(c in '"\r\n\0' for c in argument):
                raise ValueError("a string argument may not hold quotes, line ends or zeros: %r" % (argument,))
            fields.append('"%s"' % argument)
        elif kind == "f":
            fields.append("%d" % float_to_int(argument))
        else:
            fields.append("%d" % argument)
    try:
        command = ("AT*%s=%s\r" % (name, ",".join(fields))).encode("ascii")
    except UnicodeEncodeError:
        raise ValueError("AT commands are ASCII, got %r" % (arguments,)) from None
    if len(command) > MAX_COMMAND_CHARS:
        raise ValueError("an AT command has at most %d characters, got %d" % (MAX_COMMAND_CHARS, len(command)))
    return command


def ref(sequence, start=False, select=False):
    """Take off / keep flying (start), land (not start); a rising edge of select toggles the emergency state."""
    return b"AT*REF=%d,%d\r" % (sequence, _REF[bool(start), bool(select)])


def pcmd_mag(sequence, flags=0, roll=0.0, pitch=0.0, gaz=0.0, yaw=0.0, psi=0.0, psi_accuracy=0.0):
    """Sticks in [-1, 1], clipped: roll + right, pitch + nose up (backward), gaz + up, yaw + clockwise from above.

    psi, psi_accuracy: the pilot's magnetic heading and its error as fractions of 180 degrees.
    """
    sticks = [_stick(value) for value in (roll, pitch, gaz, yaw, psi, psi_accuracy)]
    return b"AT*PCMD_MAG=%d,%d,%d,%d,%d,%d,%d,%d\r" % (sequence, flags, *_PATTERNS.unpack(_STICKS.pack(*sticks)))


def ftrim(sequence):
    """The aircraft lies flat now (only on the ground)."""
    return encode("FTRIM", sequence)


def config(sequence, key, value):
    """Write one configuration value; key "section:name", value already formatted (see config.format_value)."""
    return encode("CONFIG", sequence, key, value)


def config_ids(sequence, session, user, application):
    """Must directly precede each CONFIG while multi-configuration is in use; ids of 8 hexadecimal digits."""
    return encode("CONFIG_IDS", sequence, session, user, application)


def comwdg(sequence):
    """Reset the communication watchdog."""
    return encode("COMWDG", sequence)


def ctrl(sequence, mode):
    """See CtrlMode."""
    return encode("CTRL", sequence, mode, 0)


def led(sequence, animation, frequency_hz, duration_s):
    """LED animation, see LedAnimation."""
    return encode("LED", sequence, animation, frequency_hz, duration_s)


def _stick(value):
    if not math.isfinite(value):
        raise ValueError("a stick must be a finite number in [-1, 1], got %r" % (value,))
    return min(1.0, max(-1.0, value)) + 0.0  # which turns -0.0 into 0.0


class SequenceCounter:
    """Client side: one counter shared by all commands of a socket; the first number is 1, which resets the aircraft."""

    def __init__(self):
        self._last = 0

    def next(self):
        """The number of the next command."""
        self._last += 1
        return self._last

    def reset(self):
        """Start again at 1, as after a lost link."""
        self._last = 0
