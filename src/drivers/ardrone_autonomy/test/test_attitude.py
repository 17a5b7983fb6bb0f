import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ardrone_autonomy.attitude import Odometry, quaternion_xyzw
from ardrone_autonomy.protocol.navdata import LAYOUTS, Tag

DEMO = LAYOUTS[Tag.DEMO].value_type._make([0] * len(LAYOUTS[Tag.DEMO].fields))


def test_quaternion_equals_scipys():
    rng = np.random.default_rng(1)
    for roll, pitch, yaw in rng.uniform(-math.pi, math.pi, (50, 3)):
        expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        error = expected.inv() * Rotation.from_quat(quaternion_xyzw(roll, pitch, yaw))
        assert error.magnitude() < 1e-9


def test_signs_and_units():
    state = Odometry().update(
        DEMO._replace(vx=1000.0, vy=2000.0, vz=3000.0, altitude=4000, phi=10e3, theta=20e3, psi=30e3), 5.0
    )
    assert state.position_m == (0.0, 0.0, 4.0)
    assert state.velocity_m_s == (1.0, -2.0, -3.0)
    np.testing.assert_allclose(
        Rotation.from_quat(state.quaternion_xyzw).as_euler("ZYX", degrees=True), (-30.0, -20.0, 10.0)
    )


def test_track_turns_with_the_vehicle():
    # Nose turned 90 degrees to the left: psi of the aircraft is -90 degrees. Forward is then +y of odom.
    odometry = Odometry()
    demo = DEMO._replace(psi=-90e3, vx=1000.0)
    odometry.update(demo, 0.0)
    state = odometry.update(demo, 0.5)
    np.testing.assert_allclose(state.position_m, (0.0, 0.5, 0.0), atol=1e-12)
    # ... and to its left is -x
    state = odometry.update(DEMO._replace(psi=-90e3, vy=-1000.0), 1.0)
    np.testing.assert_allclose(state.position_m, (-0.5, 0.5, 0.0), atol=1e-12)


@pytest.mark.parametrize("dt_s", [0.0, -0.1, 1.5])
def test_gaps_and_repeated_times_do_not_move_it(dt_s):
    odometry = Odometry()
    demo = DEMO._replace(vx=1000.0)
    odometry.update(demo, 10.0)
    assert odometry.update(demo, 10.0 + dt_s).position_m[0] == 0.0
