"""The firmware as machine code of the Due, in an emulator: messages in, edges of the signal out, at 57600 baud.

With the node's link, in simulated time: nothing depends on the computer's speed. Then with serial_node itself, from a
message of ROS on, in real time: for that the emulator needs half a core.
"""

import json
import os
import pathlib
import shutil
import subprocess
import sys

import due
import pytest
import serial_line as bench

pytestmark = pytest.mark.skipif(
    shutil.which("arm-none-eabi-g++") is None, reason="gcc-arm-none-eabi is missing: ./maap setup installs it"
)
STEADY = 20  # commands from the first on, and before the last, that are not measured


@pytest.fixture(autouse=True)
def emulated(monkeypatch, tmp_path):
    """The chains of this test have the machine code at their end."""
    program = due.build(due.FIRMWARE / "dueppm", tmp_path)
    monkeypatch.setattr(bench, "Board", lambda: due.MachineCode(program))


def test_messages_in_and_edges_out(capsys):
    chain = bench.Chain()
    chain.run(1.6)
    counts = chain.link.facts.counts
    assert counts["packets"] > 12 and counts["damaged"] == counts["lost"] == counts["replaced"] == 0
    assert set(chain.receiver.counts) <= {"frames", "no gap before"}
    sent = [(at_s, number) for number, at_s in enumerate(chain.posted_s)][STEADY:-STEADY]
    delays = bench.percentiles(bench.delays_s(sent, chain.frames))
    with capsys.disabled():
        print("\n" + bench.line_of("machine code: frame begins [ms]", delays))
    assert 13.0 < delays["p50_ms"] < delays["max_ms"] < 60.0, "a message takes 13 ms over the line, a frame 20 ms"


@pytest.mark.release
@pytest.mark.parametrize("what", ["noise both ways", "loss both ways"])
@pytest.mark.parametrize("lasts_s", [bench.SHORT_S, bench.LONG_S], ids=["short", "long"])
def test_the_signal_follows_again_after_damage(what, lasts_s):
    back = bench.after_damage(what, 10, lasts_s)
    assert back["host"]["max_ms"] <= 100.0 and back["signal"]["max_ms"] <= 100.0


@pytest.mark.release
def test_through_the_node(capsys):
    """How long a command takes depends on the computer's load. That it arrives does not."""
    program = "import json, serial_line as b; print(json.dumps(b.through_the_node(40, b.machine_code())))"
    path = os.pathsep.join((str(pathlib.Path(bench.__file__).parent), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.PIPE, timeout=300.0
    )
    assert done.returncode == 0
    figures = json.loads(done.stdout.splitlines()[-1])
    with capsys.disabled():
        print("\n" + bench.line_of("serial_node, machine code: frame begins", figures["signal"]))
    assert 0.0 < figures["board"]["p50_ms"] < figures["signal"]["p50_ms"] < float("inf")
