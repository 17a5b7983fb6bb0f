"""The virtual lab as one program without ROS: physics, a Cortex host and a host for each vehicle, in one thread.

A separate process makes the camera pictures; it starts with the lab and sleeps while no client watches.

    python3 -m risc_simulator.virtual_lab FLEET.yaml [options]

Lab time is seconds since the start. World time runs behind it by the reported delay of motion capture: frame k is
exposed at world time k / rate and sent at lab time k / rate + reported delay. The schedule is absolute, so it does not
drift: after a stall of the computer the missed frames follow at once, each with its own exposure time. If the computer
is too slow for that, frames are skipped, so that frames and commands stay near real time. While the computer is
suspended, lab time stops.

One process serves all vehicles: 50 in flight take 0.27 of a core (./maap bench world), ten take 0.11, so
dividing the hosts among processes would gain less than it costs.
"""

import argparse
import gc
import json
import logging
import math
import pathlib
import select
import signal
import sys
import threading
import time
from dataclasses import dataclass, field, fields, replace

import numpy as np

from risc_lab.lab import load_fleet, load_templates, load_vehicle_type
from risc_lab.priority import VIRTUAL_LAB, raise_priority
from risc_lab.settings import Fraction, Settings, settings_from
from risc_simulator.cortex_host import CortexHost
from risc_simulator.faults import FaultFile, load_fault_file
from risc_simulator.injector import Injector
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras
from risc_simulator.socket_host import SocketSet
from risc_simulator.video.server import VideoServer
from risc_simulator.wires import Wires
from risc_simulator.world import World, look_up

MAX_STEP_S = 0.005  # see test_quadrotor.py for what the step costs in accuracy
MAX_CATCH_UP_S = 1.0  # a longer suspension of the computer stops the lab's clock meanwhile
HANDS_S = 3.0  # a vehicle that is picked up and put back is hidden from the cameras for this time
LATE_S = 0.1  # a frame that is overdue by more than this is late,
LATE_PATIENCE_S = 0.5  # and if all frames were late for this long, the overdue ones are skipped
_LOG = logging.getLogger(__name__)
_CAMERA_STREAM = (1000000,)  # random stream of the mocap cameras; those of the vehicles are (index, purpose)


class LatenessHistogram:
    """Streaming percentiles of delays: 10 us bins up to 100 ms, and one last bin for all above."""

    BIN_S = 1e-5
    BINS = 10000

    def __init__(self):
        self._counts = [0] * (self.BINS + 1)
        self.max_s = 0.0

    def add(self, lateness_s):
        """Count one delay [s]; a negative one counts as 0."""
        lateness_s = max(lateness_s, 0.0)
        self.max_s = max(self.max_s, lateness_s)
        self._counts[min(int(lateness_s / self.BIN_S), self.BINS)] += 1

    def percentile_s(self, percent):
        """Upper edge [s] of the bin that holds the percentile (never above the maximum); 0 without data."""
        seen = np.cumsum(self._counts)
        wanted = max(math.ceil(seen[-1] * percent / 100.0 - 1e-6), 1)  # the tolerance: rounding must not add one
        index = int(np.searchsorted(seen, wanted))
        return self.max_s if index >= self.BINS else min((index + 1) * self.BIN_S, self.max_s)


def _told(default, text, metavar=None):
    return field(default=default, metadata={"help": text, "metavar": metavar})


