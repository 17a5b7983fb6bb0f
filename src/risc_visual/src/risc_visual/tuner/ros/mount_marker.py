"""A camera as an interactive marker: six handles, a menu, and a small camera to see where it looks.

Frame: the vehicle's body; the marker's own axes are the camera's: x along the optical axis, y right, z down.
"""

import math

from geometry_msgs.msg import Point, Pose, Quaternion
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from visualization_msgs.msg import InteractiveMarker, InteractiveMarkerControl, Marker, MenuEntry

from risc_lab.camera import rotation_camera_to_body
from risc_lab.frames import euler_from_body_to_ned
from risc_lab.vehicle_frames import body_frame
from risc_visual.drawing.ros.markers import ORIGIN, Pen, pyramid
from risc_visual.tuner.mount_tuner import NUMBERS

_SCALE_M = 0.45  # radius of the rings
VIEW_M = (0.16, 0.08, 0.05)  # the pyramid of what it sees: length, half width, half height
_LINE_M = 0.008
_BODY_M = (0.06, 0.05, 0.05)
_PANE_M = 0.004
_BODY_RGBA = (1.0, 0.85, 0.1, 0.9)
_PANE_RGBA = (1.0, 0.85, 0.1, 0.35)
_HALF = math.sqrt(0.5)
# rviz moves along, and turns about, the x axis of a control: these turn x to x, to y and to z
_AXES = (
    ("x", Quaternion(0.0, 0.0, 0.0, 1.0)),
    ("y", Quaternion(0.0, 0.0, _HALF, _HALF)),
    ("z", Quaternion(0.0, -_HALF, 0.0, _HALF)),
)
_MODES = (("move", InteractiveMarkerControl.MOVE_AXIS), ("turn", InteractiveMarkerControl.ROTATE_AXIS))


def mount_marker(name, template, mount, actions):
    """InteractiveMarker of a vehicle's camera. actions: titles of the menu; their ids count from 1.

    name: of the marker; template: of the vehicle, whose body frame it is in. Its header has no stamp: rviz moves it
    with the vehicle.
    """
    controls = [
        InteractiveMarkerControl(
            name="%s_%s" % (mode, axis), orientation=turn, interaction_mode=kind, description="%s %s" % (mode, axis)
        )
        for mode, kind in _MODES
        for axis, turn in _AXES
    ]
    controls.append(
        InteractiveMarkerControl(
            name="camera",
            interaction_mode=InteractiveMarkerControl.MENU,
            always_visible=True,
            markers=_camera_parts(),
            description="the camera of %s: right click for the menu" % name,
        )
    )
    return InteractiveMarker(
        header=Header(frame_id=body_frame(template)),
        pose=pose_of(mount),
        name=name,
        scale=_SCALE_M,
        menu_entries=[MenuEntry(id=k, title=title) for k, title in enumerate(actions, start=1)],
        controls=controls,
    )


def pose_of(mount):
    """geometry_msgs/Pose of a CameraMount in its vehicle's body."""
    quaternion = Rotation.from_matrix(rotation_camera_to_body(mount)).as_quat().tolist()
    return Pose(Point(*mount.position_m), Quaternion(*quaternion))


def numbers_from_pose(pose):
    """{x, y, z [m], roll, pitch, yaw [deg]} of a geometry_msgs/Pose. Raises ValueError for a quaternion of zeros."""
    turn = pose.orientation
    R = Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).as_matrix()
    angles = [math.degrees(angle) for angle in euler_from_body_to_ned(R)]
    return dict(zip(NUMBERS, (pose.position.x, pose.position.y, pose.position.z, *angles)))


def _camera_parts():
    """Housing, the edges of what it sees, and a pane across them: easily hit with a mouse, in front of the vehicle."""
    far, wide, high = VIEW_M
    pen = Pen(0.0, Header())  # without a frame: in that of the control
    return [
        pen.marker("", 0, Marker.CUBE, ORIGIN, _BODY_M, _BODY_RGBA),
        pen.line("", 0, pyramid(*VIEW_M), _LINE_M, _BODY_RGBA, Marker.LINE_LIST),
        pen.marker("", 0, Marker.CUBE, (far, 0.0, 0.0), (_PANE_M, 2.0 * wide, 2.0 * high), _PANE_RGBA),
    ]
