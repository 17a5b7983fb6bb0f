"""Private parameters of the virtual lab's node, without a master."""

import pytest

from risc_simulator.virtual_lab import LabOptions

rospy = pytest.importorskip("rospy", reason="needs ROS")


@pytest.fixture
def load_options(monkeypatch):
    """load_options(**given): the LabOptions that the node reads from these private parameters."""
    from risc_simulator.ros import node

    def load(**given):
        private = {"~": given, **{"~" + name: value for name, value in given.items()}}
        monkeypatch.setattr(rospy, "get_param", private.get)
        return node.load_options()

    return load


def test_texts_and_numbers_arrive_over_the_defaults(load_options):
    options = load_options(subnet="127.80", radio_loss=0.1, delay=1, interface="127.0.0.1")
    assert options == LabOptions(subnet="127.80", radio_loss=0.1, delay=1.0, interface="127.0.0.1")
    assert load_options() == LabOptions()


@pytest.mark.parametrize("value", [127.8, 127])
def test_a_number_for_a_subnet_is_refused_with_the_cure(load_options, value):
    """roscore turns 127.80 on a command line into 127.8, another network; a guess could be silently wrong."""
    with pytest.raises(ValueError, match="~subnet .*text, found .*_subnet:="):
        load_options(subnet=value)


@pytest.mark.parametrize("key, value", [("seed", "7"), ("ideal", 1), ("radio_loss", True), ("stats", 5)])
def test_wrong_types_name_the_key(load_options, key, value):
    with pytest.raises(ValueError, match="'%s'" % key):
        load_options(**{key: value})
