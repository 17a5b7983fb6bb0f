"""The bridge's Autopilot connected to a scripted autopilot by bytes; time is simulated."""

import scripted_autopilot

from roscopter.autopilot import TICK_S, Autopilot
from roscopter.options import Options


class Bench:
    """options: fields of Options.  vehicle: the scripted autopilot; None: a new one with this MAVLink version."""

    def __init__(self, version=2, vehicle=None, is_open=True, **options):
        self.vehicle = vehicle or scripted_autopilot.Autopilot(version=version)
        self._steps = 0
        self.reports = []  # (level, text)
        self.messages = []  # to be published
        self.sent = bytearray()  # by the bridge, since the last step
        self.packets = []  # all sent by the bridge: (time, bytes)
        self.outcomes = []
        self.noise = bytearray()  # extra bytes for the bridge to receive
        self.autopilot = Autopilot(Options(**options), self._write, lambda *report: self.reports.append(report))
        if is_open:
            self.autopilot.opened(self.now_s)

    @property
    def now_s(self):
        return 1000.0 + self._steps * TICK_S

    def _write(self, data):
        self.packets.append((self.now_s, data))
        self.sent += data

    def step(self):
        """Advance the time by TICK_S."""
        self._steps += 1
        data, self.sent = bytes(self.sent), bytearray()
        self.vehicle.receive(data, self.now_s)
        self.vehicle.advance(self.now_s)
        data = self.vehicle.take() + bytes(self.noise)
        self.noise.clear()
        if data:
            self.messages += self.autopilot.receive(data, self.now_s)
        self.autopilot.poll(self.now_s)

    def run(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            self.step()
        return self

    def until(self, condition, limit_s=60.0):
        """Step until the condition holds. Returns the time it took [s]."""
        begin_s = self.now_s
        while not condition():
            assert self.now_s - begin_s < limit_s, "not within %g s; reports: %s" % (limit_s, self.reports[-5:])
            self.step()
        return self.now_s - begin_s

    def connect(self):
        self.until(lambda: self.autopilot.is_connected)
        return self

    def order(self, order, limit_s=60.0):
        """Carry out an order; return its Outcome."""
        outcomes = []
        self.autopilot.begin(order, outcomes.append, self.now_s)
        self.until(lambda: outcomes, limit_s)
        return outcomes[0]

    def named(self, name):
        return [message for message in self.messages if message.get_type() == name]

    def said(self, level):
        return [text for each, text in self.reports if each == level]
