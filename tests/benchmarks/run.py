"""`./maap bench [NAME ...] [--json FILE]`, `./maap bench NAME [its options]`: the measurements behind the figures in
README and docs.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
DOCS = HERE.parents[1] / "docs"
PYTHON = sys.executable

# name: (what it measures, command; {json} is the file that the command writes its figures to)
BENCHMARKS = {
    "world": ("speed of the offline world", [PYTHON, str(HERE / "world.py"), "--json", "{json}"]),
    "render": ("time of a rendered picture", [PYTHON, str(HERE / "render.py"), "--json", "{json}"]),
    "offline": ("offline closed loop: accuracy and speed", [PYTHON, "-m", "risc_experiments.offline", "--seeds", "3",
                                                            "--delay", "0.1", "0.3", "--json", "{json}"]),
    "planning": ("ways of 1 to 50 vehicles: time to plan and to sample, gaps in the references",
                 [PYTHON, str(HERE / "planning.py"), "--json", "{json}"]),
    "estimation": ("noise and time of the estimator", [PYTHON, str(HERE / "estimation.py"), "--json", "{json}"]),
    "control": ("time per frame of controller and vehicle pilot", [PYTHON, str(HERE / "control.py"),
                                                                   "--json", "{json}"]),
    "decode": ("decoding a 16-body frame in C++", [PYTHON, str(HERE / "decode.py"), "--json", "{json}"]),
    "serial_line": ("line to the board of an IRIS+: back after damage and outages, dead line, ROS message to signal",
                    [PYTHON, str(HERE / "serial_line.py"), "--json", "{json}"]),
    "drawing": ("markers for rviz: time per drawing, up to 50 vehicles", [PYTHON, str(HERE / "drawing.py"),
                                                                          "--json", "{json}"]),
    "vision": ("landmark detection on a rendered set: precision, recall, centre error, time",
               [PYTHON, str(HERE / "vision.py"), "--json", "{json}", "--markdown", str(DOCS / "vision.md"),
                "--pictures", str(DOCS / "images" / "vision")]),
    "long_bag": ("report of a long bag with pictures: time and peak memory (needs 9 GB of disk meanwhile)",
                 [PYTHON, str(HERE / "long_bag.py"), "--json", "{json}"]),
    "startup": ("start-up time of estimator, controller, trajectory, vehicle node, driver; up to 50 vehicles",
                [PYTHON, str(HERE / "startup.py"), "--json", "{json}"]),
    "recording": ("processor time of a recording, ours and that of rosbag record in turn",
                  [PYTHON, str(HERE / "recording.py"), "--json", "{json}"]),
    "flood": ("a stranger floods the mocap stream's port: frames lost, processor time",
              [PYTHON, str(HERE / "flood.py"), "--json", "{json}"]),
    "profile": ("where the processor time of a flight goes, program by program",
                [PYTHON, str(HERE / "profile_nodes.py"), "--json", "{json}"]),
    "scale": ("1 to 50 vehicles, 1 to 100 bodies: latency, cores, memory, frames lost, quiet and beside a busy loop",
              [PYTHON, str(HERE / "scale.py"), "--json", "{json}"]),
    "faults": ("whole graph in real time: from the begin of a fault to the command on the wire, many events of each",
               [PYTHON, str(HERE / "faults.py"), "--json", "{json}"]),
    "false_states": ("whole graph in real time: false motion capture, states that say visible and are wrong",
                     [PYTHON, str(HERE / "false_states.py"), "--json", "{json}"]),
    "gate": ("what the estimator refuses: good poses, false frames, outages; NEES and NIS (options: --gate off ...)",
             [PYTHON, str(HERE / "gate.py"), "--json", "{json}"]),
    "tracking": ("accuracy of courses beside the H2 limit (options: --gust, --delay, --loss, --swap ...)",
                 [PYTHON, str(HERE / "tracking.py"), "--json", "{json}"]),
    "plants": ("accuracy on plants that differ from their type in loops, delay, mass, thrust",
               [PYTHON, str(HERE / "plants.py"), "--json", "{json}"]),
    "flights": ("whole graph in real time: accuracy and latency, 5 seeds", [PYTHON, str(HERE / "flights.py"),
                                                                           "--json", "{json}"]),
}  # fmt: skip
# false_states, faults, flights and scale take a quarter of an hour and more, gate, plants and tracking some minutes,
# long_bag a big disk; vision rewrites tables of docs/vision.md
BY_NAME_ONLY = {
    "false_states",
    "faults",
    "flights",
    "gate",
    "long_bag",
    "plants",
    "profile",
    "scale",
    "tracking",
    "vision",
}


def run(name, options=()):
    """Run one benchmark with options of its own; it prints its table. Returns (exit code, its figures)."""
    what, command = BENCHMARKS[name]
    print("== %s: %s" % (name, what), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "figures.json"
        code = subprocess.call([part.replace("{json}", str(path)) for part in command] + list(options))
        figures = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    print(flush=True)
    return code, figures


def main():
    """Command line. Returns 1 when a benchmark failed or missed what it requires."""
    parser = argparse.ArgumentParser(prog="maap bench", description=__doc__, allow_abbrev=False)
    names = "; ".join("%s: %s" % (name, what) for name, (what, _) in BENCHMARKS.items())
    help_text = "%s. Default: all but %s" % (names, ", ".join(sorted(BY_NAME_ONLY)))
    parser.add_argument("names", nargs="*", metavar="NAME", help=help_text)
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="also write all figures here")
    args, options = parser.parse_known_args()
    if options and len(args.names) != 1:
        parser.error("%s: options are those of one benchmark; write ./maap bench NAME %s" % (
            options[0], " ".join(options)))  # fmt: skip
    unknown = sorted(set(args.names) - set(BENCHMARKS))
    if unknown:
        parser.error("unknown: %s; known are %s" % (", ".join(unknown), ", ".join(BENCHMARKS)))
    chosen = args.names or [name for name in BENCHMARKS if name not in BY_NAME_ONLY]
    results = {name: run(name, options) for name in chosen}
    if args.json:
        figures = {name: figures for name, (_, figures) in results.items()}
        if len(results) == 1:  # also without its name, as its own program writes them
            figures.update(next(iter(figures.values())) or {})
        args.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    failed = [name for name, (code, _) in results.items() if code != 0]
    if failed:
        print("failed or below what is required: %s" % ", ".join(failed), file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
