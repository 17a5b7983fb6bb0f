"""Parameters of the drawing nodes."""

from dataclasses import dataclass

from risc_lab.lab.ranges import check_positive


@dataclass(frozen=True)
class ArenaParams:
    """Settings of draw_risc_maap; config/draw_risc_maap.yaml explains and holds the same values."""

    arena_file: str = ""
    refresh_hz: float = 1.0

    def __post_init__(self):
        check_positive(self, "refresh_hz")


@dataclass(frozen=True)
class CortexParams:
    """Settings of draw_cortex; config/draw_cortex.yaml explains and holds the same values."""

    rate_hz: float = 25.0
    status_hz: float = 2.0
    lifetime_s: float = 1.0
    label_alpha: float = 0.8
    templates_file: str = ""
    landmarks_file: str = ""
    vehicles: tuple[str, ...] = ()

    def __post_init__(self):
        check_positive(self, "rate_hz", "status_hz", "lifetime_s")
        _check_alpha(self, "label_alpha")


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
    vehicles: tuple[str, ...] = ()

    def __post_init__(self):
        check_positive(self, "rate_hz", "away_m")


@dataclass(frozen=True)
class AngleParams:
    """Settings of draw_angles beside rays.RayParams; config/draw_angles.yaml explains and holds the same values."""

    rate_hz: float = 25.0
    lifetime_s: float = 0.3
    max_age_s: float = 5.0
    alpha: float = 0.4
    labels: bool = False
    label_alpha: float = 0.8
    landmarks_file: str = ""

    def __post_init__(self):
        check_positive(self, "rate_hz", "lifetime_s", "max_age_s")
        _check_alpha(self, "alpha", "label_alpha")


@dataclass(frozen=True)
class WaypointParams:
    """Settings of draw_waypoints; config/draw_waypoints.yaml explains and holds the same values."""

    rate_hz: float = 25.0
    lifetime_s: float = 1.0
    alpha: float = 0.4
    label_alpha: float = 0.8
    trail_s: float = 10.0
    step_m: float = 0.02
    jump_m: float = 0.5
    gap_s: float = 0.5
    vehicles: tuple[str, ...] = ()

    def __post_init__(self):
        check_positive(self, "rate_hz", "lifetime_s")
        _check_alpha(self, "alpha", "label_alpha")


def _check_alpha(params, *keys):
    for key in keys:
        if not 0.0 < getattr(params, key) <= 1.0:
            raise ValueError("parameter '%s' must be in (0, 1], got %r" % (key, getattr(params, key)))
