"""Navdata: telemetry packets from the aircraft, UDP port 5554.

A packet is a 16-byte header (magic, state bits, sequence, vision_defined), then options (uint16 tag, uint16 size
*including these four bytes*, payload; packed), then always the checksum option: the plain sum of all bytes before it.

One table (`LAYOUTS`) describes every option; the virtual aircraft (risc_simulator) writes with it.  Field names, order
and units are those of the aircraft (and of the navdata_* messages of the ROS driver): axes x nose, y right, z down;
milli-degrees, mm, mm/s.

Reading: `peek` looks at the header only (about a microsecond); `Navdata` finds the options, verifies the checksum and
decodes an option only when asked.  Options are read by their own size: longer ones are read as far as they are known,
unknown tags are skipped, a size of 0 ends the packet.  All errors are NavdataError.
"""

import struct
from collections import namedtuple
from enum import IntEnum, IntFlag

MAGIC = 0x55667788
MAGIC_FLIGHT_RECORDER = 0x55667789  # seen on newer firmware

HEADER = struct.Struct("<IIII")
OPTION_HEADER = struct.Struct("<HH")
CHECKSUM_TAG = 0xFFFF
CHECKSUM_OPTION = struct.Struct("<HHI")
MIN_PACKET_BYTES = HEADER.size + CHECKSUM_OPTION.size  # a bootstrap packet

WAKE_UP = b"\x01\x00\x00\x00"  # unicast; 2 would ask for multicast
MAX_WAKE_UP_BYTES = 14

DEMO_PERIOD = 13  # a demo packet is every 13th cycle of the 200 Hz loop, about 15 Hz
FULL_RATE_HZ = 200.0


class NavdataError(ValueError):
    """A datagram that is not a sound navdata packet."""


class State(IntFlag):
    """State bits of the header."""

    FLYING = 1 << 0
    VIDEO_ENABLED = 1 << 1
    VISION_ENABLED = 1 << 2
    ANGULAR_RATE_CONTROL = 1 << 3  # 0: Euler angle control
    ALTITUDE_CONTROL = 1 << 4
    USER_START = 1 << 5
    COMMAND_ACK = 1 << 6  # a CONFIG or CTRL was received
    CAMERA_READY = 1 << 7
    TRAVELLING = 1 << 8
    USB_READY = 1 << 9
    NAVDATA_DEMO = 1 << 10
    BOOTSTRAP = 1 << 11  # no options are sent
    MOTOR_PROBLEM = 1 << 12
    COM_LOST = 1 << 13
    SOFTWARE_FAULT = 1 << 14
    BATTERY_LOW = 1 << 15
    USER_EMERGENCY_LANDING = 1 << 16
    TIMER_ELAPSED = 1 << 17
    MAGNETO_UNCALIBRATED = 1 << 18
    ANGLES_OUT_OF_RANGE = 1 << 19
    WIND = 1 << 20
    ULTRASOUND_DEAF = 1 << 21
    CUTOUT = 1 << 22
    PIC_VERSION_OK = 1 << 23
    AT_THREAD = 1 << 24
    NAVDATA_THREAD = 1 << 25
    VIDEO_THREAD = 1 << 26
    ACQUISITION_THREAD = 1 << 27
    CONTROL_LATE = 1 << 28
    ADC_LATE = 1 << 29
    COM_WATCHDOG = 1 << 30  # no command for 50 ms: answer with COMWDG
    EMERGENCY = 1 << 31


class Tag(IntEnum):
    """Option tags; 27 is `gps` on firmware 2.4 and `zimmu_3000` before, told apart by size."""

    DEMO = 0
    TIME = 1
    RAW_MEASURES = 2
    PHYS_MEASURES = 3
    GYROS_OFFSETS = 4
    EULER_ANGLES = 5
    REFERENCES = 6
    TRIMS = 7
    RC_REFERENCES = 8
    PWM = 9
    ALTITUDE = 10
    VISION_RAW = 11
    VISION_OF = 12
    VISION = 13
    VISION_PERF = 14
    TRACKERS_SEND = 15
    VISION_DETECT = 16
    WATCHDOG = 17
    ADC_DATA_FRAME = 18
    VIDEO_STREAM = 19
    GAMES = 20
    PRESSURE_RAW = 21
    MAGNETO = 22
    WIND_SPEED = 23
    KALMAN_PRESSURE = 24
    HDVIDEO_STREAM = 25
    WIFI = 26
    ZIMMU_3000 = 27
    GPS = 27


