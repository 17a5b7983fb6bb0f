"""How fast the offline world is: `python3 -m risc_simulator.bench [--json FILE]`.

Every vehicle is in the air and gets a new setpoint at the rate of its radio, as in a flight; plants are honest.
"""

import argparse
import json
import math
import statistics
import sys
import time

from risc_control.lab import Fleet, FleetVehicle, MocapEndpoint, Template, load_vehicle_type
from risc_control.lab.arena import NET_HALF_X_M, NET_HALF_Y_M
from risc_simulator.world import Setpoint, World

COUNTS = (1, 10, 50)
REPEATS = 5
WARM_UP_S = 0.5
REQUIRED_TIMES_REAL_TIME = {1: 50.0}


def make_world(count, seed=0):
    """World with `count` AR.Drones, and their places on a grid across the arena [m]."""
    columns = int(math.ceil(math.sqrt(count)))
    places_m = [
        (
            1.6 * NET_HALF_X_M * ((i % columns + 0.5) / columns - 0.5),
            1.6 * NET_HALF_Y_M * ((i // columns + 0.5) / columns - 0.5),
            1.5,
        )
        for i in range(count)
    ]
    names = ["vehicle%d" % (i + 1) for i in range(count)]
    fleet = Fleet(
        "bench",
        MocapEndpoint("127.0.0.1"),
        tuple(
            FleetVehicle(name, name, "ardrone", "127.0.1.%d" % (i + 1), "", place, 0.0)
            for i, (name, place) in enumerate(zip(names, places_m))
        ),
    )
    templates = {name: Template(name, "vehicle", (), ()) for name in names}
    # 50 vehicles stand closer on their grid than two may come in flight: they fly through each other
    world = World(fleet, {"ardrone": load_vehicle_type("ardrone")}, templates, seed=seed, collisions=False)
    return world, places_m


def fly(world, places_m, duration_s):
    """Fly to and fro around the places for duration_s [s] of world time. Returns the computing time [s]."""
    start_s = world.time_s
    for index, (vehicle, place_m) in enumerate(zip(world.vehicles.values(), places_m)):
        vehicle.fly_at(place_m)
        rate_hz = vehicle.type.command_rate_hz
        for k in range(int(duration_s * rate_hz)):
            swing = 2.0 * math.pi * (k / rate_hz + 0.1 * index)
            vehicle.schedule(
                start_s + k / rate_hz,
                Setpoint(0.05 * math.cos(swing), 0.05 * math.sin(swing), 0.05 * math.sin(swing), 0.2),
            )
    clock_s = time.perf_counter()
    world.step_to(start_s + duration_s)
    return time.perf_counter() - clock_s


def measure(count, repeats=REPEATS, duration_s=None):
    """{"vehicles", "times_real_time", "us_per_step", "repeats"}: medians of several repeats.

    Raises RuntimeError when a vehicle crashed, for then the figure would mean nothing.
    """
    if duration_s is None:
        duration_s = max(1.0, 5.0 / math.sqrt(count))
    world, places_m = make_world(count)
    fly(world, places_m, WARM_UP_S)
    took_s = statistics.median(fly(world, places_m, duration_s) for _ in range(repeats))
    if world.crashes:
        raise RuntimeError("bench: %s %s" % (world.crashes[0].namespace, world.crashes[0].reason))
    return {
        "vehicles": count,
        "times_real_time": duration_s / took_s,
        "us_per_step": 1e6 * took_s / (duration_s / world.step_s),
        "repeats": repeats,
    }


def main(arguments=None):
    """Command line. Returns 1 when a required speed is missed."""
    parser = argparse.ArgumentParser(prog="bench", description="Speed of the offline world on one core.")
    parser.add_argument("--json", metavar="FILE", help="write the table there too")
    options = parser.parse_args(arguments)
    rows = [measure(count, REPEATS) for count in COUNTS]
    print("offline world, one core, step 5 ms (median of %d):" % REPEATS)
    print("  vehicles   times real time   us per step   required")
    for row in rows:
        required = REQUIRED_TIMES_REAL_TIME.get(row["vehicles"])
        print(
            "  %8d   %15.0f   %11.0f   %s"
            % (row["vehicles"], row["times_real_time"], row["us_per_step"], ">= %g" % required if required else "-")
        )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as stream:
            json.dump({"offline_world": rows}, stream, indent=2)
            stream.write("\n")
    met = all(row["times_real_time"] >= REQUIRED_TIMES_REAL_TIME.get(row["vehicles"], 0.0) for row in rows)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
