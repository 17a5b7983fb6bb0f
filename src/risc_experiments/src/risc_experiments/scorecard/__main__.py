"""`./maap scorecard`: faults against estimators and controllers in whole flights offline, as tables and one page."""

import argparse
import datetime
import json
import os
import pathlib
import shlex
import sys
from dataclasses import asdict

from data_extraction.progress import Progress, bar
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_estimation.filters import REGISTRY as ESTIMATORS
from risc_experiments.estimators import estimator_of
from risc_experiments.offline import Flight
from risc_experiments.option_types import name_list, number
from risc_experiments.scorecard import output
from risc_experiments.scorecard.figures import compare, key_of, row_of, totals_of
from risc_experiments.scorecard.flights import Record, code_version, fly_plan
from risc_experiments.scorecard.from_bag import make_script
from risc_experiments.scorecard.plan import (
    GRADES,
    NONE,
    RANDOM,
    Cell,
    Plan,
    is_file,
    load_params,
    members,
    severities_of,
    vehicles_of,
)
from risc_lab.revision import revision
from risc_simulator.faults import REGISTRY, load_faults


def arguments(argv=None):
    """Options of the command line."""
    parser = argparse.ArgumentParser(
        prog="maap scorecard",
        description="Faults of every severity against estimators and controllers, in offline flights (simulated).",
        epilog="A run that was interrupted goes on where it was when it is started again.",
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="a few faults, a minute or two")
    add("--faults", metavar="A,B", type=name_list, help="names of ./maap faults, %s (nothing happens), %s (any of them "
        "at random times), or FILE.yaml with a list of faults (default: all)" % (NONE, RANDOM))  # fmt: skip
    add("--severities", metavar="A,B", type=name_list, help="of %s (default: all)" % ", ".join(GRADES))
    add("--estimators", metavar="A,B", type=name_list, help="of %s (default: that of the controller)"
        % ", ".join(ESTIMATORS.names()))  # fmt: skip
    add("--controllers", metavar="A,B", type=name_list, default=(Flight.controller,), help="of %s (default: %s)"
        % (", ".join(CONTROLLERS.names()), Flight.controller))  # fmt: skip
    add("--minutes", type=number(0.01), metavar="M", help="on the course, at least, of each row")
    add("--seeds", type=_seeds, metavar="N|A-B", help="N flights of each row, with the seeds 1 to N, or those with the "
        "seeds A to B: a part for each of several computers, say; with --minutes M/N minutes each")  # fmt: skip
    add("--seed", type=number(1), metavar="K", help="only the flight of each row that has this seed, to look into it")
    add("--no-ladder", action="store_false", dest="ladder", help="control arm: the vehicle nodes' safety ladder is off")
    add("--from", type=pathlib.Path, metavar="BAG", dest="bag", help="write the faults that a bag shows into DIR; fly "
        "them")  # fmt: skip
    add("--against", type=pathlib.Path, metavar="JSON", help="compare with another scorecard")
    add("--json", type=pathlib.Path, metavar="FILE", help="write the JSON file here, too")
    add("--out", type=pathlib.Path, metavar="DIR", help="folder (default: flights/scorecard, or "
        "flights/scorecard_no_ladder)")  # fmt: skip
    add("--settings", type=pathlib.Path, metavar="YAML", help="what differs from config/scorecard.yaml, e.g. "
        "config/scorecard_iris.yaml")  # fmt: skip
    add("--workers", type=number(1), metavar="N", help="flights at the same time (default: a core each)")
    args = parser.parse_args(argv)
    if args.out is None:
        args.out = pathlib.Path(os.environ.get("RISC_MAAP_ROOT", "."), "flights", "scorecard")
        if not args.ladder:
            args.out = args.out.with_name("scorecard_no_ladder")
    return parser, args


def _seeds(text):
    """The seeds of "N" or "A-B"."""
    first, dash, last = text.partition("-")
    try:
        seeds = range(int(first), int(last) + 1) if dash else range(1, int(first) + 1)
    except ValueError:
        seeds = ()
    if not seeds or seeds[0] < 1:
        raise argparse.ArgumentTypeError("must be N, or A-B from 1 on, found %s" % text)
    return seeds


