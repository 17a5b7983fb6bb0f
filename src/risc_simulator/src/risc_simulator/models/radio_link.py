"""Command link of a vehicle: a rate limit, a delay and losses between what is sent and what the vehicle obeys.

The link carries one item per slot of 1/rate_hz; of several items in one slot only the newest survives, because that is
how a vehicle treats progressive commands.  An item leaves at the end of its slot and arrives delay_s later.
Events that must not be overtaken (take-off, land, emergency) are submitted with must_arrive: all of them are kept, in
order, and a lost slot only makes them late, as it does for commands that the client repeats.
"""

import math
from collections import namedtuple

_Entry = namedtuple("_Entry", "slot item must_arrive")


class RadioLink:
    """Slotted, delayed, lossy link; times in seconds on any one clock.

    delay_s: from the end of a slot to the arrival [s].   rate_hz: slots per second.
    loss: probability in [0, 1) that a slot is lost; needs rng (numpy Generator or anything with random()).
    phase_s: a slot ends at phase_s + k / rate_hz.
    """

    def __init__(self, delay_s, rate_hz=30.0, loss=0.0, rng=None, phase_s=0.0):
        if not 0.0 <= loss < 1.0:
            raise ValueError("loss is a probability in [0, 1), got %r" % (loss,))
        self.delay_s, self.rate_hz, self.loss = delay_s, rate_hz, loss
        self.slots_lost = 0
        self.items_superseded = 0
        self._rng = rng
        self._phase_s = phase_s
        self._pending = []  # entries in order of submission
        self._collected_s = -math.inf  # slots that ended by then are closed

    def submit(self, time_s, item, must_arrive=False):
        """Hand an item over at time_s (not decreasing from call to call)."""
        slot = self._slot_at(time_s)
        if self._collected_s > -math.inf:
            slot = max(slot, self._slots_ended(self._collected_s))
        self._pending.append(_Entry(slot, item, must_arrive))

    def collect(self, time_s):
        """Items of all slots that ended at or before time_s: list of (arrival time [s], item), in order.

        The arrival may lie in the future; each item is returned once.
        """
        if time_s > self._collected_s:
            self._collected_s = time_s
        if not self._pending:
            return []
        delivered = []
        closed = self._slots_ended(time_s)
        while self._pending and self._pending[0].slot < closed:
            slot = self._pending[0].slot
            count = sum(1 for entry in self._pending if entry.slot == slot)
            entries, self._pending = self._pending[:count], self._pending[count:]
            lost = self.loss > 0.0 and self._rng.random() < self.loss
            if lost:
                self.slots_lost += 1
                kept = [e._replace(slot=slot + 1) for e in entries if e.must_arrive]
                self._pending = kept + self._pending
                continue
            newest = max((i for i, e in enumerate(entries) if not e.must_arrive), default=None)
            arrival_s = self._slot_end(slot) + self.delay_s
            for i, entry in enumerate(entries):
                if entry.must_arrive or i == newest:
                    delivered.append((arrival_s, entry.item))
                else:
                    self.items_superseded += 1
        return delivered

    def clear(self):
        """Drop all submitted items that were not collected yet."""
        self._pending = []

    def _slots_ended(self, time_s):
        """Slots below this index have ended at time_s."""
        return math.floor((time_s - self._phase_s) * self.rate_hz + 1e-9) + 1

    def _slot_at(self, time_s):
        """Index of the slot that a submission at time_s falls in: the first that ends at or after time_s."""
        return math.ceil((time_s - self._phase_s) * self.rate_hz - 1e-9)

    def _slot_end(self, slot):
        return self._phase_s + slot / self.rate_hz
