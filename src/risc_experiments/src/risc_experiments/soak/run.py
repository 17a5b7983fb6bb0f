"""The main loop of a soak: one graph, flight after flight, monitored all the time."""

import contextlib
import datetime
import json
import os
import shutil
import subprocess
import sys
import time
from collections import Counter

from data_extraction.report.origin import FLIGHT, PARAMETERS
from risc_experiments import fly
from risc_experiments.flight_record import write_flight, write_parameters
from risc_experiments.headroom import Headroom
from risc_experiments.operator import time_limit_s
from risc_experiments.soak import invariants, script, table
from risc_experiments.soak.drift import Track
from risc_experiments.soak.processes import Processes
from risc_experiments.soak.table import RECORD
from risc_experiments.soak.verdict import BAG, FAULTS, FLEET, JUDGED
from risc_lab.phases import OperatorPhase
from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port, wait_until

LOOK_S = 0.2  # how often everything is checked
SIGN_S = 3.0  # for a request to take effect
RECORDER_S = 30.0  # for a recorder to start, to end
ON_GROUND_S = 15.0  # for all vehicles to say that they stand, once the flight is over
PUT_BACK_S = 20.0  # for a vehicle to be put back
JUDGE_S = 300.0  # for the bag of a flight to be judged
STARTING_S = 120.0  # for all nodes to start
LAND_S = fly.STOP_PATIENCE_S
FLIGHTS = "flights"
TRACEBACK = b"Traceback (most recent call last)"
_TRACEBACK_BYTES = 4000  # of it that are reported
_READ_BYTES = 1 << 20  # of a log at a time


class EndError(Exception):
    """The soak ends now: an invariant does not hold (a Violation), or it was interrupted or is too slow (None)."""

    def __init__(self, violation=None):
        super().__init__(violation)
        self.violation = violation


class Record:
    """soak.jsonl: a line for each event and sample, written at once."""

    def __init__(self, folder):
        self._begin_s = time.monotonic()
        self._file = (folder / RECORD).open("a", encoding="utf-8", buffering=1)

    @property
    def time_s(self):
        """Time since the start [s]."""
        return time.monotonic() - self._begin_s

    def add(self, kind, **fields):
        """Write a line."""
        now = datetime.datetime.now().astimezone().isoformat(timespec="milliseconds")
        entry = {"time": now, "t_s": round(self.time_s, 2), "kind": kind, **fields}
        self._file.write(json.dumps(entry, allow_nan=False, default=str) + "\n")

    def close(self):
        """Close the file."""
        self._file.close()


class LogFollower:
    """Finds tracebacks in a log that grows."""

    def __init__(self, path):
        self._path, self._at = path, 0

    def tracebacks(self):
        """Texts of the tracebacks since the last call."""
        with self._path.open("rb") as log:
            log.seek(self._at)
            data = log.read(_READ_BYTES)
        found, begin = [], data.find(TRACEBACK)
        while begin >= 0:
            if len(data) - begin < _TRACEBACK_BYTES and data[begin:].count(b"\n") < 3:
                break  # not complete yet
            lines = data[begin : begin + _TRACEBACK_BYTES].decode(errors="replace").splitlines()
            end = next((k for k, line in enumerate(lines[1:], 1) if line and not line[0].isspace()), len(lines) - 1)
            found.append("\n".join(lines[: end + 1]))
            begin = data.find(TRACEBACK, begin + 1)
        self._at += len(data) if begin < 0 else begin
        return found


class Judge:
    """Judges bags in a separate process, one after another, while the next flights fly."""

    def __init__(self):
        self._running = None  # (number, folder, Popen)

    def start(self, number, folder, asked, failure):
        """Judge a flight. failure: see `verdict.judge_flight`."""
        command = ["nice", "-n", "19", sys.executable, "-m", "risc_experiments.soak.verdict", str(folder)]
        command += ["--cut-short"] if failure is None else ["--asked", str(asked), "--failure", failure]
        with (folder / "judge.txt").open("w") as output:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                start_new_session=True,  # Ctrl-C must not reach it
            )
        self._running = number, folder, process

    @property
    def busy(self):
        return self._running is not None

    def result(self):
        """(number, content of its JUDGED) of a flight that has been judged; None when there is none.

        Raises EndError when it cannot be judged.
        """
        if not self.busy or self._running[2].poll() is None:
            return None
        number, folder, _ = self._running
        self._running = None
        if not (folder / JUDGED).exists():
            said = (folder / "judge.txt").read_text(errors="replace").strip().splitlines()[-1:]
            raise EndError(invariants.Violation("judge", "flight %d cannot be judged: %s" % (number, "".join(said))))
        return number, json.loads((folder / JUDGED).read_text(encoding="utf-8"))

    def end(self):
        """Abort the running evaluation."""
        if self.busy:
            self._running[2].kill()
            self._running[2].wait()
            self._running = None