@dataclass(frozen=True)
class LabOptions(Settings):
    """Options by name. An empty text or a negative number keeps the value of the fleet file or the vehicle type."""

    fleet: str = _told("", "what flies, and at which addresses", "FLEET.yaml")
    seed: int = _told(-1, "same seed, same vehicles and noise (default: that of the file of faults, else 0)", "N")
    ideal: bool = _told(False, "every vehicle is exactly what its type says")
    exact_markers: bool = _told(False, "cameras without noise, loss and ghosts")
    gusts: bool = _told(False, "moving air")
    delay: float = _told(-1.0, "nominal command delay of every vehicle", "S")
    radio_loss: Fraction = _told(0.0, "probability that the radio loses a command or navdata, 0 to 1", "P")
    faults: str = _told("", "what goes wrong, and when", "FILE.yaml")
    live: bool = _told(False, "stream at once, without waiting for a client's LiveMode")
    vehicles: int = _told(-1, "only the first N vehicles", "N")
    subnet: str = _told("", "Cortex host at A.B.0.1, vehicle k at A.B.1.k, e.g. 127.78", "A.B")
    cortex_host: str = _told("", "its address", "ADDRESS")
    cortex_port: int = _told(-1, "its port for commands", "PORT")
    stream_group: str = _told("", "multicast group of the stream", "ADDRESS")
    stream_port: int = _told(-1, "port of the stream", "PORT")
    interface: str = _told(
        "", "of this computer's network card that the stream goes out by (default: that of the Cortex host)", "ADDRESS"
    )
    rate: float = _told(-1.0, "frame rate of motion capture", "HZ")
    cameras_on_demand: bool = _told(
        False, "start the program that makes pictures only when the first client asks for video, who then waits for it"
    )
    stats: str = _told("", "write the statistics there at the end", "FILE.json")

    def configure(self, fleet):
        """Return the fleet with the vehicles, addresses and frame rate of these options. Raises ValueError."""
        if self.vehicles >= 0:
            fleet = fleet.with_vehicles(self.vehicles)
        if self.subnet:
            fleet = fleet.in_subnet(self.subnet)
        texts = {"host": self.cortex_host, "stream_group": self.stream_group}
        numbers = {"command_port": self.cortex_port, "stream_port": self.stream_port, "rate_hz": self.rate}
        changes = {name: text for name, text in texts.items() if text}
        changes.update({name: number for name, number in numbers.items() if number >= 0})
        # the lab is one computer: vehicles that have separate networks elsewhere need distinct addresses here
        return replace(fleet, own_networks=False, mocap=replace(fleet.mocap, **changes))

    def make_lab(self, fleet):
        """VirtualLab of a fleet. Raises ValueError and OSError."""
        script = load_fault_file(self.faults) if self.faults else FaultFile(())
        seed = self.seed if self.seed >= 0 else script.seed or 0
        return VirtualLab(fleet, not self.cameras_on_demand, script.faults, **vars(self) | {"seed": seed})