ALL_TAGS = tuple(range(28))
ALL_OPTIONS_MASK = (1 << 28) - 1  # general:navdata_options, "everything"
DEFAULT_OPTIONS_MASK = 1 << Tag.DEMO | 1 << Tag.VISION_DETECT  # 0x10001


class ControlState(IntEnum):
    """High 16 bits of demo.ctrl_state."""

    DEFAULT = 0
    INIT = 1
    LANDED = 2
    FLYING = 3
    HOVERING = 4
    TEST = 5
    TAKING_OFF = 6
    GOTO_FIX = 7
    LANDING = 8
    LOOPING = 9


# --- layouts -----------------------------------------------------------------------------------------------------
class Field(namedtuple("Field", "name code count offset")):
    """One field: struct code, number of elements (1: a scalar, else a tuple), byte offset behind tag and size."""

    __slots__ = ()


class Layout:
    """One option: its fields in wire order and the value type with the same field names.

    required: number of leading fields that must be there.  Options grow at their end between firmware versions, so
    the fields behind are allowed to be absent; absent fields read 0.
    """

    def __init__(self, tag, name, spec, required=None):
        self.tag = int(tag)
        self.name = name
        fields = []
        offset = 0
        for item in spec.split():
            field_name, _, kind = item.partition(":")
            count = int(kind[:-1] or 1)
            fields.append(Field(field_name, kind[-1], count, offset))
            offset += struct.calcsize("<" + kind)
        self.fields = tuple(fields)
        self.index = {f.name: i for i, f in enumerate(fields)}
        self.struct = struct.Struct("<" + "".join("%d%s" % (f.count, f.code) for f in fields))
        self.size = OPTION_HEADER.size + self.struct.size  # as on the wire
        needed = len(fields) if required is None else self.index[required] + 1
        last = fields[needed - 1]
        self.required_bytes = last.offset + struct.calcsize("<%d%s" % (last.count, last.code))
        self.value_type = namedtuple(name, [f.name for f in fields])
        # (start, stop) of each field in the flat tuple; None when every field is a scalar and no grouping is needed
        self._slices = None
        if any(f.count > 1 for f in fields):
            slices, at = [], 0
            for f in fields:
                slices.append((at, at + f.count, f.count > 1))
                at += f.count
            self._slices = tuple(slices)

    def unpack(self, data, offset, payload_bytes):
        """Value of the option whose payload starts at offset; NavdataError when required fields are missing."""
        if payload_bytes >= self.struct.size:
            flat = self.struct.unpack_from(data, offset)
        elif payload_bytes >= self.required_bytes:
            payload = bytearray(self.struct.size)
            whole = 0  # bytes of the last field that fits: half a field is worth nothing
            for f in self.fields:
                end = f.offset + struct.calcsize("<%d%s" % (f.count, f.code))
                if end <= payload_bytes:
                    whole = end
            payload[:whole] = data[offset : offset + whole]
            flat = self.struct.unpack(payload)
        else:
            raise NavdataError(
                "navdata option %s has %d bytes, at least %d are needed"
                % (self.name, payload_bytes + 4, self.required_bytes + 4)
            )
        if self._slices is None:
            return self.value_type._make(flat)
        return self.value_type._make([flat[a:b] if group else flat[a] for a, b, group in self._slices])


def _layout_table(*layouts):
    return {layout.tag: layout for layout in layouts}


