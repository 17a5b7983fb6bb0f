"""How long a frame takes in the controller and in the vehicle pilot: `./maap bench control`.

Vehicles on a circle with noisy states, one frame after the other as in flight. Seeded.
"""

import argparse
import json
import sys
import time
from collections import defaultdict
from dataclasses import replace

import numpy as np

from risc_control.controllers import ControlLoop
from risc_control.reference_buffer import ReferenceBuffer
from risc_control.trajectories import make_course
from risc_control.vehicle_pilot import OwnState, VehicleNodeParams, VehiclePilot
from risc_control.vehicles import Controls, FlightState, Status
from risc_lab.lab.vehicle_types import load_vehicle_type
from risc_lab.states import S, States

FRAME_S = 0.005
AGE_S = 0.006  # of a state when it is answered
TICK_EVERY, NAVDATA_EVERY = 3, 13  # frames
WARM_UP = 100  # frames that do not count
DELAYS_S = (0.1, 0.3)
POSITION_NOISE_M, VELOCITY_NOISE_M_S = 0.001, 0.01


def controller_row(count, delay_s, frames, seed=1):
    """Dict of the median time [us] per frame of each step, for `count` vehicles with this link delay."""
    begin_s = time.perf_counter()
    vehicle_type = replace(load_vehicle_type("ardrone"), command_delay_s=delay_s)
    loop, buffer = ControlLoop("differential_flatness", [vehicle_type] * count), ReferenceBuffer()
    construction_s = time.perf_counter() - begin_s
    course, rng, everyone = make_course("circle", count), np.random.default_rng(seed), np.ones(count, dtype=bool)
    seconds = []
    for k in range(WARM_UP + frames):
        stamp_s = k * FRAME_S
        now_s = stamp_s + AGE_S
        reference, x = course.at(stamp_s), np.zeros((count, len(S)))
        x[:, S.X : S.U] = reference[0, :, :3] + POSITION_NOISE_M * rng.standard_normal((count, 3))
        x[:, S.U : S.PHI] = reference[1, :, :3] + VELOCITY_NOISE_M_S * rng.standard_normal((count, 3))
        times = [time.perf_counter()]
        buffer.push(stamp_s, reference[:3])
        times.append(time.perf_counter())
        present, ahead = loop.pick(buffer.at(loop.times_s(stamp_s, now_s)))
        times.append(time.perf_counter())
        loop.update(stamp_s, now_s, States(everyone, x), present, ahead, everyone, everyone)
        times.append(time.perf_counter())
        seconds.append([*np.diff(times), times[-1] - times[0]])
    steps_us = dict(zip(("push_us", "at_us", "update_us", "frame_us"), 1e6 * np.median(seconds[WARM_UP:], axis=0)))
    return {"vehicles": count, "delay_s": delay_s, "construction_ms": 1e3 * construction_s, **steps_us}


def pilot_table(frames):
    """{what arrives: median time [us] to handle it} of one vehicle in autonomous flight."""
    params = VehicleNodeParams(joystick_timeout=0.0)
    pilot = VehiclePilot(params, load_vehicle_type("ardrone"), 0.0)
    own, control = OwnState((0.1, 0.2, 1.0), (0.1, 0.0, 0.02), 0.02, 0.03, 0.0), Controls(0.1, 0.05, 0.02, 4.4)
    buttons, seconds = [0] * 11, defaultdict(list)
    for k in range(WARM_UP + frames):
        now_s = k * FRAME_S
        if k % NAVDATA_EVERY == 0:
            pilot.on_status(Status(FlightState.FLYING, 90.0), now_s)
        if k in (5, 6):
            buttons[params.JoytoWay] = k - 5
            pilot.on_joy(buttons, [0.0] * 8, now_s)
        begin_s = time.perf_counter()
        pilot.on_state(own, 0.004, now_s)
        seen_s = time.perf_counter()
        orders = pilot.on_controls(control, now_s, AGE_S, now_s)
        answered_s = time.perf_counter()
        what = "controls, no command due" if orders.command is None else "controls, command sent"
        seconds["state"].append(seen_s - begin_s)
        seconds[what].append(answered_s - seen_s)
        if k % TICK_EVERY == 0:
            pilot.tick(now_s)
            seconds["tick"].append(time.perf_counter() - answered_s)
    return {what: 1e6 * float(np.median(values)) for what, values in seconds.items()}


def main(arguments=None):
    """Print both tables; with --json also write them. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, nargs="+", default=[3, 10, 50], help="fleet sizes to time")
    parser.add_argument("--frames", type=int, default=2000, help="frames to time (default: 2000)")
    parser.add_argument("--json", type=argparse.FileType("w"), metavar="FILE", help="also write the figures here")
    options = parser.parse_args(arguments)
    controller_row(1, DELAYS_S[0], options.frames)  # loads what is compiled, and wakes the processor up
    controller = [controller_row(count, delay_s, options.frames) for count in options.vehicles for delay_s in DELAYS_S]
    print("Controller: median time per frame, one core")
    print("%10s%8s%15s%10s%10s%10s%10s" % ("vehicles", "delay", "construction", "push", "at", "update", "frame"))
    for row in controller:
        print("%10d%6.1f s%12.0f ms%7.1f us%7.1f us%7.1f us%7.1f us" % tuple(row.values()))
    print("\nVehicle pilot: median time per message, one vehicle in autonomous flight")
    pilot = pilot_table(options.frames)
    for what, microseconds in pilot.items():
        print("%-26s%7.1f us" % (what, microseconds))
    if options.json:
        with options.json:
            json.dump({"controller": controller, "pilot_us": pilot}, options.json, indent=2)
    return 0


if __name__ == "__main__":
    sys.exit(main())
