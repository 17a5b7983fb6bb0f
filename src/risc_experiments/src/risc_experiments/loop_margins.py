"""How robust the loops are: margins of the whole sampled loop, from motion capture's frame to the aircraft's command.

    rosrun risc_control loop_margins.py --delay 0.1 --bandwidth 0.7

A vehicle without noise hovers in an offline flight, with the same estimator, predictor, controller, vehicle node and
link as in any flight. A pulse d, one frame long, is added to the input of the aircraft's roll, pitch and climb loops;
the commands c that follow are recorded. The pulse is repeated at each frame of the common period of frames, node ticks
and command slots, and the responses are averaged. They give the sensitivity S = 1 + C/D = 1/(1 + L) of the loop broken
at the aircraft's command, so L = 1/S - 1, and from it crossover, gain, phase and delay margin, and max|S|. No second
model of the loop is needed.
"""

import argparse
import json
import math
import pathlib
import sys
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data_extraction.plots import plt
from data_extraction.progress import Progress, bar
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_experiments.estimators import add_option, estimator_of
from risc_experiments.offline import Flight, RunningFlight
from risc_experiments.offline_chain import FRAME_S
from risc_experiments.option_types import add_set_option, numbers_of
from risc_lab.lab.vehicle_types import DEFAULT_TYPE, load_vehicle_type

AXES = ("roll", "pitch", "climb")
_STILL = {"trajectory": "circle", "course": {"radius_m": 1e-5}, "psi_deg": 0.0, "perturbed": False, "noise": False}
_PULSES = {"roll": 0.5, "pitch": 0.5, "climb": 1.0}  # [rad, m/s] for a frame
_FRAMES = 60  # 0.3 s: whole periods of frames, ticks (15 ms) and commands (30 Hz)
_DECAY_S = 7.5  # from one pulse to the next
_BEFORE_S = 12.0  # until it is on its course, and at rest
_DECAYED = 0.03  # fraction of the largest response that may be left when the next pulse comes
FREQUENCIES_RAD_S = np.geomspace(0.2, 100.0, 4000)


class Margins(NamedTuple):
    """Stability margins of one axis. Infinite: no crossing."""

    max_s: float
    phase_margin_deg: float
    delay_margin_ms: float
    gain_margin_db: float  # in either direction
    crossover_rad_s: float  # the highest


class _Hovering(RunningFlight):
    """A hovering vehicle, and the commands that its aircraft receives, frame by frame."""

    def __init__(self, flight):
        super().__init__(replace(flight, vehicles=1, duration_s=math.inf, **_STILL))
        (self._vehicle,) = self._world.vehicles.values()
        self._settled = self._vehicle.plant
        self.commands, self.pulse = [], False

    def _let_lab_go_on(self):
        if self.pulse:
            roll_rad, pitch_rad = (getattr(self._settled, axis).gain * _PULSES[axis] for axis in ("roll", "pitch"))
            pulse = {"roll_level_rad": roll_rad, "pitch_level_rad": pitch_rad, "climb_bias_m_s": -_PULSES["climb"]}
            self._vehicle.change_plant(**pulse)
        super()._let_lab_go_on()
        if self.pulse:
            self._vehicle.change_plant(**vars(self._settled))
        roll, pitch, _, climb = self._vehicle.firmware.command
        self.commands.append((roll, pitch, climb))


def slower(vehicle_type, bandwidth):
    """Flight.plant with attitude loops slower than those of a VehicleType. bandwidth: factor."""
    loops = {"roll": vehicle_type.roll, "pitch": vehicle_type.pitch}
    return {
        a: replace(loop, natural_frequency_rad_s=bandwidth * loop.natural_frequency_rad_s) for a, loop in loops.items()
    }


