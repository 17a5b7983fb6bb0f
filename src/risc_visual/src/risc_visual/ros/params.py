"""Parameters of the drawing nodes."""

from dataclasses import dataclass
from typing import Tuple


@dataclass(frozen=True)
class ArenaParams:
    """Settings of draw_risc_maap; config/draw_risc_maap.yaml explains and holds the same values."""

    arena_file: str = ""
    refresh_hz: float = 1.0

    def __post_init__(self):
        _check_positive(self, "refresh_hz")


@dataclass(frozen=True)
class CortexParams:
    """Settings of draw_cortex; config/draw_cortex.yaml explains and holds the same values."""

    rate_hz: float = 25.0
    status_hz: float = 2.0
    lifetime_s: float = 1.0
    label_alpha: float = 0.8
    templates_file: str = ""
    vehicles: Tuple[str, ...] = ()

    def __post_init__(self):
        _check_positive(self, "rate_hz", "status_hz", "lifetime_s", "label_alpha")


@dataclass(frozen=True)
class TrajectoryParams:
    """Settings of draw_trajectories; config/draw_trajectories.yaml explains and holds the same values."""

    rate_hz: float = 25.0
    actual_s: float = 10.0
    desired_s: float = 40.0
    step_m: float = 0.02
    jump_m: float = 0.5
    gap_s: float = 0.5
    away_m: float = 0.4
    title: str = ""
    vehicles: Tuple[str, ...] = ()

    def __post_init__(self):
        _check_positive(self, "rate_hz", "away_m")


def _check_positive(params, *keys):
    for key in keys:
        if not getattr(params, key) > 0.0:
            raise ValueError("parameter '%s' must be positive, got %r" % (key, getattr(params, key)))
