"""Fills the options of an AR.Drone's navdata packet from the readings of its sensors, fast enough for 200 Hz.

Every option has one builder: it takes the encoder's slots once and returns the function that writes the option.
What has no counterpart in the virtual lab (detections, trackers, wind, USB recording, satellite positions) stays zero.
"""

import math

from ardrone_autonomy.protocol.navdata import Tag
from risc_simulator.vehicles.ardrone.sensors import TEMPERATURE_TENTHS_C
from risc_simulator.vehicles.ardrone.wire import NavdataEncoder, seconds_to_time

_RAD = math.pi / 180.0
_ACCELEROMETER_ZERO = 2048
_ACCELEROMETER_LSB_PER_MG = 0.512, 0.512, -0.512  # real captures: above the middle on z where acc z is -1000 mg
_MAGNETOMETER_MG_PER_LSB = -3.5  # as in real captures, where x and y are exchanged, too
_MOTOR_LIMIT = 255  # sat_motor
_GYRO_LSB_PER_DEG_S = 16.4
_FLOW_PIXELS = 200.0 / 60.0  # pixels a picture for 1 m/s at 1 m height


class Frame:
    """All that a packet is made of.

    reading: Reading.   time_s: since boot.   ctrl_state: major << 16 | minor.   sticks: last obeyed Sticks.
    command: (roll [rad], pitch [rad], climb [m/s], yaw rate [rad/s]) in force.
    picture: bytes and number of the newest one, of those that were made because somebody watches.
    """

    __slots__ = (
        "reading",
        "time_s",
        "ctrl_state",
        "sticks",
        "command",
        "ref_sequence",
        "ref_gap_ms",
        "cycles",
        "picture",
    )


def _demo(encoder, host):
    write = encoder.slot(Tag.DEMO, "ctrl_state", "vz")
    write_camera = encoder.slot(Tag.DEMO, "drone_camera_rot", "drone_camera_trans")
    encoder.put(Tag.DEMO, detection_camera_type=_uint32(host.get("detect:detect_type")))

    def fill(f):
        r = f.reading
        vx, vy, vz = r.velocity_m_s
        write(
            f.ctrl_state,
            int(r.battery_pct),
            1e3 * r.pitch_deg,
            1e3 * r.roll_deg,
            1e3 * r.yaw_deg,
            int(1e3 * r.altitude_m),
            1e3 * vx,
            1e3 * vy,
            1e3 * vz,
        )
        sf, cf = math.sin(r.roll_deg * _RAD), math.cos(r.roll_deg * _RAD)
        st, ct = math.sin(r.pitch_deg * _RAD), math.cos(r.pitch_deg * _RAD)
        sp, cp = math.sin(r.turned_deg * _RAD), math.cos(r.turned_deg * _RAD)
        write_camera(
            ct * cp,
            sf * st * cp - cf * sp,
            cf * st * cp + sf * sp,
            ct * sp,
            sf * st * sp + cf * cp,
            cf * st * sp - sf * cp,
            -st,
            sf * ct,
            cf * ct,
            1e3 * r.way_m[0],
            1e3 * r.way_m[1],
            -1e3 * r.altitude_raw_m,
        )

    return fill


def _time(encoder, _):
    write = encoder.slot(Tag.TIME, "time")
    return lambda f: write(seconds_to_time(f.time_s))


def _uint32(value):
    """A configured number, whatever a client wrote."""
    return min(2**32 - 1, max(0, value))


def _uint16(value):
    return min(65535, max(0, int(value)))


def _int16(value):
    return min(32767, max(-32768, int(value)))


def _raw_measures(encoder, _):
    write = encoder.slot(Tag.RAW_MEASURES, "raw_accs", "vbat_raw")
    write_echo = encoder.slot(Tag.RAW_MEASURES, "us_distance_echo")
    write_altitude = encoder.slot(Tag.RAW_MEASURES, "alt_temp_raw")
    encoder.put(Tag.RAW_MEASURES, nb_echo=1)

    def fill(f):
        r = f.reading
        ax, ay, az = (
            _uint16(_ACCELEROMETER_ZERO + lsb_per_mg * a)
            for lsb_per_mg, a in zip(_ACCELEROMETER_LSB_PER_MG, r.acceleration_mg)
        )
        p, q, s = r.rates_deg_s
        k = _GYRO_LSB_PER_DEG_S
        write(
            ax,
            ay,
            az,
            _int16(k * p),
            _int16(k * q),
            _int16(k * s),
            _int16(4.0 * k * p),
            _int16(4.0 * k * q),
            int(r.battery_mv),
        )
        write_echo(_uint16(1e3 * r.altitude_raw_m))
        write_altitude(int(1e3 * r.altitude_raw_m))

    return fill


