"""A loose plug: nothing arrives for this share of the time; random interruptions, every 0.2 s on average."""

CYCLE_S = 0.2  # mean of a silence and the time until the next one, together


def make(severity, rng):
    silent, until_s = False, None

    def act(datagram, now_s):
        nonlocal silent, until_s
        if until_s is None:
            until_s = now_s
        while now_s >= until_s:
            silent = not silent
            until_s += rng.exponential(CYCLE_S * (severity if silent else 1.0 - severity)) + 1e-6
        return [] if silent else [(0.0, datagram)]

    return act
