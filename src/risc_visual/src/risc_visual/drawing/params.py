"""Parameters of the drawing nodes. Needs no ROS."""

from dataclasses import dataclass

from risc_lab.settings import Fraction, Positive, Settings


@dataclass(frozen=True)
class ArenaParams(Settings):
    """Settings of draw_risc_maap."""

    arena_file: str = ""  # arena to draw; "" = config/arena.yaml of this package, around the net of /fleet
    refresh_hz: Positive = 1.0  # static markers are sent at this rate; they expire after three periods without


@dataclass(frozen=True)
class DrawingParams(Settings):
    """Settings of all nodes that draw moving things."""

    rate_hz: Positive = 25.0  # of drawing; what arrives in between is not even deserialised
    lifetime_s: Positive = 1.0  # without a message after which moving things vanish


@dataclass(frozen=True)
class FleetDrawingParams(DrawingParams):
    """Settings of all nodes that draw vehicles."""

    vehicles: tuple[str, ...] = ()  # that get the first colours and ids, in this order; () = those of /fleet


@dataclass(frozen=True)
class PathParams(Settings):
    """How paths are kept."""

    step_m: Positive = 0.02  # between two points; nearer ones only move the end
    jump_m: Positive = 0.5  # a longer step breaks the path
    gap_s: Positive = 0.5  # so does a longer time without a position

    def __post_init__(self):
        super().__post_init__()
        if not self.step_m < self.jump_m:
            raise ValueError("step_m must be less than jump_m, found %g and %g" % (self.step_m, self.jump_m))


@dataclass(frozen=True)
class CortexParams(FleetDrawingParams):
    """Settings of draw_cortex."""

    label_alpha: Fraction = 0.8  # how opaque names are; the original's 0.4 is hard to read on black
    status_hz: Positive = 2.0  # of texts, which live three periods, and of landmarks, which stand still
    templates_file: str = ""  # mocap templates, which tell vehicles from attached bodies; "" = those of risc_lab
    landmarks_file: str = ""  # paints of the landmarks, by which they are coloured; "" = config/landmark_detector.yaml


@dataclass(frozen=True)
class TrajectoryParams(PathParams, FleetDrawingParams):
    """Settings of draw_trajectories."""

    lifetime_s: Positive = 0.5  # of the marks of references
    actual_s: Positive = 10.0  # length of the path flown (the original drew 5 s)
    desired_s: Positive = 40.0  # length of the path that was to be flown
    away_m: Positive = 0.4  # a vehicle farther from its reference gets a mark with its name at the reference
    title: str = ""  # first line of the text over the arena; the phases on /trajectory_phase come below it


@dataclass(frozen=True)
class RayParams(DrawingParams):
    """Settings of draw_angles."""

    lifetime_s: Positive = 0.3  # of a ray: bridges the time between two pictures
    max_age_s: Positive = 5.0  # a picture older than the newest sight of its vehicle by this is not drawn
    length_m: Positive = 4.0
    width_m: Positive = 0.04
    template_width_m: Positive = 0.01  # under a mocap template's name: no measurements in the original release
    alpha: Fraction = 0.4  # how opaque rays are
    azimuth_max_deg: Positive = 40.0  # a bearing farther than this from the optical axis is not drawn
    elevation_max_deg: Positive = 30.0
    labels: bool = False  # names of what is seen at the ends of the rays
    label_alpha: Fraction = 0.8  # how opaque these are
    landmarks_file: str = ""  # names and paints of the landmarks; "" = config/landmark_detector.yaml


@dataclass(frozen=True)
class WaypointParams(PathParams, FleetDrawingParams):
    """Settings of draw_waypoints."""

    alpha: Fraction = 0.4  # how opaque balls and arrows are; the original's 0.2 is hard to see on black
    label_alpha: Fraction = 0.8  # and their names
    trail_s: Positive = 10.0  # length of the path flown by a vehicle that has a waypoint (the original: 500 points)
