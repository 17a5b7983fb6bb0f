"""Navdata: telemetry packets from the aircraft, UDP port 5554.

A packet is a 16-byte header (magic, state bits, sequence, vision_defined), then options (uint16 tag, uint16 size
*including these four bytes*, payload; packed), then always the checksum option: the plain sum of all bytes before it.

One table (`LAYOUTS`) describes every option; the virtual aircraft (risc_simulator) encodes by it.  Field names, order
and units are those of the aircraft (and of the navdata_* messages of the ROS driver): axes x nose, y right, z down;
milli-degrees, mm, mm/s.

Reading: `peek` reads the header only (about a microsecond); `Navdata` finds the options, verifies the checksum and
decodes an option only when asked.  Options are read by their own size field: the unknown end of a longer option is
ignored, unknown tags are skipped, a size of 0 ends the packet.  All errors are NavdataError.
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
    """A datagram that is not a valid navdata packet."""


# State bits of the header, from 1 << 0 on.
State = IntFlag(
    "State",
    "FLYING VIDEO_ENABLED VISION_ENABLED ANGULAR_RATE_CONTROL ALTITUDE_CONTROL USER_START "
    "COMMAND_ACK "  # a CONFIG or CTRL was received
    "CAMERA_READY TRAVELLING USB_READY NAVDATA_DEMO "
    "BOOTSTRAP "  # no options are sent
    "MOTOR_PROBLEM COM_LOST SOFTWARE_FAULT BATTERY_LOW USER_EMERGENCY_LANDING TIMER_ELAPSED MAGNETO_UNCALIBRATED "
    "ANGLES_OUT_OF_RANGE WIND ULTRASOUND_DEAF CUTOUT PIC_VERSION_OK AT_THREAD NAVDATA_THREAD VIDEO_THREAD "
    "ACQUISITION_THREAD CONTROL_LATE ADC_LATE "
    "COM_WATCHDOG "  # no command for 50 ms: answer with COMWDG
    "EMERGENCY",
)

# Option tags. 27 is gps on firmware 2.4 and zimmu_3000 on earlier ones, distinguished by size.
Tag = IntEnum(
    "Tag",
    "DEMO TIME RAW_MEASURES PHYS_MEASURES GYROS_OFFSETS EULER_ANGLES REFERENCES TRIMS RC_REFERENCES PWM ALTITUDE "
    "VISION_RAW VISION_OF VISION VISION_PERF TRACKERS_SEND VISION_DETECT WATCHDOG ADC_DATA_FRAME VIDEO_STREAM GAMES "
    "PRESSURE_RAW MAGNETO WIND_SPEED KALMAN_PRESSURE HDVIDEO_STREAM WIFI ZIMMU_3000",
    start=0,
)
ALL_TAGS = tuple(map(int, Tag))

ALL_OPTIONS_MASK = (1 << len(ALL_TAGS)) - 1  # general:navdata_options, "everything"
DEFAULT_OPTIONS_MASK = 1 << Tag.DEMO | 1 << Tag.VISION_DETECT  # 0x10001

# High 16 bits of demo.ctrl_state.
ControlState = IntEnum(
    "ControlState", "DEFAULT INIT LANDED FLYING HOVERING TEST TAKING_OFF GOTO_FIX LANDING LOOPING", start=0
)


# --- layouts -----------------------------------------------------------------------------------------------------
# One field: struct code, number of elements (1: a scalar, else a tuple), byte offset after tag and size.
Field = namedtuple("Field", "name code count offset")


class Layout:
    """One option: its fields in wire order and the value type with the same field names.

    Options grow at their end between firmware versions: fields after the bar "|" may be absent and then read 0.
    """

    def __init__(self, name, spec):
        self.name = name
        self.fields = ()
        self._ends = []  # end offset of each field [bytes]
        self._places = []  # of each field among the numbers of the struct: an index or a slice
        offset = elements = 0
        for item in spec.replace("|", "").split():
            field_name, kind = item.split(":")
            count = int(kind[:-1] or 1)
            self.fields += (Field(field_name, kind[-1], count, offset),)
            self._places.append(elements if count == 1 else slice(elements, elements + count))
            offset += struct.calcsize("<" + kind)
            elements += count
            self._ends.append(offset)
        self.required_bytes = self._ends[len(spec.partition("|")[0].split()) - 1]
        self.index = {field.name: i for i, field in enumerate(self.fields)}
        self.size = OPTION_HEADER.size + offset  # as on the wire
        self.value_type = namedtuple(name, self.index)
        self._struct = struct.Struct("<" + "".join("%d%s" % (field.count, field.code) for field in self.fields))

    def unpack(self, payload):
        """Decode an option from its bytes after tag and size; NavdataError when required fields are missing."""
        if len(payload) < self.required_bytes:
            raise NavdataError(
                "navdata option %s has %d bytes, at least %d are needed"
                % (self.name, len(payload) + 4, self.required_bytes + 4)
            )
        if len(payload) < self._struct.size:
            whole = max(end for end in self._ends if end <= len(payload))  # drops an incomplete field
            payload = payload[:whole].ljust(self._struct.size, b"\0")
        flat = self._struct.unpack_from(payload)
        return self.value_type._make([flat[place] for place in self._places])


# "name:kind", kind = struct code with an optional count in front.  Units in the comments; unmarked = raw numbers.
_LAYOUTS = (
    # theta, phi, psi: mdeg (+ nose up, + right side down, + clockwise from above); altitude: mm; v: mm/s, levelled body
    # drone_camera_rot: from body axes to those of the start, row by row; drone_camera_trans: mm from the start, z down
    Layout(
        "demo",
        "ctrl_state:I vbat_flying_percentage:I theta:f phi:f psi:f altitude:i vx:f vy:f vz:f | num_frames:I "
        "detection_camera_rot:9f detection_camera_trans:3f detection_tag_index:I detection_camera_type:I "
        "drone_camera_rot:9f drone_camera_trans:3f",
    ),
    Layout("time", "time:I"),  # see time_to_seconds
    Layout(
        "raw_measures",  # accs: counts around 2048, z grows upwards; vbat_raw: mV; alt_temp_raw: mm
        "raw_accs:3H raw_gyros:3h raw_gyros_110:2h vbat_raw:I us_debut_echo:H us_fin_echo:H us_association_echo:H "
        "us_distance_echo:H us_courbe_temps:H us_courbe_valeur:H us_courbe_ref:H flag_echo_ini:H nb_echo:H "
        "sum_echo:I alt_temp_raw:i | gradient:h",
    ),
    Layout(
        "phys_measures",  # accs: milli-g, -1000 on z at rest; gyros: deg/s
        "accs_temp:f gyro_temp:H phys_accs:3f phys_gyros:3f | alim3V3:I vrefEpson:I vrefIDG:I",
    ),
    Layout("gyros_offsets", "offset_g:3f"),
    Layout("euler_angles", "theta_a:f phi_a:f"),  # mdeg
    Layout(
        "references",
        "ref_theta:i ref_phi:i ref_theta_I:i ref_phi_I:i ref_pitch:i ref_roll:i ref_yaw:i ref_psi:i | vx_ref:f "
        "vy_ref:f theta_mod:f phi_mod:f k_v_x:f k_v_y:f k_mode:I ui_time:f ui_theta:f ui_phi:f ui_psi:f "
        "ui_psi_accuracy:f ui_seq:i",
    ),
    Layout("trims", "angular_rates_trim_r:f euler_angles_trim_theta:f euler_angles_trim_phi:f"),
    Layout("rc_references", "rc_ref_pitch:i rc_ref_roll:i rc_ref_yaw:i rc_ref_gaz:i rc_ref_ag:i"),
    Layout(
        "pwm",  # motors 0..255: front-left, clockwise; current: mA
        "motor1:B motor2:B motor3:B motor4:B | sat_motor1:B sat_motor2:B sat_motor3:B sat_motor4:B "
        "gaz_feed_forward:f gaz_altitude:f altitude_integral:f vz_ref:f u_pitch:i u_roll:i u_yaw:i yaw_u_I:f "
        "u_pitch_planif:i u_roll_planif:i u_yaw_planif:i u_gaz_planif:f current_motor1:H current_motor2:H "
        "current_motor3:H current_motor4:H altitude_prop:f altitude_der:f",
    ),
    Layout(
        "altitude",  # altitude_*: mm; altitude_vz: mm/s
        "altitude_vision:i altitude_vz:f altitude_ref:i altitude_raw:i | obs_accZ:f obs_alt:f obs_x:3f obs_state:I "
        "est_vb:2f est_state:I",
    ),
    Layout("vision_raw", "vision_tx_raw:f vision_ty_raw:f vision_tz_raw:f"),
    Layout("vision_of", "of_dx:5f of_dy:5f"),
    Layout(
        "vision",
        "vision_state:I vision_misc:i vision_phi_trim:f vision_phi_ref_prop:f vision_theta_trim:f "
        "vision_theta_ref_prop:f new_raw_picture:i theta_capture:f phi_capture:f psi_capture:f altitude_capture:i "
        "time_capture:I body_v:3f | delta_phi:f delta_theta:f delta_psi:f gold_defined:I gold_reset:I gold_x:f "
        "gold_y:f",
    ),
    Layout(
        "vision_perf",
        "time_szo:f time_corners:f time_compute:f time_tracking:f time_trans:f time_update:f | time_custom:20f",
    ),
    Layout("trackers_send", "locked:30i point:60i"),  # point: x0 y0 x1 y1 ...
    Layout(
        "vision_detect",  # only the first nb_detected of each four are valid; dist: cm
        "nb_detected:I type:4I xc:4I yc:4I width:4I height:4I dist:4I orientation_angle:4f | rotation:36f "
        "translation:12f camera_source:4I",
    ),
    Layout("watchdog", "watchdog:i"),
    Layout("adc_data_frame", "version:I data_frame:32B"),
    Layout(
        "video_stream",
        "quant:B frame_size:I frame_number:I | atcmd_ref_seq:I atcmd_mean_ref_gap:I atcmd_var_ref_gap:f "
        "atcmd_ref_quality:I out_bitrate:I desired_bitrate:I data1:i data2:i data3:i data4:i data5:i "
        "tcp_queue_level:I fifo_queue_level:I",
    ),
    Layout("games", "double_tap_counter:I finish_line_counter:I"),
    Layout("pressure_raw", "up:i ut:h Temperature_meas:i Pression_meas:i"),  # 0.1 deg C, Pa
    Layout(
        "magneto",  # mx..mz: counts of the sensor; fields: mG; headings: deg; unaligned after the uint8
        "mx:h my:h mz:h | magneto_raw:3f magneto_rectified:3f magneto_offset:3f heading_unwrapped:f "
        "heading_gyro_unwrapped:f heading_fusion_unwrapped:f magneto_calibration_ok:B magneto_state:I "
        "magneto_radius:f error_mean:f error_var:f",
    ),
    Layout(
        "wind_speed",  # m/s, rad
        "wind_speed:f wind_angle:f wind_compensation_theta:f wind_compensation_phi:f | state_x1:f state_x2:f "
        "state_x3:f state_x4:f state_x5:f state_x6:f magneto_debug1:f magneto_debug2:f magneto_debug3:f",
    ),
    Layout(
        "kalman_pressure",
        "offset_pressure:f est_z:f est_zdot:f | est_bias_PWM:f est_biais_pression:f offset_US:f prediction_US:f "
        "cov_alt:f cov_PWM:f cov_vitesse:f bool_effet_sol:i somme_inno:f flag_rejet_US:i u_multisinus:f "
        "gaz_altitude:f Flag_multisinus:i Flag_multisinus_debut:i",
    ),
    Layout(
        "hdvideo_stream",  # sizes in kB; remaining time in s
        "hdvideo_state:I | storage_fifo_nb_packets:I storage_fifo_size:I usbkey_size:I usbkey_freespace:I "
        "frame_number:I usbkey_remaining_time:I",
    ),
    Layout("wifi", "link_quality:I"),
    Layout("zimmu_3000", "vzimmuLSB:i vzfind:f"),
)

# Tag 27 on firmware 2.4; public clients agree only on the first fields of its 216 bytes.
GPS_LAYOUT = Layout("gps", "latitude:d longitude:d elevation:d | more:188B")

LAYOUTS = {int(Tag[layout.name.upper()]): layout for layout in _LAYOUTS}  # by tag


# --- time option -----------------------------------------------------------------------------------------------------
def time_to_seconds(time_raw):
    """Seconds since boot from the time option: top 11 bits seconds, low 21 bits microseconds; wraps after 2048 s."""
    return (time_raw >> 21) + (time_raw & 0x1FFFFF) * 1e-6


# --- reading ---------------------------------------------------------------------------------------------------------
Header = namedtuple("Header", "magic state sequence vision_defined")


def is_wake_up(data):
    """True for the datagram with which a client asks for navdata: 1 to 14 bytes, the first is 1 or 2."""
    return 0 < len(data) <= MAX_WAKE_UP_BYTES and data[0] in (1, 2)


def peek(data):
    """Return the header of a packet without reading the rest. NavdataError when it is too short or not navdata."""
    if len(data) < MIN_PACKET_BYTES:
        raise NavdataError("a navdata packet has at least %d bytes, got %d" % (MIN_PACKET_BYTES, len(data)))
    header = Header._make(HEADER.unpack_from(data))
    if header.magic not in (MAGIC, MAGIC_FLIGHT_RECORDER):
        raise NavdataError("not navdata: the first word is 0x%08x, not 0x%08x" % (header.magic, MAGIC))
    return header


class Navdata:
    """One received packet.

    data: bytes.  NavdataError when the packet is invalid: short, wrong magic, an option that reaches beyond the end, a
    checksum that is missing or wrong.  state: int of State bits.
    """

    def __init__(self, data):
        self.state = peek(data).state
        self._options = {}  # tag -> payload
        offset, end = HEADER.size, len(data)
        while offset + OPTION_HEADER.size <= end:
            tag, size = OPTION_HEADER.unpack_from(data, offset)
            if size == 0:
                break
            if size < OPTION_HEADER.size or offset + size > end:
                raise NavdataError(
                    "navdata option %d at byte %d claims %d bytes, the packet has %d" % (tag, offset, size, end)
                )
            if tag == CHECKSUM_TAG and size >= CHECKSUM_OPTION.size:
                stated = CHECKSUM_OPTION.unpack_from(data, offset)[2]
                actual = sum(memoryview(data)[:offset]) & 0xFFFFFFFF
                if stated != actual:
                    raise NavdataError("navdata checksum is %d, the bytes sum up to %d" % (stated, actual))
                return
            self._options.setdefault(tag, data[offset + OPTION_HEADER.size : offset + size])
            offset += size
        raise NavdataError("the navdata packet has no checksum")

    def size_of(self, tag):
        """Wire size of an option (its four header bytes included), None when absent."""
        payload = self._options.get(tag)
        return None if payload is None else len(payload) + OPTION_HEADER.size

    def option(self, tag):
        """Decoded option (namedtuple, see LAYOUTS), None when absent or unknown.

        NavdataError when the option is too short for its required fields.
        """
        payload = self._options.get(tag)
        if payload is None:
            return None
        layout = LAYOUTS.get(tag)
        if tag == Tag.ZIMMU_3000 and len(payload) >= GPS_LAYOUT.required_bytes:
            layout = GPS_LAYOUT
        return None if layout is None else layout.unpack(payload)