def _phys_measures(encoder, _):
    write = encoder.slot(Tag.PHYS_MEASURES, "phys_accs", "phys_gyros")
    encoder.put(
        Tag.PHYS_MEASURES,
        accs_temp=0.1 * TEMPERATURE_TENTHS_C,
        gyro_temp=TEMPERATURE_TENTHS_C,
        alim3V3=3300,
        vrefEpson=1500,
        vrefIDG=1350,
    )

    def fill(f):
        write(*f.reading.acceleration_mg, *f.reading.rates_deg_s)

    return fill


def _gyros_offsets(encoder, host):
    encoder.put(Tag.GYROS_OFFSETS, offset_g=host.sensors.gyro_offsets_deg_s)


def _euler_angles(encoder, _):
    write = encoder.slot(Tag.EULER_ANGLES, "theta_a", "phi_a")
    return lambda f: write(1e3 * f.reading.pitch_deg, 1e3 * f.reading.roll_deg)


def _references(encoder, _):
    write = encoder.slot(Tag.REFERENCES, "ref_theta", "ref_psi")
    write_ui = encoder.slot(Tag.REFERENCES, "ui_time", "ui_seq")

    def fill(f):
        roll, pitch, _, yaw_rate = f.command
        theta, phi = int(1e3 * pitch / _RAD), int(1e3 * roll / _RAD)
        write(theta, phi, 0, 0, theta, phi, int(1e3 * yaw_rate / _RAD), int(1e3 * f.reading.yaw_deg))
        s = f.sticks
        write_ui(s.time_s, s.pitch, s.roll, s.yaw, s.psi_accuracy, s.sequence & 0x7FFFFFFF)

    return fill


def _trims(encoder, host):
    write = encoder.slot(Tag.TRIMS, "angular_rates_trim_r", "euler_angles_trim_phi")

    def fill(_):
        roll_deg, pitch_deg = host.sensors.trim_deg
        write(0.0, pitch_deg * _RAD, roll_deg * _RAD)

    return fill


def _rc_references(encoder, _):
    write = encoder.slot(Tag.RC_REFERENCES, "rc_ref_pitch", "rc_ref_gaz")

    def fill(f):
        roll, pitch, climb, yaw_rate = f.command
        write(int(1e3 * pitch / _RAD), int(1e3 * roll / _RAD), int(1e3 * yaw_rate / _RAD), int(1e3 * climb))

    return fill


def _pwm(encoder, _):
    write = encoder.slot(Tag.PWM, "motor1", "motor4")
    write_gaz = encoder.slot(Tag.PWM, "vz_ref")
    write_current = encoder.slot(Tag.PWM, "current_motor1", "current_motor4")
    encoder.put(Tag.PWM, **{"sat_motor%d" % k: _MOTOR_LIMIT for k in (1, 2, 3, 4)})

    def fill(f):
        motors = f.reading.motor_pwm
        write(*motors)
        write_gaz(1e3 * f.command[2])
        write_current(*[int(0.06 * m * m) for m in motors])  # some 2 A at hover

    return fill


def _altitude(encoder, _):
    write = encoder.slot(Tag.ALTITUDE, "altitude_vision", "obs_x")
    write_velocity = encoder.slot(Tag.ALTITUDE, "est_vb")

    def fill(f):
        r = f.reading
        vx, vy, vz = r.velocity_m_s
        height_mm = 1e3 * r.altitude_m
        write(
            int(height_mm),
            -1e3 * vz,
            int(height_mm),
            int(1e3 * r.altitude_raw_m),
            -1e-3 * r.acceleration_mg[2] - 1.0,
            height_mm,
            height_mm,
            -1e3 * vz,
            0.0,
        )
        write_velocity(1e3 * vx, 1e3 * vy)

    return fill


def _vision_raw(encoder, _):
    write = encoder.slot(Tag.VISION_RAW, "vision_tx_raw", "vision_ty_raw")
    return lambda f: write(1e3 * f.reading.velocity_m_s[0], 1e3 * f.reading.velocity_m_s[1])


def _vision_of(encoder, _):
    write = encoder.slot(Tag.VISION_OF, "of_dx", "of_dy")

    def fill(f):
        r = f.reading
        scale = _FLOW_PIXELS / max(0.1, r.altitude_m)
        dx, dy = scale * r.velocity_m_s[0], scale * r.velocity_m_s[1]
        write(dx, dx, dx, dx, dx, dy, dy, dy, dy, dy)

    return fill