class VirtualLab:
    """World and hosts on one schedule. Use it from one thread; only the stop_event of `run` may be set elsewhere.

    Raises ValueError for a fleet that cannot be simulated (unknown type, template, ...), OSError for an address in use.
    """

    def __init__(self, fleet, /, cameras_ahead=False, events=(), **options):
        """fleet: Fleet. cameras_ahead: start the camera process now, not when the first client asks for video.

        events: faults.FaultEvents; their start counts from that of the lab. options: fields of LabOptions.
        """
        told = LabOptions(**options)
        told = self.options = replace(told, seed=max(told.seed, 0))
        fleet = told.configure(fleet).with_overrides(command_delay_s=told.delay if told.delay >= 0.0 else None)
        self.fleet, seed = fleet, told.seed
        self._period_s = 1.0 / fleet.mocap.rate_hz
        self._send_after_s = fleet.mocap.reported_delay_s
        templates = load_templates(fleet=fleet)
        types = {name: load_vehicle_type(name) for name in {v.type for v in fleet.vehicles}}
        self._cycles_per_frame = int(np.ceil(self._period_s / MAX_STEP_S - 1e-9))
        step_s = self._period_s / self._cycles_per_frame
        self.world = World(fleet, types, templates, seed, not told.ideal, told.gusts, step_s)
        self.frame = 0  # number of the newest exposure
        self.stalls = 0  # number of suspensions longer than MAX_CATCH_UP_S
        self.frames_skipped = 0  # because the computer was too slow
        self._late_since_s = None  # lab time; None: the last frame was not late
        self.lateness = LatenessHistogram()  # of frames against the absolute schedule
        self.cameras = MocapCameras(
            CameraParams.ideal() if told.exact_markers else CameraParams.of_arena(fleet.arena),
            seed=np.random.SeedSequence(seed, spawn_key=_CAMERA_STREAM),
        )
        self._start_s = time.monotonic()
        self._served_s = 0.0  # lab time at which the hosts were last served
        self._hosts = []
        self.wires = Wires(seed)
        self._waiting = SocketSet()
        try:
            self.cortex_host = CortexHost(
                self.world, fleet.mocap, self.cameras, self.now_s, templates, told.live, told.interface, self.wires
            )
            self._hosts.append(self.cortex_host)
            self.vehicle_hosts = {}
            for vehicle in fleet.vehicles:
                if vehicle.devices:
                    text = "vehicle '%s' has `devices`, which are a real laboratory's: give it an address instead"
                    raise ValueError(text % vehicle.namespace)
                body = self.world.vehicles[vehicle.namespace]
                host = body.virtual.Host(body, vehicle.address, seed=seed, radio_loss=told.radio_loss, wires=self.wires)
                self.vehicle_hosts[vehicle.namespace] = host
                self._hosts.append(host)
            listeners = [
                host.video_listener if self.world.vehicles[namespace].virtual.cameras else None
                for namespace, host in self.vehicle_hosts.items()
            ]
            self._video = VideoServer(self.world, fleet, seed, self.wires, listeners)
            self._hosts.append(self._video)
            for namespace, host in self.vehicle_hosts.items():
                host.attach_video(self._video.stations[namespace])
            if cameras_ahead:
                self._video.start()
            for host in self._hosts:
                self._waiting.add(host)
            self.injector = Injector(self.world, self.wires, seed, {"cortex": self.cortex_host})
            for event in events:
                self.injector.add(event, 0.0)
        except (OSError, ValueError):
            self.close()
            raise

    def describe(self):
        """Lines for people: what listens where, and what flies."""
        told = self.options
        mode = "%s, seed %d" % ("ideal plants" if told.ideal else "perturbed plant", told.seed)
        lines = ["virtual lab '%s': %s%s" % (self.fleet.name, mode, ", gusts" if told.gusts else "")]
        if told.radio_loss:
            lines[0] += ", radio loses %g %% of the commands' slots and of navdata" % (100.0 * told.radio_loss)
        return "\n".join(lines + [host.describe() for host in (self.cortex_host, *self.vehicle_hosts.values())])

    @property
    def cameras_ready(self):
        """Whether the camera process is up: a client of a vehicle's video is served at once."""
        return self._video.ready

    def now_s(self):
        """Lab time: 0 at the first step."""
        return time.monotonic() - self._start_s

    @property
    def exposure_s(self):
        """Lab time at which the newest frame was exposed."""
        return self.frame * self._period_s

    def step(self):
        """Serve clients until the next frame is due, then expose and send it."""
        if self.frame == 0:
            self._start_s = time.monotonic()  # delays before the first frame do not count
        self._skip_what_is_too_late()
        for cycle in range(1, self._cycles_per_frame + 1):
            time_s = (self.frame + cycle / self._cycles_per_frame) * self._period_s
            due_s = time_s + self._send_after_s
            self._serve_until(due_s)
            now_s = self._forgive(due_s)
            self.injector.step(now_s)
            self.world.step_to(time_s)
            if cycle == self._cycles_per_frame:
                self.frame += 1
                self.lateness.add(now_s - due_s)
                self.cortex_host.tick(now_s)
            for host in self._hosts[1:]:
                host.tick(now_s)

    def _skip_what_is_too_late(self):
        """Skip the overdue frames if the computer did not catch up with them in time."""
        due_s = self.exposure_s + self._period_s + self._send_after_s
        now_s = self._forgive(due_s)
        late_s = now_s - due_s
        if late_s < LATE_S:
            self._late_since_s = None
        elif self._late_since_s is None:
            self._late_since_s = now_s
        elif now_s - self._late_since_s > LATE_PATIENCE_S:
            skipped = int(late_s / self._period_s)
            if not self.frames_skipped:
                _LOG.warning(
                    "the computer is too slow: %d frames of motion capture are left out to stay near real time; from "
                    "now on they are only counted",
                    skipped,
                )
            self.frame += skipped
            self.frames_skipped += skipped
            self._late_since_s = None

    def _forgive(self, due_s):
        """Return lab time. After a suspension, first set the clock back to due_s or the last service (the later)."""
        now_s = self.now_s()
        slept_s = now_s - max(due_s, self._served_s)  # never before the time that the hosts have seen
        if slept_s > MAX_CATCH_UP_S:
            if not self.stalls:
                _LOG.warning("the computer was suspended for %.1f s, and with it the lab's clock", slept_s)
            self._start_s += slept_s
            self.stalls += 1
            now_s -= slept_s
        self._served_s = now_s
        return now_s

    def _serve_until(self, due_s):
        while True:
            now_s = self._forgive(due_s)
            self.wires.release(now_s)
            self._video.send(now_s)
            wake_s = min(due_s, self.wires.due_s, self._video.due_s)
            # select, because epoll's own timeout is in whole milliseconds
            if not select.select((self._waiting,), (), (), max(wake_s - now_s, 0.0))[0]:
                if wake_s < due_s:
                    continue
                return
            for host in self._waiting.readable():
                host.serve(self._forgive(due_s))
            if now_s >= due_s:
                return

    def run(self, stop_event=None, duration_s=None, on_frame=None):
        """Run in real time until stop_event (threading.Event) is set or duration_s of lab time has passed.

        on_frame: called without arguments after each frame has been sent; must be quick.
        """
        gc.collect()
        gc.freeze()  # what exists now lives as long as the lab: collections stay short
        while not (stop_event is not None and stop_event.is_set()):
            if duration_s is not None and self.exposure_s >= duration_s:
                break
            self.step()
            if on_frame is not None:
                on_frame()

    def inject(self, event):
        """Schedule a faults.FaultEvent; its start counts from now. Returns its injector.FaultRecord.

        Raises ValueError if the fault is not possible in this lab.
        """
        return self.injector.add(event, self._served_s)

    def put_back(self, namespace=""):
        """Prepare a vehicle ("": all) for its next flight, as a person does: pick it up, end the faults on it, fit a
        full battery, switch it off and on, and stand it at its start.

        Raises ValueError, and moves nothing, for an unknown vehicle, for one that flies or whose rotors turn, and if
        another vehicle occupies its start.
        """
        known = self.world.vehicles
        vehicles = [look_up(known, namespace, "vehicle")] if namespace else list(known.values())
        self.world.check_place_for(vehicles)
        for vehicle in vehicles:
            self.injector.end_on(vehicle, self._served_s)
            vehicle.put_back()
            self.vehicle_hosts[vehicle.namespace].power_cycle(self._served_s)
            for body in (vehicle.template, *([vehicle.attached.template] if vehicle.attached else ())):
                self.cameras.hide(body, self.world.time_s + HANDS_S)

    def end_faults(self):
        """End all faults, including those that have not begun."""
        self.injector.end_all(self._served_s)

    def set_light(self, brightness):
        """Set the brightness of the room for the cameras: 1 = normal. Raises ValueError outside 0 to 10."""
        if not 0.0 <= brightness <= 10.0:
            raise ValueError("the light must be from 0 to 10 times the normal one, got %r" % (brightness,))
        self._video.light = brightness

    def move_board(self, namespace, duration_s):
        """Move a checkerboard in front of a vehicle's camera for a time [s] from now. Raises ValueError."""
        if not 0.0 <= duration_s < math.inf:
            raise ValueError("a board is moved for a time of 0 s or more, got %r" % (duration_s,))
        station = look_up(self._video.stations, namespace, "vehicle")
        station.board_s = self._served_s, self._served_s + duration_s

    def statistics(self):
        """Statistics of the run, as plain numbers and texts (for JSON)."""
        vehicles = {}
        for namespace, vehicle in self.world.vehicles.items():
            plant = vehicle.plant
            vehicles[namespace] = {
                "template": vehicle.template,
                "phase": vehicle.phase.value,
                "battery_pct": vehicle.state.battery_pct,
                "plant": {
                    "mass_kg": plant.mass_kg,
                    "thrust_scale": plant.thrust_scale,
                    "roll_natural_frequency_rad_s": plant.roll.natural_frequency_rad_s,
                    "pitch_natural_frequency_rad_s": plant.pitch.natural_frequency_rad_s,
                    "drag_n_s_m": plant.drag_n_s_m,
                    "command_delay_s": plant.command_delay_s,
                },
                "host": self.vehicle_hosts[namespace].statistics(),
                "video": self._video.stations[namespace].statistics(),
            }
        return {
            "simulated": True,
            "fleet": self.fleet.name,
            "seed": self.options.seed,
            "perturbed": not self.options.ideal,
            "gusts": self.options.gusts,
            "radio_loss": self.options.radio_loss,
            "frames": self.frame - self.frames_skipped,
            "rate_hz": self.fleet.mocap.rate_hz,
            "duration_s": self.exposure_s,
            "late_ms": {
                "p50": 1e3 * self.lateness.percentile_s(50.0),
                "p99": 1e3 * self.lateness.percentile_s(99.0),
                "max": 1e3 * self.lateness.max_s,
            },
            "stalls": self.stalls,
            "frames_skipped": self.frames_skipped,
            "least_separation_m": self.world.least_separation_m,
            "crashes": [
                {
                    "time_s": crash.time_s,
                    "vehicle": crash.namespace,
                    "position_m": crash.position_m.tolist(),
                    "reason": crash.reason,
                }
                for crash in self.world.crashes
            ],
            "wires": self.wires.statistics(),
            "cortex": self.cortex_host.statistics(),
            "vehicles": vehicles,
        }

    def close(self):
        """Close all sockets and end the camera process. May be called twice."""
        for host in reversed(self._hosts):
            host.close()
        self._waiting.close()
        self._hosts = []


