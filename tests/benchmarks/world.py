"""How fast the virtual lab is: `./maap bench world`, with IRIS+s `./maap bench world --type iris`.

World and cameras offline, as fast as they go, on one core: every vehicle is in the air and gets a new setpoint at the
rate of its radio, as in a flight; plants are nominal. Then the whole lab in real time, with a client for each vehicle
in another process: what part of a core it takes.
"""

import argparse
import contextlib
import json
import math
import multiprocessing
import random
import socket
import statistics
import struct
import sys
import time
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from ardrone_autonomy import protocol
from ardrone_autonomy.protocol import at, navdata
from risc_lab.lab import generated_fleet, load_templates, load_vehicle_type
from risc_simulator.models.flight import FlightPhase, Setpoint
from risc_simulator.models.mocap_cameras import MocapCameras
from risc_simulator.vehicles.iris.firmware import Mode, RcFrame
from risc_simulator.vehicles.iris.host import STANDARD_PORTS, system_id
from risc_simulator.virtual_lab import VirtualLab
from risc_simulator.world import World
from rosserial_python.protocol import FIRST_TOPIC, REQUEST_TOPICS, encode

COUNTS = (1, 3, 10, 50)
REPEATS = 5
WARM_UP_S = 0.5
LAB_TAKE_OFF_S, LAB_MEASURED_S = 6.0, 5.0
REQUIRED_TIMES_REAL_TIME = {1: 200.0}
TYPES = "ardrone", "iris"
_COMMANDS_HZ = {"ardrone": 30.0, "iris": 45.0}
_ARMED_AFTER_S, _CLIMB_S = 2.0, 1.5  # an IRIS+, with its throttle at the lowest; by the stick of ALT_HOLD


def make_fleet(count, kind="ardrone"):
    """Fleet of `count` vehicles of a type in a net that is large enough, and nothing else."""
    net = "127.%d" % random.SystemRandom().randint(210, 249)  # another run may be under way
    fleet = generated_fleet(count)
    wide = load_vehicle_type(kind).radius_m / load_vehicle_type("ardrone").radius_m  # it is made for AR.Drones
    arena = replace(fleet.arena, half_x_m=wide * fleet.arena.half_x_m, half_y_m=wide * fleet.arena.half_y_m)
    vehicles = []
    for vehicle in fleet.vehicles:
        x, y, z = vehicle.start.position_m
        start = replace(vehicle.start, position_m=(wide * x, wide * y, z))
        vehicles.append(replace(vehicle, type=kind, start=start))
    vehicles = tuple(vehicles)
    return replace(fleet, arena=arena, vehicles=vehicles, landmarks=()).in_subnet(net)


def make_world(count, kind="ardrone", seed=0):
    """World of make_fleet(), and where its vehicles are to fly [m]."""
    fleet = make_fleet(count, kind)
    # without control, vehicles that are not level would fly into each other: plants are nominal
    types, templates = {kind: load_vehicle_type(kind)}, load_templates(fleet=fleet)
    world = World(fleet, types, templates, seed=seed, perturbed=False)
    return world, [vehicle.start.position_m[:2] + (1.5,) for vehicle in fleet.vehicles]


def start_flight(world, places_m, duration_s):
    """Let the vehicles fly to and fro around the places for duration_s [s] of world time, from now on."""
    for index, (vehicle, place_m) in enumerate(zip(world.vehicles.values(), places_m)):
        vehicle.fly_at(place_m)
        if vehicle.type.name == "iris":
            vehicle.firmware.set_mode(Mode.ALT_HOLD)
        rate_hz = vehicle.type.command_rate_hz
        for k in range(int(duration_s * rate_hz)):
            swing = 2.0 * math.pi * (k / rate_hz + 0.1 * index)
            vehicle.schedule(world.time_s + k / rate_hz, _command(vehicle.type.name, swing))


def _command(kind, swing):
    """Command to fly to and fro. swing: phase [rad]."""
    c, s = math.cos(swing), math.sin(swing)
    if kind == "iris":
        return RcFrame((1500 + round(50 * c), 1500 + round(50 * s), 1500 + round(150 * s), 1520))
    return Setpoint(0.05 * c, 0.05 * s, 0.05 * s, 0.2)


