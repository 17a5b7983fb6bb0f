import math

import pytest

from ardrone_autonomy.piloting import HOVER, Sticks, sticks_from_velocity
from ardrone_autonomy.protocol import at

ZERO = (0.0, 0.0, 0.0)


def test_every_axis_keeps_its_own_sign():
    # forward = nose down, left = roll negative, up = gaz positive, counter-clockwise = yaw negative
    sticks = sticks_from_velocity((0.1, 0.2, 0.3), (0.0, 0.0, 0.4))
    assert sticks == Sticks(1, roll=-0.2, pitch=-0.1, gaz=0.3, yaw=-0.4)


def test_values_are_clipped():
    assert sticks_from_velocity((3.0, -3.0, 3.0), (7.0, 7.0, -3.0)) == Sticks(1, 1.0, -1.0, 1.0, 1.0)


def test_hover_only_when_all_six_are_zero():
    assert sticks_from_velocity(ZERO, ZERO) == HOVER
    assert sticks_from_velocity((9e-7, -9e-7, 0.0), (0.0, 9e-7, 0.0)) == HOVER
    for index in range(6):
        six = [0.0] * 6
        six[index] = 2e-6
        assert sticks_from_velocity(six[:3], six[3:]).flags == 1, "value %d" % index


def test_rotation_about_x_or_y_means_level_without_holding_the_position():
    sticks = sticks_from_velocity(ZERO, (1.0, 0.0, 0.0))
    assert sticks == Sticks(1, 0.0, 0.0, 0.0, 0.0)
    assert at.pcmd_mag(1, *sticks) == b"AT*PCMD_MAG=1,1,0,0,0,0,0,0\r"  # no minus zero on the wire


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("index", range(6))
def test_what_is_not_finite_is_refused(bad, index):
    six = [0.5] * 6
    six[index] = bad
    with pytest.raises(ValueError, match="cmd_vel"):
        sticks_from_velocity(six[:3], six[3:])
