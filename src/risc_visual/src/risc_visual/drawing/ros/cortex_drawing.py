"""Messages of motion capture and of the vehicles -> the markers of draw_cortex. Needs no ROS master."""

import math

import numpy as np
from geometry_msgs.msg import Quaternion
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from risc_control.safety import FailsafeLevel
from risc_estimation.ros.bearing_conversions import states_from_msg
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.arena import Arena
from risc_lab.lab.templates import attached_bodies
from risc_visual.drawing.cast import Index, is_news
from risc_visual.drawing.palette import sphere_colours, vehicle_colour
from risc_visual.drawing.ros.airframes import parts_of
from risc_visual.drawing.ros.markers import GREEN, LINE_M, ORANGE, ORIGIN, RED, TEXT_M, WHITE, Pen, header, is_known

_TEXT_PERIODS = 3.0  # without a message after which a text vanishes
_SPHERE_ALPHA, _OTHER_ALPHA = 0.7, 0.4  # of landmarks, and of unknown ones
_PENDULUM = (1.0, 0.6, 0.0)
_ROD_MAX_M = 1.5  # a pendulum tip farther than this from every vehicle stands on none
_BARE = (0.75, 0.75, 0.75)
_LOST_RGBA = (0.6, 0.6, 0.6, 0.4)
_LEAST_M = 1e-3  # least diameter that rviz can draw
_MODES_M, _BATTERIES_M = (-0.5, -1.4, 0.0), (1.0, 1.15, 0.0)  # from two corners of the net to the lists of texts


