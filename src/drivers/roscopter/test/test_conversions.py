"""Each field of each topic, in the units of the original. The values: scripted_autopilot.TELEMETRY."""

from types import SimpleNamespace

import pytest

pytest.importorskip("roscopter.msg", reason="the messages are not generated: build and source the workspace")

import genpy  # noqa: E402
from bench import Bench  # noqa: E402
from pymavlink.dialects.v20 import ardupilotmega as mavlink  # noqa: E402

from roscopter import msg  # noqa: E402
from roscopter.msg import Waypoint  # noqa: E402
from roscopter.options import Options  # noqa: E402
from roscopter.ros import conversions  # noqa: E402
from roscopter.ros.missions import mission_items  # noqa: E402

STAMP = genpy.Time(12, 34)


@pytest.fixture(scope="module", params=[1, 2], ids=["MAVLink 1", "MAVLink 2"])
def telemetry(request):
    bench = Bench(request.param).connect().run(5.0)
    return {message.get_type(): message for message in bench.messages}


def values(message):
    return [getattr(message, name) for name in message.__slots__ if name != "header"]


def test_gps(telemetry):
    fix = conversions.gps(telemetry["GPS_RAW_INT"], STAMP)
    assert (fix.header.stamp, fix.header.frame_id) == (STAMP, "base_link")
    assert (fix.latitude, fix.longitude, fix.altitude) == pytest.approx((41.75, -111.81, 1400.25))
    assert (fix.status.status, fix.position_covariance_type) == (0, 1)
    spread = ((3.04 * 1.2**2) ** 2 + 3.57**2) ** 0.5
    assert fix.position_covariance == pytest.approx([spread, 0, 0, 0, spread, 0, 0, 0, spread])


def test_gps_without_a_fix():
    message = SimpleNamespace(lat=0, lon=0, alt=0, fix_type=2, eph=65535)
    fix = conversions.gps(message, STAMP)
    assert (fix.status.status, fix.position_covariance_type) == (-1, 0)


def test_rc(telemetry):
    for name in {"RC_CHANNELS", "RC_CHANNELS_RAW"} & set(telemetry):
        assert conversions.rc(telemetry[name], STAMP).channel == [1500, 1500, 1000, 1500, 1000, 1000, 1500, 1500]


def test_status(telemetry):
    status = conversions.status(telemetry["SYS_STATUS"], STAMP)
    assert status.header.stamp == STAMP
    assert values(status) == [11800, 1234, 87, 0x80000001]


def test_a_voltage_beyond_the_field_is_its_end():
    known = {"onboard_control_sensors_enabled": 0, "current_battery": -1, "battery_remaining": -1}
    assert conversions.status(SimpleNamespace(voltage_battery=65535, **known), STAMP).battery_voltage == 32767


def test_filtered_position(telemetry):
    made = conversions.filtered_position(telemetry["GLOBAL_POSITION_INT"], STAMP)
    assert made.header.stamp == STAMP
    assert values(made) == [417500001, -1118100002, 1400300, 1500, 10, -20, 30, 27000]


def test_raw_imu(telemetry):
    made = conversions.raw_imu(telemetry["RAW_IMU"], STAMP)
    assert values(made) == [123456789, 1, -2, -1000, 4, -5, 6, 7, -8, 9]


def test_same_fields(telemetry):
    attitude = conversions.same_fields(msg.Attitude)(telemetry["ATTITUDE"], STAMP)
    assert values(attitude) == pytest.approx([0.1, -0.2, 3.0, 0.4, -0.5, 0.6])
    hud = conversions.same_fields(msg.VFR_HUD)(telemetry["VFR_HUD"], STAMP)
    assert values(hud) == [1.0, 2.0, 270, 42, 1400.0, -0.5]


def test_navigation_and_mission(telemetry):
    navigation = telemetry["NAV_CONTROLLER_OUTPUT"]
    assert values(conversions.controller_output(navigation, STAMP)) == [1.5, -2.5, -30, 0.5, -0.25, 2.0]
    current = telemetry["MISSION_CURRENT"]
    assert values(conversions.current_mission(current, navigation, STAMP)) == [3, 12, 45]
    assert values(conversions.current_mission(current, None, STAMP)) == [3, 0, 0]


