"""A filter that asks for the commands is given them in an offline flight, too."""

import numpy as np

from risc_estimation.filters import COMMAND, least_squares
from risc_experiments.offline import Flight, fly


def test_a_filter_is_given_the_commands_that_were_sent(monkeypatch):
    given = []
    monkeypatch.setattr(least_squares.Filter, "ON_BOARD", (COMMAND,))
    monkeypatch.setattr(least_squares.Filter, "on_board", lambda self, *sent: given.append(sent))
    fly(Flight(vehicles=1, duration_s=0.5))
    rows, times_s, what, commands = zip(*given)
    assert set(rows) == {0} and set(what) == {COMMAND} and len(given) > 20
    assert (np.diff(times_s) > 0.0).all() and np.isfinite(commands).all() and np.any(commands)