def summary(statistics):
    """The statistics in a few lines for people."""
    lines = ["%(frames)d frames in %(duration_s).1f s (%(rate_hz)g Hz); late against the schedule: " % statistics]
    lines[0] += "p50 %(p50).2f, p99 %(p99).2f, max %(max).2f ms" % statistics["late_ms"]
    if statistics["stalls"]:
        lines[0] += "; the computer stalled %d times" % statistics["stalls"]
    if statistics["frames_skipped"]:
        lines[0] += "; %d frames left out" % statistics["frames_skipped"]
    if statistics["least_separation_m"] is not None:
        lines.append("least separation of vehicles in the air: %.2f m" % statistics["least_separation_m"])
    lines += [
        "crash at %.2f s: %s %s at (%.2f, %.2f, %.2f) m"
        % (crash["time_s"], crash["vehicle"], crash["reason"], *crash["position_m"])
        for crash in statistics["crashes"]
    ]
    hosts = {"Cortex host": statistics["cortex"]}
    hosts.update({namespace: vehicle["host"] for namespace, vehicle in statistics["vehicles"].items()})
    lines += [
        "%s: %s %s: %d times" % (name, sender, what, times)
        for name, host in hosts.items()
        for what, senders in host["notices"]["complaints"].items()
        for sender, times in senders.items()
        if times > 1  # a single one has been logged already
    ]
    return "\n".join(lines)