def _vision(encoder, _):
    write = encoder.slot(Tag.VISION, "theta_capture", "body_v")
    encoder.put(Tag.VISION, vision_state=2)

    def fill(f):
        r = f.reading
        vx, vy, vz = r.velocity_m_s
        write(
            r.pitch_deg * _RAD,
            r.roll_deg * _RAD,
            r.yaw_deg * _RAD,
            int(1e3 * r.altitude_m),
            seconds_to_time(f.time_s),
            1e3 * vx,
            1e3 * vy,
            1e3 * vz,
        )

    return fill


def _watchdog(encoder, _):
    write = encoder.slot(Tag.WATCHDOG, "watchdog")
    return lambda f: write(f.cycles & 0x7FFFFFFF)


def _video_stream(encoder, host):
    write = encoder.slot(Tag.VIDEO_STREAM, "frame_size", "atcmd_mean_ref_gap")
    encoder.put(Tag.VIDEO_STREAM, desired_bitrate=_uint32(host.get("video:bitrate")))
    return lambda f: write(*f.picture, f.ref_sequence, int(f.ref_gap_ms))


def _pressure_raw(encoder, _):
    write = encoder.slot(Tag.PRESSURE_RAW, "up", "Pression_meas")

    def fill(f):
        pressure = int(f.reading.pressure_pa)
        write(pressure // 3, 29000, TEMPERATURE_TENTHS_C, pressure)  # up, ut: uncalibrated, of plausible size

    return fill


def _magneto(encoder, _):
    write = encoder.slot(Tag.MAGNETO, "mx", "mz")
    write_field = encoder.slot(Tag.MAGNETO, "magneto_raw", "magneto_rectified")
    write_heading = encoder.slot(Tag.MAGNETO, "heading_unwrapped", "heading_fusion_unwrapped")
    encoder.put(Tag.MAGNETO, magneto_calibration_ok=1, magneto_state=2, magneto_radius=500.0)

    def fill(f):
        r = f.reading
        x, y, z = r.magnetic_mg
        write(*[_int16(value / _MAGNETOMETER_MG_PER_LSB) for value in (y, x, z)])
        write_field(x, y, z, x, y, z)
        heading = r.heading_unwrapped_deg
        write_heading(heading, heading, heading)

    return fill


def _wind_speed(encoder, _):
    write = encoder.slot(Tag.WIND_SPEED, "state_x1", "state_x2")
    return lambda f: write(f.reading.velocity_m_s[0], f.reading.velocity_m_s[1])


def _kalman_pressure(encoder, _):
    write = encoder.slot(Tag.KALMAN_PRESSURE, "offset_pressure", "est_zdot")

    def fill(f):
        r = f.reading
        write(r.pressure_pa, 1e3 * r.altitude_m, -1e3 * r.velocity_m_s[2])

    return fill


# Options that are not here are sent with all fields zero, as on a vehicle that has nothing to say there.
_BUILDERS = {
    Tag.DEMO: _demo,
    Tag.TIME: _time,
    Tag.RAW_MEASURES: _raw_measures,
    Tag.PHYS_MEASURES: _phys_measures,
    Tag.GYROS_OFFSETS: _gyros_offsets,
    Tag.EULER_ANGLES: _euler_angles,
    Tag.REFERENCES: _references,
    Tag.TRIMS: _trims,
    Tag.RC_REFERENCES: _rc_references,
    Tag.PWM: _pwm,
    Tag.ALTITUDE: _altitude,
    Tag.VISION_RAW: _vision_raw,
    Tag.VISION_OF: _vision_of,
    Tag.VISION: _vision,
    Tag.WATCHDOG: _watchdog,
    Tag.VIDEO_STREAM: _video_stream,
    Tag.PRESSURE_RAW: _pressure_raw,
    Tag.MAGNETO: _magneto,
    Tag.WIND_SPEED: _wind_speed,
    Tag.KALMAN_PRESSURE: _kalman_pressure,
}


class NavdataWriter:
    """Packets with a fixed set of options.

    tags: options in wire order, none for bootstrap packets.  source: has sensors (ArdroneSensors) and get(key), the
    typed configuration; it is read once, so build a new writer when the configuration changes.
    """

    def __init__(self, tags, source):
        self._encoder = NavdataEncoder(tags)
        fills = [_BUILDERS[tag](self._encoder, source) for tag in tags if tag in _BUILDERS]
        self._fills = [fill for fill in fills if fill is not None]

    @property
    def has_options(self):
        """False for a bootstrap packet, which needs no Frame."""
        return bool(self._encoder.tags)

    def packet(self, frame, state_bits, sequence):
        """The packet as bytes; frame may be None when has_options is False."""
        for fill in self._fills:
            fill(frame)
        return self._encoder.finish(state_bits, sequence, vision_defined=int(self.has_options))
