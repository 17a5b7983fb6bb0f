"""Findings of checks: levels, JSON and back, the table for people."""

import io
import json

import pytest

from risc_doctor.findings import (
    GREEN,
    RED,
    YELLOW,
    Finding,
    count_text,
    exit_code,
    green,
    print_findings,
    red,
    table,
    worst,
    yellow,
)

MIXED = [
    green("network", "eth0 has 10.0.0.1/24"),
    yellow("clock", "nothing keeps this clock right", "sudo apt-get install chrony", offset_s=float("nan")),
    red("cortex", "129.123.5.10 does not answer on port 1510", "switch the Cortex computer on"),
]


def test_the_worst_one_decides():
    assert [worst(MIXED), worst(MIXED[:2]), worst(MIXED[:1]), worst([])] == [RED, YELLOW, GREEN, GREEN]
    assert [exit_code(MIXED), exit_code(MIXED[:2]), exit_code([])] == [1, 0, 0]
    assert count_text(MIXED + MIXED[:1]) == "2 green, 1 yellow, 1 red"


def test_a_finding_survives_json():
    text = json.dumps([finding.to_dict() for finding in MIXED], allow_nan=False)
    back = [Finding.from_dict(item) for item in json.loads(text)]
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
        Finding.from_dict(content)


def test_the_table_is_aligned_with_the_cure_below():
    assert table(MIXED) == [
        "green   network  eth0 has 10.0.0.1/24",
        "yellow  clock    nothing keeps this clock right",
        "                 > sudo apt-get install chrony",
        "red     cortex   129.123.5.10 does not answer on port 1510",
        "                 > switch the Cortex computer on",
    ]


def test_long_texts_are_wrapped_into_their_column_and_commands_stay_whole():
    address = "http://" + 60 * "a"
    lines = table([red("x", 20 * "word ", "see " + address)], width=60)
    assert all(len(line) <= 60 for line in lines if address not in line)
    assert sum(address in line for line in lines) == 1
    assert all(line.startswith(" " * len("yellow  x  ")) for line in lines[1:])


def test_only_a_terminal_gets_colours():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    plain, coloured = io.StringIO(), Terminal()
    print_findings(MIXED, plain)
    print_findings(MIXED, coloured)
    assert "\033" not in plain.getvalue() and plain.getvalue().splitlines() == table(MIXED)
    assert coloured.getvalue().count("\033[0m") == len(MIXED)
