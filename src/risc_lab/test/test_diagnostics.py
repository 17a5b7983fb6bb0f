import itertools

import pytest
import rospy

from risc_lab.ros.diagnostics import make_updater


@pytest.fixture
def master(monkeypatch):
    """(parameters of a master, names that were looked up there but are not set and so not cached)."""
    params, asked = {}, []

    def get_param_cached(name, default=None):
        if name not in params:
            asked.append(name)  # as in rospy: missing parameters are not cached
        return params.get(name, default)

    monkeypatch.setattr(rospy, "has_param", params.__contains__)
    monkeypatch.setattr(rospy, "set_param", params.__setitem__)
    monkeypatch.setattr(rospy, "get_param_cached", get_param_cached)
    monkeypatch.setattr(rospy, "Publisher", lambda *args, **options: None)
    clock = itertools.count(1000)
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(next(clock)))
    return params, asked


def test_the_master_is_not_asked_again_and_again(master):
    params, asked = master
    updater = make_updater("a vehicle")
    updater._check_diagnostic_period()
    assert (updater.hwid, updater.period, asked) == ("a vehicle", 1.0, [])


def test_a_period_that_somebody_chose_stays(master):
    params, _ = master
    params["~diagnostic_period"] = 5.0
    updater = make_updater("none")
    updater._check_diagnostic_period()
    assert updater.period == 5.0
