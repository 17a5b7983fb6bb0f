"""`./maap fly`: a whole flight in the virtual lab, from start-up to the table of results."""

import argparse
import contextlib
import datetime
import json
import math
import os
import pathlib
import signal
import socket
import sys
import threading
import time
import xmlrpc.client
from dataclasses import replace

import yaml

from cortex_ros.wire import MAX_BODIES
from data_extraction.progress import Progress
from data_extraction.report.origin import PROCESSORS
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_control.controllers import own_params
from risc_control.feasibility import fleet_course
from risc_control.trajectories import COURSES, YawProgram, find_course
from risc_experiments.estimators import add_option, estimator_of
from risc_experiments.faults_list import fault_option
from risc_experiments.fleets import default_fleet
from risc_experiments.flight_progress import flight_detail
from risc_experiments.flight_record import course_name, write_flight, write_parameters
from risc_experiments.headroom import RATES_HZ, READY_S, Headroom, next_rate_hz
from risc_experiments.operator import OperatorParams, course_s, time_limit_s
from risc_experiments.option_types import course, number, speed
from risc_experiments.processor_use import ProcessorUse
from risc_experiments.report import WITH_CAMERAS, make_report
from risc_lab.lab import load_fleet
from risc_lab.lab.calibration import load_calibration
from risc_lab.phases import OperatorPhase
from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port
from risc_simulator.faults import FaultFile, load_fault_file
from risc_simulator.virtual_lab import LabOptions

ROOT = pathlib.Path(os.environ.get("RISC_MAAP_ROOT", "."))
STOP_PATIENCE_S = 40.0  # for landing after Ctrl-C
SILENT_S = 5.0  # an operator that publishes nothing for so long has died
HUNG_S = 15.0  # ... that a fault has stopped is then continued: the ladders have landed all vehicles by then
LONGEST_DELAY_S = 0.5  # well inside what the controller can look ahead
CONTROLLER = "differential_flatness"
SEED = 1  # default seed of a flight
STATES = "cortex_raw", "cortex_ekf"  # state topics that a controller may use
WAYPOINTS = "waypoints.yaml"  # file of the flight's waypoints, in its folder
BROWSER_PORT = 8080  # of the web page, unless another program has it
IN_THE_AIR = range(OperatorPhase.TAKEOFF, OperatorPhase.LAND + 1)
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # end the flight
TRIED_RATES = "RISC_MAAP_TRIED_RATES"  # environment variable for the process that starts over at a lower rate
USE_PERIOD_S = 2.0  # how often processor use is recorded
START_MARGIN_S = 30.0  # for nodes to start, in addition to the operator's own limits
EXPERIMENTS = {
    "circles3": "several vehicles on courses (default)",
    "df_demo": "one vehicle, the figures of the lab course",
    "iris": "the same figures with an IRIS+",
    "coop": "as circles3 with cameras: landmarks are seen, bearings measured",
}
BUMPER_STEPS = {"df_demo": 5, "iris": 5}  # one vehicle: three figures, chosen by the bumper, and a rest before each


class FlightError(Exception):
    """The flight could not be carried out; the text says why and what to do."""


def arguments(argv):
    """Command line -> argparse namespace."""
    parser = options()
    args = parser.parse_args(argv)
    complete(args, parser.error)
    return args


