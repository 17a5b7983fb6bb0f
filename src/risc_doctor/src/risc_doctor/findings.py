"""Findings of checks: green, yellow or red, in one sentence, with the cure. For `maap doctor` and `machines`.

The sentences are in config/findings.yaml, by check and code.
"""

import functools
import pathlib
import shutil
import sys
import textwrap
import traceback
from dataclasses import dataclass, field

import msgspec

from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Settings

GREEN, YELLOW, RED = LEVELS = ("green", "yellow", "red")  # from good to bad
_COLOURS = {GREEN: "\033[32m", YELLOW: "\033[33m", RED: "\033[1;31m"}
_PLAIN = "\033[0m"
_WIDTH = 110  # characters of a table that goes into a file
_NARROWEST = 40  # characters for the text, however narrow the terminal is


@dataclass(frozen=True)
class Finding(Settings):
    """Result of one check. Raises ValueError for an unknown level, and without a cure unless it is green."""

    check: str  # name of the check, e.g. "cortex"
    level: str  # GREEN: good; YELLOW: may fly, or could not be checked; RED: does not fly
    text: str  # what was found, one sentence, with numbers and units
    cure: str = ""  # what to do about it; needed unless green
    data: dict = field(default_factory=dict)  # values for other programs; must fit into JSON
    code: str = ""  # of the sentence, in config/findings.yaml

    def __post_init__(self):
        super().__post_init__()
        if self.level not in LEVELS:
            raise ValueError("the level of a finding is one of %s, not %r" % (", ".join(LEVELS), self.level))
        if self.level != GREEN and not self.cure:
            raise ValueError("a finding that is %s needs a cure: %s: %s" % (self.level, self.check, self.text))


def to_json(findings):
    """A list of findings as text; numbers that JSON does not have (NaN, infinite) become null."""
    return msgspec.json.encode(findings, enc_hook=str).decode()


@functools.cache
def catalogue():
    """{check: {code: entry}} of config/findings.yaml."""
    return load_yaml(package_file("risc_doctor", "config/findings.yaml"))


def finding(check, code, level=None, **values):
    """The Finding of a code, with the values of its sentence and cure. level: None = the one in the file."""
    entry = catalogue()[check].get(code) or catalogue()["any"][code]
    usual = next(key for key in LEVELS if key in entry)
    level, data = level or usual, {key: values[key] for key in entry.get("data", "").split()}
    cure = entry["cure"].format(**values) if level != GREEN else ""
    return Finding(check, level, entry[usual].format(**values), cure, data, code)


class Findings(list):
    """What a check has found."""

    def __init__(self, check):
        super().__init__()
        self._check = check

    def say(self, code, level=None, **values):
        """Add a finding, see `finding`. Returns self."""
        self.append(finding(self._check, code, level, **values))
        return self


class FoundError(Exception):
    """Nothing more can be checked; `finding` says why."""

    def __init__(self, check, code, **values):
        self.finding = finding(check, code, **values)
        super().__init__(self.finding.text)


def collect(findings):
    """List of the findings of an iterator. A FoundError may end it: its finding is the last one."""
    found = []
    try:
        for one in findings:
            found.append(one)  # noqa: PERF402 - those before an error stay
    except FoundError as error:
        found.append(error.finding)
    return found


def guarded(check, function, *arguments):
    """`collect` of a function's findings; after an exception a red one that says where, so that other checks go on."""
    try:
        return collect(function(*arguments))
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = "%s, line %d" % (pathlib.PurePath(place.filename).name, place.lineno)
        return [finding(check, "broken", error="%s: %s" % (type(error).__name__, error), place=where)]


def worst(findings):
    """The worst level of all; GREEN when there are none."""
    return max((finding.level for finding in findings), key=LEVELS.index, default=GREEN)


def exit_code(findings):
    """0 when nothing is red, else 1."""
    return 1 if worst(findings) == RED else 0


def count_text(findings):
    """How many there are of each level, e.g. "12 green, 2 yellow, 1 red"; levels without any are left out."""
    counts = [(level, sum(finding.level == level for finding in findings)) for level in LEVELS]
    return ", ".join("%d %s" % (count, level) for level, count in counts if count) or "nothing was looked at"


def print_findings(findings):
    """Print an aligned table, the cure below each finding that is not green; coloured, and as wide as a terminal is."""
    terminal = sys.stdout.isatty()
    names, levels = max((len(found.check) for found in findings), default=0), max(map(len, LEVELS))
    space = " " * (levels + names + 4)
    width = max(_NARROWEST + len(space), shutil.get_terminal_size((_WIDTH, 24)).columns if terminal else _WIDTH)
    for found in findings:
        text = _wrapped(found.text, "%-*s  %-*s  " % (levels, found.level, names, found.check), space, width)
        print(_COLOURS[found.level] + found.level + _PLAIN + text[len(found.level) :] if terminal else text)
        if found.level != GREEN:
            print(_wrapped(found.cure, space + "> ", space + "  ", width))


def _wrapped(text, first, others, width):
    """Wrap a text, with its first and other lines indented; commands and addresses are not broken."""
    options = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": others}
    lines = [line for line in text.splitlines() if line.strip()] or [""]
    return "\n".join(
        textwrap.fill(line, width, initial_indent=others if number else first, **options) or first
        for number, line in enumerate(lines)
    )
