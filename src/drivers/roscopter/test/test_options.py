"""Command lines as launch files give them."""

import pytest

from roscopter.options import Options, driver_options, node_options


def test_the_laboratorys_launch_line():
    line = ["--device=/dev/ttyUSB0", "--baudrate=56000", "--enable-rc-control=false", "__name:=roscopter", "__log:=/x"]
    options, ignored = driver_options(line)
    assert (options.device, options.baudrate, options.enable_rc_control) == ("/dev/ttyUSB0", 56000, False)
    assert ignored == []


@pytest.mark.parametrize("text, value", [("true", True), ("True", True), ("1", True), ("on", True), ("false", False),
                                         ("False", False), ("0", False), ("no", False)])  # fmt: skip
def test_truth_is_read_as_it_is_meant(text, value):
    """The original took every non-empty text for true, even "false"."""
    assert driver_options(["--enable-rc-control", text])[0].enable_rc_control is value


def test_nothing_is_sent_to_the_sticks_by_default():
    assert Options().enable_rc_control is False
    assert driver_options([])[0] == Options()


def test_defaults_of_the_other_form():
    options, _ = node_options([])
    assert (options.baudrate, options.device, options.mavlink_rate) == (57600, "/dev/ttyUSB0", 10)
    assert options.enable_rc_control is False and options.source_system == 255
    assert node_options(["--rate=4", "--enable-control=true"])[0].mavlink_rate == 4


def test_other_arguments_are_told():
    assert driver_options(["--rate=50", "forgotten", "rc:=/rc"])[1] == ["forgotten"]


@pytest.mark.parametrize(
    "line, said",
    [
        (["--enable-rc-control=maybe"], "true or false"),
        (["--baudrate=fast"], "baudrate"),
        (["--baudrate=0"], "baudrate"),
        (["--type=Plane"], "ArduCopter, ArduRover"),
        (["--source-system=256"], "source_system"),
        (["--mavlink-rate=0"], "mavlink_rate"),
        (["--autonomous-channel-id=4"], "autonomous_channel_id"),
        (["--max-watchdog-time=nan"], "max_watchdog_time"),
        (["--device=tcp:host"], "tcp:HOST:PORT"),
        (["--device=udpin:1.2.3.4:70000"], "udpin:HOST:PORT"),
        (["--device=udpin:1.2.3.4:14550:"], "udpin:HOST:PORT:VEHICLE"),
        (["--device=udpin:0.0.0.0:14550"], "append :VEHICLE"),
        (["--device=udpin::14550"], "append :VEHICLE"),
        (["--device=udpin:laptop:14550"], "append :VEHICLE"),
        (["--device=udpout:1.2.3.4:14550:1.2.3.5"], "udpout:HOST:PORT"),
        (["--minimum-waypoint-altitude=60000"], "maximum-altitude"),
        (["--launch-altitude=1000"], "launch-altitude"),
        (["--unknown=1"], "no such option"),
    ],
)
def test_what_is_wrong_is_named(line, said, capsys):
    with pytest.raises(SystemExit) as error:
        driver_options(line)
    assert error.value.code == 2
    assert said in capsys.readouterr().err
