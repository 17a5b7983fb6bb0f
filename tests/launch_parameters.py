"""Parameters of a launch file as the parameter server shows them."""

from roslaunch.core import Param


def unroll(config):
    """Add to a ROSLaunchConfig the single parameters of those that it sets several at once, as dictionaries."""
    waiting = list(config.params.items())
    while waiting:
        name, param = waiting.pop()
        if isinstance(param.value, dict):
            inner = [(name + "/" + key, Param(name + "/" + key, value)) for key, value in param.value.items()]
            waiting += inner
            for key, value in inner:
                config.params.setdefault(key, value)  # what is set by itself comes later, and counts
            del config.params[name]
