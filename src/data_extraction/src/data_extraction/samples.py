"""Compact storage for many rows of numbers, filled while a bag is read."""

from array import array

import numpy as np


class Samples:
    """Rows of numbers in the order they came, 8 bytes a number."""

    def __init__(self, width, limit=None):
        """width: numbers in a row. limit: most rows that are kept; None = all.

        When there are more, every second row is dropped, and from then on only every second is taken: the rows stay
        evenly spread over everything that came.
        """
        self._width = width
        self._limit = limit
        self._numbers = array("d")
        self._count = 0
        self.every = 1  # one of this many rows is kept

    def __len__(self):
        return len(self._numbers) // self._width

    @property
    def first(self):
        """The first row; empty when there is none."""
        return tuple(self._numbers[: self._width])

    def append(self, row):
        """Take one row, an iterable of `width` numbers."""
        self._count += 1
        if (self._count - 1) % self.every:
            return
        self._numbers.extend(row)
        if self._limit is not None and len(self) > self._limit:
            self._numbers = array("d", self.table()[::2].tobytes())
            self.every *= 2

    def forget(self, column, begin, end):
        """Delete the rows with begin <= row[column] < end."""
        table = self.table()
        kept = (table[:, column] < begin) | (table[:, column] >= end)
        self._numbers = array("d", table[kept].tobytes())

    def table(self):
        """(n, width) array of the rows, a copy."""
        return np.array(self._numbers).reshape(-1, self._width)


class Arrivals:
    """Times of receipt of messages by their stamps: 16 bytes a message."""

    def __init__(self):
        self._stamps_ns = array("q")
        self._receipts_s = array("d")

    def append(self, stamp, receipt_s):
        """Take one message: its stamp, as rosbags gives it, and when it was received [s]."""
        self._stamps_ns.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        self._receipts_s.append(receipt_s)

    def first(self):
        """(stamps (n,) [ns], strictly increasing; receipts (n,) [s]): for each stamp the first message."""
        stamps_ns, first = np.unique(np.array(self._stamps_ns, dtype=np.int64), return_index=True)
        return stamps_ns, np.array(self._receipts_s)[first]

    def since_s(self, earlier):
        """(n,) [s] from receipt in `earlier`, other Arrivals, to receipt here, for the stamps that both hold."""
        (stamps_ns, receipts_s), (earlier_ns, earlier_s) = self.first(), earlier.first()
        _, ours, theirs = np.intersect1d(stamps_ns, earlier_ns, assume_unique=True, return_indices=True)
        return receipts_s[ours] - earlier_s[theirs]