def fly(world, places_m, duration_s):
    """Fly as start_flight() says. Returns the computing time [s]."""
    start_flight(world, places_m, duration_s)
    clock_s = time.perf_counter()
    world.step_to(world.time_s + duration_s)
    return time.perf_counter() - clock_s


def watch(world, places_m, duration_s):
    """Fly, seen by cameras in every step. Returns the median times [us] of a step and of a frame."""
    cameras = MocapCameras(seed=0)
    start_flight(world, places_m, duration_s)
    start_s, step_s, frame_s = world.time_s, [], []
    for k in range(1, int(duration_s / world.step_s) + 1):
        clock_s = time.perf_counter()
        world.step_to(start_s + k * world.step_s)
        stepped_s = time.perf_counter()
        cameras.observe(world.time_s, world.layout, world.markers_m())
        step_s.append(stepped_s - clock_s)
        frame_s.append(time.perf_counter() - stepped_s)
    return 1e6 * statistics.median(step_s), 1e6 * statistics.median(frame_s)


def measure(count, kind="ardrone", repeats=REPEATS, duration_s=None):
    """{"vehicles", "times_real_time", "us_per_step", "repeats", "step_us", "frame_us"}: medians.

    times_real_time, us_per_step: of the world alone, in long strides; step_us and frame_us: of single steps, and of the
    cameras' frame after each.
    Raises RuntimeError when a vehicle crashed, for then the figure would mean nothing.
    """
    if duration_s is None:
        duration_s = max(1.0, 5.0 / math.sqrt(count))
    world, places_m = make_world(count, kind)
    fly(world, places_m, WARM_UP_S)
    took_s = statistics.median(fly(world, places_m, duration_s) for _ in range(repeats))
    step_us, frame_us = watch(world, places_m, duration_s)
    if world.crashes:
        raise RuntimeError("bench: %s %s" % (world.crashes[0].namespace, world.crashes[0].reason))
    return {
        "vehicles": count,
        "times_real_time": duration_s / took_s,
        "us_per_step": 1e6 * took_s / (duration_s / world.step_s),
        "repeats": repeats,
        "step_us": step_us,
        "frame_us": frame_us,
    }


def measure_lab(count, kind="ardrone", take_off_s=LAB_TAKE_OFF_S, measured_s=LAB_MEASURED_S):
    """{"lab_cores", "lab_late_ms", "lab_flying"}: cores that the lab uses, the 99th percentile of its lateness, and how
    many vehicles fly at the end."""
    fleet = make_fleet(count, kind)
    lab = VirtualLab(fleet, live=True)
    pilots = multiprocessing.get_context("fork").Process(target=_PILOTS[kind], args=(fleet,), daemon=True)
    pilots.start()
    try:
        lab.run(duration_s=take_off_s)
        start_s, clock_s = lab.exposure_s, time.process_time()
        lab.run(duration_s=take_off_s + measured_s)
        cores = (time.process_time() - clock_s) / (lab.exposure_s - start_s)
        return {
            "lab_cores": cores,
            "lab_late_ms": 1e3 * lab.lateness.percentile_s(99.0),
            "lab_flying": sum(vehicle.phase is FlightPhase.FLYING for vehicle in lab.world.vehicles.values()),
        }
    finally:
        pilots.terminate()
        pilots.join()
        lab.close()


def _pilot_ardrones(fleet):
    """A client for each vehicle: sends commands at the rate of a driver, reads what comes back. Until terminated."""
    with contextlib.ExitStack() as stack:
        clients = []
        for vehicle in fleet.vehicles:
            client = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            client.setblocking(False)
            clients.append((client, vehicle.address))
        start_s, k = time.monotonic(), 0
        while True:
            for client, address in clients:
                swing = 2.0 * math.pi * k / _COMMANDS_HZ["ardrone"]  # once a second: they stay where they are
                commands = at.ref(3 * k + 1, start=True) + at.pcmd_mag(
                    3 * k + 2, at.PcmdFlag.PROGRESSIVE, 0.2 * math.cos(swing), 0.2 * math.sin(swing)
                )
                if k < 10:
                    commands += at.encode("CONFIG", 3 * k + 3, "general:navdata_demo", "TRUE")
                    client.sendto(navdata.WAKE_UP, (address, protocol.NAVDATA_PORT))
                client.sendto(commands, (address, protocol.AT_PORT))
                with contextlib.suppress(BlockingIOError):
                    while True:
                        client.recv(65536)
            k += 1
            time.sleep(max(0.0, start_s + k / _COMMANDS_HZ["ardrone"] - time.monotonic()))