def options():
    """Parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="maap fly", description="Fly in the virtual lab: take off, fly, come home, land; record and report."
    )
    add = parser.add_argument
    help_text = "; ".join("%s: %s" % item for item in EXPERIMENTS.items())
    add("experiment", nargs="?", default="circles3", choices=EXPERIMENTS, help=help_text)
    add("--vehicles", type=number(1), metavar="N", help="how many vehicles (default: 3; df_demo, iris: 1)")
    trajectory_help = "course to fly: %s, or a file of waypoints (default: circles3)" % ", ".join(sorted(COURSES))
    add("--trajectory", type=course, metavar="NAME|FILE.yaml", help=trajectory_help)
    speed_help = "largest speed on the course [m/s], or e.g. 2x: twice as fast as by its numbers"
    add("--speed", type=speed, metavar="M_S", help=speed_help)
    add("--controller", metavar="NAME", help="of risc_control.controllers, or your own (default: %s)" % CONTROLLER)
    psi_help = "constant heading, + clockwise (default: the course's own)"
    add("--psi", type=number(-math.inf), metavar="DEG", help=psi_help)
    add(
        "--duration",
        type=number(5.0, 600.0),
        metavar="S",
        help="time on each course (default: 30 s; df_demo, iris: 20 s, of which the way to a figure takes about 5 s)",
    )
    seed_help = "of everything random (default: that of --faults FILE.yaml, else %d)" % SEED
    add("--seed", type=number(0), metavar="N", help=seed_help)
    delay_help = "command delay (default: that of the type, e.g. 0.1 s)"
    add("--delay", type=number(0.0, LONGEST_DELAY_S), metavar="S", help=delay_help)
    rate_help = "of motion capture (default: 200, less if it must be)"
    add("--mocap-rate", type=number(RATES_HZ[-1], 500.0), metavar="HZ", help=rate_help)
    add_option(add)
    states_help = "what the controller flies by: /cortex_raw, or /cortex_ekf of quad_EKF.py (default: %s)" % STATES[0]
    add("--states", choices=STATES, default=STATES[0], help=states_help)
    add("--ideal", action="store_true", help="plant exactly as the controllers believe it to be")
    add("--gusts", action="store_true", help="with gusts of wind")
    add("--rviz", action="store_true", help="open rviz")
    add("--browser", action="store_true", help="show the flight as a web page, whose address is printed")
    fps_help = "pictures a second of each camera (coop; default: 15)"
    add("--fps", type=number(1.0, 30.0), metavar="HZ", help=fps_help)
    fault_help = (
        "let a fault happen, so many seconds after all are on the course; repeatable. Which there are: ./maap faults"
    )
    add("--fault", type=fault_option, action="append", default=[], metavar="NAME[:ARG][@SECONDS]", help=fault_help)
    faults_help = "the same from a file: its list `faults`; and its `seed`, if it has one"
    add("--faults", type=fault_file, default=FaultFile(()), metavar="FILE.yaml", help=faults_help)
    add("--fleet", type=pathlib.Path, metavar="YAML", help="fleet file (default: launch/fleets/, from 6 on generated)")
    add("--out", type=pathlib.Path, metavar="DIR", help="folder for the results (default: flights/...)")
    return parser


def complete(args, error):
    """Fill in options that depend on others. error: called with a message when options are wrong."""
    demo = args.experiment in BUMPER_STEPS
    args.vehicles = args.vehicles or (1 if demo else 3)
    args.duration = args.duration or (20.0 if demo else 30.0)
    if demo and (args.vehicles != 1 or args.trajectory):
        text = "%s is for one vehicle and flies its own figures: leave out --vehicles and --trajectory"
        error(text % args.experiment)
    if demo and args.speed:
        error("%s flies its own figures: leave out --speed" % args.experiment)
    if demo and args.controller:
        error("%s is controller and trajectory in one: leave out --controller" % args.experiment)
    args.controller = args.controller or CONTROLLER
    try:
        CONTROLLERS.module(args.controller)
    except ValueError as problem:
        error("--controller: %s" % problem)
    if args.fps is not None and args.experiment != "coop":
        error("--fps is for coop: the other experiments use no cameras")
    if args.seed is None:
        args.seed = SEED if args.faults.seed is None else args.faults.seed
    args.faults = (*args.fault, *args.faults.faults)
    del args.fault
    limit_s = course_s(operator_params(args))
    for event in args.faults:
        if not 0.0 <= event.start_s < limit_s:
            error("--fault %s: it must start 0 to %g s after all are on the course" % (event, limit_s))
    args.estimator = estimator_of(args.controller, args.estimator)


def fault_file(path):
    """Type of an option: faults.FaultFile."""
    try:
        return load_fault_file(path)
    except (ValueError, OSError) as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def prepare_folder(args, name=None, holds="flight.bag"):
    """Make the folder of this flight. Returns its path. Raises FlightError when it holds a flight already.

    name: follows the date in the folder's name; None: name of the course.  holds: file that shows a flight is there.
    """
    if args.out is not None:
        if (args.out / holds).exists():
            raise FlightError("%s holds a flight already: choose another --out" % args.out)
        args.out.mkdir(parents=True, exist_ok=True)
        return args.out.resolve()
    stem = datetime.datetime.now().strftime("%Y%m%d-%H%M%S_") + (name or course_name(args))
    for suffix in ("", *("-%d" % k for k in range(2, 100))):
        folder = ROOT / "flights" / (stem + suffix)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder.resolve()
    raise FlightError("flights/%s exists 99 times" % stem)


def prepare_fleet(args, subnet, folder):
    """The fleet of this flight, moved to its own loopback subnet and written beside the results.

    Raises ValueError for a bad file, or a course that is not for this many vehicles or exceeds what they can do;
    FlightError when there are more bodies than motion capture can show, or a vehicle lacks what the experiment needs
    (its type, a calibration).
    """
    chosen = find_course(args.trajectory or "circles3")
    if args.fleet is None:
        fleet = default_fleet(args.vehicles, chosen, args.experiment)
    else:
        fleet = load_fleet(args.fleet).with_vehicles(args.vehicles)
    first = fleet.vehicles[0]
    if args.experiment == "iris" and "iris" not in (first.type, first.vehicle_type.driver):
        text = "iris flies an IRIS+, and the first vehicle of fleet '%s' is of type '%s': use another fleet file"
        raise FlightError(text % (fleet.name, first.type))
    counts = len(fleet.vehicles), len(fleet.landmarks)
    if sum(counts) > MAX_BODIES:
        text = "%d vehicles and %d landmarks are %d bodies, Cortex's clients hold %d: fly fewer vehicles"
        raise FlightError(text % (*counts, sum(counts), MAX_BODIES))
    # better to fail now than in the air
    if args.experiment not in BUMPER_STEPS:
        yaw = None if args.psi is None else YawProgram(math.radians(args.psi))
        late = fleet.with_overrides(command_delay_s=args.delay)  # it needs more room to stop
        fleet_course(chosen, late.vehicles, fleet.arena, args.speed or "", yaw)
    own_params(args.controller, fleet.vehicles, args.fleet)
    fleet = fleet.in_subnet(subnet)
    if args.mocap_rate is not None:
        fleet = replace(fleet, mocap=replace(fleet.mocap, rate_hz=args.mocap_rate))
    for vehicle in fleet.vehicles if args.experiment in WITH_CAMERAS else ():
        if not vehicle.calibration:
            raise FlightError(
                "%s measures bearings, but %s has no camera calibration: give it one in the fleet file%s, or fly "
                "fewer vehicles" % (args.experiment, vehicle.namespace, " %s" % args.fleet if args.fleet else "")
            )
        load_calibration(vehicle.calibration)  # without it the driver flies, but no bearings are measured
    (folder / "fleet.yaml").write_text(yaml.safe_dump(fleet.to_dict(), sort_keys=False), encoding="utf-8")
    if args.trajectory and args.trajectory not in COURSES:
        (folder / WAYPOINTS).write_bytes(pathlib.Path(args.trajectory).read_bytes())
    return load_fleet(folder / "fleet.yaml")


def launch_arguments(args, fleet, folder):
    """Arguments of the launch file, {name: value}."""
    result = {
        "fleet": folder / "fleet.yaml",
        "vehicles": " ".join(vehicle.namespace for vehicle in fleet.vehicles),
        "duration": args.duration,
        "seed": args.seed,
        "ideal": str(args.ideal).lower(),
        "gusts": str(args.gusts).lower(),
        "delay": -1.0 if args.delay is None else args.delay,
        "statistics": folder / "virtual_lab.json",
        "bag": folder / "flight.bag",
        "rviz": str(args.rviz).lower(),
        "browser": str(args.browser).lower(),
        "psi_deg": "" if args.psi is None else args.psi,
        "ready": READY_S,
        "estimator": args.estimator,
        "states": args.states,
    }
    if args.experiment in BUMPER_STEPS:
        result["bumper_steps"] = BUMPER_STEPS[args.experiment]
    else:
        result["trajectory"] = course_name(args) if args.trajectory else "circles3"
        result["speed"] = args.speed or ""
        if args.trajectory and args.trajectory not in COURSES:
            result["waypoints"] = folder / WAYPOINTS
        result["controller"] = args.controller
        result["rate"] = fleet.mocap.rate_hz
    if args.fps is not None:
        result["video_fps"] = args.fps
    return result


def operator_params(args):
    """OperatorParams of a flight."""
    return OperatorParams(duration=args.duration, ready=READY_S, bumper_steps=BUMPER_STEPS.get(args.experiment, 0))


def longest_s(args):
    """How long [s] a flight may take from the start of its nodes: longer than all phases of its operator."""
    return time_limit_s(operator_params(args)) + START_MARGIN_S


def check_faults(events, fleet, seed):
    """Check, in a lab that never runs, that faults are possible with a fleet. Raises ValueError for one that is not.

    For faults on programs: check that the vehicle exists, and that the flight can still be judged.
    """
    on_programs, in_the_lab = by_place(events)
    namespaces = [vehicle.namespace for vehicle in fleet.vehicles]
    for event in on_programs:
        if event.vehicle and event.vehicle not in namespaces:
            raise ValueError("fault %s: no vehicle '%s'; there are %s" % (event, event.vehicle, ", ".join(namespaces)))
        if event.program == "recorder" and event.fault == "node_kill":
            raise ValueError("fault %s: flights are judged by what is recorded; stop the recorder for a while" % event)
    lab = LabOptions(seed=seed, cameras_on_demand=True).make_lab(fleet)
    try:
        for event in in_the_lab:
            lab.injector.check(event)
    finally:
        lab.close()


def by_place(events):
    """Split FaultEvents into (those on programs, those of the virtual lab)."""
    on_programs = [event for event in events if event.settings.on_programs]
    return on_programs, [event for event in events if event not in on_programs]


class TooSlow(str):
    """Why the computer does not keep up with motion capture; found on the ground, before anything has flown."""


def fly(args, folder, progress, interrupted):
    """Carry out the flight. Returns why it failed, "" when it did not, or TooSlow. Raises FlightError when it could not
    be carried out.
    """
    reservation = PortReservation()
    launch = page = programs = None
    try:
        fleet = prepare_fleet(args, reservation.subnet, folder)
        if args.faults:
            check_faults(args.faults, fleet, args.seed)
        write_flight(args, fleet, ROOT, folder)
        master_port = free_tcp_port()
        os.environ["ROS_MASTER_URI"] = "http://127.0.0.1:%d" % master_port
        os.environ["ROS_IP"] = "127.0.0.1"
        launch_file = ROOT / "launch" / (args.experiment + ".launch")
        launch_args = launch_arguments(args, fleet, folder)
        if args.browser:
            page = WebPage(free_tcp_port(BROWSER_PORT), progress)
            launch_args["browser_port"] = page.port
        launch = Launch(launch_file, launch_args, folder, master_port, reservation)
        wait_for_master(launch, master_port, interrupted)
        from risc_experiments.ros.program_faults import ProgramFaults  # late: rospy must see this flight's environment
        from risc_experiments.ros.watch import Watch

        watch = Watch()
        programs = ProgramFaults(launch.identity)
        return _follow(args, folder, launch, watch, programs, progress, interrupted, page)
    finally:
        if programs is not None:
            programs.end_all()
        if page is not None:
            page.end()
        if launch is not None:
            progress.show("stopping")
            killed = launch.stop()
            if killed:
                progress.say("these had to be killed: " + "; ".join(killed))
        reservation.close()


def fly_slower(module, argv, folder, reason, progress, interrupted):
    """Start over in a new process (rospy knows only one master per process), at the next lower rate of motion capture.

    module, argv: the running module and its command line.  folder: of the flight so far, whose bag is removed.
    Returns only when there is no lower rate: why the flight failed. Raises FlightError when it is interrupted.
    """
    rate_hz = load_fleet(folder / "fleet.yaml").mocap.rate_hz
    os.environ[TRIED_RATES] = json.dumps([*tried_rates(), {"rate_hz": rate_hz, "reason": reason}])
    lower_hz = next_rate_hz(rate_hz)
    if lower_hz is None:
        return (
            "this computer is too slow to fly so many vehicles: %s at %g Hz, and below %g Hz a lost frame or "
            "two would leave the vehicles without control" % (reason, rate_hz, RATES_HZ[-1])
        )
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # pending until the new process has its handlers
    if interrupted.is_set():
        raise FlightError("interrupted before anything flew")
    progress.say("%s: too little time for motion capture at %g Hz, flying at %g Hz" % (reason, rate_hz, lower_hz))
    for name in ("flight.bag", "flight.bag.active", "virtual_lab.json"):
        (folder / name).unlink(missing_ok=True)
    command = [sys.executable, "-m", module, *argv, "--mocap-rate", "%g" % lower_hz]
    return os.execv(command[0], [str(word) for word in command])  # does not return


def handle_signals(handler):
    """Install a handler for all SIGNALS, and unblock them: those that came meanwhile are handled now."""
    for which in SIGNALS:
        signal.signal(which, handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def tried_rates():
    """[{"rate_hz", "reason"}] of the rates at which this flight was started and given up."""
    return json.loads(os.environ.get(TRIED_RATES, "[]"))


class WebPage:
    """Prints the address of the flight's web page, once a server answers there."""

    def __init__(self, port, progress):
        self.port = port
        self._progress = progress
        self._found = False

    def look(self):
        """Print the address once the server answers. Cheap; to be called repeatedly."""
        if not self._found:
            with socket.socket() as probe:
                self._found = probe.connect_ex(("127.0.0.1", self.port)) == 0
            if self._found:
                self._progress.say("to be seen (and landed) at http://127.0.0.1:%d" % self.port)

    def end(self):
        """Report, after the flight, if there was no page."""
        if not self._found:
            self._progress.say("there was no page of the flight (see roslaunch.log)")


