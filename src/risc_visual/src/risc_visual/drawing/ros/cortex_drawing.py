"""Messages of motion capture and of the vehicles -> the markers of draw_cortex. Needs no ROS master."""

import math
import threading

from risc_control.failsafe import FailsafeLevel
from risc_lab.lab.templates import attached_bodies
from risc_visual.drawing.cast import Cast, Index, is_news, rod_foot
from risc_visual.drawing.palette import sphere_colours
from risc_visual.drawing.ros import markers
from risc_visual.ros.conversions import bodies_from_mocap, landmarks_from_msg, poses_from_cortex

TEXT_PERIODS = 3.0  # without news after which a text vanishes
_SPHERE_ALPHA = 0.7  # of landmarks


class CortexDrawing:
    """Every method belongs to one topic, each topic may have a thread of its own. Stamps are those of the messages.

    What has no stamp has the ROS time that the caller gives.
    """

    def __init__(self, params, fleet, templates, landmarks):
        """params: CortexParams. fleet: FleetVehicles. templates: of lab.templates. landmarks: LandmarksConfig."""
        index = Index(params.vehicles or [vehicle.template for vehicle in fleet])
        self._cast = Cast(index, {vehicle.template: vehicle.type for vehicle in fleet})
        self._tips = attached_bodies(templates)
        self._colours = {name: rgb + (_SPHERE_ALPHA,) for name, rgb in sphere_colours(landmarks).items()}
        self._lifetime_s, self._label_alpha = params.lifetime_s, params.label_alpha
        self._text_lifetime_s = TEXT_PERIODS / params.status_hz
        self._lock = threading.Lock()
        self._safety = {}  # line -> Verdict of the vehicle's safety when it is not content
        self._levels = {}  # name -> (level of the safety ladder, when it was said [s])

    def vehicles(self, msg, now_s):
        """Cortex -> (vehicles and pendulums, their names). now_s: ROS time, that of the header of `mode`."""
        head = markers.header(msg.header.stamp)
        poses = poses_from_cortex(msg)
        views = self._cast.views([pose for pose in poses if pose.name not in self._tips])
        found = markers.vehicle_markers(head, views, self._lifetime_s)
        labels = markers.vehicle_labels(head, views, self._label_alpha, self._lifetime_s, self._levels_at(now_s))
        for tip in poses:
            if tip.name in self._tips and tip.visible:
                foot_m = rod_foot(tip.position_m, [view for view in views if not view.lost])
                found += markers.pendulum_markers(head, tip.name, tip.position_m, foot_m, self._lifetime_s)
                labels.append(
                    markers.pendulum_label(head, tip.name, tip.position_m, self._label_alpha, self._lifetime_s)
                )
        return found, labels

    def bodies(self, msg):
        """Mocap_data -> the markers on the bodies."""
        return markers.body_markers(markers.header(msg.header.stamp), bodies_from_mocap(msg), self._lifetime_s)

    def landmarks(self, msg):
        """Landmarks -> (spheres, their names)."""
        head, found = markers.header(msg.header.stamp), landmarks_from_msg(msg)
        spheres = markers.landmark_markers(head, found, self._text_lifetime_s, self._colours)
        return spheres, markers.landmark_labels(head, found, self._label_alpha, self._text_lifetime_s)

    def covariance(self, msg, number):
        """`position_cov` of the original's filter -> ellipsoid, None if it holds none.

        msg: TwistStamped with the position [m] in `linear`, its variances [m^2] in `angular`. number: 0, or of the
        vehicle from 1.
        """
        at, variance = msg.twist.linear, msg.twist.angular
        position_m, variances_m2 = (at.x, at.y, at.z), (variance.x, variance.y, variance.z)
        if not all(map(math.isfinite, position_m + variances_m2)) or min(variances_m2) < 0.0:
            return None
        head = markers.header(msg.header.stamp)
        return markers.covariance_marker(head, position_m, variances_m2, self._lifetime_s, number)

    def note_safety(self, line, verdict):
        """What the safety of the vehicle on a line of the list says: its Verdict."""
        with self._lock:
            self._safety[line] = None if verdict.level == FailsafeLevel.OK else verdict

    def mode(self, head, line, name, autonomous):
        """Line of text: who flies the vehicle, or what its safety does about it."""
        with self._lock:
            safety = self._safety.get(line)
            if safety:
                self._levels[name] = (safety.level.name, head.stamp.to_sec())
            else:
                self._levels.pop(name, None)
        return markers.mode_marker(head, line, name, autonomous, safety.text if safety else "", self._text_lifetime_s)

    def battery(self, head, line, name, percent):
        """Line of text: charge of a vehicle's battery."""
        return markers.battery_marker(head, line, name, percent, self._text_lifetime_s)

    def _levels_at(self, now_s):
        """dict name -> level of the vehicles that still speak: what a vehicle said last is not true for ever."""
        with self._lock:
            said = dict(self._levels)
        return {name: level for name, (level, said_s) in said.items() if is_news(said_s, now_s, self._text_lifetime_s)}