# "name:kind", kind = struct code with an optional count in front.  Units in the comments; unmarked = raw numbers.
LAYOUTS = _layout_table(
    # theta, phi, psi: mdeg (+ nose up, + right side down, + clockwise from above); altitude: mm; v: mm/s, levelled body
    # drone_camera_rot: from body axes to those of the start, row by row; drone_camera_trans: mm from the start, z down
    Layout(
        Tag.DEMO,
        "demo",
        "ctrl_state:I vbat_flying_percentage:I theta:f phi:f psi:f altitude:i vx:f vy:f vz:f num_frames:I "
        "detection_camera_rot:9f detection_camera_trans:3f detection_tag_index:I detection_camera_type:I "
        "drone_camera_rot:9f drone_camera_trans:3f",
        required="vz",
    ),
    Layout(Tag.TIME, "time", "time:I"),  # see time_to_seconds
    Layout(
        Tag.RAW_MEASURES,
        "raw_measures",  # accs: counts around 2048, z grows upwards; vbat_raw: mV; alt_temp_raw: mm
        "raw_accs:3H raw_gyros:3h raw_gyros_110:2h vbat_raw:I us_debut_echo:H us_fin_echo:H us_association_echo:H "
        "us_distance_echo:H us_courbe_temps:H us_courbe_valeur:H us_courbe_ref:H flag_echo_ini:H nb_echo:H "
        "sum_echo:I alt_temp_raw:i gradient:h",
        required="alt_temp_raw",
    ),
    Layout(
        Tag.PHYS_MEASURES,
        "phys_measures",  # accs: milli-g, -1000 on z at rest; gyros: deg/s
        "accs_temp:f gyro_temp:H phys_accs:3f phys_gyros:3f alim3V3:I vrefEpson:I vrefIDG:I",
        required="phys_gyros",
    ),
    Layout(Tag.GYROS_OFFSETS, "gyros_offsets", "offset_g:3f"),
    Layout(Tag.EULER_ANGLES, "euler_angles", "theta_a:f phi_a:f"),  # mdeg
    Layout(
        Tag.REFERENCES,
        "references",
        "ref_theta:i ref_phi:i ref_theta_I:i ref_phi_I:i ref_pitch:i ref_roll:i ref_yaw:i ref_psi:i vx_ref:f "
        "vy_ref:f theta_mod:f phi_mod:f k_v_x:f k_v_y:f k_mode:I ui_time:f ui_theta:f ui_phi:f ui_psi:f "
        "ui_psi_accuracy:f ui_seq:i",
        required="ref_psi",
    ),
    Layout(Tag.TRIMS, "trims", "angular_rates_trim_r:f euler_angles_trim_theta:f euler_angles_trim_phi:f"),
    Layout(Tag.RC_REFERENCES, "rc_references", "rc_ref_pitch:i rc_ref_roll:i rc_ref_yaw:i rc_ref_gaz:i rc_ref_ag:i"),
    Layout(
        Tag.PWM,
        "pwm",  # motors 0..255: front-left, clockwise; current: mA
        "motor1:B motor2:B motor3:B motor4:B sat_motor1:B sat_motor2:B sat_motor3:B sat_motor4:B "
        "gaz_feed_forward:f gaz_altitude:f altitude_integral:f vz_ref:f u_pitch:i u_roll:i u_yaw:i yaw_u_I:f "
        "u_pitch_planif:i u_roll_planif:i u_yaw_planif:i u_gaz_planif:f current_motor1:H current_motor2:H "
        "current_motor3:H current_motor4:H altitude_prop:f altitude_der:f",
        required="motor4",
    ),
    Layout(
        Tag.ALTITUDE,
        "altitude",  # altitude_*: mm; altitude_vz: mm/s
        "altitude_vision:i altitude_vz:f altitude_ref:i altitude_raw:i obs_accZ:f obs_alt:f obs_x:3f obs_state:I "
        "est_vb:2f est_state:I",
        required="altitude_raw",
    ),
    Layout(Tag.VISION_RAW, "vision_raw", "vision_tx_raw:f vision_ty_raw:f vision_tz_raw:f"),
    Layout(Tag.VISION_OF, "vision_of", "of_dx:5f of_dy:5f"),
    Layout(
        Tag.VISION,
        "vision",
        "vision_state:I vision_misc:i vision_phi_trim:f vision_phi_ref_prop:f vision_theta_trim:f "
        "vision_theta_ref_prop:f new_raw_picture:i theta_capture:f phi_capture:f psi_capture:f altitude_capture:i "
        "time_capture:I body_v:3f delta_phi:f delta_theta:f delta_psi:f gold_defined:I gold_reset:I gold_x:f "
        "gold_y:f",
        required="body_v",
    ),
    Layout(
        Tag.VISION_PERF,
        "vision_perf",
        "time_szo:f time_corners:f time_compute:f time_tracking:f time_trans:f time_update:f time_custom:20f",
        required="time_update",
    ),
    Layout(Tag.TRACKERS_SEND, "trackers_send", "locked:30i point:60i"),  # point: x0 y0 x1 y1 ...
    Layout(
        Tag.VISION_DETECT,
        "vision_detect",  # only the first nb_detected of each four are valid; dist: cm
        "nb_detected:I type:4I xc:4I yc:4I width:4I height:4I dist:4I orientation_angle:4f rotation:36f "
        "translation:12f camera_source:4I",
        required="orientation_angle",
    ),
    Layout(Tag.WATCHDOG, "watchdog", "watchdog:i"),
    Layout(Tag.ADC_DATA_FRAME, "adc_data_frame", "version:I data_frame:32B"),
    Layout(
        Tag.VIDEO_STREAM,
        "video_stream",
        "quant:B frame_size:I frame_number:I atcmd_ref_seq:I atcmd_mean_ref_gap:I atcmd_var_ref_gap:f "
        "atcmd_ref_quality:I out_bitrate:I desired_bitrate:I data1:i data2:i data3:i data4:i data5:i "
        "tcp_queue_level:I fifo_queue_level:I",
        required="frame_number",
    ),
    Layout(Tag.GAMES, "games", "double_tap_counter:I finish_line_counter:I"),
    Layout(Tag.PRESSURE_RAW, "pressure_raw", "up:i ut:h Temperature_meas:i Pression_meas:i"),  # 0.1 deg C, Pa
    Layout(
        Tag.MAGNETO,
        "magneto",  # mx..mz: counts of the sensor; fields: mG; headings: deg; behind the uint8 all is unaligned
        "mx:h my:h mz:h magneto_raw:3f magneto_rectified:3f magneto_offset:3f heading_unwrapped:f "
        "heading_gyro_unwrapped:f heading_fusion_unwrapped:f magneto_calibration_ok:B magneto_state:I "
        "magneto_radius:f error_mean:f error_var:f",
        required="mz",
    ),
    Layout(
        Tag.WIND_SPEED,
        "wind_speed",  # m/s, rad
        "wind_speed:f wind_angle:f wind_compensation_theta:f wind_compensation_phi:f state_x1:f state_x2:f "
        "state_x3:f state_x4:f state_x5:f state_x6:f magneto_debug1:f magneto_debug2:f magneto_debug3:f",
        required="wind_compensation_phi",
    ),
    Layout(
        Tag.KALMAN_PRESSURE,
        "kalman_pressure",
        "offset_pressure:f est_z:f est_zdot:f est_bias_PWM:f est_biais_pression:f offset_US:f prediction_US:f "
        "cov_alt:f cov_PWM:f cov_vitesse:f bool_effet_sol:i somme_inno:f flag_rejet_US:i u_multisinus:f "
        "gaz_altitude:f Flag_multisinus:i Flag_multisinus_debut:i",
        required="est_zdot",
    ),
    Layout(
        Tag.HDVIDEO_STREAM,
        "hdvideo_stream",  # sizes in kB; remaining time in s
        "hdvideo_state:I storage_fifo_nb_packets:I storage_fifo_size:I usbkey_size:I usbkey_freespace:I "
        "frame_number:I usbkey_remaining_time:I",
        required="hdvideo_state",
    ),
    Layout(Tag.WIFI, "wifi", "link_quality:I"),
    Layout(Tag.ZIMMU_3000, "zimmu_3000", "vzimmuLSB:i vzfind:f"),
)

