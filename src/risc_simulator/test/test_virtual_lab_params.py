"""Private parameters of the virtual lab's node, without a master."""

import pytest

rospy = pytest.importorskip("rospy", reason="needs ROS")


@pytest.fixture
def load_params(monkeypatch):
    """load_params(given): what the node makes of these private parameters."""
    from risc_simulator.ros import params

    def load(**given):
        monkeypatch.setattr(rospy, "get_param", lambda name, default=None: given if name == "~" else default)
        return params.load_params()

    return load


def test_texts_and_numbers_arrive_over_the_defaults(load_params):
    params = load_params(subnet="127.80", radio_loss=0.1, delay=1, interface="127.0.0.1")
    assert (params["subnet"], params["radio_loss"], params["delay"], params["interface"]) == (
        "127.80",
        0.1,
        1.0,
        "127.0.0.1",
    )
    assert load_params() == dict(params, subnet="", radio_loss=0.0, delay=-1.0, interface="")


@pytest.mark.parametrize("key, value", [("subnet", 127.8), ("subnet", 127), ("stats", 5), ("fleet", None)])
def test_a_number_for_a_text_is_refused_with_the_cure(load_params, key, value):
    """roscore keeps 127.8 of a command line's 127.80, another network: guessing would be wrong silently."""
    with pytest.raises(ValueError, match="~%s must be a text, found .*quote it twice.*_%s:=" % (key, key)):
        load_params(**{key: value})


@pytest.mark.parametrize("key, value", [("seed", "7"), ("ideal", 1), ("radio_loss", True)])
def test_other_wrong_types_name_the_key(load_params, key, value):
    with pytest.raises(ValueError, match="~%s must be like" % key):
        load_params(**{key: value})
