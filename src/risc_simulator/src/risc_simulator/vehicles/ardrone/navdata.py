"""Fills the options of an AR.Drone's navdata packet from the readings of its sensors, fast enough for 200 Hz.

What has no counterpart in the virtual lab (detections, trackers, wind, USB recording, satellite positions) stays zero.
"""

import math
from typing import Any, NamedTuple

from ardrone_autonomy.protocol.navdata import CHECKSUM_OPTION, CHECKSUM_TAG, HEADER, NavdataError, Tag, peek
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
    """All values that a packet is made of."""

    reading: Reading
    time_s: float  # since boot
    ctrl_state: int  # major << 16 | minor
    sticks: Any  # last obeyed Sticks
    command: tuple[float, float, float, float]  # in force: roll [rad], pitch [rad], climb [m/s], yaw rate [rad/s]
    ref_sequence: int
    ref_gap_ms: float
    cycles: int
    picture: tuple[int, int]  # bytes and number of the newest one; none are made while no client watches
    trim_deg: tuple[float, float]  # roll, pitch


def repeated(told, packet):
    """A packet of navdata with the content of the first one of its length, which `told` (a dict) keeps.

    It keeps its own sequence number and gets a valid checksum. Other data is returned unchanged.
    """
    try:
        header = peek(packet)
    except NavdataError:
        return packet
    first = told.setdefault(("navdata", len(packet)), packet)
    body = bytearray(first[: -CHECKSUM_OPTION.size])
    HEADER.pack_into(body, 0, *peek(first)._replace(sequence=header.sequence))
    return bytes(body) + CHECKSUM_OPTION.pack(CHECKSUM_TAG, CHECKSUM_OPTION.size, sum(body) & 0xFFFFFFFF)


def _uint32(value):
    """A configured number, limited: a client may write any."""
    return min(2**32 - 1, max(0, value))


def _uint16(value):
    return min(65535, max(0, int(value)))


def _int16(value):
    return min(32767, max(-32768, int(value)))


def _rotation(roll_deg, pitch_deg, yaw_deg):
    """The nine numbers of a rotation matrix from body to level axes, row by row."""
    sf, cf = math.sin(roll_deg * _RAD), math.cos(roll_deg * _RAD)
    st, ct = math.sin(pitch_deg * _RAD), math.cos(pitch_deg * _RAD)
    sp, cp = math.sin(yaw_deg * _RAD), math.cos(yaw_deg * _RAD)
    north = ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp
    east = ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp
    return *north, *east, -st, sf * ct, cf * ct


