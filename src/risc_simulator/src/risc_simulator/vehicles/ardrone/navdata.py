"""Fills the options of an AR.Drone's navdata packet from the readings of its sensors, fast enough for 200 Hz.

Every run of fields has one function here, which takes the Frame and returns its numbers. What has no counterpart in the
virtual lab (detections, trackers, wind, USB recording, satellite positions) stays zero.
"""

import math
from typing import Any, NamedTuple

from ardrone_autonomy.protocol.navdata import Tag
from risc_simulator.vehicles.ardrone.sensors import TEMPERATURE_TENTHS_C, Reading
from risc_simulator.vehicles.ardrone.wire import NavdataEncoder, seconds_to_time

_RAD = math.pi / 180.0
_ACCELEROMETER_ZERO = 2048
_ACCELEROMETER_LSB_PER_MG = 0.512, 0.512, -0.512  # real captures: above the middle on z where acc z is -1000 mg
_MAGNETOMETER_MG_PER_LSB = -3.5  # as in real captures, where x and y are exchanged, too
_MOTOR_LIMIT = 255  # sat_motor
_GYRO_LSB_PER_DEG_S = 16.4
_FLOW_PIXELS = 200.0 / 60.0  # pixels a picture for 1 m/s at 1 m height


class Frame(NamedTuple):
    """All that a packet is made of."""

    reading: Reading
    time_s: float  # since boot
    ctrl_state: int  # major << 16 | minor
    sticks: Any  # last obeyed Sticks
    command: tuple[float, float, float, float]  # in force: roll [rad], pitch [rad], climb [m/s], yaw rate [rad/s]
    ref_sequence: int
    ref_gap_ms: float
    cycles: int
    picture: tuple[int, int]  # bytes and number of the newest one, of those that were made because somebody watches
    trim_deg: tuple[float, float]  # roll, pitch


_RUNS = {}  # tag -> [(first field, last field, function of the Frame)]


def _fills(tag, first, last=None):
    """The function fills the fields of an option from `first` to `last` (default: only first) in every packet."""

    def register(values):
        _RUNS.setdefault(tag, []).append((first, last, values))
        return values

    return register


def _uint32(value):
    """A configured number, whatever a client wrote."""
    return min(2**32 - 1, max(0, value))


def _uint16(value):
    return min(65535, max(0, int(value)))


def _int16(value):
    return min(32767, max(-32768, int(value)))


@_fills(Tag.DEMO, "ctrl_state", "vz")
def _demo(f):
    r = f.reading
    vx, vy, vz = r.velocity_m_s
    attitude_mdeg = 1e3 * r.pitch_deg, 1e3 * r.roll_deg, 1e3 * r.yaw_deg
    return f.ctrl_state, int(r.battery_pct), *attitude_mdeg, int(1e3 * r.altitude_m), 1e3 * vx, 1e3 * vy, 1e3 * vz


@_fills(Tag.DEMO, "drone_camera_rot", "drone_camera_trans")
def _demo_camera(f):
    r = f.reading
    sf, cf = math.sin(r.roll_deg * _RAD), math.cos(r.roll_deg * _RAD)
    st, ct = math.sin(r.pitch_deg * _RAD), math.cos(r.pitch_deg * _RAD)
    sp, cp = math.sin(r.turned_deg * _RAD), math.cos(r.turned_deg * _RAD)
    north = ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp
    east = ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp
    down = -st, sf * ct, cf * ct
    return *north, *east, *down, 1e3 * r.way_m[0], 1e3 * r.way_m[1], -1e3 * r.altitude_raw_m


@_fills(Tag.TIME, "time")
def _time(f):
    return (seconds_to_time(f.time_s),)


@_fills(Tag.RAW_MEASURES, "raw_accs", "vbat_raw")
def _raw_measures(f):
    r, k = f.reading, _GYRO_LSB_PER_DEG_S
    accelerations = [
        _uint16(_ACCELEROMETER_ZERO + lsb_per_mg * a)
        for lsb_per_mg, a in zip(_ACCELEROMETER_LSB_PER_MG, r.acceleration_mg)
    ]
    p, q, s = r.rates_deg_s
    fast = _int16(k * p), _int16(k * q), _int16(k * s)
    return *accelerations, *fast, _int16(4.0 * k * p), _int16(4.0 * k * q), int(r.battery_mv)


