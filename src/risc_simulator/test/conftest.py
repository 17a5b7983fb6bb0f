"""Simulated time for tests."""

import pathlib
import select
import sys

import pytest

from risc_simulator import virtual_lab

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))  # addresses.py


class Clock:
    """Simulated time: advances while the lab waits and when the test sets it; stalls of this computer do not count."""

    def __init__(self):
        self.now_s = 100.0

    def monotonic(self):
        return self.now_s

    def select(self, readable, writable, exceptional, timeout_s):
        ready = select.select(readable, writable, exceptional, 0.0)
        if not any(ready):
            self.now_s += timeout_s + 1e-6  # always a little late
        return ready


@pytest.fixture
def clock(monkeypatch):
    """Clock that replaces the lab's `time` and `select` modules."""
    result = Clock()
    monkeypatch.setattr(virtual_lab, "time", result)
    monkeypatch.setattr(virtual_lab, "select", result)
    return result
