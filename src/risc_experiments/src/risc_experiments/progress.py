"""What a person sees while a flight runs, beside `data_extraction.progress`."""


def flight_detail(errors_mm, rate_hz):
    """Per-vehicle position errors [mm] (None: unknown) and the rate of the mocap stream [Hz] as text."""
    parts = ["%s %s" % (name, "   -" if error is None else "%4.0f" % error) for name, error in errors_mm.items()]
    if parts:
        parts[-1] += " mm"
    parts.append("mocap %s" % ("-" if rate_hz is None else "%.0f Hz" % rate_hz))
    return "  ".join(parts)
