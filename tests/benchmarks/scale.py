"""The cost of more vehicles: the whole graph, motion capture to states alone, and the closed loop offline.

graph        `maap fly` with N vehicles (simulated); latency from the datagram to cmd_vel
estimation   virtual cameras -> stream_markers -> states_estimation -> a subscriber, N bodies of five markers that
             stand in the net; latency from the datagram to the states
offline      the closed loop without ROS, on one core, as fast as possible

Loaded: a busy loop takes what it can of one core meanwhile. Each row is a process of its own, or a flight.
"""

import argparse
import contextlib
import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace

import numpy as np
import psutil
import yaml

from risc_experiments.estimators import add_option
from risc_experiments.fly import STATES

ROOT = pathlib.Path(__file__).resolve().parents[2]
COUNTS = {"graph": (1, 3, 5, 10, 20, 50), "estimation": (1, 3, 10, 20, 50, 100), "offline": (1, 3, 10, 20, 50)}
FIGURES = ("p50_ms", "p99_ms", "frames_lost", "cpu_cores", "memory_mb", "times_real_time")
SETTLE_S = 5.0  # from the first state of a node to the measurement
START_S = 60.0  # that a launch may take until states come
RATE_HZ = 200.0
_MOST_WORDS = 120  # characters of why a row failed, in the table
COURSE, SEED = "circles3", 1
ESTIMATION_LAUNCH = """<launch>
  <arg name="fleet"/>
  <rosparam command="load" file="$(arg fleet)" ns="fleet"/>
  <include file="{launch}/lab.launch">
    <arg name="fleet" value="$(arg fleet)"/>
    <arg name="statistics" value="$(dirname)/virtual_lab.json"/>
  </include>
  <include file="{launch}/mocap.launch">
    <arg name="fleet" value="$(arg fleet)"/>
    <arg name="estimator" value="{estimator}"/>
    <arg name="states" value="{states}"/>
  </include>
</launch>
"""
PEERS = {  # {what pip installs: program; it prints the version, the simulation's rate [Hz] and times real time}
    "rotorpy": """
import importlib.metadata, time
import numpy
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.environments import Environment
from rotorpy.trajectories.circular_traj import ThreeDCircularTraj
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor
for rate_hz in (100, 200):
    for duration_s in (1.0, 20.0):  # the first loads what is needed
        course = ThreeDCircularTraj(numpy.zeros(3), numpy.array([0.35, 0.35, 0.0]), numpy.array([0.12, 0.12, 0.0]))
        loop = Environment(Multirotor(quad_params), SE3Control(quad_params), course, sim_rate=rate_hz)
        begin = time.perf_counter()
        loop.run(t_final=duration_s, use_mocap=True, terminate=False, plot=False, animate_bool=False, verbose=False)
        times = duration_s / (time.perf_counter() - begin)
    print("RotorPy", importlib.metadata.version("rotorpy"), rate_hz, times)
""",
    "gym-pybullet-drones": "raise SystemExit('it can be had now, and no flight of it is written here')",
}
PEER_S = 600.0  # limit for a peer's installation, and for its flight


@contextlib.contextmanager
def busy_loop(wanted):
    """Run a program that never waits, while the block runs."""
    program = subprocess.Popen([sys.executable, "-c", "while True: pass"]) if wanted else None
    try:
        yield
    finally:
        if program is not None:
            program.kill()
            program.wait()


