"""The definitions never change: bags and nodes of the original driver carry these sums."""

import pathlib

import pytest
import roslib.message

PACKAGE_DIR = pathlib.Path(__file__).resolve().parent.parent
MSG_DIR = PACKAGE_DIR / "msg"
SRV_DIR = PACKAGE_DIR / "srv"

# As published with ardrone_autonomy 1.3.1 to 1.4.1.
MESSAGE_MD5SUMS = {
    "Navdata": "e1169f766234363125ac62c9a3f87eeb",
    "navdata_demo": "5f569653293c884e2ea43f113057d0ea",
    "navdata_time": "8642a5656fdcc9310938a1807c46d608",
    "navdata_raw_measures": "4da7145c7478d1eb84be4d5fa4acd9ca",
    "navdata_phys_measures": "649dd469618f5ff313f6bceab2c356b7",
    "navdata_gyros_offsets": "c1f7c76e172c058c98de03cda79060d4",
    "navdata_euler_angles": "ce675f5dfa1b9c65f4844f2311d307aa",
    "navdata_references": "263b844b053f4a098c75c1c26a452911",
    "navdata_trims": "71133941ec04f0892b7754f7e7191d05",
    "navdata_rc_references": "57eebe7ce3b678ed3cfbdcf4646ffe93",
    "navdata_pwm": "6369e637a869960c68d7de5c2e10d6b1",
    "navdata_altitude": "f0fd1fd20697e6083c6bc3a308a260dc",
    "navdata_vision_raw": "a656de33995320e1ee5a84370378836e",
    "navdata_vision_of": "76d31747173a842fbf71db03104edecd",
    "navdata_vision": "55dd9a6c13917332d6d39025ed1318ab",
    "navdata_vision_perf": "5ed8267a2e2980a430a3439af8e5c9f7",
    "navdata_trackers_send": "77326ae58ca7691bcd2f23425242a70e",
    "navdata_vision_detect": "ab5f6b8c66aead58358d45a7c2dce7f6",
    "navdata_watchdog": "9e64269f1f5e463ea4f48c395e917507",
    "navdata_adc_data_frame": "403dbf67522d768c3f509d9614c23941",
    "navdata_video_stream": "caf560356d435eb563ce5b9e8278da00",
    "navdata_games": "3b3ea3628a5ac44a2ed78d3ac0c1cf49",
    "navdata_pressure_raw": "bee798af5d1297cfcb39217d797b8d90",
    "navdata_magneto": "c256b1c1d1ff0cb12a13c36720b3e224",
    "navdata_wind_speed": "2cc5c1e9675c330dd38261e958a136d3",
    "navdata_kalman_pressure": "70734b6caff0fb7ea6fc88ffeea5cde5",
    "navdata_hdvideo_stream": "1ba321578916df95f899ca2f5348f234",
    "navdata_wifi": "f88a3241b15d1e7b20ce9d8673bac09a",
    "navdata_zimmu_3000": "ae43ce2a4ef6cf0002f177f8265000bc",
    "vector21": "ff8d7d66dd3e4b731ef14a45d38888b6",
    "vector31": "cc153912f1453b708d221682bc23d9ac",
    "matrix33": "d6abfd8481fcb7c359a8d5d9388fa257",
}
SERVICE_MD5SUMS = {
    "CamSelect": "bbeb5212f8ee1d6da7ff0d1169124280",
    "FlightAnim": "b67c0059d7339761bcde13f61a58763f",
    "LedAnim": "0447d1620f8ba70a5b1fc2d89e406549",
    "RecordEnable": "29d58f387352c15c4e4f5763022ae875",
}


@pytest.mark.parametrize("name", sorted(MESSAGE_MD5SUMS))
def test_message_is_that_of_the_original(name):
    assert roslib.message.get_message_class("ardrone_autonomy/" + name)._md5sum == MESSAGE_MD5SUMS[name]


@pytest.mark.parametrize("name", sorted(SERVICE_MD5SUMS))
def test_service_is_that_of_the_original(name):
    assert roslib.message.get_service_class("ardrone_autonomy/" + name)._md5sum == SERVICE_MD5SUMS[name]


def test_no_definition_is_missing_or_added():
    assert {path.stem for path in MSG_DIR.glob("*")} == set(MESSAGE_MD5SUMS)
    assert {path.stem for path in SRV_DIR.glob("*")} == set(SERVICE_MD5SUMS)


@pytest.mark.parametrize("path", sorted([*MSG_DIR.glob("*.msg"), *SRV_DIR.glob("*.srv")]), ids=lambda path: path.stem)
def test_every_field_is_commented(path):
    for line in path.read_text().splitlines():
        if line and line != "---" and not line.startswith("#"):
            _, _, comment = line.partition("#")
            assert comment.strip(), "no comment: " + line
