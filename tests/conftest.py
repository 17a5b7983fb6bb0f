import pathlib
import sys

import pytest

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE / "benchmarks")]  # flying.py, labelled_pictures.py ...


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Of tests that want the computer for themselves one runs at a time, until what it flies is down."""
    if not item.get_closest_marker("alone"):
        return (yield)
    from flying import airspace

    airspace.take()
    try:
        return (yield)
    finally:
        airspace.leave()
