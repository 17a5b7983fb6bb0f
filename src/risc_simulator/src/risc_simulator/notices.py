"""What clients of a host do, for its operators: each kind of action of a client is logged once, then only counted."""

import logging
from collections import Counter

MAX_SAID = 50  # lines per host: a flood may come from any number of senders


class Notices:
    """The notices of one host.

    logger: of the host's module.  whose: name of the host, in front of every line.
    """

    def __init__(self, logger, whose):
        self._logger, self._whose = logger, whose
        self._events, self._complaints = Counter(), Counter()  # (what, sender) -> times

    def event(self, what, sender, detail=""):
        """Note an action of a client. what: "asks for video".  sender: (address, port).  detail: only logged."""
        self._count(self._events, logging.INFO, what, sender, detail)

    def complaint(self, what, sender, detail=""):
        """Note an action of a client that is wrong, or that disturbs other clients."""
        self._count(self._complaints, logging.WARNING, what, sender, detail)

    def statistics(self):
        """{"events": {what: {"address:port": times}}, "complaints": likewise}, for JSON; "others": not logged."""
        result = {"events": {}, "complaints": {}}
        for kind, counts in zip(result.values(), (self._events, self._complaints)):
            for (what, sender), times in counts.items():
                kind.setdefault(what, {})["others" if sender is None else "%s:%d" % sender[:2]] = times
        return result

    def _count(self, counts, level, what, sender, detail):
        key = what, sender
        if key not in counts:
            said = len(self._events) + len(self._complaints)
            if said >= MAX_SAID:
                key = what, None
            else:
                self._logger.log(level, "%s: %s:%d %s%s", self._whose, *sender[:2], what, detail and " (%s)" % detail)
                if said == MAX_SAID - 1:
                    self._logger.warning("%s: what other clients do is only counted", self._whose)
        counts[key] += 1
