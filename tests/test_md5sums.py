"""The definitions of others never change: bags and nodes of the originals carry these sums."""

import pathlib

import pytest
import roslib.message

SRC = pathlib.Path(__file__).resolve().parents[1] / "src"
FOLDERS = {"risc_msgs": "risc_msgs", "ardrone_autonomy": "drivers/ardrone_autonomy", "roscopter": "drivers/roscopter"}
MESSAGES = {
    "risc_msgs": {  # computed with genmsg from the original release's definitions
        "Angle": "be95d8b52b2e16e0138b2b3779cd930f",
        "Angles": "9dd576705f18c801e12e4a78c9c66088",
        "Control": "006e11d00572e1d052feb2e4f190b45f",
        "Controls": "5fa2036879cc2f7d0c75bc2dc1639156",
        "Cortex": "ace87fb5cb38f4ed182a1466180c255e",
        "Landmark": "2edff07075d48378c13052415416989c",
        "Landmarks": "e9a4316d2f24284f65cb567c9ba0ce46",
        "Mocap_data": "4aa5a955bf007c7b2e0835be10fbfbd4",
        "Mocap_marker": "4a842b65f413084dc2b10fb484ea7f17",
        "Mocap_markers": "00f6d3da8c0240d68d028bf339d9a65f",
        "Observed_angles": "8b371119782f9b738e9c6225d8efba1c",
        "Observed_rois": "8173f98bffabff1f99aee7f14dbf861e",
        "Pen_with_cov": "ff4830a3e9858442f40e95367727974c",
        "Risc_roi": "09e4af56af7b1197f305e2925faf4927",
        "Risc_rois": "f66579dedd062ccc57f1aced22cbbd3a",
        "States": "8271f59b5179794f309908101ca21e03",
        "Trajectories": "aea5153d61f2124cab4812ac4763db8c",
        "Trajectory": "5bb19cf770231c9b18a409040fde64c0",
        "Waypoint": "c0027f92b0acc03e6886dd3a0b948e52",
        "Waypoints": "28fbf348f14b39c66bdb32d0c92bb26c",
    },
    "ardrone_autonomy": {  # as published with 1.3.1 to 1.4.1
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
    },
    "roscopter": {
        "Attitude": "a0ed90d05663fe955b3f4e85f83050df",
        "Control": "f2b64ccef8f731e7d5b721d65f7d91ec",
        "ControllerOutput": "14e8f32f6dc13cd7db7fdae805a6677b",
        "CurrentMission": "deaf93654547b1e516f7011234618190",
        "FilteredPosition": "c085fbfb9542cd7c5704f043b5e23e5c",
        "Mavlink_RAW_IMU": "f00561d290c2da804223c20d12427677",
        "MissionItem": "a4eec5db18601d2affa66a99457a442d",
        "RC": "a40d8c478f8d8fdeb5a2f988302e5696",
        "State": "78271f1d5e63aa48bd71dc911f0524f1",
        "Status": "44bba29061029309cd51365dfdec8bae",
        "VFR_HUD": "d675e2b95b45d51cd67453c819986216",
        "Waypoint": "6dac49f8cf4308a151d9b97deaca8a40",
        "WaypointList": "55f6e3d4649782ff855bc4699f0b61df",
    },
}
SERVICES = {
    "ardrone_autonomy": {
        "CamSelect": "bbeb5212f8ee1d6da7ff0d1169124280",
        "FlightAnim": "b67c0059d7339761bcde13f61a58763f",
        "LedAnim": "0447d1620f8ba70a5b1fc2d89e406549",
        "RecordEnable": "29d58f387352c15c4e4f5763022ae875",
    },
    "roscopter": {
        "APMCommand": "a0da65f8b813c6736761742ef711a1d1",
        "SendWaypoint": "e5f60840a7c8257ef80f2e79965e13d9",
        "SendWaypointList": "9944296f2443b43e549ac358efe7dae8",
        "XBEECommand": "4092736087ba4328fa7dc96a85fda7a6",
    },
}
MESSAGE_SUMS = {"%s/%s" % (package, name): total for package, sums in MESSAGES.items() for name, total in sums.items()}
SERVICE_SUMS = {"%s/%s" % (package, name): total for package, sums in SERVICES.items() for name, total in sums.items()}
FILES = [
    path for folder in FOLDERS.values() for kind in ("msg", "srv") for path in sorted((SRC / folder / kind).glob("*"))
]


@pytest.mark.parametrize("name", MESSAGE_SUMS)
def test_a_message_is_that_of_the_original(name):
    assert roslib.message.get_message_class(name)._md5sum == MESSAGE_SUMS[name]


@pytest.mark.parametrize("name", SERVICE_SUMS)
def test_a_service_is_that_of_the_original(name):
    assert roslib.message.get_service_class(name)._md5sum == SERVICE_SUMS[name]


@pytest.mark.parametrize("package", FOLDERS)
def test_none_is_missing_or_added(package):
    for kind, table in (("msg", MESSAGES), ("srv", SERVICES)):
        assert {path.stem for path in (SRC / FOLDERS[package] / kind).glob("*")} == set(table.get(package, ()))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_field_is_commented(path):
    for line in path.read_text().splitlines():
        field, _, comment = line.partition("#")
        if field.strip(" -") and "=" not in field:  # constants explain themselves
            assert comment.strip(), "no comment: " + line