@pytest.mark.parametrize("is_int", [True, False])
def test_mission_item(is_int):
    kind = mavlink.MAVLink_mission_item_int_message if is_int else mavlink.MAVLink_mission_item_message
    scale = 1e7 if is_int else 1
    message = kind(255, 0, 4, 3, 16, 1, 1, 2.0, 3.0, 4.0, 90.0, int(41 * scale), int(-111 * scale), 8.0)
    made = conversions.mission_item(message, STAMP)
    assert values(made) == pytest.approx([4, 1, 1, 3.0, 2.0, 4.0, 90.0, 41.0, -111.0, 8.0])


@pytest.mark.parametrize(
    "base_mode, mode, expected",
    [
        (81, 0, [False, False, "STABILIZE"]),
        (209, 9, [True, False, "LAND"]),
        (217, 4, [True, True, "GUIDED"]),
    ],
)
def test_state(base_mode, mode, expected):
    heartbeat = SimpleNamespace(base_mode=base_mode, custom_mode=mode)
    assert values(conversions.state(heartbeat, "ArduCopter")) == expected


def test_every_message_can_be_sent(telemetry):
    """Each value fits its field: genpy checks when it packs."""
    import io

    for made in (
        conversions.gps(telemetry["GPS_RAW_INT"], STAMP),
        conversions.status(telemetry["SYS_STATUS"], STAMP),
        conversions.filtered_position(telemetry["GLOBAL_POSITION_INT"], STAMP),
        conversions.raw_imu(telemetry["RAW_IMU"], STAMP),
        conversions.same_fields(msg.VFR_HUD)(telemetry["VFR_HUD"], STAMP),
        conversions.controller_output(telemetry["NAV_CONTROLLER_OUTPUT"], STAMP),
    ):
        made._check_types()
        made.serialize(io.BytesIO())


# ------------------------------------------------------------------------------------------------------- waypoints


def waypoint(**fields):
    known = {"latitude": 417500000, "longitude": -1118100000, "altitude": 8000, "waypoint_type": Waypoint.TYPE_NAV}
    return Waypoint(**{**known, **fields})


def test_a_place_to_fly_to():
    (item,) = mission_items([waypoint(pos_acc=2500, hold_time=3000, yaw_from=90000)], Options())
    assert item.command == mavlink.MAV_CMD_NAV_WAYPOINT
    assert (item.param1, item.param2, item.param4, item.altitude_m) == (3.0, 2.5, 90.0, 8.0)
    assert (item.latitude, item.longitude) == (417500000, -1118100000)


def test_the_other_types():
    kinds = (Waypoint.TYPE_TAKEOFF, Waypoint.TYPE_CONDITION_CHANGE_ALT, Waypoint.TYPE_CONDITION_YAW)
    up, change, turn = mission_items([waypoint(waypoint_type=kind, yaw_from=-90000) for kind in kinds], Options())
    assert (up.command, up.altitude_m) == (mavlink.MAV_CMD_NAV_TAKEOFF, 8.0)
    assert (change.command, change.altitude_m) == (mavlink.MAV_CMD_CONDITION_CHANGE_ALT, 8.0)
    assert (turn.command, turn.param1) == (mavlink.MAV_CMD_CONDITION_YAW, 270.0)


@pytest.mark.parametrize(
    "fields, said",
    [
        ({"altitude": 4999}, "5000 .. 50000 mm"),
        ({"altitude": 50001}, "5000 .. 50000 mm"),
        ({"latitude": 900_000_001}, "latitude 900000001,"),
        ({"longitude": -1_800_000_001}, "longitude -1800000001 "),
        ({"waypoint_type": 9}, "type 9"),
    ],
)
def test_a_waypoint_that_is_not_possible_is_named(fields, said):
    with pytest.raises(ValueError, match="waypoint 2: .*" + said):
        mission_items([waypoint(), waypoint(**fields)], Options())
