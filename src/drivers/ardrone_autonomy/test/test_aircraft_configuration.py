import re

import pytest

from ardrone_autonomy import aircraft_configuration
from ardrone_autonomy.aircraft_configuration import setup_writes, wanted_texts

# The names that the original driver's manual lists.
BARE_NAMES = re.findall(
    r"\w+",
    """
altitude altitude_max altitude_min ardrone_name autonomous_flight bitrate bitrate_ctrl_mode bitrate_storage codec_fps
com_watchdog control_iphone_tilt control_level control_vz_max control_yaw detect_type detections_select_h
detections_select_v detections_select_v_hsync enemy_colors enemy_without_shell euler_angle_max flight_anim
flight_without_shell flying_mode groundstripe_colors hovering_range indoor_euler_angle_max indoor_control_vz_max
indoor_control_yaw outdoor_euler_angle_max outdoor_control_vz_max outdoor_control_yaw latitude leds_anim longitude
manual_trim max_bitrate max_size navdata_demo navdata_options nb_files outdoor output owner_mac ssid_multi_player
ssid_single_player travelling_enable travelling_mode ultrasound_freq ultrasound_watchdog userbox_cmd video_channel
video_codec video_enable video_file_index video_live_socket video_on_usb video_slices vision_enable wifi_mode wifi_rate
""",
)

# Appendix C of the thesis, one of its three aircraft.
APPENDIX_C = {
    "outdoor": 0,
    "flight_without_shell": 0,
    "altitude_max": 3000,
    "altitude_min": 50,
    "euler_angle_max": 0.349066,
    "control_vz_max": 1000,
    "control_yaw": 0.349066,
    "detect_type": 10,
    "detections_select_h": 32,
    "detections_select_v_hsync": 128,
    "detections": 3,
    "enemy_colors": 3,
    "enemy_without_shell": 0,
}
ALWAYS = {"navdata_demo": "FALSE", "max_bitrate": "4000", "navdata_options": "268435455", "com_watchdog": "1"}


def test_the_parameters_are_those_of_the_original():
    assert set(aircraft_configuration.WRITABLE_KEYS) == set(BARE_NAMES)


def test_without_parameters_only_the_drivers_own_values_are_written():
    assert wanted_texts({}) == ALWAYS


def test_every_parameter_is_written_although_it_equals_the_sdks_default():
    assert wanted_texts(APPENDIX_C) == dict(
        ALWAYS,
        outdoor="FALSE",
        flight_without_shell="FALSE",
        altitude_max="3000",
        altitude_min="50",
        euler_angle_max="0.349066",
        control_vz_max="1000.000000",
        control_yaw="0.349066",
        detect_type="10",
        detections_select_h="32",
        detections_select_v_hsync="128",
        enemy_colors="3",
        enemy_without_shell="0",
    )
    assert wanted_texts({"max_bitrate": 1000, "video_channel": 0}) == dict(
        ALWAYS, max_bitrate="1000", video_channel="0"
    )


def test_numbers_are_cast_to_the_kind_of_the_key():
    texts = wanted_texts(
        {
            "altitude_max": 2500.9,
            "outdoor": 1,
            "navdata_demo": 1,
            "control_yaw": "2.5",
            "video_channel": True,
            "ardrone_name": 7,
        }
    )
    assert (texts["altitude_max"], texts["outdoor"], texts["navdata_demo"]) == ("2500", "TRUE", "TRUE")
    assert (texts["control_yaw"], texts["video_channel"], texts["ardrone_name"]) == ("2.500000", "1", "7")


def test_long_strings_are_cut():
    assert wanted_texts({"ardrone_name": "x" * 500})["ardrone_name"] == "x" * 127


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("altitude_max", "high"),
        ("altitude_max", float("nan")),
        ("euler_angle_max", float("inf")),
        ("outdoor", [1]),
        ("ssid_single_player", 'a"b'),
        ("ardrone_name", "dr\u00f6ne"),
        ("control_yaw", {}),
    ],
)
def test_bad_values_are_named(name, value):
    with pytest.raises(ValueError, match="~" + name):
        wanted_texts({name: value})


def test_order_of_the_writes():
    texts = wanted_texts(dict(APPENDIX_C, outdoor=1, altitude_max=2000, com_watchdog=3))
    keys = [key for key, _ in setup_writes(texts, "00c0ffee")]
    assert keys[0] == "general:navdata_demo"
    outdoor = keys.index("control:outdoor")
    assert keys[outdoor - 1] == "custom:application_desc"  # nothing of ours comes before it
    user_keys = [keys.index("control:" + name) for name in ("euler_angle_max", "control_vz_max", "control_yaw")]
    common_keys = [
        keys.index("general:com_watchdog"),
        keys.index("control:altitude_max"),
        keys.index("detect:enemy_colors"),
    ]
    assert outdoor < min(common_keys) < max(common_keys) < min(user_keys)


def test_old_profiles_are_deleted_before_ours_are_made():
    writes = setup_writes(wanted_texts({}), "00c0ffee")
    ids = [write for write in writes if write[0] in ("custom:session_id", "custom:profile_id", "custom:application_id")]
    assert ids == [
        ("custom:session_id", "-all"),
        ("custom:profile_id", "-cea48d22"),
        ("custom:application_id", "-e182b69b"),
        ("custom:session_id", "00c0ffee"),
        ("custom:profile_id", "cea48d22"),
        ("custom:application_id", "e182b69b"),
    ]
