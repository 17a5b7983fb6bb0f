"""The faults of each flight of a soak, made of its seed."""

import numpy as np
import yaml

from risc_experiments.scorecard import plan


def names_of(wanted, left_out, card):
    """Names of the faults that are drawn. wanted: (), for all that a flight can end safely with.

    card: ScorecardParams.  Raises ValueError for a name that is none.
    """
    known = plan.members(card)
    unknown = [name for name in (*wanted, *left_out) if name not in known]
    if unknown:
        raise ValueError("unknown fault '%s'; known faults are: %s" % (unknown[0], ", ".join(known)))
    names = [name for name in wanted or plan.safe_members(card) if name not in left_out]
    if not names:
        raise ValueError("no fault is left to be drawn")
    return names


def faults_of(number, seed, names, vehicles, duration_s, card):
    """FaultEvents of a flight, as the scorecard draws its `random`. number: of the flight, from 1.

    vehicles: namespaces.  duration_s: on the course.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    return plan.script(lambda: plan.random_fault(names, card.random, rng), card.events, vehicles, duration_s, rng)


def check(names, duration_s, card):
    """Raises ValueError when flights are too short for faults."""
    if not any(faults_of(number, 1, names, ["risc1"], duration_s, card) for number in range(1, 10)):
        raise ValueError("no fault fits into flights of %g s on the course: a longer --duration" % duration_s)


def file_text(events):
    """Content of a file for `./maap fly --faults`."""
    fields = ("fault", "vehicle", "severity", "duration_s", "start_s", "channel")
    return yaml.safe_dump({"faults": [{name: getattr(event, name) for name in fields} for event in events]})