# Tag 27 on firmware 2.4.  Field list as public clients print it, types chosen to fill the 216 bytes seen on the wire.
GPS_LAYOUT = Layout(
    Tag.GPS,
    "gps",
    "latitude:d longitude:d elevation:d hdop:d data_available:i zero_validated:i wpt_validated:i lat0:d lon0:d "
    "lat_fuse:d lon_fuse:d gps_state:I x_traj:f x_ref:f y_traj:f y_ref:f theta_p:f phi_p:f theta_i:f phi_i:f "
    "theta_d:f phi_d:f vdop:d pdop:d speed:f last_frame_timestamp:I degree:f degree_mag:f ehpe:f ehve:f c_n0:f "
    "nb_satellites:I channels:24B gps_plugged:i ephemeris_status:I vx_traj:f vy_traj:f firmware_status:I",
    required="elevation",
)

TAG_BY_NAME = {layout.name: tag for tag, layout in LAYOUTS.items()}


def layout_of(tag, size):
    """Layout of an option with this tag and this wire size, None for an unknown tag."""
    if tag == Tag.GPS and size >= OPTION_HEADER.size + GPS_LAYOUT.required_bytes:
        return GPS_LAYOUT
    return LAYOUTS.get(tag)


# --- time option -----------------------------------------------------------------------------------------------------
def time_to_seconds(time_raw):
    """Seconds since boot of the time option: top 11 bits seconds, low 21 bits microseconds; wraps after 2048 s."""
    return (time_raw >> 21) + (time_raw & 0x1FFFFF) * 1e-6


