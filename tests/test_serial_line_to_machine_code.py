"""The node's link and the firmware as machine code of the Due, in an emulator: messages in, edges of the signal out.

In simulated time, at 57600 baud; nothing depends on the computer's speed.
"""

import shutil

import due
import pytest
import serial_line as bench

pytestmark = pytest.mark.skipif(
    shutil.which("arm-none-eabi-g++") is None, reason="gcc-arm-none-eabi is missing: ./maap setup installs it"
)
STEADY = 20  # commands from the first on, and before the last, that are not measured


class MachineCode:
    """An emulated board, with the methods of risc_simulator's Board."""

    def __init__(self, program):
        self._due, self._sent, self._edges = due.Due(*program), 0, 0

    def receive(self, data):
        self._due.uart.receive(data)

    def advance(self, time_s):
        self._due.run(max(0, int(1e6 * time_s) - self._due.now // due.CYCLES_PER_US))

    def sent(self):
        data = bytes(self._due.uart.sent[self._sent :])
        self._sent += len(data)
        return data

    def edges(self):
        found = self._due.edges[self._edges :]
        self._edges += len(found)
        return found

    def close(self):
        """Nothing is open."""


@pytest.fixture(autouse=True)
def emulated(monkeypatch, tmp_path):
    """The chains of this test have the machine code at their end."""
    program = due.build(due.FIRMWARE / "dueppm", tmp_path)
    monkeypatch.setattr(bench, "Board", lambda: MachineCode(program))


def test_messages_in_and_edges_out(capsys):
    chain = bench.Chain()
    chain.run(1.6)
    counts = chain.link.facts.counts
    assert counts["packets"] > 12 and counts["damaged"] == counts["lost"] == counts["replaced"] == 0
    assert set(chain.receiver.counts) <= {"frames", "no gap before"}
    sent = [(at_s, k % bench.STEPS) for k, at_s in enumerate(chain.posted_s)][STEADY:-STEADY]
    delays = bench.percentiles(bench.delays_s(sent, chain.frames))
    with capsys.disabled():
        print("\n" + bench.line_of("machine code: frame begins [ms]", delays))
    assert 13.0 < delays["p50_ms"] < delays["max_ms"] < 60.0, "a message takes 13 ms over the line, a frame 20 ms"


@pytest.mark.release
@pytest.mark.parametrize("what", ["noise both ways", "loss both ways"])
def test_the_signal_follows_again_after_damage(what):
    back = bench.after_damage(what, 10)
    assert back["host"]["max_ms"] <= 100.0 and back["signal"]["max_ms"] <= 100.0
