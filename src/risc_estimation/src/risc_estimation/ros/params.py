"""Parameters of the nodes beside those of the modules that they wire."""

from dataclasses import dataclass

from risc_estimation.filters import DEFAULT, REGISTRY, make_filter
from risc_lab.ros.params import has_private, private


@dataclass(frozen=True)
class NodeParams:
    """Settings of the node around the estimator; config/states_estimation.yaml explains and holds the same values."""

    filter: str = DEFAULT  # name of the velocity filter, whose settings may be private parameters, too
    vehicles: tuple[str, ...] = ()  # vehicles that are listed before they are seen; empty = those of /fleet
    templates_file: str = ""  # marker templates; empty = config/templates.yaml of risc_lab
    silence_s: float = 0.1  # [s] without frames before everything is declared invisible; 0 = never
    queue_s: float = 0.05  # [s] of frames that may wait while the node is held up; older ones are passed over

    def __post_init__(self):
        if self.silence_s < 0.0:
            raise ValueError("silence_s must be 0 (off) or positive, got %r" % (self.silence_s,))
        if self.queue_s <= 0.0:
            raise ValueError("queue_s must be positive, got %r" % (self.queue_s,))

    def queue_frames(self, rate_hz):
        """How many frames may wait at a rate of motion capture [Hz]."""
        return max(int(self.queue_s * rate_hz + 1e-6), 1)


def load_filter():
    """(velocity filter of the parameter ~filter, names of its settings). Private parameters come before its YAML file.

    Raises ValueError for an unknown filter or a bad value.
    """
    name = private("filter", DEFAULT)
    keys = REGISTRY.settings(name)
    return make_filter(name, {key: private(key, None) for key in keys if has_private(key)}), keys


@dataclass(frozen=True)
class AngleParams:
    """Settings of angle_estimation; config/angle_estimation.yaml explains and holds the same values."""

    rectified: bool = True  # regions are of image_rect_color, not of image_raw
    camera: str = "ardrone"  # namespace of the pictures below the vehicle's
    default_calibration: str = ""  # calibration file of vehicles that have none; empty = none


@dataclass(frozen=True)
class SyntheticNodeParams:
    """Settings of synthetic_angles beside those of the cameras; config/synthetic_angles.yaml holds the same values."""

    vehicles: tuple[str, ...] = ()  # templates or namespaces of those that observe; empty = the whole fleet
    default_calibration: str = ""  # calibration file of vehicles whose fleet entry names none; empty = none