@_fills(Tag.RAW_MEASURES, "us_distance_echo")
def _echo(f):
    return (_uint16(1e3 * f.reading.altitude_raw_m),)


@_fills(Tag.RAW_MEASURES, "alt_temp_raw")
def _raw_altitude(f):
    return (int(1e3 * f.reading.altitude_raw_m),)


@_fills(Tag.PHYS_MEASURES, "phys_accs", "phys_gyros")
def _phys_measures(f):
    return *f.reading.acceleration_mg, *f.reading.rates_deg_s


@_fills(Tag.EULER_ANGLES, "theta_a", "phi_a")
def _euler_angles(f):
    return 1e3 * f.reading.pitch_deg, 1e3 * f.reading.roll_deg


@_fills(Tag.REFERENCES, "ref_theta", "ref_psi")
def _references(f):
    roll, pitch, _, yaw_rate = f.command
    theta, phi = int(1e3 * pitch / _RAD), int(1e3 * roll / _RAD)
    return theta, phi, 0, 0, theta, phi, int(1e3 * yaw_rate / _RAD), int(1e3 * f.reading.yaw_deg)


@_fills(Tag.REFERENCES, "ui_time", "ui_seq")
def _pilots_references(f):
    s = f.sticks
    return s.time_s, s.pitch, s.roll, s.yaw, s.psi_accuracy, s.sequence & 0x7FFFFFFF


@_fills(Tag.TRIMS, "angular_rates_trim_r", "euler_angles_trim_phi")
def _trims(f):
    roll_deg, pitch_deg = f.trim_deg
    return 0.0, pitch_deg * _RAD, roll_deg * _RAD


@_fills(Tag.RC_REFERENCES, "rc_ref_pitch", "rc_ref_gaz")
def _rc_references(f):
    roll, pitch, climb, yaw_rate = f.command
    return int(1e3 * pitch / _RAD), int(1e3 * roll / _RAD), int(1e3 * yaw_rate / _RAD), int(1e3 * climb)


@_fills(Tag.PWM, "motor1", "motor4")
def _motors(f):
    return f.reading.motor_pwm


@_fills(Tag.PWM, "vz_ref")
def _gaz(f):
    return (1e3 * f.command[2],)


@_fills(Tag.PWM, "current_motor1", "current_motor4")
def _motor_currents(f):
    return [int(0.06 * m * m) for m in f.reading.motor_pwm]  # some 2 A at hover


@_fills(Tag.ALTITUDE, "altitude_vision", "obs_x")
def _altitude(f):
    r = f.reading
    height_mm, up_mm_s = 1e3 * r.altitude_m, -1e3 * r.velocity_m_s[2]
    raw_mm, felt_g = int(1e3 * r.altitude_raw_m), -1e-3 * r.acceleration_mg[2] - 1.0
    return int(height_mm), up_mm_s, int(height_mm), raw_mm, felt_g, height_mm, height_mm, up_mm_s, 0.0


@_fills(Tag.ALTITUDE, "est_vb")
@_fills(Tag.VISION_RAW, "vision_tx_raw", "vision_ty_raw")
def _level_velocity(f):
    return 1e3 * f.reading.velocity_m_s[0], 1e3 * f.reading.velocity_m_s[1]


@_fills(Tag.VISION_OF, "of_dx", "of_dy")
def _vision_of(f):
    r = f.reading
    scale = _FLOW_PIXELS / max(0.1, r.altitude_m)
    return [scale * r.velocity_m_s[0]] * 5 + [scale * r.velocity_m_s[1]] * 5


