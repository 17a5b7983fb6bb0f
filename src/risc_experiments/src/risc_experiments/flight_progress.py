"""Details of a running flight for the progress line of `data_extraction.progress`."""

import statistics

_MOST_NAMES = 5  # that fit on a line


def flight_detail(errors_mm, rate_hz):
    """Per-vehicle position errors [mm] (None: unknown) and the rate of the mocap stream [Hz] as text.

    Of many vehicles: the median, the vehicle with the largest error, and how many errors are unknown.
    """
    known = {name: error for name, error in errors_mm.items() if error is not None}
    if len(errors_mm) <= _MOST_NAMES:
        parts = ["%s %s" % (name, "   -" if error is None else "%4.0f" % error) for name, error in errors_mm.items()]
    elif known:
        worst = max(known, key=known.get)
        unknown = len(errors_mm) - len(known)
        parts = ["%d vehicles, %d unknown" % (len(errors_mm), unknown) if unknown else "%d vehicles" % len(errors_mm)]
        parts.append("median %3.0f  %s %4.0f" % (statistics.median(known.values()), worst, known[worst]))
    else:
        parts = ["%d vehicles    -" % len(errors_mm)]
    if parts:
        parts[-1] += " mm"
    parts.append("mocap %s" % ("-" if rate_hz is None else "%.0f Hz" % rate_hz))
    return "  ".join(parts)