class CortexDrawing:
    """Not thread-safe. Stamps are those of the messages; for messages without one, the caller gives the ROS time."""

    def __init__(self, params, fleet, templates, landmarks, arena=Arena()):
        """params: CortexParams. fleet: FleetVehicles. templates: of lab.templates. landmarks: LandmarksConfig."""
        self._index = Index(params.vehicles or [vehicle.template for vehicle in fleet])
        airframes = {kind: parts_of(kind) for kind in {vehicle.type for vehicle in fleet}}
        self._airframes = {vehicle.template: airframes[vehicle.type] for vehicle in fleet}
        self._other_airframe = parts_of()  # of those not in the fleet
        self._tips = attached_bodies(templates)
        self._colours = {name: rgb + (_SPHERE_ALPHA,) for name, rgb in sphere_colours(landmarks).items()}
        self._lifetime_s, self._label_rgba = params.lifetime_s, WHITE + (params.label_alpha,)
        self._text_lifetime_s = _TEXT_PERIODS / params.status_hz
        self._half_m = arena.half_x_m, arena.half_y_m, 0.0
        self._last = {}  # name -> (position [m], Quaternion, places of its parts [m]) where it was seen last
        self._safety = {}  # line -> Verdict of the vehicle's safety; None when it is OK
        self._levels = {}  # name -> (level of the safety ladder, when it was said [s])

    def vehicles(self, msg, now_s):
        """Cortex -> (vehicles and pendulums, their names): ns = name. now_s: ROS time, as given to `mode`.

        A lost vehicle, also one with numbers that are not finite, is a grey ghost where it was last seen; the name of
        one whose failsafe acts says so.
        """
        pen, found, labels = Pen(self._lifetime_s, header(msg.header.stamp)), [], []
        states = states_from_msg(msg)
        tips_m = {name: states.pop(name)[0] for name in self._tips.intersection(states)}
        seen = {name: pose for name, pose in states.items() if np.isfinite(pose).all()}
        self._remember(seen)
        for name in (entry.name for entry in msg.Obj if entry.name in self._last):
            at_m, turn, places_m = self._last[name]
            index, lost = self._index[name], name not in seen
            for number, (part, place_m) in enumerate(zip(self._parts(name), places_m), start=1):
                rgba = _LOST_RGBA if lost else (vehicle_colour(index) if part.painted else _BARE) + (part.alpha,)
                found.append(pen.marker(name, number, part.shape, place_m, part.size_m, rgba, turn, part.points_m))
            text, rgba = name + (" (lost)" if lost else ""), self._label_rgba
            level, said_s = self._levels.get(name, ("", -math.inf))
            if is_news(said_s, now_s, self._text_lifetime_s):  # an old report no longer counts
                text, rgba = "%s: %s" % (text, level), RED + rgba[3:]
            labels.append(pen.label(name, index + 1, text, at_m, rgba))
        for name, tip_m in tips_m.items():
            found.append(pen.ball(name, 1, tip_m, 0.076, _PENDULUM + (1.0,)))
            foot_m = min((at_m for at_m, _ in seen.values()), key=lambda at_m: math.dist(at_m, tip_m), default=None)
            if foot_m and math.dist(foot_m, tip_m) <= _ROD_MAX_M:
                found.append(pen.line(name, 2, (foot_m, tip_m), 0.02, _PENDULUM + (0.7,)))
            labels.append(pen.label(name, 1, name, tip_m, self._label_rgba))
        return found, labels

    def _remember(self, seen):
        """seen: dict name -> (position [m], angles [rad])."""
        if seen:
            rotations = rotation_body_to_cortex(*np.array([euler_rad for _, euler_rad in seen.values()]).T)
            turns = Rotation.from_matrix(rotations).as_quat().tolist()
            for (name, (at_m, _)), R, turn in zip(seen.items(), rotations, turns):
                places_m = [part.centre_m for part in self._parts(name)] @ R.T + at_m
                self._last[name] = at_m, Quaternion(*turn), places_m.tolist()

    def _parts(self, name):
        return self._airframes.get(name, self._other_airframe)

    def bodies(self, msg):
        """Mocap_data -> the markers of every body that are seen, as one list of spheres: ns = template."""
        pen, found = Pen(self._lifetime_s, header(msg.header.stamp)), []
        for body in msg.Obj:
            seen = [(marker.x, marker.y, marker.z) for marker in body.marker]
            seen = [point for point in seen if is_known(point)]
            if seen:
                size_m, rgba = (0.03, 0.03, 0.03), WHITE + (1.0,)
                found.append(pen.marker(body.name, 1, Marker.SPHERE_LIST, ORIGIN, size_m, rgba, points_m=seen))
        return found

    def landmarks(self, msg):
        """Landmarks -> (spheres, their names): ns = name."""
        pen = Pen(self._text_lifetime_s, header(msg.header.stamp))
        places_m = {entry.name: (entry.x, entry.y, entry.z) for entry in msg.Obj}
        seen = {name: at_m for name, at_m in places_m.items() if is_known(at_m)}
        other = WHITE + (_OTHER_ALPHA,)
        spheres = [pen.ball(name, 1, at_m, 0.17, self._colours.get(name, other)) for name, at_m in seen.items()]
        return spheres, [pen.label(name, 1, name, at_m, self._label_rgba) for name, at_m in seen.items()]

    def covariance(self, msg, number):
        """`position_cov` of the original's filter -> ellipsoid with a diameter of three standard deviations along each
        axis; None if it holds none.

        msg: TwistStamped with the position [m] in `linear`, its variances [m^2] in `angular`. number: of the vehicle
        from 1; 0 for a laboratory with one vehicle.
        """
        at, variance = msg.twist.linear, msg.twist.angular
        at_m, variances_m2 = (at.x, at.y, at.z), (variance.x, variance.y, variance.z)
        if not all(map(math.isfinite, at_m + variances_m2)) or min(variances_m2) < 0.0:
            return None
        size_m = tuple(max(_LEAST_M, 3.0 * math.sqrt(value)) for value in variances_m2)
        pen = Pen(self._lifetime_s, header(msg.header.stamp))
        return pen.marker("covariance", number, Marker.SPHERE, at_m, size_m, RED + (0.2,))

    def note_safety(self, line, verdict):
        """Take the safety Verdict of the vehicle on a line of the list."""
        self._safety[line] = None if verdict.level == FailsafeLevel.OK else verdict

    def mode(self, head, line, name, autonomous):
        """Line of text: who flies the vehicle, or what its failsafe does.

        line: of the list of vehicles, from 0. name: "" for a laboratory with one vehicle.
        """
        self._levels.pop(name, None)
        safety = self._safety.get(line)
        if safety:
            self._levels[name] = safety.level.name, head.stamp.to_sec()
        text = safety.text if safety else "Autonomous" if autonomous else "Manual"
        rgb = RED if safety else GREEN if autonomous else ORANGE
        return self._status(head, "controller_status", _MODES_M, line, name, text, rgb)

    def battery(self, head, line, name, percent):
        """Line of text: charge of a vehicle's battery, from red (empty) to green (full)."""
        full = min(1.0, max(0.0, percent / 100.0))
        rgb = (min(1.0, 2.0 - 2.0 * full), min(1.0, 2.0 * full), 0.0)
        text = "%.0f%%" % percent if name else "Battery: %.0f%%" % percent
        return self._status(head, "battery_status", _BATTERIES_M, line, name, text, rgb)

    def _status(self, head, ns, offset_m, line, name, text, rgb):
        """One line of a list outside of the net, at a corner where no vehicle is behind it in the saved views.

        Lines follow each other outwards along x, and along z: so they are apart in a view from above and in one from
        the side, and do not cancel in one from behind (-x), where the saved view is.
        """
        height_m, side = LINE_M if name else TEXT_M, math.copysign(1.0, offset_m[0])
        apart_m = 1.3 * height_m * line
        x, y, z = (side * half_m + more_m for half_m, more_m in zip(self._half_m, offset_m))
        text = "%s: %s" % (name, text) if name else text
        at_m = (x + side * apart_m, y, z + side * apart_m)
        return Pen(self._text_lifetime_s, head).text(ns, line, text, at_m, height_m, rgb + (1.0,))