@_fills(Tag.VISION, "theta_capture", "body_v")
def _vision(f):
    r = f.reading
    vx, vy, vz = r.velocity_m_s
    attitude_rad = r.pitch_deg * _RAD, r.roll_deg * _RAD, r.yaw_deg * _RAD
    return *attitude_rad, int(1e3 * r.altitude_m), seconds_to_time(f.time_s), 1e3 * vx, 1e3 * vy, 1e3 * vz


@_fills(Tag.WATCHDOG, "watchdog")
def _watchdog(f):
    return (f.cycles & 0x7FFFFFFF,)


@_fills(Tag.VIDEO_STREAM, "frame_size", "atcmd_mean_ref_gap")
def _video_stream(f):
    return *f.picture, f.ref_sequence, int(f.ref_gap_ms)


@_fills(Tag.PRESSURE_RAW, "up", "Pression_meas")
def _pressure_raw(f):
    pressure = int(f.reading.pressure_pa)
    return pressure // 3, 29000, TEMPERATURE_TENTHS_C, pressure  # up, ut: uncalibrated, of plausible size


@_fills(Tag.MAGNETO, "mx", "mz")
def _magneto(f):
    x, y, z = f.reading.magnetic_mg
    return [_int16(value / _MAGNETOMETER_MG_PER_LSB) for value in (y, x, z)]


@_fills(Tag.MAGNETO, "magneto_raw", "magneto_rectified")
def _field(f):
    return *f.reading.magnetic_mg, *f.reading.magnetic_mg


@_fills(Tag.MAGNETO, "heading_unwrapped", "heading_fusion_unwrapped")
def _headings(f):
    return [f.reading.heading_unwrapped_deg] * 3


@_fills(Tag.WIND_SPEED, "state_x1", "state_x2")
def _wind_speed(f):
    return f.reading.velocity_m_s[:2]


@_fills(Tag.KALMAN_PRESSURE, "offset_pressure", "est_zdot")
def _kalman_pressure(f):
    r = f.reading
    return r.pressure_pa, 1e3 * r.altitude_m, -1e3 * r.velocity_m_s[2]


def _constants(source):
    """{tag: fields} that stay as they are while the configuration does."""
    return {
        Tag.DEMO: {"detection_camera_type": _uint32(source.get("detect:detect_type"))},
        Tag.RAW_MEASURES: {"nb_echo": 1},
        Tag.PHYS_MEASURES: {
            "accs_temp": 0.1 * TEMPERATURE_TENTHS_C,
            "gyro_temp": TEMPERATURE_TENTHS_C,
            "alim3V3": 3300,
            "vrefEpson": 1500,
            "vrefIDG": 1350,
        },
        Tag.GYROS_OFFSETS: {"offset_g": source.sensors.gyro_offsets_deg_s},
        Tag.PWM: {"sat_motor%d" % k: _MOTOR_LIMIT for k in (1, 2, 3, 4)},
        Tag.VISION: {"vision_state": 2},
        Tag.VIDEO_STREAM: {"desired_bitrate": _uint32(source.get("video:bitrate"))},
        Tag.MAGNETO: {"magneto_calibration_ok": 1, "magneto_state": 2, "magneto_radius": 500.0},
    }


class NavdataWriter:
    """Packets with a fixed set of options.

    tags: options in wire order, none for bootstrap packets.  source: has sensors (ArdroneSensors) and get(key), the
    typed configuration; it is read once, so build a new writer when the configuration changes.
    """

    def __init__(self, tags, source):
        self._encoder = NavdataEncoder(tags)
        self.has_options = bool(tags)  # False for a bootstrap packet, which needs no Frame
        constants = _constants(source)
        for tag in tags:
            self._encoder.put(tag, **constants.get(tag, {}))
        self._runs = [
            (self._encoder.slot(tag, first, last), values) for tag in tags for first, last, values in _RUNS.get(tag, ())
        ]

    def packet(self, frame, state_bits, sequence):
        """The packet as bytes; frame may be None when has_options is False."""
        for write, values in self._runs:
            write(*values(frame))
        return self._encoder.finish(state_bits, sequence, vision_defined=int(self.has_options))
