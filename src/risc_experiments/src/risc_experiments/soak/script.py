"""The faults of each flight of a soak, generated from its seed."""

from typing import NamedTuple

import numpy as np
import yaml

from risc_experiments.scorecard import plan
from risc_experiments.soak.settings import ProgramFaultParams
from risc_simulator.faults import FaultEvent

KILL, STOP = OF_PROGRAMS = "node_kill", "node_stop"


class Deck(NamedTuple):
    """What faults are drawn from."""

    names: tuple[str, ...]  # of those in the lab, as the scorecard draws its `random`
    of_programs: tuple[str, ...]  # some of OF_PROGRAMS
    share: float  # of faults of programs, among all
    programs: ProgramFaultParams
    card: plan.ScorecardParams

    def draw(self, rng):
        """A random FaultEvent, without a time yet."""
        if not self.of_programs or self.names and rng.random() >= self.share:
            return plan.random_fault(self.names, self.card.random, rng)
        programs = self.programs
        name = self.of_programs[rng.integers(len(self.of_programs))]
        program = programs.names[rng.integers(len(programs.names))]
        if name == KILL:
            return FaultEvent(KILL, program=program)
        return FaultEvent(STOP, program=program, duration_s=plan.between_log(*programs.stop_s, rng))

    @property
    def samples(self):
        """A FaultEvent of each kind."""
        yield from map(FaultEvent, self.names)
        for name in self.of_programs:
            yield from (FaultEvent(name, program=program) for program in self.programs.names)


def deck_of(wanted, params, card):
    """Deck of the wanted faults; (): of all with which a flight can end safely.

    params: SoakParams.  card: ScorecardParams.  Raises ValueError for an unknown name.
    """
    programs = params.programs
    known = [*plan.members(card), *OF_PROGRAMS]
    unknown = [name for name in (*wanted, *params.leave_out) if name not in known]
    if unknown:
        raise ValueError("unknown fault '%s'; known faults are: %s" % (unknown[0], ", ".join(known)))
    chosen = wanted or (*plan.safe_members(card), *(OF_PROGRAMS if programs.share and programs.names else ()))
    chosen = [name for name in chosen if name not in params.leave_out]
    of_programs = tuple(name for name in OF_PROGRAMS if name in chosen)
    names = tuple(name for name in chosen if name not in OF_PROGRAMS)
    if not chosen or of_programs and not programs.names:
        raise ValueError("no fault is left to be drawn")
    return Deck(names, of_programs, programs.share, programs, card)


def faults_of(number, seed, deck, vehicles, duration_s):
    """FaultEvents of a flight. number: of the flight, from 1.  vehicles: namespaces.  duration_s: on the course."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    return plan.script(lambda: deck.draw(rng), deck.card.events, vehicles, duration_s, rng)


def check(deck, duration_s):
    """Raises ValueError when flights are too short for faults."""
    if not any(faults_of(number, 1, deck, ["risc1"], duration_s) for number in range(1, 10)):
        raise ValueError("no fault fits into flights of %g s on the course: a longer --duration" % duration_s)


def file_text(events, seed):
    """Content of a file for `./maap fly --faults`. seed: of the soak, and so of its vehicles."""
    fields = ("fault", "vehicle", "severity", "duration_s", "start_s", "channel", "program")
    faults = [{name: getattr(event, name) for name in fields} for event in events]
    return yaml.safe_dump({"seed": seed, "faults": faults}, sort_keys=False)