def _runs(f):
    """Runs of fields that change from packet to packet: (tag, first field, last field, their numbers) of each."""
    r, s, k = f.reading, f.sticks, _GYRO_LSB_PER_DEG_S
    vx, vy, vz = (1e3 * value for value in r.velocity_m_s)
    height_mm, raw_mm, pressure = 1e3 * r.altitude_m, 1e3 * r.altitude_raw_m, int(r.pressure_pa)
    attitude_rad = r.pitch_deg * _RAD, r.roll_deg * _RAD, r.yaw_deg * _RAD
    attitude_mdeg = 1e3 * r.pitch_deg, 1e3 * r.roll_deg, 1e3 * r.yaw_deg
    roll, pitch, climb, yaw_rate = f.command
    wanted_mdeg = int(1e3 * pitch / _RAD), int(1e3 * roll / _RAD)
    turn_mdeg_s = int(1e3 * yaw_rate / _RAD)
    time = seconds_to_time(f.time_s)
    p_lsb, q_lsb, r_lsb = (k * rate for rate in r.rates_deg_s)
    gyros = _int16(p_lsb), _int16(q_lsb), _int16(r_lsb), _int16(4.0 * p_lsb), _int16(4.0 * q_lsb)
    accelerometers = [
        _uint16(_ACCELEROMETER_ZERO + scale * a) for scale, a in zip(_ACCELEROMETER_LSB_PER_MG, r.acceleration_mg)
    ]
    magnetic_x, magnetic_y, magnetic_z = r.magnetic_mg
    magnetometers = [_int16(value / _MAGNETOMETER_MG_PER_LSB) for value in (magnetic_y, magnetic_x, magnetic_z)]
    flow = _FLOW_PIXELS / max(0.1, r.altitude_m)
    felt_g = -1e-3 * r.acceleration_mg[2] - 1.0
    trim_rad = [value * _RAD for value in reversed(f.trim_deg)]
    return (
        (Tag.DEMO, "ctrl_state", "vz", (f.ctrl_state, int(r.battery_pct), *attitude_mdeg, int(height_mm), vx, vy, vz)),
        (Tag.DEMO, "drone_camera_rot", "drone_camera_rot", _rotation(r.roll_deg, r.pitch_deg, r.turned_deg)),
        (Tag.DEMO, "drone_camera_trans", "drone_camera_trans", (1e3 * r.way_m[0], 1e3 * r.way_m[1], -raw_mm)),
        (Tag.TIME, "time", "time", (time,)),
        (Tag.RAW_MEASURES, "raw_accs", "vbat_raw", (*accelerometers, *gyros, int(r.battery_mv))),
        (Tag.RAW_MEASURES, "us_distance_echo", "us_distance_echo", (_uint16(raw_mm),)),
        (Tag.RAW_MEASURES, "alt_temp_raw", "alt_temp_raw", (int(raw_mm),)),
        (Tag.PHYS_MEASURES, "phys_accs", "phys_gyros", (*r.acceleration_mg, *r.rates_deg_s)),
        (Tag.EULER_ANGLES, "theta_a", "phi_a", attitude_mdeg[:2]),
        (
            *(Tag.REFERENCES, "ref_theta", "ref_psi"),
            (*wanted_mdeg, 0, 0, *wanted_mdeg, turn_mdeg_s, int(attitude_mdeg[2])),
        ),
        (
            *(Tag.REFERENCES, "ui_time", "ui_seq"),
            (s.time_s, s.pitch, s.roll, s.yaw, s.psi_accuracy, s.sequence & 0x7FFFFFFF),
        ),
        (Tag.TRIMS, "angular_rates_trim_r", "euler_angles_trim_phi", (0.0, *trim_rad)),
        (Tag.RC_REFERENCES, "rc_ref_pitch", "rc_ref_gaz", (*wanted_mdeg, turn_mdeg_s, int(1e3 * climb))),
        (Tag.PWM, "motor1", "motor4", r.motor_pwm),
        (Tag.PWM, "vz_ref", "vz_ref", (1e3 * climb,)),
        (Tag.PWM, "current_motor1", "current_motor4", [int(0.06 * m * m) for m in r.motor_pwm]),  # some 2 A at hover
        (
            *(Tag.ALTITUDE, "altitude_vision", "obs_x"),
            (int(height_mm), -vz, int(height_mm), int(raw_mm), felt_g, height_mm, height_mm, -vz, 0.0),
        ),
        (Tag.ALTITUDE, "est_vb", "est_vb", (vx, vy)),
        (Tag.VISION_RAW, "vision_tx_raw", "vision_ty_raw", (vx, vy)),
        (Tag.VISION_OF, "of_dx", "of_dx", [flow * r.velocity_m_s[0]] * 5),
        (Tag.VISION_OF, "of_dy", "of_dy", [flow * r.velocity_m_s[1]] * 5),
        (Tag.VISION, "theta_capture", "body_v", (*attitude_rad, int(height_mm), time, vx, vy, vz)),
        (Tag.WATCHDOG, "watchdog", "watchdog", (f.cycles & 0x7FFFFFFF,)),
        (Tag.VIDEO_STREAM, "frame_size", "atcmd_mean_ref_gap", (*f.picture, f.ref_sequence, int(f.ref_gap_ms))),
        # up, ut: uncalibrated, of plausible size
        (Tag.PRESSURE_RAW, "up", "Pression_meas", (pressure // 3, 29000, TEMPERATURE_TENTHS_C, pressure)),
        (Tag.MAGNETO, "mx", "mz", magnetometers),
        (Tag.MAGNETO, "magneto_raw", "magneto_rectified", (*r.magnetic_mg, *r.magnetic_mg)),
        (Tag.MAGNETO, "heading_unwrapped", "heading_fusion_unwrapped", [r.heading_unwrapped_deg] * 3),
        (Tag.WIND_SPEED, "state_x1", "state_x2", r.velocity_m_s[:2]),
        (Tag.KALMAN_PRESSURE, "offset_pressure", "est_zdot", (r.pressure_pa, height_mm, -vz)),
    )


def _constants(source):
    """{tag: fields} that change only with the configuration."""
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
        self._encoder, self._tags = NavdataEncoder(tags), tags
        self.has_options = bool(tags)  # False for a bootstrap packet, which needs no Frame
        constants = _constants(source)
        for tag in tags:
            self._encoder.put(tag, **constants.get(tag, {}))
        self._slots = None  # functions that write the runs, in their order; None for an option that is not sent

    def packet(self, frame, state_bits, sequence):
        """The packet as bytes; frame may be None when has_options is False."""
        if self.has_options:
            runs = _runs(frame)
            if self._slots is None:
                slot, tags = self._encoder.slot, self._tags
                self._slots = [slot(tag, first, last) if tag in tags else None for tag, first, last, _ in runs]
            for write, (_, _, _, numbers) in zip(self._slots, runs):
                if write is not None:
                    write(*numbers)
        return self._encoder.finish(state_bits, sequence, vision_defined=int(self.has_options))
