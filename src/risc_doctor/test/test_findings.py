"""Findings of checks: levels, JSON and back, the table for people."""

import ast
import io
import json
import pathlib
import string
import sys

import msgspec
import pytest

from risc_doctor import findings
from risc_doctor.findings import (
    GREEN,
    LEVELS,
    RED,
    YELLOW,
    Finding,
    catalogue,
    count_text,
    exit_code,
    print_findings,
    to_json,
    worst,
)
from risc_doctor.serial_lines import CODES

SOURCES = sorted((pathlib.Path(__file__).resolve().parents[1] / "src").rglob("*.py"))

MIXED = [
    Finding("network", GREEN, "eth0 has 10.0.0.1/24"),
    Finding(
        "clock", YELLOW, "nothing synchronises this clock", "sudo apt-get install chrony", {"offset_s": float("nan")}
    ),
    Finding("cortex", RED, "129.123.5.10 does not answer on port 1510", "switch the Cortex computer on"),
]


def test_the_worst_one_decides():
    assert [worst(MIXED), worst(MIXED[:2]), worst(MIXED[:1]), worst([])] == [RED, YELLOW, GREEN, GREEN]
    assert [exit_code(MIXED), exit_code(MIXED[:2]), exit_code([])] == [1, 0, 0]
    assert count_text(MIXED + MIXED[:1]) == "2 green, 1 yellow, 1 red"


def test_a_finding_survives_json():
    back = msgspec.json.decode(to_json(MIXED), type=list[Finding])
    assert [finding.text for finding in back] == [finding.text for finding in MIXED]
    assert back[0] == MIXED[0] and back[1].data == {"offset_s": None}


@pytest.mark.parametrize(
    "content",
    [
        None,
        "green",
        {},
        {"check": "a", "level": "blue", "text": "b"},
        {"check": "a", "level": "red", "text": "without a cure"},
        {"check": "a", "level": "green", "text": 5},
        {"check": "a", "level": "green", "text": "b", "data": 5},
    ],
)
def test_what_is_no_finding_is_refused(content):
    with pytest.raises(ValueError):
        msgspec.json.decode(json.dumps(content), type=Finding)


def test_the_table_is_aligned_with_the_cure_below(capsys):
    print_findings(MIXED)
    assert capsys.readouterr().out.splitlines() == [
        "green   network  eth0 has 10.0.0.1/24",
        "yellow  clock    nothing synchronises this clock",
        "                 > sudo apt-get install chrony",
        "red     cortex   129.123.5.10 does not answer on port 1510",
        "                 > switch the Cortex computer on",
    ]


def test_long_texts_are_wrapped_into_their_column_and_commands_stay_whole(capsys, monkeypatch):
    monkeypatch.setattr(findings, "_WIDTH", 60)
    address = "http://" + 60 * "a"
    print_findings([Finding("x", RED, 20 * "word ", "see " + address + "\n\nor not")])
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 60 for line in lines if address not in line)
    assert sum(address in line for line in lines) == 1 and lines[-1].endswith("  or not")
    assert sum("> " in line for line in lines) == 1, "an empty line is left out"
    assert all(line.startswith(" " * len("yellow  x  ")) for line in lines[1:])


def test_only_a_terminal_gets_colours(monkeypatch, capsys):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    print_findings(MIXED)
    assert "\033" not in capsys.readouterr().out
    coloured = Terminal()
    monkeypatch.setattr(sys, "stdout", coloured)
    print_findings(MIXED)
    assert coloured.getvalue().count("\033[0m") == len(MIXED)


def fields(entry):
    return {name for text in entry.values() for _, name, _, _ in string.Formatter().parse(text) if name}


def calls():
    """(place, codes, names of values or None where they are not written out) of all findings in the doctor's code."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = ast.unparse(node.func).split(".")[-1] if isinstance(node, ast.Call) else ""
            if name in ("say", "finding"):
                code = node.args[name == "finding"]
                codes = {part.value for part in ast.walk(code) if isinstance(part, ast.Constant)}
                names = [keyword.arg for keyword in node.keywords]
                yield "%s:%d" % (path.name, node.lineno), codes, None if None in names else set(names)


def test_what_is_said_is_in_the_catalogue_and_has_its_values():
    entries = {code: entry for codes in catalogue().values() for code, entry in codes.items()}
    for place, codes, names in calls():
        for code in codes & set(entries) if names is not None else ():
            mine = [codes[code] for codes in catalogue().values() if code in codes]
            assert any(fields(entry) <= names for entry in mine), (place, code)
    texts = {
        part.value
        for path in SOURCES
        for part in ast.walk(ast.parse(path.read_text()))
        if isinstance(part, ast.Constant)
    } | set(CODES.values())
    assert [code for code in entries if code not in texts] == [], "no program says these"
    for entry in entries.values():
        (level,) = set(entry) & set(LEVELS)
        assert set(entry) <= {level, "cure", "data"} and (level == GREEN or entry["cure"])
