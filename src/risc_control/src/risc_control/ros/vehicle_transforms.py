"""/cortex_raw -> tf: the frames of every visible vehicle, and where their cameras sit. Wiring only.

One program for all nodes that send these frames: `transforms`, `risc_transforms`, and the tuner of risc_visual.
"""

import math
from dataclasses import dataclass

import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped

from risc_lab.lab.calibration import load_mount
from risc_lab.lab.templates import attached_bodies, load_templates
from risc_lab.ros.node import run
from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_lab.ros.params import fleet_vehicles, known_fleet, load_params
from risc_lab.settings import Positive, Settings
from risc_lab.vehicle_frames import camera_transform, vehicle_frames
from risc_msgs.msg import Cortex


@dataclass(frozen=True)
class TransformParams(Settings):
    """Parameters of the node."""

    rate: Positive = 50.0  # [Hz]


class VehicleTransforms:
    """Sends the transforms. A vehicle that is not seen gets no new ones: its frames become stale, none is repeated."""

    def __init__(self, mounts):
        """mounts: {mocap template: CameraMount}."""
        self._attached = attached_bodies(load_templates(fleet=known_fleet()))
        self._mounts = dict(mounts)
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._send_mounts()

    def move_camera(self, name, mount):
        """Change the camera mount of a vehicle. name: mocap template. mount: CameraMount."""
        self._mounts = dict(self._mounts, **{name: mount})
        self._send_mounts()

    def _send_mounts(self):
        """Send all mounts: later subscribers get only the last message."""
        now = rospy.Time.now()
        self._static.sendTransform([_message(camera_transform(*item), now) for item in self._mounts.items()])

    def send(self, message):
        """Send the frames of the vehicles that are visible in a Cortex message, with its stamp."""
        transforms = []
        for state in message.Obj:
            if state.visible and state.name not in self._attached:
                angles_rad = map(math.radians, (state.phi, state.theta, state.psi))
                transforms += vehicle_frames(state.name, (state.x, state.y, state.z), *angles_rad)
        if transforms:
            self._broadcaster.sendTransform([_message(item, message.header.stamp) for item in transforms])


def main(name):
    """Run the node that sends the fleet's frames until ROS shuts down."""

    def make():
        (params,) = load_params(TransformParams, lenient=True)
        mounts = {v.template: load_mount(v.camera_mount) for v in fleet_vehicles()}
        return PacedSubscriber("/cortex_raw", Cortex, VehicleTransforms(mounts).send, params.rate)

    run(name, make)


def _message(transform, stamp):
    message = TransformStamped()
    message.header.stamp, message.header.frame_id = stamp, transform.parent
    message.child_frame_id = transform.child
    place, turn = message.transform.translation, message.transform.rotation
    place.x, place.y, place.z = transform.position_m
    turn.x, turn.y, turn.z, turn.w = transform.quaternion_xyzw
    return message