def _pilot_irises(fleet):
    """Two clients for each vehicle: Controls over its serial line, and telemetry at 10 Hz. Until terminated."""
    with contextlib.ExitStack() as stack:
        clients = []
        for vehicle in fleet.vehicles:
            line = stack.enter_context(socket.create_connection((vehicle.address, STANDARD_PORTS.arduino), 10.0))
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            telemetry = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            telemetry.connect((vehicle.address, STANDARD_PORTS.telemetry))
            line.setblocking(False)
            telemetry.setblocking(False)
            line.send(REQUEST_TOPICS)
            clients.append((vehicle, line, telemetry, mavlink.MAVLink(None, 255, 190)))
        start_s, k = time.monotonic(), 0
        while True:
            flown_s = k / _COMMANDS_HZ["iris"] - _ARMED_AFTER_S
            swing = 2.0 * math.pi * flown_s
            throttle = -1.0 if flown_s < 0.0 else 0.6 if flown_s < _CLIMB_S else 0.0
            sticks = struct.pack("<4d", 0.1 * math.cos(swing), 0.1 * math.sin(swing), 0.0, throttle)
            for vehicle, line, telemetry, codec in clients:
                name = vehicle.template.encode()
                # a risc_msgs/Controls with an empty header
                line.send(encode(FIRST_TOPIC, struct.pack("<6I", 0, 0, 0, 0, 1, len(name)) + name + sticks))
                system = system_id(vehicle.address)
                orders = ()
                if k == 1:
                    orders = (
                        mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3),
                        mavlink.MAVLink_request_data_stream_message(system, 1, 0, 10, 1),
                        mavlink.MAVLink_set_mode_message(system, 1, Mode.ALT_HOLD),
                    )
                elif k % 10 == 0 and 0.5 < k / _COMMANDS_HZ["iris"] < _ARMED_AFTER_S - 0.2:  # it may not be ready yet
                    arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
                    orders = (mavlink.MAVLink_command_long_message(system, 1, arm, 0, 1, 0, 0, 0, 0, 0, 0),)
                for order in orders:
                    telemetry.send(order.pack(codec))
                for client in (line, telemetry):
                    with contextlib.suppress(BlockingIOError):
                        while True:
                            client.recv(65536)
            k += 1
            time.sleep(max(0.0, start_s + k / _COMMANDS_HZ["iris"] - time.monotonic()))


_PILOTS = {"ardrone": _pilot_ardrones, "iris": _pilot_irises}


def main(arguments=None):
    """Command line. Returns 1 when a required speed is missed."""
    parser = argparse.ArgumentParser(prog="world.py", description="Speed of the virtual lab, offline and in real time.")
    parser.add_argument("--type", choices=TYPES, default="ardrone", help="of the vehicles (default: ardrone)")
    parser.add_argument("--json", metavar="FILE", help="write the table there too")
    options = parser.parse_args(arguments)
    print(
        "offline on one core, step 5 ms (median of %d); the whole lab at 200 Hz, a client for each vehicle:" % REPEATS
    )
    print("                             world alone  |  world   cameras  |  whole lab   late p99")
    print("  vehicles   times real time   us / step  |  us / step, frame  |      cores         ms   required")
    rows = []
    for count in COUNTS:
        row = {**measure(count, options.type), **measure_lab(count, options.type)}
        required = REQUIRED_TIMES_REAL_TIME.get(count)
        print(
            "  %8d   %15.0f   %9.1f  |  %5.1f  %8.1f  |  %9.3f  %9.2f   %s"
            % (
                count,
                row["times_real_time"],
                row["us_per_step"],
                row["step_us"],
                row["frame_us"],
                row["lab_cores"],
                row["lab_late_ms"],
                ">= %g times real time" % required if required else "-",
            ),
            flush=True,
        )
        rows.append(row)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as stream:
            json.dump({"offline_world": rows}, stream, indent=2)
            stream.write("\n")
    met = all(row["times_real_time"] >= REQUIRED_TIMES_REAL_TIME.get(row["vehicles"], 0.0) for row in rows)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
