"""Parameters of a launch file as a node gets them."""

from roslaunch.core import Param


def unroll(config):
    """Add to a ROSLaunchConfig the single parameters of those that it sets together: ~vehicles of a driver for one
    vehicle, and ~mocap of stream_markers.
    """
    for name, param in list(config.params.items()):
        owner, _, key = name.rpartition("/")
        together = {}
        if key == "vehicles" and isinstance(param.value, dict) and len(param.value) == 1:
            (together,) = param.value.values()
        elif key == "mocap" and isinstance(param.value, dict):
            together = param.value
        for key, value in together.items():
            config.params.setdefault("%s/%s" % (owner, key), Param("%s/%s" % (owner, key), value))