def plan_of(args):
    """The Plan of the options. Raises ValueError."""
    params = load_params(args.settings)
    quick = params.quick
    flight_s, minutes = (quick.flight_s, quick.minutes) if args.quick else (params.flight_s, params.minutes)
    if args.seeds is not None:
        flight_s = flight_s if args.minutes is None else 60.0 * args.minutes / len(args.seeds)
    elif args.minutes is not None:
        minutes, flight_s = args.minutes, min(flight_s, 60.0 * args.minutes)
    flight_s = max(flight_s, params.least_flight_s)
    seeds = args.seeds if args.seed is None else (args.seed,)
    names = args.faults or (quick.faults if args.quick else (NONE, *members(params), RANDOM))
    severities = args.severities or (quick.severities if args.quick else GRADES)
    _check(severities, GRADES, "severity", "severities")
    graded = [NONE, RANDOM, *members(params)]
    for name in names:
        if name in REGISTRY.names() and name not in graded:
            text = "fault %s has no grades, or is left out by the settings: fly it from a list, with --faults FILE.yaml"
            raise ValueError(text % name)
    _check([name for name in names if not is_file(name)], graded, "fault", "faults")
    _check(args.controllers, CONTROLLERS.names(), "controller", "controllers")
    for name in filter(is_file, names):
        load_faults(name)
    _check(args.estimators or (), ESTIMATORS.names(), "estimator", "estimators")
    cells = [
        Cell(name, severity, estimator, controller)
        for controller in args.controllers
        for estimator in args.estimators or [estimator_of(controller)]
        for name in names
        for severity in severities_of(name, severities)
    ]
    plan = Plan(tuple(cells), flight_s, minutes, seeds and tuple(seeds), args.ladder, params)
    for cell in cells:
        plan.check(cell)
    return plan


def _check(names, known, what, kind):
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError("unknown %s '%s'; known %s are: %s" % (what, unknown[0], kind, ", ".join(known)))


def identity_of(plan):
    """Identity of a file of flights: flights of another identity do not belong to the same scorecard. The minutes are
    not part of it: they may be increased.
    """
    files = {cell.fault: repr(load_faults(cell.fault)) for cell in plan.cells if is_file(cell.fault)}
    identity = {
        "command_line": plan._replace(params=None, minutes=None)._asdict() | {"files": files},
        "settings": asdict(plan.params),
        "code": code_version(),
    }
    return json.loads(json.dumps(identity))


def scorecard_of(plan, record, command, complete):
    """The scorecard of what was flown so far, as a dict for JSON."""
    rows = [row_of(cell, record.flown[cell]) for cell in plan.cells if cell in record.flown]
    failures, findings = [], []
    for cell in plan.cells:
        for seed, figures in sorted(record.flown.get(cell, {}).items()):
            who = key_of(cell) | {"seed": seed}
            if "error" in figures:
                failures.append(who | {"error": figures["error"]})
                continue
            findings += [who | {"what": what, "text": text} for what in ("breach", "contact") for text in figures[what]]
    root = os.environ.get("RISC_MAAP_ROOT")
    return {
        "simulated": True,
        "complete": complete,
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": command,
        "revision": revision(root) if root else None,
        "ladder": plan.ladder,
        "settings": asdict(plan.params) | {"flight_s": plan.flight_s, "minutes": None if plan.seeds else plan.minutes},
        "rows": rows,
        "totals": totals_of(rows),
        "findings": findings,
        "failures": failures,
    }


def main(argv=None):
    """Make a scorecard. Returns the exit code."""
    parser, args = arguments(argv)
    command = "./maap scorecard " + shlex.join(sys.argv[1:] if argv is None else argv)
    progress = Progress()
    if args.json and not args.json.parent.is_dir():
        parser.error("--json: there is no folder %s" % args.json.parent)
    try:
        if args.bag is not None:
            args.faults = (_script(args, progress),)
        plan = plan_of(args)
        against = None if args.against is None else output.read(args.against)
        record = Record(args.out, identity_of(plan))
        if record.notice:
            progress.say(record.notice)
        code = _fly(plan, record, args.workers, progress)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    scorecard = scorecard_of(plan, record, command.strip(), code == 0)
    if not scorecard["rows"]:
        progress.say("scorecard: nothing was flown")
        return code
    if against is not None:
        scorecard["against"] = {
            "file": str(args.against),
            "conditions": output.differing_conditions(scorecard, against),
            "differences": compare(scorecard["rows"], against["rows"]),
        }
    paths = output.write_all(scorecard, args.out)
    if args.json:
        output.write_json(scorecard, args.json)
    progress.clear()
    print(output.markdown(scorecard))
    for form, path in paths.items():
        print("%-5s %s" % (form, path))
    return code


def _script(args, progress):
    """Write a file of the faults that a bag shows. Returns its path. Raises ValueError when it shows none."""
    path = args.out / (args.bag.stem + "_faults.yaml")
    vehicles = vehicles_of(load_params(args.settings))
    events, outside = make_script(args.bag, path, vehicles, lambda part: progress.show("reading", bar(part)))
    left_out = ", and %d before or after, which are left out" % outside if outside else ""
    progress.say("%s: %d faults on the course%s; %s" % (args.bag, len(events), left_out, path))
    for event in events:
        progress.say("  %s" % event)
    if not events:
        raise ValueError("%s shows no fault of motion capture on the course: there is nothing to fly" % args.bag)
    return str(path)


def _fly(plan, record, workers, progress):
    """Fly the plan. Returns the exit code, 0 when all was flown."""
    try:
        fly_plan(plan, record, workers, lambda part: progress.show("flying", bar(part)))
    except KeyboardInterrupt:
        progress.say("scorecard: interrupted; the same command goes on where it was")
        return 130
    except ChildProcessError as error:
        progress.say("scorecard: %s" % error)
        return 1
    finally:
        record.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
