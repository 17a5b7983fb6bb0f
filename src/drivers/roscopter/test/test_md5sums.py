"""The definitions never change: bags and nodes of the original carry these sums."""

import pathlib

import pytest
import roslib.message

PACKAGE_DIR = pathlib.Path(__file__).resolve().parent.parent
MSG_DIR, SRV_DIR = PACKAGE_DIR / "msg", PACKAGE_DIR / "srv"

MESSAGE_MD5SUMS = {
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
}
SERVICE_MD5SUMS = {
    "APMCommand": "a0da65f8b813c6736761742ef711a1d1",
    "SendWaypoint": "e5f60840a7c8257ef80f2e79965e13d9",
    "SendWaypointList": "9944296f2443b43e549ac358efe7dae8",
    "XBEECommand": "4092736087ba4328fa7dc96a85fda7a6",
}


@pytest.mark.parametrize("name", sorted(MESSAGE_MD5SUMS))
def test_message_is_that_of_the_original(name):
    assert roslib.message.get_message_class("roscopter/" + name)._md5sum == MESSAGE_MD5SUMS[name]


@pytest.mark.parametrize("name", sorted(SERVICE_MD5SUMS))
def test_service_is_that_of_the_original(name):
    assert roslib.message.get_service_class("roscopter/" + name)._md5sum == SERVICE_MD5SUMS[name]


def test_no_definition_is_missing_or_added():
    assert {path.stem for path in MSG_DIR.glob("*")} == set(MESSAGE_MD5SUMS)
    assert {path.stem for path in SRV_DIR.glob("*")} == set(SERVICE_MD5SUMS)


@pytest.mark.parametrize("path", sorted([*MSG_DIR.glob("*.msg"), *SRV_DIR.glob("*.srv")]), ids=lambda path: path.stem)
def test_every_field_is_commented(path):
    for line in path.read_text().splitlines():
        if line and line != "---" and not line.startswith("#") and "=" not in line.partition("#")[0]:
            _, _, comment = line.partition("#")
            assert comment.strip(), "no comment: " + line