def wait_for_master(launch, port, interrupted):
    """Wait until the master answers. Raises FlightError when it does not, or when interrupted."""
    master = xmlrpc.client.ServerProxy("http://127.0.0.1:%d" % port)
    deadline = time.monotonic() + 30.0
    while True:
        with contextlib.suppress(OSError, xmlrpc.client.Error):  # not there yet, or just starting
            if master.lookupNode("/maap_fly", "/rosout")[0] == 1:
                return
        if not launch.running():
            raise FlightError("roslaunch ended at once:\n" + launch.log_tail())
        if time.monotonic() > deadline:
            raise FlightError("the ROS master did not start within 30 s:\n" + launch.log_tail())
        if interrupted.wait(0.05):
            raise FlightError("interrupted before anything flew")


def _follow(args, folder, launch, watch, programs, progress, interrupted, page=None):
    """Wait for the end of the flight, showing its progress. Returns why it failed, "" when it did not, or TooSlow.

    As soon as everything has started, record the parameters, and check that all programs that faults act on are there
    (else FlightError).  page: a `WebPage` to look for.
    """
    deadline = time.monotonic() + longest_s(args)
    on_programs, in_the_lab = by_place(args.faults)
    landing = recorded = injected = False
    patience_s = SILENT_S
    problem = ""  # of the faults
    use, use_s = ProcessorUse(launch.identity), 0.0
    headroom = Headroom(launch.identity)
    may_be_slower = args.mocap_rate is None or tried_rates()
    while watch.failure is None:
        if not recorded and watch.operator_heard:  # by then all parameters are set, and nothing flies yet
            recorded = True
            try:
                programs.check(on_programs)
            except LookupError as error:
                if not launch.running():
                    return "a node that the flight needs has died (see roslaunch.log)"
                raise FlightError("--fault: %s" % error) from error
            try:
                write_parameters(watch.parameters(), folder)
            except OSError as error:  # no reason to end a flight
                progress.say("the parameters are not recorded: %s" % error)
        if page is not None:
            page.look()
        phase, text = watch.phase, watch.text
        if phase == OperatorPhase.WAITING and not text and may_be_slower and not landing:
            too_slow = headroom.look(watch)
            if too_slow:
                return TooSlow(too_slow)
        if phase in IN_THE_AIR and time.monotonic() >= use_s:
            use_s = time.monotonic() + USE_PERIOD_S
            use.look()
            (folder / PROCESSORS).write_text(json.dumps(use.figures(), indent=2) + "\n", encoding="utf-8")
        if args.faults and watch.on_course and not injected:
            injected = True
            if in_the_lab:
                watch.inject(in_the_lab)
            programs.start(on_programs)
        if injected and not landing and watch.fault_problem:
            problem = watch.fault_problem
            progress.say("%s: landing all vehicles" % problem)
            landing, deadline = True, time.monotonic() + STOP_PATIENCE_S
            if not watch.land():
                return problem + "; and the operator does not answer"
        name = "starting" if phase is None else phase.name.lower()
        progress.show(name, "  ".join(filter(None, (flight_detail(watch.errors_mm, watch.rate_hz), text))))
        if interrupted.wait(0.1) and not landing:
            progress.say("interrupted: landing all vehicles (once more: stop at once)")
            landing = True
            interrupted.clear()
            deadline = time.monotonic() + STOP_PATIENCE_S
            if not watch.land():
                return "interrupted, and the operator does not answer"
        elif interrupted.is_set():
            return "interrupted twice"
        if not launch.running():
            return "a node that the flight needs has died (see roslaunch.log)"
        if programs.acting:
            patience_s = HUNG_S + SILENT_S
            if watch.operator_silent(HUNG_S):
                programs.end_all()
        if watch.operator_silent(patience_s):
            return "the operator has died (see roslaunch.log)"
        if time.monotonic() > deadline:
            return problem or ("interrupted" if landing else "not finished in time (phase: %s)" % name)
    # with faults, what single vehicles did is judged from the bag
    failure = watch.failure if not args.faults or watch.flight_failed else ""
    return "; ".join(filter(None, (problem, failure)))


def main(argv=None):
    """Command line. Returns the exit code: 0 only when all vehicles flew and landed inside limits."""
    argv = sys.argv[1:] if argv is None else argv
    args = arguments(argv)
    interrupted = threading.Event()
    handle_signals(lambda *_: interrupted.set())
    progress = Progress()
    try:
        folder = prepare_folder(args)
        progress.say("flight %s, seed %d, results in %s" % (args.experiment, args.seed, folder))
        result = fly(args, folder, progress, interrupted)
        if isinstance(result, TooSlow):
            words = [*argv, "--out", folder]
            result = fly_slower("risc_experiments.fly", words, folder, result, progress, interrupted)
        progress.say("failed: " + result if result else "all vehicles have landed")
        return make_report(args, folder, result, progress, interrupted, tried_rates())
    except (FlightError, ValueError, OSError, RuntimeError) as error:
        progress.say("maap fly: %s" % error)
        return 1


if __name__ == "__main__":
    sys.exit(main())