def responses(flight, on_progress=None):
    """(k, 3) responses of the roll, pitch and climb commands to a unit pulse on each, from the pulse's frame on.

    flight: Flight, of which one vehicle hovers without noise.  on_progress: called with the fraction that is flown.
    Raises RuntimeError when the vehicle crashes, or the commands do not come to rest between two pulses.
    """
    running = _Hovering(flight)
    between, first = round(_DECAY_S / FRAME_S) // _FRAMES * _FRAMES + 1, round(_BEFORE_S / FRAME_S)
    starts = [first + between * k for k in range(_FRAMES)]
    frames = starts[-1] + between
    for frame in range(frames):
        running.pulse = frame in starts
        running.frame()
        if on_progress is not None and frame % between == 0:
            on_progress(frame / frames)
    commands = np.array(running.commands)
    found = np.mean([commands[k : k + between] - commands[k - 1] for k in starts], axis=0)
    most, rest = np.abs(found).max(axis=0), np.abs(found[-between // 10 :]).max(axis=0)
    hums = np.ptp(commands[first - between // 4 : first], axis=0)  # without pulses: dead zones and steps of sticks
    alive = rest > _DECAYED * most + hums
    alive[:2] |= hums[:2] > 0.5 * most[:2]  # attitude loops oscillate without a pulse
    for axis, is_alive in zip(AXES, alive):
        if is_alive:
            raise RuntimeError("%s does not come to rest within %g s after a pulse: the loop is unstable, or nearly so"
                               % (axis, _DECAY_S))  # fmt: skip
    return found / [_PULSES[axis] for axis in AXES]


def sensitivity(response, frequencies_rad_s=FREQUENCIES_RAD_S):
    """S (k,) of one axis at these frequencies. response: (n,) of its command, a column of `responses`."""
    turns = np.exp(-1j * FRAME_S * np.outer(frequencies_rad_s, np.arange(len(response))))
    return 1.0 + turns @ response


def margins(S, frequencies_rad_s=FREQUENCIES_RAD_S):
    """Margins of a loop from its sensitivity S (k,)."""
    w, L = frequencies_rad_s, 1.0 / S - 1.0
    size_db, phase_rad = 20.0 * np.log10(np.abs(L)), np.unwrap(np.angle(L))
    crosses = np.flatnonzero(size_db[:-1] * size_db[1:] <= 0.0)
    left_rad = np.remainder(np.angle(L[crosses]) + math.pi, 2.0 * math.pi)  # phase lag to instability
    near_rad = np.minimum(left_rad, 2.0 * math.pi - left_rad)
    turns = np.floor((phase_rad - math.pi) / (2.0 * math.pi))
    through = np.flatnonzero(turns[:-1] != turns[1:])  # crossings of the negative real axis
    return Margins(
        float(np.abs(S).max()),
        math.degrees(near_rad.min(initial=math.inf)),
        float(1e3 * (left_rad / w[crosses]).min(initial=math.inf)),
        float(np.abs(size_db[through]).min(initial=math.inf)),
        float(w[crosses].max(initial=0.0)),
    )


def figures(per_axis):
    """What --json writes: the worse of roll and pitch, and each axis. per_axis: {axis: Margins}."""
    level = [per_axis["roll"], per_axis["pitch"]]
    worst = Margins(max(m.max_s for m in level), *(min(m[k] for m in level) for k in (1, 2, 3)),
                    max(m.crossover_rad_s for m in level))  # fmt: skip
    told = {**worst._asdict(), "axes": {axis: found._asdict() for axis, found in per_axis.items()}}
    return json.loads(json.dumps(told), parse_constant=lambda _: None)  # what is infinite is null


def picture(path, per_axis_s, title):
    """Draw |S| and the Nyquist plot of L, of all axes."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.5), layout="constrained")
    circle = np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 200))
    for axis, S in per_axis_s.items():
        left.loglog(FREQUENCIES_RAD_S, np.abs(S), label=axis)
        L = 1.0 / S - 1.0
        right.plot(L.real, L.imag, label=axis)
    left.axhline(2.0, color="0.6", linewidth=1.0, linestyle="--")
    left.set(xlabel="frequency [rad/s]", ylabel="|S|", title="Sensitivity", ylim=(0.02, 20.0))
    right.plot(circle.real, circle.imag, color="0.8", linewidth=1.0)
    right.plot(-1.0 + 0.5 * circle.real, 0.5 * circle.imag, color="0.6", linewidth=1.0, linestyle="--", label="|S| = 2")
    right.plot(-1.0, 0.0, "k+")
    right.set(
        xlabel="Re L", ylabel="Im L", title="Loop L (Nyquist)", xlim=(-3.0, 1.5), ylim=(-2.2, 2.2), aspect="equal"
    )
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.suptitle(title)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(argv=None):
    """Print the margins. Returns the exit code: 1 where the loop is unstable; --json has nulls then."""
    parser = argparse.ArgumentParser(
        prog="rosrun risc_control loop_margins.py",
        description="Margins of the whole sampled loop of a hovering vehicle, broken at the command, offline.",
    )
    add = parser.add_argument
    add("--type", default=DEFAULT_TYPE, metavar="TYPE", help="of the vehicle (default: %(default)s)")
    add("--delay", type=float, metavar="S", dest="delay_s", help="of the link (default: that of the type)")
    add("--bandwidth", type=float, default=1.0, metavar="X",
        help="of the aircraft's attitude loops, over what the controller believes (default: 1)")  # fmt: skip
    add("--controller", choices=CONTROLLERS.names(), default=Flight.controller)
    add_option(add)
    add_set_option(add)
    add("--json", action="store_true", help="print JSON: the worse of roll and pitch, and each axis")
    add("--plot", type=pathlib.Path, metavar="FILE", help="draw |S| and the loop (.png, .pdf)")
    args = parser.parse_args(argv)
    progress = Progress()
    try:
        if not args.bandwidth > 0.0:
            raise ValueError("--bandwidth must be greater than 0")
        chosen = {"controller": args.controller, "estimator": args.estimator}
        chosen["params"] = numbers_of(args.controller, args.set)
        plant = slower(load_vehicle_type(args.type), args.bandwidth)
        flight = Flight(types=(args.type,), delay_s=args.delay_s, plant=plant, **chosen)
        found = responses(flight, lambda share: progress.show("hovering", bar(share)))
    except ValueError as error:
        progress.clear()
        parser.error(str(error))
    except RuntimeError as error:
        progress.say("loop_margins: %s" % error)
        if args.json:
            print(json.dumps(figures(dict.fromkeys(AXES, Margins(*[math.inf] * 5))), indent=2))
        return 1
    except KeyboardInterrupt:
        progress.say("loop_margins: interrupted")
        return 130
    progress.clear()
    per_axis_s = {axis: sensitivity(response) for axis, response in zip(AXES, found.T)}
    per_axis = {axis: margins(S) for axis, S in per_axis_s.items()}
    if args.json:
        print(json.dumps(figures(per_axis), indent=2))
    else:
        columns = "max|S|", "phase [deg]", "delay [ms]", "gain [dB]", "crossover [rad/s]"
        print("%-6s %7s %12s %11s %10s %18s" % ("axis", *columns))
        for axis, m in per_axis.items():
            print("%-6s %7.2f %12.1f %11.0f %10.1f %18.1f" % (axis, *m))
    if args.plot is not None:
        said = "%s, %s, %s" % (args.type, args.controller, estimator_of(args.controller, args.estimator))
        if args.delay_s is not None:
            said += ", delay %g s" % args.delay_s
        if args.bandwidth != 1.0:
            said += ", attitude loops x %g" % args.bandwidth
        picture(args.plot, per_axis_s, said)
    return 0


if __name__ == "__main__":
    sys.exit(main())