class Soak:
    """State of a soak. `carry_out` flies; the results stay here for `output`."""

    def __init__(self, args, flight, params, deck, folder, progress, interrupted):
        """args: of soak.__main__.  flight: its options as `fly.options` has them.  deck: script.Deck."""
        self.args, self.flight, self.params, self.folder = args, flight, params, folder
        self.deck = deck
        self.record = Record(folder)
        self.duration_s = 3600.0 * args.hours
        self.began = datetime.datetime.now().astimezone()
        self.violation = self.violated = None  # and the number of its flight
        self.interrupted = self.too_slow = False
        self.flights, self.faults, self.put_back = [], [], Counter()  # figures of flights; of faults
        self.flown_s = 0.0  # since the first take-off
        self.processes = None
        self.totals = Track("pss_mb", "own_mb", "descriptors", "threads", "cpu_cores")
        self.latencies = Track("p50_ms", "p99_ms")
        self.number = 0  # of the flight
        self._progress, self._interrupt = progress, interrupted
        self._launch = self._recorder = self._watch = self._log = self._programs = None
        self._missing_s = {}  # {name of a killed process: since when it has no successor}
        self._judge = Judge()
        self.began_s = None  # record time when the first flight took off
        self._sample_s = self._line_s = self._check_s = 0.0
        self._recorded_parameters = False

    # ------------------------------------------------------------------ the whole

    @property
    def warm_s(self):
        """Record time [s] from which drift is judged."""
        return (self.began_s or 0.0) + self.params.warm_up_of(self.duration_s)

    def warm_of(self, process):
        """`warm_s` of a process, which may have started later."""
        return max(self.warm_s, process.since_s + self.params.warm_up_of(self.duration_s))

    def forget(self):
        """Remove what was written, for a soak that starts over in the same folder."""
        self.record.close()
        (self.folder / RECORD).unlink()
        shutil.rmtree(self.folder / FLIGHTS)

    def carry_out(self):
        """Fly until the time is over, an invariant is violated, or interrupted. Raises FlightError, ValueError."""
        reservation = PortReservation()
        try:
            self._start(reservation)
            try:
                while not self._is_over():
                    self._fly()
                self._await_judge()
            except EndError as stop:
                self._note(stop)
        finally:
            self._end()
            reservation.close()

    def _is_over(self):
        return self.began_s is not None and self.record.time_s - self.began_s >= self.duration_s

    def _start(self, reservation):
        fleet = fly.prepare_fleet(self.flight, reservation.subnet, self.folder)
        self._vehicles = [vehicle.namespace for vehicle in fleet.vehicles]
        fly.check_faults(list(self.deck.samples), fleet, self.args.seed)
        write_flight(self.flight, fleet, fly.ROOT, self.folder)
        self._port = free_tcp_port()
        os.environ.update(ROS_MASTER_URI="http://127.0.0.1:%d" % self._port, ROS_IP="127.0.0.1")
        arguments = fly.launch_arguments(self.flight, fleet, self.folder) | {"bag": ""}
        launch_file = fly.ROOT / "launch" / (self.flight.experiment + ".launch")
        self._launch = Launch(launch_file, arguments, self.folder, self._port, reservation)
        self._log = LogFollower(self._launch.log_path)
        fly.wait_for_master(self._launch, self._port, self._interrupt)
        from risc_experiments.ros.program_faults import ProgramFaults  # late: rospy must see this graph's environment
        from risc_experiments.ros.soak_watch import SoakWatch

        self._watch = SoakWatch(self._vehicles)
        self._programs = ProgramFaults(self._launch.identity)
        self.processes = Processes(self._launch.identity)
        self._headroom = None
        if self.flight.mocap_rate is None or fly.tried_rates():
            self._headroom = Headroom(self._launch.identity)
        self.record.add("start", **self.described())

    def described(self):
        """What is flown, for the record."""
        return {
            "command": self.args.command, "seed": self.args.seed, "hours": self.args.hours, "vehicles": self._vehicles,
            "faults": [*self.deck.names, *self.deck.of_programs], "mocap_rate_hz": self.flight.mocap_rate,
        }  # fmt: skip

    def _note(self, stop):
        """Remember why the soak ends, and land."""
        self.violation = stop.violation
        self.interrupted = stop.violation is None and not self.too_slow
        if stop.violation is not None:
            self.violated = self.violated or self.number
            self.record.add("violation", flight=self.violated, **stop.violation._asdict())
            self._progress.say("%s: %s" % stop.violation)
        if self._watch is None or self._watch.phase is None or self._watch.failure is not None:
            return
        self._progress.say("landing all vehicles")
        self._interrupt.clear()
        self._end_faults()
        if self._watch.land():
            wait_until(self._has_landed, LAND_S)

    def _has_landed(self):
        """Whether the flight is over, or cannot be waited for any longer."""
        return self._watch.failure is not None or not self._launch.running() or self._interrupt.is_set()

    def _end(self):
        """Judge the flight that was cut short, and end all programs."""
        self._interrupt.clear()
        if self._programs is not None:
            self._programs.end_all()  # a program that hangs would not end
        try:
            self._stop_recording(None)
            self._await_judge()
        except EndError as stop:
            if self.violation is None and stop.violation is not None:
                self._note(stop)
        self._judge.end()
        if self._launch is not None:
            self._progress.show("stopping")
            killed = self._launch.stop()
            if killed:
                self._progress.say("these had to be killed: " + "; ".join(killed))
                self.record.add("killed", programs=killed)

    # ------------------------------------------------------------------ one flight

    def folder_of(self, number):
        """Folder of a flight."""
        return self.folder / FLIGHTS / ("%04d" % number)

    def _fly(self):
        self.number += 1
        folder = self.folder_of(self.number)
        folder.mkdir(parents=True)
        events = script.faults_of(self.number, self.args.seed, self.deck, self._vehicles, self.params.duration_s)
        (folder / FAULTS).write_text(script.file_text(events, self.args.seed), encoding="utf-8")
        self._events, self._injected = events, False
        self._record_into(folder)
        self._watch.begin_flight()
        if self.number > 1:
            self._again()
        self.record.add("flight", number=self.number, faults=[str(event) for event in events])
        self._follow()
        self._after()

    def _record_into(self, folder):
        for name in (FLEET, FLIGHT):
            shutil.copy(self.folder / name, folder / name)
        launch_file = fly.ROOT / "launch" / "record.launch"
        self._recorder = Launch(launch_file, {"bag": folder / BAG, "frames": "false"}, folder, self._port)
        active = folder / (BAG + ".active")
        end_s = time.monotonic() + RECORDER_S
        while not active.exists():
            if time.monotonic() > end_s or not self._recorder.running():
                text = "the recorder of flight %d does not begin: %s"
                raise EndError(invariants.Violation("recorder", text % (self.number, self._recorder.log_tail(3))))
            self._tick("recorder")

    def _again(self):
        """Have the operator start another flight."""
        problem = self._watch.fly_again()
        if problem:
            raise EndError(invariants.Violation("take-off", problem))
        if not wait_until(lambda: self._watch.failure is None, SIGN_S):
            raise EndError(
                invariants.Violation("take-off", "the operator accepted another flight and did not start it")
            )

    def _follow(self):
        """Follow the flight until the operator says that it is over."""
        asked_s = time.monotonic()
        limit_s = time_limit_s(fly.operator_params(self.flight)) + STARTING_S
        starting_s = STARTING_S if self.began_s is None else 0.0
        said = None
        while self._watch.failure is None:
            phase = self._watch.phase
            if phase != said:
                said = phase
                self.record.add("phase", flight=self.number, phase=phase.name.lower())
            self._tick("starting" if phase is None else phase.name.lower(), self._watch.text)
            waited_s = time.monotonic() - asked_s
            if phase is None or phase == OperatorPhase.WAITING:
                self._look_before(phase)
                self._check(invariants.not_ready(waited_s - starting_s, self._watch.text, self.params.limits))
            elif self.began_s is None:
                self.began_s = self._line_s = self.record.time_s
                self.processes.look(self.record.time_s)
                self.processes.expect()
            if self._watch.on_course and not self._injected:
                self._injected = True
                on_programs, in_the_lab = fly.by_place(self._events)
                self._watch.inject(in_the_lab)
                self._programs.start(on_programs)
            if self._injected and self._watch.fault_problem:
                self._check(invariants.Violation("faults", self._watch.fault_problem))
            if waited_s > limit_s:
                self._check(invariants.Violation("flight", "not over within %.0f s" % limit_s))

    def _look_before(self, phase):
        """Check what has to be checked before the very first take-off."""
        if not self._recorded_parameters and self._watch.operator_heard:
            self._recorded_parameters = True
            try:
                self._programs.check(fly.by_place(list(self.deck.samples))[0])
            except LookupError as error:
                raise fly.FlightError("faults of programs: %s" % error) from error
            try:
                write_parameters(self._watch.parameters(), self.folder)
            except OSError as error:
                self._progress.say("the parameters are not recorded: %s" % error)
        if self._headroom is not None and self.began_s is None:
            if phase == OperatorPhase.WAITING and not self._watch.text:
                self.too_slow = self._headroom.look(self._watch)
                if self.too_slow:
                    raise EndError

    def _after(self):
        """After a flight: end faults, wait for landings, complete the bag, and put back the vehicles that need it."""
        failure = self._watch.failure if self._watch.flight_failed else ""
        problem = self._end_faults()
        if problem:
            raise EndError(invariants.Violation("faults", problem))
        self._await_landings()
        self._stop_recording(failure)
        charges = self._watch.batteries_pct
        for name in self._vehicles:
            why = self._watch.out.get(name, "")
            if not why and not charges.get(name, 0.0) >= self.params.battery_pct:
                why = "battery %.0f %%" % charges.get(name, 0.0)
            if why:
                self._put_back(name)
                self.put_back[name] += 1
                self.record.add("put_back", flight=self.number, vehicle=name, why=why)

    def _await_landings(self):
        """Wait for vehicles whose programs have died: only their ladders can land them, not the operator."""
        end_s = time.monotonic() + ON_GROUND_S
        while self._watch.in_flight and time.monotonic() < end_s:
            self._tick("landing", ", ".join(self._watch.in_flight))

    def _end_faults(self):
        """End all faults. Returns "", or why that failed."""
        self._programs.end_all()
        return self._watch.end_faults()

    def _put_back(self, name):
        """Put a vehicle back; try repeatedly, as one that was silent may still be landing."""
        end_s = time.monotonic() + PUT_BACK_S
        problem = self._watch.put_back(name)
        while problem:
            if time.monotonic() > end_s:
                raise EndError(invariants.Violation("put back", problem))
            self._tick("put back")
            problem = self._watch.put_back(name)

    def _stop_recording(self, failure):
        """Complete the bag, and have it judged. failure: why the flight failed, ""; None: it was cut short."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        died = not recorder.running()
        recorder.stop(RECORDER_S)
        folder = self.folder_of(self.number)
        with contextlib.suppress(FileNotFoundError):
            shutil.copy(self.folder / PARAMETERS, folder / PARAMETERS)
        if died or not (folder / BAG).exists():
            raise EndError(invariants.Violation("recorder", "the recorder of flight %d died" % self.number))
        self._await_judge()
        self._judge.start(self.number, folder, len(self._events), failure)

    # ------------------------------------------------------------------ what is checked all the time

    def _tick(self, phase, text=""):
        """Wait LOOK_S, and check everything. Raises EndError."""
        self._progress.show("flight %d" % self.number, "%-8s %s" % (phase, text))
        if self._interrupt.wait(LOOK_S):
            raise EndError
        if not self._launch.running():
            self._check(invariants.Violation("process", "a node that the graph needs has died (see roslaunch.log)"))
        if self._watch.operator_silent(fly.HUNG_S + fly.SILENT_S if self._programs.acting else fly.SILENT_S):
            self._check(invariants.Violation("process", "the operator has fallen silent"))
        while self._watch.crashes:
            crash = self._watch.crashes.popleft()
            self.record.add("crash", flight=self.number, vehicle=crash.vehicle, other=crash.other, reason=crash.reason)
            self._check(invariants.crash(crash.vehicle, crash.reason, self._watch.safe or ()))
        while self._watch.errors:
            node, text = self._watch.errors.popleft()
            explained = self._watch.safe is not None or self.began_s is None  # nodes start before those that they need
            self.record.add("error", flight=self.number, node=node, text=text, explained=explained)
            self._check(invariants.error(node, text, explained))
        self._judged()
        now_s = self.record.time_s
        if now_s >= self._check_s:
            self._check_s = now_s + 1.0
            for text in self._log.tracebacks():
                self.record.add("traceback", flight=self.number, text=text)
                self._check(invariants.traceback(text))
            self._look_who_is_missing(now_s)
            self._check(invariants.disk(shutil.disk_usage(self.folder).free / 1e6, self.params.limits))
        if self.began_s is not None:
            if now_s >= self._sample_s:
                self._sample_s = now_s + self.params.sample_s
                self._sample(now_s)
            if now_s >= self._line_s + self.params.line_s:
                self._line_s = now_s
                self._progress.say(self.line())
                self._check_growth()

    def _look_who_is_missing(self, now_s):
        ended = self.processes.ended(self._programs.killed)
        self._check(invariants.gone(ended))
        if not ended:
            self._missing_s = {}
            return
        self.processes.find(now_s)  # their successors
        names = [name for name, _, _ in ended if not self.processes.replace(name)]
        self._missing_s = {name: self._missing_s.get(name, now_s) for name in names}
        waited_s = {name: now_s - since_s for name, since_s in self._missing_s.items()}
        self._check(invariants.not_back(waited_s, self.params.limits))

    def _check(self, violation):
        if violation is not None:
            raise EndError(violation)

    def _sample(self, now_s):
        looks = self.processes.look(now_s)
        self.flown_s = now_s - self.began_s
        processes = {process.name: process for process in self.processes.known}  # the newest of each name
        cores = {name: processes[name].cpu_cores for name in looks}
        sums = {name: sum(getattr(look, name) for look in looks.values()) for name in
                ("pss_mb", "own_mb", "descriptors", "threads")}  # fmt: skip
        self.totals.add(now_s, *sums.values(), sum(value for value in cores.values() if value == value))
        told = {
            name: {
                "pid": processes[name].key[0],
                **{key: round(value, 2) for key, value in look._asdict().items()},
                "cpu_cores": round(cores[name], 4) if cores[name] == cores[name] else None,
            }
            for name, look in looks.items()
        }
        self.record.add("sample", flight=self.number, processes=told)

    def _check_growth(self):
        for process in self.processes.living:
            for violation in invariants.growth(process.name, process.track, self.warm_of(process), self.params):
                self._check(violation)

    def _await_judge(self):
        """Wait until the previous flight is judged. Raises EndError."""
        end_s = time.monotonic() + JUDGE_S
        while self._judge.busy:
            self._progress.show("judging", "flight %d" % self.number)
            self._judged()
            if self._judge.busy and self._interrupt.wait(LOOK_S):
                raise EndError
            if time.monotonic() > end_s:
                self._judge.end()
                self._check(invariants.Violation("judge", "a flight was not judged within %.0f s" % JUDGE_S))

    def _judged(self):
        """Take the result of a judged flight, if there is one. Raises EndError."""
        result = self._judge.result()
        if result is None:
            return
        number, judged = result
        self.record.add("judged", flight=number, **{key: judged[key] for key in judged if key != "faults"})
        for fault in judged["faults"]:
            self.record.add("fault", flight=number, **fault)
        self.faults += table.counted(judged["faults"])
        self.flights.append({"number": number, **{key: judged[key] for key in judged if key != "faults"}})
        latency_ms = judged["latency_ms"]
        if latency_ms["p99"] is not None:
            self.latencies.add(self.record.time_s, latency_ms["p50"], latency_ms["p99"])
        violation = invariants.flight(judged, self.params.limits)
        violation = violation or invariants.latency(self.latencies, self.warm_s, self.params)
        if violation is not None:
            if self.violation is None:
                self.violated = number
            raise EndError(violation)
        self._remove_bags(number)

    def _remove_bags(self, newest):
        """Remove the bags of flights without a violation, except the newest."""
        for number in set(range(1, newest - self.params.keep_flights + 1)) - {self.violated}:
            (self.folder_of(number) / BAG).unlink(missing_ok=True)

    # ------------------------------------------------------------------ for people

    def line(self):
        """Progress in one line."""
        minutes = int(self.flown_s / 60.0)
        newest = self.flights[-1]["latency_ms"] if self.flights else {"p50": None, "p99": None}
        memory = self.totals.drift("own_mb", self.warm_s)
        sums = [self.totals.drift(name, self.warm_s).last or 0.0 for name in ("pss_mb", "descriptors", "threads")]
        faults = table.row_of("all", self.faults)
        parts = ["%d:%02d h" % divmod(minutes, 60), "flight %d" % self.number, "faults " + table.events_text(faults)]
        if newest["p50"] is not None:
            parts.append("command after %.1f, p99 %.1f ms" % (newest["p50"], newest["p99"]))
        if faults["p99_ms"] is not None:
            parts.append("reaction p99 %.0f ms" % faults["p99_ms"])
        grows = "" if memory.slope is None else ", own %+.1f MB/h" % memory.slope
        parts.append("%.0f MB%s" % (sums[0], grows))
        parts.append("%d descriptors, %d threads" % tuple(sums[1:]))
        cores = self.totals.drift("cpu_cores", self.warm_s).last
        parts.append("%.2f cores" % cores if cores is not None else "")
        return "; ".join(filter(None, parts))
