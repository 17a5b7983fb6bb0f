"""Private parameters of the virtual lab's node, and the lab that they describe."""

import rospy

from risc_lab.lab import load_fleet
from risc_lab.ros.params import known_fleet, load_params
from risc_simulator.virtual_lab import LabOptions


def load_options():
    """LabOptions of the private parameters. Raises ValueError that names the key."""
    subnet = rospy.get_param("~subnet", "")
    if not isinstance(subnet, str):  # a command line makes the number 127.8 of 127.80: what was meant is lost
        raise ValueError(
            "parameter ~subnet must be a text, found %r: quote it twice on a command line (_subnet:=\"'...'\"), and "
            'give it type="str" in a launch file' % (subnet,)
        )
    (options,) = load_params(LabOptions)
    return options


def make_lab(options):
    """The lab that they describe. Raises ValueError or OSError."""
    fleet = load_fleet(options.fleet) if options.fleet else known_fleet()
    if fleet is None:
        raise ValueError("no fleet: set ~fleet to the path of a fleet file, or load one as the parameter /fleet")
    return options.make_lab(fleet)
