#!/usr/bin/env python3
"""Values of a fleet file, for launch files:

    <param name="stream_markers/mocap" type="yaml" command="fleet_value.py FLEET mocap SOURCE"/>

Usage: fleet_value.py FLEET mocap SOURCE | FLEET NAMESPACE KEY | FLEET drivers FOLDER OUT [KEY:=VALUE...] NAMESPACE...
mocap: prints ~mocap of stream_markers for a source of motion capture, see config/sources of cortex_ros.
A vehicle's KEY is one of its own, one of its type's (video_latency_s ..., keys of `own`), one of its type's devices
(which its driver opens), or camera_info_url: prints its value.
drivers: writes the launch file OUT that starts the drivers of these vehicles, and prints {driver: namespaces}. For each
vehicle it includes the launch file of its type, with those of its arguments that are a KEY; is_first is true for the
first vehicle of a driver. FOLDER holds the launch files of the types in the tree. A KEY:=VALUE overrides the vehicle's
own value unless it is empty.
"""

import pathlib
import sys
from xml.etree import ElementTree

import yaml

from risc_lab.lab import load_fleet
from risc_lab.lab.calibration import resolve_url
from risc_lab.lab.yaml_reader import config_files, load_yaml, member_folders


def fleet_value(fleet, what, *words):
    """Value to print, see above. Raises ValueError when there is none."""
    if what == "mocap":
        return mocap_parameters(fleet.mocap, *words)
    if what == "drivers":
        return write_drivers(fleet, *words)
    values = _values(fleet, what)
    (key,) = words
    if key not in values:
        raise ValueError("'%s' has no '%s'; it has %s" % (what, key, ", ".join(values)))
    return values[key]


def mocap_parameters(endpoint, source):
    """Settings of a source of motion capture: its YAML file, overridden by what the fleet file says of the host."""
    files = config_files("sources", "cortex_ros")
    if source not in files:
        raise ValueError("no source of motion capture '%s'; there are %s" % (source, ", ".join(sorted(files))))
    settings = load_yaml(files[source])
    told = {**vars(endpoint), "local_address": endpoint.interface, "frame_rate": endpoint.rate_hz}
    return {**settings, **{key: told[key] for key in settings if told.get(key) is not None}, "source": source}


def write_drivers(fleet, folder, out, *words):
    """Write the launch file `out`, see above. Returns {driver: namespaces}. Raises ValueError."""
    given = dict(word.split(":=", 1) for word in words if ":=" in word)
    drivers, launch = {}, ElementTree.Element("launch")
    for name in words:
        if ":=" in name:
            continue
        values = {**_values(fleet, name), **{key: value for key, value in given.items() if value}}
        driver = values["driver"] or values["name"]  # another type's, or its own
        values["is_first"] = str(driver not in drivers).lower()
        drivers.setdefault(driver, []).append(name)
        path = _driver_file(driver, folder)
        include = ElementTree.SubElement(launch, "include", file=str(path))
        for arg in ElementTree.parse(path).getroot().findall("arg"):
            value = values.get(arg.get("name"))
            if isinstance(value, (str, int, float)):
                ElementTree.SubElement(include, "arg", name=arg.get("name"), value=str(value))
            elif "default" not in arg.attrib and "value" not in arg.attrib:
                raise ValueError(
                    "%s asks for '%s', which %s has not: give it a default" % (path, arg.get("name"), name)
                )
    pathlib.Path(out).parent.mkdir(parents=True, exist_ok=True)
    ElementTree.ElementTree(launch).write(out)
    return drivers


def _driver_file(driver, folder):
    """The launch file of a type's driver. Raises ValueError."""
    folders = [pathlib.Path(folder), *(member / "vehicle_types" for member in member_folders())]
    found = [path for path in (folder / (driver + ".launch") for folder in folders) if path.is_file()]
    if not found:
        raise ValueError(
            "there is no %s.launch in %s: write it, or name a type with the same driver as `driver` in the type's YAML "
            "file" % (driver, ", ".join(map(str, folders)))
        )
    return found[0].resolve()


def _values(fleet, name):
    """{key: value} of the vehicle with that namespace, and of its type."""
    vehicles = {vehicle.namespace: vehicle for vehicle in fleet.vehicles}
    if name not in vehicles:
        raise ValueError("fleet '%s' has no vehicle '%s'; it has %s" % (fleet.name, name, ", ".join(sorted(vehicles))))
    vehicle = vehicles[name]
    own = vars(vehicle)
    calibration = own["calibration"]
    url = "file://%s" % resolve_url(calibration).absolute() if calibration else ""
    kind = vehicle.vehicle_type
    return {**kind.own, **vars(kind), **own, **vehicle.links, "camera_info_url": url}


def main():
    """Command line."""
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    try:
        value = fleet_value(load_fleet(sys.argv[1]), *sys.argv[2:])
    except ValueError as error:
        sys.exit("fleet_value: %s" % error)
    print(yaml.safe_dump(value) if isinstance(value, dict) else value, end="")


if __name__ == "__main__":
    main()