def report(statistics, path=""):
    """Print the summary, and write the statistics to a JSON file if one is named. Returns the exit code."""
    print(summary(statistics), flush=True)
    if path:
        try:
            pathlib.Path(path).expanduser().write_text(json.dumps(statistics, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            print("virtual_lab: cannot write the statistics: %s" % error, file=sys.stderr)
            return 1
    return 0


def _parse_arguments(arguments):
    """Return (LabOptions, duration of the run [s] or None) of a command line. Raises ValueError."""
    parser = argparse.ArgumentParser(
        prog="virtual_lab", description="The virtual lab: motion capture and vehicles on the wire, without ROS."
    )
    for option in fields(LabOptions):
        kind, told = type(option.default), dict(option.metadata)
        if option.name == "fleet":
            parser.add_argument("fleet", **told)
        elif kind is bool:
            parser.add_argument("--" + option.name.replace("_", "-"), action="store_true", help=told["help"])
        else:
            parser.add_argument("--" + option.name.replace("_", "-"), type=kind, default=option.default, **told)
    parser.add_argument("--duration", type=float, metavar="S", help="stop after this time (default: Ctrl-C)")
    values = vars(parser.parse_args(arguments))
    duration_s = values.pop("duration")
    return settings_from(LabOptions, values), duration_s


def main(arguments=None):
    """Command line. Returns the exit code."""
    logging.basicConfig(stream=sys.stdout, format="%(asctime)s %(message)s", datefmt="%H:%M:%S", level=logging.INFO)
    stop_event = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop_event.set())
    try:
        options, duration_s = _parse_arguments(arguments)
        lab = options.make_lab(load_fleet(options.fleet))
    except (ValueError, OSError) as error:
        print("virtual_lab: %s" % error, file=sys.stderr)
        return 1
    try:
        print(lab.describe(), flush=True)
        raise_priority(VIRTUAL_LAB)
        lab.run(stop_event, duration_s)
        statistics = lab.statistics()
    finally:
        lab.close()
    return report(statistics, options.stats)


if __name__ == "__main__":
    sys.exit(main())
