"""Where a calibration lies: file:///PATH, package://PACKAGE/PATH, with ${NAME} and ${ROS_HOME}."""

import os
import re

import rospkg

DEFAULT_URL = "file://${ROS_HOME}/camera_info/${NAME}.yaml"
_VARIABLE = re.compile(r"\$\{([^}]*)\}")
_NAME = re.compile(r"[A-Za-z0-9_]+\Z")


class UrlError(ValueError):
    """A URL that names no file; the text says what is wrong with it."""


def is_valid_name(name):
    """A camera's name has letters, digits and underscores only."""
    return bool(_NAME.match(name))


def resolve(url, name):
    """The URL with its variables replaced, the default one for "". UrlError for an unknown variable."""
    values = {"NAME": name, "ROS_HOME": rospkg.get_ros_home()}

    def value(match):
        if match.group(1) not in values:
            raise UrlError("%s: the variable ${%s} is not known, only ${NAME} and ${ROS_HOME} are" % (url, match[1]))
        return values[match.group(1)]

    return _VARIABLE.sub(value, url.strip() or DEFAULT_URL)


def path_of(url, name):
    """Path of the file that a URL names for a camera of this name; UrlError when it names none.

    The file need not exist, but a package must.
    """
    resolved = resolve(url, name)
    scheme, separator, rest = resolved.partition("://")
    if separator and scheme.lower() == "file" and os.path.isabs(rest):
        return rest
    if separator and scheme.lower() == "package":
        package, _, relative = rest.partition("/")
        if package and relative:
            try:
                return os.path.join(rospkg.RosPack().get_path(package), relative)
            except rospkg.ResourceNotFound:
                raise UrlError("%s: there is no package %s (is setup.bash sourced?)" % (resolved, package)) from None
    raise UrlError("%r is no calibration URL: write file:///PATH.yaml or package://PACKAGE/PATH.yaml" % resolved)