def graph(vehicles, args):
    """Figures of a flight. Its rate is given, so it does not continue at a lower one on a computer that is too slow."""
    folder = args.folder
    command = [sys.executable, "-m", "risc_experiments.fly", "--vehicles", str(vehicles), "--seed", str(SEED)]
    command += ["--trajectory", COURSE, "--duration", "%g" % args.seconds, "--mocap-rate", "%g" % RATE_HZ]
    command += ["--estimator", args.estimator] if args.estimator else []
    command += ["--states", args.states, "--out", str(folder / "flight")]
    with (folder / "fly.txt").open("w") as log:
        subprocess.call(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    path = folder / "flight" / "summary.json"
    if not path.exists():
        return {"passed": False, "reasons": [(folder / "fly.txt").read_text(encoding="utf-8")[-300:]]}
    summary = json.loads(path.read_text(encoding="utf-8"))
    mocap, latency_ms = summary["mocap"], summary["latency_ms"]["datagram_to_cmd_vel"]
    rmse_m = [vehicle["position_rmse_m"] for vehicle in summary["vehicles"].values()]
    return {
        "p50_ms": latency_ms["p50"],
        "p99_ms": latency_ms["p99"],
        "frames_lost": mocap["frames_sent"] - mocap["frames_estimated"],
        "cpu_cores": sum(summary["cpu_cores"].values()),
        "memory_mb": sum(summary["memory_mb"].values()),
        "mocap_hz": mocap["rate_hz"],
        "rmse_mm": None if None in rmse_m or not rmse_m else 1e3 * max(rmse_m),
        "passed": summary["passed"],
        "reasons": summary["reasons"],
    }


def estimation(bodies, args):
    """Figures of motion capture and estimation alone."""
    import rospy

    from risc_estimation.filters import DEFAULT
    from risc_experiments.processor_use import ProcessorUse
    from risc_lab.lab import generated_fleet
    from risc_lab.ros import low_latency
    from risc_lab.ros.fleet_messages import CortexArrays
    from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port
    from risc_maap_msgs.msg import MocapTime

    folder, reservation, port = args.folder, PortReservation(), free_tcp_port()
    fleet = _of_five_markers(replace(generated_fleet(bodies), landmarks=())).in_subnet(reservation.subnet)
    (folder / "fleet.yaml").write_text(yaml.safe_dump(fleet.to_dict()), encoding="utf-8")
    text = ESTIMATION_LAUNCH.format(launch=ROOT / "launch", estimator=args.estimator or DEFAULT, states=args.states)
    (folder / "estimation.launch").write_text(text, encoding="utf-8")
    os.environ.update(ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1")
    launch = Launch(folder / "estimation.launch", {"fleet": folder / "fleet.yaml"}, folder, port)
    try:
        _wait(lambda: _master_answers(port), launch)
        low_latency.start("scale")
        sent, states, seen = [], [], CortexArrays()  # of (stamp, receipt) [ns]

        def on_time(message):
            sent.append((message.header.stamp.to_nsec(), message.receipt.to_nsec()))

        def on_states(message):
            now_ns = time.time_ns()
            estimate = seen.deserialize(message.buff)
            states.append((estimate.header.stamp.to_nsec(), now_ns, int(estimate.visible.sum())))

        rospy.Subscriber("/mocap_time", MocapTime, on_time, tcp_nodelay=True)
        rospy.Subscriber("/" + args.states, CortexArrays.Raw, on_states, buff_size=2**22, tcp_nodelay=True)
        _wait(lambda: len(states) > RATE_HZ, launch)
        time.sleep(SETTLE_S)
        use = ProcessorUse(launch.identity)
        use.look()
        first = len(states)
        time.sleep(args.seconds)
        last = len(states)
        use.look()
        time.sleep(0.5)
    finally:
        launch.stop()
        reservation.close()
    times = np.array(states[first:last], dtype=np.int64)
    datagrams, stamps = dict(sent), np.unique(times[:, 0])
    predicted = sum(stamp not in datagrams for stamp in stamps.tolist())
    latency_ms = [1e-6 * (receipt - datagrams[stamp]) for stamp, receipt, _ in times.tolist() if stamp in datagrams]
    expected = 1 + round((times[-1, 0] - times[0, 0]) * 1e-9 * RATE_HZ)
    figures = use.figures()
    own = pathlib.Path(__file__).name
    return {
        "p50_ms": float(np.percentile(latency_ms, 50.0)),
        "p99_ms": float(np.percentile(latency_ms, 99.0)),
        "max_ms": float(np.max(latency_ms)),
        "frames": expected,
        "frames_lost": expected - len(stamps),
        "predicted": predicted,  # states between frames: a filter gives them where a frame is late
        "not_visible": int(bodies * len(times) - times[:, 2].sum()),
        "cpu_cores": sum(cores for name, cores in figures["cpu_cores"].items() if own not in name),
        "memory_mb": sum(mb for name, mb in figures["memory_mb"].items() if own not in name),
    }


def _of_five_markers(fleet):
    """The fleet with generated hulls for all bodies: those of the laboratory have four or five markers."""
    from risc_lab.lab import generated_fleet

    many = generated_fleet(len(fleet.vehicles) + 5)
    hulls = [vehicle.template for vehicle in many.vehicles[5:]]
    vehicles = tuple(replace(vehicle, template=hull) for vehicle, hull in zip(fleet.vehicles, hulls))
    known = many.templates
    return replace(fleet, vehicles=vehicles, templates=replace(known, templates={h: known.templates[h] for h in hulls}))


def _wait(done, launch):
    deadline = time.monotonic() + START_S
    while not done():
        if not launch.running() or time.monotonic() > deadline:
            raise RuntimeError("no states came:\n" + launch.log_tail())
        time.sleep(0.1)


def _master_answers(port):
    import xmlrpc.client

    try:
        return xmlrpc.client.ServerProxy("http://127.0.0.1:%d" % port).getPid("/scale")[0] == 1
    except OSError:
        return False


def offline(vehicles, args):
    """Figures of the closed loop on one core."""
    from risc_experiments.offline import Flight, fly

    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    flight = Flight(trajectory=COURSE, vehicles=1, seed=SEED, estimator=args.estimator, duration_s=1.0)
    fly(flight)  # loads what is compiled
    used_s = sum(os.times()[:2])
    result = fly(replace(flight, vehicles=vehicles, duration_s=args.seconds))
    return {
        "cpu_cores": (sum(os.times()[:2]) - used_s) / result.took_s,
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        "times_real_time": result.flown_s / result.took_s,
        "rmse_mm": 1e3 * float(result.rmse_m.max()),
    }


def row_of(kind, vehicles, loaded, options):
    """One row, measured in a process of its own. options: for its command line."""
    row = dict({"kind": kind, "vehicles": vehicles, "loaded": loaded}, **dict.fromkeys(FIGURES))
    begin_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, busy_loop(loaded):
        command = [sys.executable, __file__, *options, "--row", kind, str(vehicles), "--folder", folder]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        row.update(json.loads(done.stdout.splitlines()[-1]))
    else:
        sys.stderr.write(done.stderr)
        row.update(passed=False, reasons=done.stderr.splitlines()[-1:])
    return dict(row, took_s=time.monotonic() - begin_s)


def slopes(rows):
    """Straight lines through the rows of each kind and load: [(kind, loaded, figure, at 0 vehicles, per vehicle)]."""
    found = []
    for kind in COUNTS:
        for loaded in (False, True):
            for figure in ("p99_ms", "cpu_cores", "memory_mb") if kind != "offline" else ("seconds_per_second",):
                points = [
                    (row["vehicles"], 1.0 / row["times_real_time"] if kind == "offline" else row[figure])
                    for row in rows
                    if row["kind"] == kind and row["loaded"] == loaded
                    and row["times_real_time" if kind == "offline" else figure] is not None
                ]  # fmt: skip
                if len(points) > 2:
                    each, none = np.polyfit(*np.transpose(points), 1).tolist()
                    found.append((kind, loaded, figure, none, each))
    return found


def peers(rows):
    """[{name, rate_hz, times_real_time, ratio}] of simulators from PyPI, one vehicle on a circle, offline.

    ratio: how many times as fast we are, in the same run of this program. Those that cannot be installed are named.
    """
    ours = next((r["times_real_time"] for r in rows if r["kind"] == "offline" and r["vehicles"] == 1), None)
    found = []
    for package, program in PEERS.items():
        with tempfile.TemporaryDirectory() as folder:
            try:
                told = _run_peer(pathlib.Path(folder), package, program)
            except (RuntimeError, subprocess.TimeoutExpired) as error:
                print("offline, one vehicle: no %s: %s" % (package, error))
                continue
        for line in told.splitlines():
            name, version, rate_hz, times = line.split()
            ratio = ours and ours / float(times)
            found.append({"name": "%s %s" % (name, version), "rate_hz": float(rate_hz),
                          "times_real_time": float(times), "ratio": ratio})  # fmt: skip
            print("offline, one vehicle: %s %s at %s Hz flies %.1f times real time" % (name, version, rate_hz,
                  float(times)) + ("" if ratio is None else ", we %.0f times as fast" % ratio))  # fmt: skip
    return found


def _run_peer(folder, package, program):
    """What the program prints in an environment with only the package. Raises RuntimeError, TimeoutExpired."""
    python = str(folder / "bin" / "python")
    for command in (
        [sys.executable, "-m", "venv", str(folder)],
        [python, "-m", "pip", "install", "-q", package],
        [python, "-c", program],
    ):
        done = subprocess.run(command, capture_output=True, text=True, timeout=PEER_S, check=False)
        if done.returncode != 0:
            raise RuntimeError((done.stderr.strip().splitlines() or ["exit code %d" % done.returncode])[-1])
    return done.stdout


def computer():
    """One line that describes this computer."""
    with open("/proc/cpuinfo", encoding="utf-8") as info:
        model = next((line.partition(":")[2].strip() for line in info if line.startswith("model name")), "unknown")
    return "%s, %d cores, %.0f GB" % (model, psutil.cpu_count(), psutil.virtual_memory().total / 1e9)


def main():
    """Command line. Returns the exit code: 1 when a row could not be measured, or its flight failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--json", type=pathlib.Path, metavar="FILE", help="write the rows here, after each one")
    add("--kinds", nargs="+", choices=list(COUNTS), default=list(COUNTS))
    add("--vehicles", nargs="+", type=int, metavar="N", help="default: 1 to 50, of estimation to 100")
    add("--seconds", type=float, default=20.0, help="that are measured (default: 20)")
    add("--load", choices=("quiet", "loaded", "both"), default="both")
    add("--peers", action="store_true", help="install simulators of others from PyPI, and compare (offline)")
    add_option(add)
    add("--states", choices=STATES, default=STATES[0], help="of graph and estimation, as those of maap fly")
    add("--row", nargs=2, help=argparse.SUPPRESS)
    add("--folder", type=pathlib.Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.row:
        kind, vehicles = args.row
        measure = {"graph": graph, "estimation": estimation, "offline": offline}[kind]
        print(json.dumps(measure(int(vehicles), args)))
        return 0
    options = ["--seconds", "%g" % args.seconds, "--states", args.states]
    options += ["--estimator", args.estimator] if args.estimator else []
    print("%s (simulated)" % computer())
    columns = "%-10s %8s %-6s %9s %9s %6s %6s %8s %8s"
    heading = ("kind", "vehicles", "load", "p50", "p99", "lost", "cores", "memory", "speed")
    print(columns % heading, flush=True)
    rows, found = [], []
    figures = {"computer": computer(), "rows": rows, "peers": found}
    for kind in args.kinds:
        for loaded in {"quiet": (False,), "loaded": (True,), "both": (False, True)}[args.load]:
            for vehicles in args.vehicles or COUNTS[kind]:
                row = row_of(kind, vehicles, loaded, options)
                rows.append(row)
                reasons = " ".join("; ".join(row.get("reasons", ())).split())
                problem = "" if row.get("passed", True) else "  failed: " + reasons[:_MOST_WORDS]
                print(columns % (kind, vehicles, "loaded" if loaded else "quiet", *_cells(row)) + problem, flush=True)
                _write(args.json, figures)
    for kind, loaded, figure, none, each in slopes(rows):
        name = "%s, %s: %s" % (kind, "loaded" if loaded else "quiet", figure.replace("_", " "))
        print("%-36s %8.3f + %.4f for each vehicle" % (name, none, each))
    print("%d rows in %.1f minutes" % (len(rows), sum(row["took_s"] for row in rows) / 60.0), flush=True)
    if args.peers:
        found += peers(rows)
        _write(args.json, figures)
    return 0 if all(row.get("passed", True) and any(row[name] is not None for name in FIGURES) for row in rows) else 1


def _cells(row):
    formats = ("%.1f ms", "%.1f ms", "%d", "%.2f", "%.0f MB", "%.1fx")
    return ["-" if row[name] is None else form % row[name] for name, form in zip(FIGURES, formats)]


def _write(path, figures):
    if path is not None:
        path.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
