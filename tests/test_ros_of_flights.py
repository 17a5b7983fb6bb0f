"""Rostests of the packages that fly and look, see test_ros.py."""

import pytest
from test_ros import parameters, run_rostest


@pytest.mark.parametrize("path", parameters(of_flights=True))
def test_rostest(path, tmp_path):
    run_rostest(path, tmp_path)
