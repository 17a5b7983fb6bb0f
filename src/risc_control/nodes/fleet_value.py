#!/usr/bin/env python3
"""Print one value of a fleet file, for launch files: <param name="host" command="... FLEET mocap host"/>.

Usage: fleet_value.py FLEET mocap KEY | fleet_value.py FLEET NAMESPACE KEY
A vehicle's KEY is one of its own, one of its type's (video_latency_s ...), or camera_info_url.
"""

import sys

from risc_control.lab import load_fleet, load_vehicle_type
from risc_control.lab.calibration import resolve_url


def fleet_value(fleet, owner, key):
    """Value of a key of `mocap`, or of the vehicle with that namespace or its type. ValueError when there is none."""
    owners = {vehicle.namespace: vehicle for vehicle in fleet.vehicles}
    owners["mocap"] = fleet.mocap
    if owner not in owners:
        raise ValueError("fleet '%s' has no vehicle '%s'; it has %s" % (fleet.name, owner, ", ".join(sorted(owners))))
    values = dict(vars(owners[owner]))
    if owner != "mocap":
        calibration = values["calibration"]
        values["camera_info_url"] = "file://%s" % resolve_url(calibration).absolute() if calibration else ""
        if key not in values:
            values.update(vars(load_vehicle_type(values["type"])))
    if key not in values:
        raise ValueError("'%s' has no '%s'; it has %s" % (owner, key, ", ".join(values)))
    return values[key]


if __name__ == "__main__":
    try:
        fleet_path, owner_name, key_name = sys.argv[1:4]
        print(fleet_value(load_fleet(fleet_path), owner_name, key_name), end="")
    except ValueError as error:
        sys.exit("fleet_value: %s" % error)
