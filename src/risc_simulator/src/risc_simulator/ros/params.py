"""Private parameters of the virtual lab's node, and the lab that they describe."""

import rospy

from risc_lab.lab import fleet_from_dict, load_fleet
from risc_simulator.faults import load_wire_faults
from risc_simulator.virtual_lab import VirtualLab, configure_fleet

# Private parameters and their defaults; "" and negative numbers leave what the fleet file says.
_DEFAULTS = {
    "fleet": "",  # path of the fleet file; "": the parameter /fleet
    "seed": 0,
    "ideal": False,  # vehicles exactly as their types say
    "exact_markers": False,  # cameras without noise, loss and ghosts
    "gusts": False,
    "delay": -1.0,  # [s] nominal command delay of every vehicle
    "radio_loss": 0.0,  # fraction of the slots of every vehicle's command link, and of navdata, that is lost
    "live": False,  # stream without waiting for a client
    "vehicles": -1,  # only the first so many
    "subnet": "",  # Cortex host at <subnet>.0.1, vehicle k at <subnet>.1.k
    "cortex_host": "",
    "cortex_port": -1,
    "stream_group": "",
    "stream_port": -1,
    "interface": "",  # address of this computer's card that the stream goes out by; "": that of the Cortex host
    "rate": -1.0,  # [Hz] of motion capture
    "cameras_on_demand": False,  # start the camera process when the first client asks for video, not with the lab
    "faults": "",  # file that says what happens to datagrams, and when
    "stats": "",  # file for the statistics at the end
}
_NODE_KEYS = {"diagnostic_period"}  # read by diagnostic_updater


def load_params():
    """Private parameters over the defaults. Raises ValueError that names the key."""
    given = rospy.get_param("~", {})
    unknown = sorted(set(given) - set(_DEFAULTS) - _NODE_KEYS)
    if unknown:
        rospy.logwarn("unknown parameters are ignored: %s; known are: %s", ", ".join(unknown), ", ".join(_DEFAULTS))
    params = dict(_DEFAULTS)
    for key, default in _DEFAULTS.items():
        value = given.get(key, default)
        if isinstance(default, str):
            if not isinstance(value, str):  # a command line makes the number 127.8 of 127.80: what was meant is lost
                raise ValueError(
                    "parameter ~%s must be a text, found %r: quote it twice on a command line (_%s:=\"'...'\"), "
                    'and give it type="str" in a launch file' % (key, value, key)
                )
        elif isinstance(value, bool) is not isinstance(default, bool) or not isinstance(value, (bool, int, float)):
            raise ValueError("parameter ~%s must be like %r, found %r" % (key, default, value))
        params[key] = type(default)(value)
    return params


def make_lab(params):
    """The lab that the parameters describe. Raises ValueError or OSError."""
    if params["fleet"]:
        fleet = load_fleet(params["fleet"])
    elif rospy.has_param("/fleet"):
        fleet = fleet_from_dict(rospy.get_param("/fleet"), "parameter /fleet")
    else:
        raise ValueError("no fleet: set ~fleet to the path of a fleet file, or load one as the parameter /fleet")

    def given(key):
        value = params[key]
        return None if value == "" or (not isinstance(value, str) and value < 0) else value

    fleet = configure_fleet(
        fleet,
        given("vehicles"),
        given("subnet"),
        given("cortex_host"),
        given("cortex_port"),
        given("stream_group"),
        given("stream_port"),
        given("rate"),
    )
    return VirtualLab(
        fleet,
        seed=params["seed"],
        perturbed=not params["ideal"],
        gusts=params["gusts"],
        command_delay_s=given("delay"),
        exact_markers=params["exact_markers"],
        live_on_start=params["live"],
        radio_loss=params["radio_loss"],
        interface=params["interface"],
        cameras_ahead=not params["cameras_on_demand"],
        wire_faults=load_wire_faults(params["faults"]) if params["faults"] else (),
    )
