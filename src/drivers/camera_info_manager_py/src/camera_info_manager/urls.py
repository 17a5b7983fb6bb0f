"""URLs of calibration files: file:///PATH, package://PACKAGE/PATH, with ${NAME} and ${ROS_HOME}."""

import re

import rospkg

from risc_lab.lab.calibration import resolve_url

DEFAULT_URL = "file://${ROS_HOME}/camera_info/${NAME}.yaml"


def is_valid_name(name):
    """Whether a camera name consists of letters, digits and underscores only."""
    return re.fullmatch("[A-Za-z0-9_]+", name) is not None


def path_of(url, name):
    """Return the path of the file that a URL names for a camera of this name; ValueError if it names none.

    The file need not exist, but the package must.
    """
    resolved = url.strip() or DEFAULT_URL
    for variable, value in (("${NAME}", name), ("${ROS_HOME}", rospkg.get_ros_home())):
        resolved = resolved.replace(variable, value)
    if "${" in resolved:
        raise ValueError("%s: only the variables ${NAME} and ${ROS_HOME} are known" % url)
    if not re.match("file:///.|package://[^/]+/.", resolved):
        raise ValueError("%r is not a calibration URL: use file:///PATH.yaml or package://PACKAGE/PATH.yaml" % resolved)
    return resolve_url(resolved)
