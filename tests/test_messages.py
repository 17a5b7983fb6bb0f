"""Facts pass between programs as typed messages: no program reads them out of text that another one wrote."""

import pathlib
import re

import pytest

from risc_control.safety import FailsafeLevel, Rule
from risc_lab.phases import OperatorPhase, OperatorResult, OutCause, TrajectoryPhase

ROOT = pathlib.Path(__file__).resolve().parents[1]
SOURCES = [
    path
    for path in sorted((ROOT / "src").rglob("*"))
    if path.is_file() and not {"test", "__pycache__"}.intersection(path.parts) and path.suffix not in (".md", ".pyc")
]
# The original release had no topic of std_msgs/String; one that had, and its mirror here, would stand in this list.
STRING = re.compile(r"from std_msgs\.msg import .*\bString\b|std_msgs[./](msg\.)?String\b|std_msgs::String")
MIRRORS = ()
# It only displays the texts to people.
SHOWS_DIAGNOSTICS = ("src/risc_doctor/src/risc_doctor/ros_graph.py",)


def those_with(pattern):
    texts = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8", errors="replace") for path in SOURCES}
    return sorted(name for name, text in texts.items() if re.search(pattern, text))


def test_no_program_sends_or_reads_facts_as_text():
    assert those_with(STRING) == sorted(MIRRORS)


def test_no_program_reads_diagnostics():
    assert those_with(r"\bDiagnosticArray\b") == sorted(SHOWS_DIAGNOSTICS)


@pytest.mark.parametrize(
    "name, enumerations",
    [
        ("Safety", (FailsafeLevel, Rule)),
        ("VehiclePhase", (TrajectoryPhase,)),
        ("OperatorState", (OperatorPhase, OperatorResult)),
        ("VehicleOut", (OutCause,)),
    ],
)
def test_enumerations_have_the_numbers_of_the_messages(name, enumerations):
    messages = pytest.importorskip("risc_maap_msgs.msg")
    constants = {key: value for key, value in vars(getattr(messages, name)).items() if key.isupper()}
    assert constants == {member.name: member.value for enumeration in enumerations for member in enumeration}
