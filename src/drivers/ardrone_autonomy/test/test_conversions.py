"""Navdata -> messages: 1, 2, 3 pushed through every axis."""

import io
import math

import numpy as np
import pytest

pytest.importorskip("ardrone_autonomy.msg", reason="the messages are not generated: build and source the workspace")

from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from ardrone_autonomy.protocol.navdata import ALL_TAGS, LAYOUTS, Navdata, Tag
from ardrone_autonomy.ros import conversions
from ardrone_autonomy.ros.params import OPTION_NAMES
from risc_simulator.vehicles.ardrone.wire import NavdataEncoder

COVARIANCES = ((1.0,) * 9, (2.0,) * 9, (3.0,) * 9)


def packet(tags=ALL_TAGS, gps=False, **options):
    encoder = NavdataEncoder(tags, gps=gps)
    for name, fields in options.items():
        encoder.put(Tag[name.upper()], **fields)
    return Navdata(encoder.finish(0, 1))


def convert(**options):
    return conversions.navdata_message(packet(**options), Header(frame_id="base"))


def test_attitude_velocity_and_battery():
    message = convert(
        demo={
            "ctrl_state": 4 << 16 | 8,
            "vbat_flying_percentage": 61,
            "phi": 1000.0,
            "theta": 2000.0,
            "psi": 3000.0,
            "altitude": 450,
            "vx": 1.0,
            "vy": 2.0,
            "vz": 3.0,
        }
    )
    assert (message.rotX, message.rotY, message.rotZ) == pytest.approx((1.0, -2.0, -3.0))
    assert (message.vx, message.vy, message.vz) == (1.0, -2.0, -3.0)
    assert (message.state, message.batteryPercent, message.altd) == (4, 61.0, 450)
    assert message.header.frame_id == "base"


def test_sensors():
    message = convert(
        phys_measures={"phys_accs": (1000.0, 2000.0, 3000.0)},
        magneto={"mx": 1, "my": 2, "mz": 3},
        pressure_raw={"Pression_meas": 101325, "Temperature_meas": 312},
        pwm={"motor1": 1, "motor2": 2, "motor3": 3, "motor4": 4},
        wind_speed={"wind_speed": 1.0, "wind_angle": 2.0, "wind_compensation_theta": 9.0, "wind_compensation_phi": 3.0},
        time={"time": 7 << 21 | 13},
    )
    assert (message.ax, message.ay, message.az) == pytest.approx((1.0, -2.0, -3.0))
    assert (message.magX, message.magY, message.magZ) == (1, 2, 3)
    assert (message.pressure, message.temp) == (101325, 312)
    assert (message.motor1, message.motor2, message.motor3, message.motor4) == (1, 2, 3, 4)
    assert (message.wind_speed, message.wind_angle, message.wind_comp_angle) == (1.0, 2.0, 3.0)
    assert message.tm == 7000013.0


def test_tag_arrays_have_the_length_of_the_count():
    fours = dict.fromkeys(("type", "xc", "yc", "width", "height", "dist", "orientation_angle"), (1, 2, 3, 4))
    message = convert(vision_detect=dict(fours, nb_detected=2))
    arrays = [
        getattr(message, "tags_" + name) for name in ("type", "xc", "yc", "width", "height", "orientation", "distance")
    ]
    assert message.tags_count == 2
    assert [list(array) for array in arrays] == [[1, 2]] * 7
    assert convert(vision_detect=dict(fours, nb_detected=99)).tags_count == 4


def test_reduced_telemetry_leaves_the_rest_zero():
    message = conversions.navdata_message(packet(tags=[Tag.DEMO], demo={"phi": 1000.0}), Header())
    assert (message.rotX, message.az, message.tm, message.tags_count) == (1.0, 0.0, 0.0, 0)
    message.serialize(io.BytesIO())


def test_imu():
    data = packet(
        demo={"phi": 10e3, "theta": 20e3, "psi": 30e3},
        phys_measures={"phys_accs": (1000.0, 2000.0, 3000.0), "phys_gyros": (1.0, 2.0, 3.0)},
    )
    imu = conversions.imu_message(data, conversions.navdata_message(data, Header(frame_id="base")), COVARIANCES)
    acceleration, rate, q = imu.linear_acceleration, imu.angular_velocity, imu.orientation
    assert (acceleration.x, acceleration.y, acceleration.z) == pytest.approx((9.8, -19.6, -29.4))
    assert (rate.x, rate.y, rate.z) == pytest.approx(tuple(map(math.radians, (1.0, -2.0, -3.0))))
    np.testing.assert_allclose(
        Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("ZYX", degrees=True), (-30.0, -20.0, 10.0), atol=1e-5
    )
    assert (
        imu.linear_acceleration_covariance,
        imu.angular_velocity_covariance,
        imu.orientation_covariance,
    ) == COVARIANCES
    assert imu.header.frame_id == "base"


def test_mag_has_unit_length_and_is_not_made_of_nothing():
    mag = conversions.mag_message(convert(magneto={"mx": 2, "my": 3, "mz": -6}))
    assert (mag.vector.x, mag.vector.y, mag.vector.z) == pytest.approx((2 / 7, 3 / 7, -6 / 7))
    assert conversions.mag_message(convert()) is None


@pytest.mark.parametrize(
    ("camera", "forward", "right"),
    [
        (conversions.FRONT_CAMERA, (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),  # looks along x of the vehicle
        (conversions.BOTTOM_CAMERA, (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),  # looks down
    ],
)
def test_camera_frames_are_optical(camera, forward, right):
    q = conversions.camera_transform("base", "camera", camera).transform.rotation
    rotation = Rotation.from_quat([q.x, q.y, q.z, q.w])
    np.testing.assert_allclose(rotation.apply([0.0, 0.0, 1.0]), forward, atol=1e-12)
    np.testing.assert_allclose(rotation.apply([1.0, 0.0, 0.0]), right, atol=1e-12)


@pytest.mark.parametrize("name", OPTION_NAMES)
def test_selective_messages_carry_the_wire_values(name):
    tag = Tag[name.upper()]
    layout = LAYOUTS[tag]
    number = 0
    sent = {}
    for field in layout.fields:
        numbers = tuple(range(number + 1, number + 1 + field.count))
        sent[field.name] = numbers if field.count > 1 else numbers[0]
        number += field.count
    data = packet(**{name: sent})
    message = conversions.OptionConverter(name).convert(data, Header(frame_id="base"))
    assert (message.header.frame_id, message.tag, message.size) == ("base", int(tag), data.size_of(tag))
    for field in message.__slots__[4:]:
        assert flat(getattr(message, field)) == flat(sent[field]), field
    message.serialize(io.BytesIO())


def flat(value):
    """Numbers of a field in order, with nested messages flattened."""
    if hasattr(value, "__slots__") and hasattr(value, "_md5sum"):
        return [getattr(value, name) for name in value.__slots__]
    if isinstance(value, (list, tuple, bytes)):
        return [number for item in value for number in flat(item)]
    return [value]


def test_drone_time_is_in_seconds():
    message = conversions.OptionConverter("wifi").convert(packet(time={"time": 3 << 21 | 250000}), Header())
    assert message.drone_time == pytest.approx(3.25)


def test_options_that_are_not_there_give_no_message():
    assert conversions.OptionConverter("wifi").convert(packet(tags=[Tag.DEMO]), Header()) is None
    assert conversions.OptionConverter("zimmu_3000").convert(packet(gps=True), Header()) is None
