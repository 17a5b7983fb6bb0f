#!/usr/bin/env python3
"""Print what a fleet file says as parameters of a node, in YAML, for launch files:

    <param name="ardrone_driver/vehicles" type="yaml" command="fleet_value.py FLEET drivers risc1"/>

Usage: fleet_value.py FLEET mocap | FLEET drivers NAMESPACE... | FLEET NAMESPACE KEY
mocap: ~mocap of stream_markers.  drivers: ~vehicles of ardrone_driver, {namespace: {...}}.
A vehicle's KEY is one of its own, one of its type's (video_latency_s ...), or camera_info_url.
"""

import sys

import yaml

from risc_lab.lab import load_fleet
from risc_lab.lab.calibration import resolve_url


def fleet_value(fleet, what, *names):
    """What is to be printed, see above. Raises ValueError when there is none."""
    if what == "mocap":
        mocap = fleet.mocap
        return {
            "host": mocap.host,
            "command_port": mocap.command_port,
            "stream_group": mocap.stream_group,
            "stream_port": mocap.stream_port,
            "local_address": mocap.interface,
        }
    if what == "drivers":
        return {name: _driver(_values(fleet, name)) for name in names}
    values = _values(fleet, what)
    (key,) = names
    if key not in values:
        raise ValueError("'%s' has no '%s'; it has %s" % (what, key, ", ".join(values)))
    return values[key]


def _driver(values):
    return {
        "drone_ip": values["address"],
        "drone_frame_id": values["namespace"] + "_ardrone_base",
        "camera_info_url": values["camera_info_url"],
        "video_latency": values["video_latency_s"],
        "euler_angle_max": values["tilt_max_rad"],
        "control_vz_max": 1e3 * values["climb_max_m_s"],
        "control_yaw": values["yaw_rate_max_rad_s"],
    }


def _values(fleet, name):
    """{key: value} of the vehicle with that namespace, and of its type."""
    vehicles = {vehicle.namespace: vehicle for vehicle in fleet.vehicles}
    if name not in vehicles:
        raise ValueError("fleet '%s' has no vehicle '%s'; it has %s" % (fleet.name, name, ", ".join(sorted(vehicles))))
    vehicle = vehicles[name]
    own = vars(vehicle)
    calibration = own["calibration"]
    url = "file://%s" % resolve_url(calibration).absolute() if calibration else ""
    return {**vars(vehicle.vehicle_type), **own, "camera_info_url": url}


def main():
    """Command line."""
    if len(sys.argv) < 3 or len(sys.argv) == 3 and sys.argv[2] != "mocap":
        sys.exit(__doc__)
    try:
        value = fleet_value(load_fleet(sys.argv[1]), *sys.argv[2:])
    except ValueError as error:
        sys.exit("fleet_value: %s" % error)
    print(yaml.safe_dump(value) if isinstance(value, dict) else value, end="")


if __name__ == "__main__":
    main()
