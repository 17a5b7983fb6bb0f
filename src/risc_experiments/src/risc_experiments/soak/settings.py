"""Settings of a soak: how it flies, and what ends it. Meanings and units: config/soak.yaml."""

from dataclasses import dataclass

from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Count, Fraction, Name, NotNegative, Positive, Settings, between, settings_from

LONGEST_WARM_UP = 1.0 / 3.0  # of the whole


@dataclass(frozen=True)
class SoakLimits(Settings):
    """Limits; the first one that is broken ends the soak."""

    memory_mb_h: NotNegative = 10.0
    memory_mb: NotNegative = 8.0
    descriptors_h: NotNegative = 6.0
    descriptors: NotNegative = 6.0
    threads_h: NotNegative = 6.0
    threads: NotNegative = 4.0
    latency_ms_h: NotNegative = 1.0
    latency_ms: NotNegative = 10.0
    lab_late_ms: Positive = 50.0
    ready_s: Positive = 60.0
    back_s: Positive = 30.0
    free_disk_mb: NotNegative = 500.0


@dataclass(frozen=True)
class ProgramFaultParams(Settings):
    """Faults of programs among the others."""

    share: Fraction = 0.15
    names: tuple[Name, ...] = (
        *("mocap_client", "states_estimation", "controller", "trajectory"),
        *("vehicle_node", "driver"),
    )
    stop_s: tuple[Positive, Positive] = (0.1, 3.0)

    def __post_init__(self):
        super().__post_init__()
        if self.stop_s[0] > self.stop_s[1]:
            raise ValueError("'stop_s' is the least and the greatest")


@dataclass(frozen=True)
class SoakParams(Settings):
    """Content of config/soak.yaml."""

    duration_s: between(5.0, 600.0) = 40.0
    leave_out: tuple[str, ...] = ()
    programs: ProgramFaultParams = ProgramFaultParams()
    sample_s: Positive = 10.0
    line_s: Positive = 60.0
    warm_up_s: NotNegative = 600.0
    least_judged_s: Positive = 180.0
    battery_pct: between(0.0, 100.0) = 40.0
    keep_flights: Count = 3
    limits: SoakLimits = SoakLimits()

    def warm_up_of(self, duration_s):
        """Warm-up [s] of a soak of this length."""
        return min(self.warm_up_s, LONGEST_WARM_UP * duration_s)


def load_params(path=None):
    """SoakParams of a file; None: config/soak.yaml. Raises ValueError."""
    path = path or package_file("risc_experiments", "config/soak.yaml")
    return settings_from(SoakParams, load_yaml(path), str(path))
