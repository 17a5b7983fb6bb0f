import pytest

from ardrone_autonomy.ros.params import OPTION_NAMES, parse_params


def test_defaults_are_those_of_the_original_but_for_the_timeout_of_commands():
    configuration = parse_params({})
    params = configuration.params
    assert (params.drone_ip, params.drone_frame_id) == ("192.168.1.1", "ardrone_base")
    assert (params.looprate, params.realtime_navdata, params.enable_legacy_navdata) == (50.0, False, True)
    assert (params.settle_time, params.cmd_timeout) == (5.0, 0.5)
    assert (params.realtime_video, params.video_latency, params.camera_info_url) == (False, 0.0, "")
    assert configuration.covariances == [(0.0,) * 9] * 3
    assert configuration.options == [] and configuration.warnings == []


def test_flags_and_numbers_may_be_written_as_launch_files_of_old_do():
    params = parse_params({"realtime_navdata": 1, "enable_legacy_navdata": 0, "looprate": "30"}).params
    assert (params.realtime_navdata, params.enable_legacy_navdata, params.looprate) == (True, False, 30.0)


def test_28_options():
    assert len(OPTION_NAMES) == 28
    names = ("wifi", "magneto", "zimmu_3000")
    params = parse_params({"enable_navdata_" + name: True for name in names})
    assert set(params.options) == set(names)


def test_the_argument_wins_over_the_parameter():
    assert parse_params({"drone_ip": "10.0.0.1"}).params.drone_ip == "10.0.0.1"
    assert parse_params({"drone_ip": "10.0.0.1"}, ["-ip", "10.0.0.2"]).params.drone_ip == "10.0.0.2"


@pytest.mark.parametrize("arguments", [["-ip"], ["10.0.0.1"], ["-ip", "10.0.0.1", "x"], ["--port", "1"]])
def test_wrong_arguments(arguments):
    with pytest.raises(ValueError, match="-ip"):
        parse_params({}, arguments)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("looprate", 0),
        ("looprate", "fast"),
        ("looprate", float("nan")),
        ("settle_time", -1),
        ("cmd_timeout", -0.1),
        ("realtime_navdata", "maybe"),
        ("realtime_video", "maybe"),
        ("video_latency", -0.1),
        ("video_latency", "long"),
        ("camera_info_url", 5),
        ("bottom_camera_info_url", ["a"]),
        ("drone_frame_id", ""),
        ("drone_ip", 5),
        ("altitude_max", "high"),
        ("enable_navdata_wifi", "x"),
    ],
)
def test_bad_values_are_named(name, value):
    with pytest.raises(ValueError, match=name):
        parse_params({name: value})


def test_covariances():
    params = parse_params({"cov": {"imu_la": list(range(9)), "imu_av": [1, 2, 3], "imu_or": [0.5] * 9}})
    # as the original: not nine numbers means zeros
    assert params.covariances == [tuple(map(float, range(9))), (0.0,) * 9, (0.5,) * 9]
    assert len(params.warnings) == 1
    assert "cov/imu_av" in params.warnings[0]


def test_names_that_nobody_reads_are_reported():
    warnings = parse_params({"detections": 3, "root_frame": 1, "looprate": 50, "diagnostic_period": 1}).warnings
    assert [text.split()[1] for text in warnings] == ["~detections", "~root_frame"]


def test_camera_channel():
    assert parse_params({}).video_channel == 0
    assert parse_params({"video_channel": 1}).video_channel == 1
