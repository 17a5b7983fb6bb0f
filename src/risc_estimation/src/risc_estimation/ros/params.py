"""Parameters of the nodes, in addition to those of the modules that they use."""

from dataclasses import dataclass

from risc_estimation.filters import DEFAULT
from risc_lab.settings import Name, NotNegative, Positive, Settings


@dataclass(frozen=True)
class NodeParams(Settings):
    """Parameters of states_estimation, in addition to `pose_fit.PoseFitParams` and the settings of the filter
    (config/filters); of quad_EKF, in addition to the settings of the filter.
    """

    filter: Name = DEFAULT  # name of the filter; its settings may be private parameters, too. quad_EKF: ekf
    vehicles: tuple[str, ...] = ()  # templates listed among the states from the start, seen or not; () = of /fleet
    templates_file: str = ""  # marker templates; "" = config/templates.yaml of risc_lab
    silence_s: NotNegative = 0.1  # [s] without frames before everything is published as invisible, once; 0 = never
    # [s] of frames may wait while the node is held up: 10 frames at 200 Hz, 5 at 100 Hz (mocap.rate_hz of the fleet
    # file; 200 Hz without one). Older ones are skipped: a computer that is too slow for all of them would fall behind
    # until no state is recent enough to fly by
    queue_s: Positive = 0.05

    def queue_frames(self, rate_hz):
        """How many frames may wait, at a frame rate [Hz]."""
        return max(int(self.queue_s * rate_hz + 1e-6), 1)


@dataclass(frozen=True)
class EkfNodeParams(Settings):
    """Parameters of quad_EKF alone."""

    publish_hz: NotNegative = 22.5  # [Hz] at most, of accelerations and position covariances; 0: with every frame


@dataclass(frozen=True)
class AngleParams(Settings):
    """Parameters of angle_estimation."""

    # regions on /land_rois are in pixels of image_rect_color (as risc_landmarks finds them); False: of image_raw, whose
    # distortion is then removed from each region's centre
    rectified: bool = True
    # namespace of the pictures below the vehicle's: its calibration is read from /<vehicle>/<camera>/camera_info while
    # that is published, else from the fleet file
    camera: str = "ardrone"
    default_calibration: str = ""  # file for vehicles that have neither (risc_lab/config/cameras); "": nothing visible


@dataclass(frozen=True)
class SyntheticNodeParams(Settings):
    """Parameters of synthetic_angles, in addition to `synthetic_bearings.SyntheticParams`."""

    vehicles: tuple[str, ...] = ()  # templates or namespaces of the observing vehicles; () = the whole fleet
    default_calibration: str = ""  # calibration file of vehicles whose fleet entry names none; "": they see nothing