# --- reading ---------------------------------------------------------------------------------------------------------
Header = namedtuple("Header", "magic state sequence vision_defined")


def is_wake_up(data):
    """True for the datagram with which a client asks for navdata: 1 to 14 bytes, the first is 1 or 2."""
    return 0 < len(data) <= MAX_WAKE_UP_BYTES and data[0] in (1, 2)


def peek(data):
    """Header of a packet without looking at the rest. NavdataError when it is too short or not navdata."""
    if len(data) < MIN_PACKET_BYTES:
        raise NavdataError("a navdata packet has at least %d bytes, got %d" % (MIN_PACKET_BYTES, len(data)))
    header = Header._make(HEADER.unpack_from(data))
    if header.magic not in (MAGIC, MAGIC_FLIGHT_RECORDER):
        raise NavdataError("not navdata: the first word is 0x%08x, not 0x%08x" % (header.magic, MAGIC))
    return header


def checksum(data):
    """Sum of all bytes mod 2**32."""
    return sum(data) & 0xFFFFFFFF


class Navdata:
    """One received packet.

    data: bytes.  NavdataError when the packet is unsound: short, wrong magic, an option that reaches beyond the end,
    or (with verify) a checksum that is missing or wrong.
    Attributes: state (int of State bits), sequence, vision_defined, header, tags (tuple, in wire order).
    """

    def __init__(self, data, verify=True):
        self.header = peek(data)
        self.state = self.header.state
        self.sequence = self.header.sequence
        self.vision_defined = self.header.vision_defined
        self._data = data
        self._options = options = {}  # tag -> (offset of the payload, payload bytes)
        offset, end = HEADER.size, len(data)
        found = None
        unpack = OPTION_HEADER.unpack_from
        while offset + 4 <= end:
            tag, size = unpack(data, offset)
            if size == 0:
                break
            if size < 4 or offset + size > end:
                raise NavdataError(
                    "navdata option %d at byte %d claims %d bytes, the packet has %d" % (tag, offset, size, end)
                )
            if tag == CHECKSUM_TAG:
                found = offset
                break
            options.setdefault(tag, (offset + 4, size - 4))
            offset += size
        if verify:
            if found is None or size < CHECKSUM_OPTION.size:
                raise NavdataError("the navdata packet has no checksum")
            stated = CHECKSUM_OPTION.unpack_from(data, found)[2]
            actual = checksum(memoryview(data)[:found])
            if stated != actual:
                raise NavdataError("navdata checksum is %d, the bytes sum up to %d" % (stated, actual))

    @property
    def tags(self):
        """Tags of the options of the packet, known or not, without the checksum."""
        return tuple(self._options)

    def __contains__(self, tag):
        return tag in self._options

    def size_of(self, tag):
        """Wire size of an option (its four header bytes included), None when absent."""
        span = self._options.get(tag)
        return None if span is None else span[1] + 4

    def payload(self, tag):
        """Raw bytes of an option behind tag and size, None when absent."""
        span = self._options.get(tag)
        return None if span is None else bytes(self._data[span[0] : span[0] + span[1]])

    def option(self, tag):
        """Decoded option (namedtuple, see LAYOUTS), None when absent or unknown.

        NavdataError when the option is too short for its required fields.
        """
        span = self._options.get(tag)
        if span is None:
            return None
        layout = layout_of(tag, span[1] + 4)
        return None if layout is None else layout.unpack(self._data, span[0], span[1])
