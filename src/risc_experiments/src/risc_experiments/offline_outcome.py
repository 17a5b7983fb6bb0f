"""Outcome of a flight without ROS: crashes, contacts, vehicles that left their course, and how each fault ended."""

import math
from typing import NamedTuple

from risc_control.safety import FailsafeLevel
from risc_experiments.offline_chain import LATENCY_S


class Breach(NamedTuple):
    """A vehicle flew into the net or onto the floor, or fell."""

    time_s: float
    name: str
    reason: str


class Contact(NamedTuple):
    """Two vehicles touched in the air."""

    time_s: float
    name: str
    other: str


class FaultOutcome(NamedTuple):
    """Outcome of one fault."""

    name: str
    args: str  # as on the command line, with the vehicle that the seed chose
    start_s: float  # of the flight
    end_s: float | None  # None: it had no end
    outcome: str  # completed, held, landed or breach: the worst of any vehicle until the next fault
    safe: bool  # the fault's member calls the outcome safe, and no two vehicles touched
    reaction_ms: float | None  # from the fault's start to the first ladder that left OK; None: none did


def breaches_of(world, chains):
    """Breaches in order of time; for a vehicle that fell without a crash: when its motors stopped."""
    found = [Breach(crash.time_s, crash.namespace, crash.reason) for crash in world.crashes if not crash.other]
    crashed = {crash.namespace for crash in world.crashes}
    found += [Breach(chain.fell_s, chain.name, "fell: its motors were cut") for chain in chains
              if chain.fell_s is not None and chain.name not in crashed]  # fmt: skip
    return tuple(sorted(found))


def contacts_of(world):
    """Contacts in order of time: one for each touch of a pair."""
    pairs = {(crash.time_s, *sorted((crash.namespace, crash.other))) for crash in world.crashes if crash.other}
    return tuple(Contact(*pair) for pair in sorted(pairs))


def left_course_s(chain, breaches, contacts):
    """Time [s] when a vehicle left its course for good; infinite: never."""
    times_s = [said_s for said_s, verdict in chain.said if verdict.level is FailsafeLevel.LAND]
    times_s += [breach.time_s for breach in breaches if breach.name == chain.name]
    times_s += [contact.time_s for contact in contacts if chain.name in (contact.name, contact.other)]
    return min(times_s + chain.descents_s, default=math.inf)


def judge_faults(records, chains, breaches, contacts):
    """Yield the FaultOutcome of each FaultRecord, judged from its start to the start of the next one."""
    begins_s = sorted(record.begins_s for record in records)
    for record in records:
        until_s = min((begin_s for begin_s in begins_s if begin_s > record.begins_s), default=math.inf)
        said = sorted(
            (said_s, verdict.level, chain.down)
            for chain in chains
            for said_s, verdict in chain.said
            if record.begins_s <= said_s < until_s and verdict.level > FailsafeLevel.OK
        )
        touched, hurt = (
            any(record.begins_s - LATENCY_S <= event.time_s < until_s for event in events)
            for events in (contacts, breaches)
        )
        landings = [down for _, level, down in said if level is FailsafeLevel.LAND]
        for chain in chains:
            landings += [chain.down for descent_s in chain.descents_s if record.begins_s <= descent_s < until_s]
        if hurt or touched or not all(landings):
            outcome = "breach"
        elif landings:
            outcome = "landed"
        else:
            levels = (chain.levels(record.begins_s, until_s) for chain in chains)
            outcome = "held" if any(own and own[-1] > FailsafeLevel.OK for own in levels) else "completed"
        yield FaultOutcome(
            record.event.fault,
            record.event.args,
            record.begins_s - LATENCY_S,
            None if record.ends_s == math.inf else record.ends_s - LATENCY_S,
            outcome,
            outcome in record.event.settings.safe and not touched,
            1e3 * (said[0][0] - record.begins_s) if said else None,
        )
