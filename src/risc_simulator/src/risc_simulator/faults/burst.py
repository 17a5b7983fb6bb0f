"""Repeated silences of this length [s]; the time between two of them is one to five times as long."""


def make(severity, rng):
    silent, until_s = True, None

    def act(datagram, now_s):
        nonlocal silent, until_s
        if until_s is None:
            until_s = now_s + severity
        while now_s >= until_s:
            silent = not silent
            until_s += severity * (1.0 if silent else rng.uniform(1.0, 5.0))
        return [] if silent else [(0.0, datagram)]

    return act
