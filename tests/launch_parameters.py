"""Parameters of a launch file as a node gets them."""

from roslaunch.core import Param


def unroll(config):
    """Add to a ROSLaunchConfig the single parameters of those that it sets together: ~vehicles of a driver, as far
    as they have the same, and ~mocap of stream_markers.
    """
    for name, param in list(config.params.items()):
        owner, _, key = name.rpartition("/")
        together = {}
        if key == "vehicles" and isinstance(param.value, dict):
            first, *others = param.value.values()
            together = {key: value for key, value in first.items() if all(other[key] == value for other in others)}
        elif key == "mocap" and isinstance(param.value, dict):
            together = param.value
        for key, value in together.items():
            config.params.setdefault("%s/%s" % (owner, key), Param("%s/%s" % (owner, key), value))
