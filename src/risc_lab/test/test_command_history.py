"""risc_lab.command_history: what is in force when."""

import numpy as np

from risc_lab.command_history import ROWS, CommandHistory


def test_a_command_holds_until_the_next_and_the_ring_keeps_the_newest():
    history = CommandHistory(2)
    assert history.at(0, -5.0).tolist() == [0.0] * 4
    count = 10 * ROWS
    for k in range(count):
        history.append(0, 0.005 * k, np.full(4, float(k)))
    end_s = 0.005 * (count - 1)
    found = [history.at(0, end_s + after_s)[0] for after_s in (0.0, 0.004, -0.001, 10.0)]
    assert found == [count - 1, count - 1, count - 2, count - 1]
    assert history.at(0, 0.0)[0] == count - ROWS, "the oldest kept"
    assert not history.at(1, end_s).any(), "each vehicle has its own"


def test_what_is_held_at_many_times():
    history = CommandHistory(1, rows=4)
    for k in range(6):  # the first two are forgotten
        history.append(0, float(k), np.full(4, 10.0 * k))
    held = history.held(0, np.array([1.5, 2.0, 4.9, 5.5, 6.1]), longest_s=1.0)[:, 0]
    assert held.tolist()[1:4] == [20.0, 40.0, 50.0] and np.isnan(held[[0, 4]]).all()
    assert np.isnan(CommandHistory(1).held(0, np.array([1.0]), longest_s=1.0)).all(), "nothing was sent"


def test_a_clock_that_was_set_back_replaces_what_came_after():
    history = CommandHistory(1)
    for time_s in (1.0, 2.0, 3.0, 2.5):
        history.append(0, time_s, np.full(4, time_s))
    assert [history.at(0, time_s)[3] for time_s in (0.5, 1.5, 2.4, 9.0)] == [0.0, 1.0, 2.0, 2.5]
    history.append(0, 0.5, np.full(4, 0.5))
    assert [history.at(0, time_s)[0] for time_s in (0.4, 9.0)] == [0.0, 0.5]
    history.clear()
    assert not history.at(0, 9.0).any()
