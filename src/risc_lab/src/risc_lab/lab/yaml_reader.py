"""Reading YAML files strictly: every problem is one ValueError that names the file, the key and the cure."""

import contextlib
import os
import pathlib
import re

import numpy as np
import yaml

from risc_lab.settings import settings_from

MEMBERS_VARIABLE = "RISC_MAAP_MEMBERS"  # of the environment: folders of members from elsewhere, see risc_lab.registry


def package_file(package, relative_path):
    """Path of a data file of one of our packages, from the source tree or from an install space.

    Raises ValueError when it is in neither.
    """
    in_source = pathlib.Path(__file__).resolve().parents[4] / package / relative_path
    if in_source.exists():
        return in_source
    import rospkg  # only an installed workspace needs it: without ROS the data lies beside the source

    try:
        installed = pathlib.Path(rospkg.RosPack().get_path(package)) / relative_path
    except rospkg.ResourceNotFound:
        installed = None
    if installed is None or not installed.exists():
        raise ValueError(
            "cannot find %s of package %s: source the workspace's setup.bash first" % (relative_path, package)
        )
    return installed


def config_files(kind, package):
    """{name: path} of the YAML files of a kind: config/KIND of a ROS package, then the members from elsewhere.

    Raises ValueError for a name that is there twice.
    """
    folders = [package_file(package, "config/" + kind)] + [folder / kind for folder in member_folders()]
    paths = [path for folder in folders for path in sorted(folder.glob("*.yaml"))]
    check_once(kind, [path.name for path in paths])
    return {path.stem: path for path in paths}


def check_once(kind, names):
    """Raises ValueError when one of the names of files of a kind is there twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError("%s: %s is there twice: rename the one in %s" % (kind, ", ".join(twice), MEMBERS_VARIABLE))


def member_folders():
    """Folders that RISC_MAAP_MEMBERS names. Raises ValueError when one is not there."""
    folders = [pathlib.Path(name) for name in os.environ.get(MEMBERS_VARIABLE, "").split(os.pathsep) if name]
    for folder in folders:
        if not folder.is_dir():
            raise ValueError("%s names the folder %s, which is not there" % (MEMBERS_VARIABLE, folder))
    return folders


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # the one in C takes a tenth of the time
    """Takes 1e-05 for a number, as programs in C++ write it; YAML 1.1 wants a point in it and makes it a text."""


_EXPONENT = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+\Z")
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+0123456789"))


def load_yaml(path):
    """Content of a YAML file as a dict. Raises ValueError when it is missing, malformed or not a mapping."""
    try:
        text = pathlib.Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError("cannot read %s: %s" % (path, error)) from error
    try:
        content = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise ValueError("%s is not valid YAML: %s" % (path, " ".join(str(error).split()))) from error
    if not isinstance(content, dict):
        raise ValueError("%s must hold `key: value` lines, found %s" % (path, type(content).__name__))
    return content


@contextlib.contextmanager
def errors_of(where):
    """Begins a ValueError from within with `where`, e.g. the path of a file, unless it begins so already."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        raise ValueError(text if text.startswith(str(where)) else "%s: %s" % (where, text)) from error


class Section:
    """One mapping of a YAML file with typed access; keys that nobody asked for are an error in `done`."""

    def __init__(self, content, where):
        if not isinstance(content, dict):
            raise ValueError("%s must be a mapping, found %r" % (where, content))
        self._content = content
        self.where = where  # file and key, for errors
        self._asked = set()

    def _value(self, key, default):
        self._asked.add(key)
        if key in self._content:
            return self._content[key]
        if default is None:
            raise ValueError("%s: key '%s' is missing" % (self.where, key))
        return default

    def number(self, key, default=None, minimum=-np.inf, maximum=np.inf):
        """A finite number within limits; without a default the key is required."""
        value = self._value(key, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise ValueError("%s: '%s' must be a number, found %r" % (self.where, key, value))
        if not minimum <= value <= maximum:
            raise ValueError("%s: '%s' must be in [%g, %g], found %r" % (self.where, key, minimum, maximum, value))
        return float(value)

    def whole(self, key, default=None, minimum=-np.inf, maximum=np.inf):
        """A whole number within limits."""
        value = self.number(key, default, minimum, maximum)
        if not value.is_integer():
            raise ValueError("%s: '%s' must be a whole number, found %r" % (self.where, key, value))
        return int(value)

    def port(self, key, default=None):
        """A UDP port number."""
        return self.whole(key, default, 1, 65535)

    def vector(self, key, length, default=None):
        """A list of `length` finite numbers, as a tuple."""
        value = self._value(key, default)
        good = isinstance(value, (list, tuple)) and len(value) == length
        if not good or not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in value):
            raise ValueError("%s: '%s' must be a list of %d numbers, found %r" % (self.where, key, length, value))
        if not np.all(np.isfinite(value)):
            raise ValueError("%s: '%s' must be finite, found %r" % (self.where, key, value))
        return tuple(float(x) for x in value)

    def flag(self, key, default=None):
        """true or false."""
        value = self._value(key, default)
        if not isinstance(value, bool):
            raise ValueError("%s: '%s' must be true or false, found %r" % (self.where, key, value))
        return value

    def text(self, key, default=None):
        """A string; without a default the key is required and must not be empty."""
        value = self._value(key, default)
        if not isinstance(value, str) or (default is None and not value):
            raise ValueError("%s: '%s' must be a text, found %r" % (self.where, key, value))
        return value

    def content(self, key, default=None):
        """Whatever is there, for readers that look at it themselves."""
        return self._value(key, default)

    def section(self, key, default=None):
        """A nested mapping, as a `Section`."""
        return Section(self._value(key, default), "%s, %s" % (self.where, key))

    def sections(self, key, default=None):
        """A list of mappings, as a list of `Section`."""
        value = self._value(key, default)
        if not isinstance(value, (list, tuple)):
            raise ValueError("%s: '%s' must be a list, found %r" % (self.where, key, value))
        return [Section(item, "%s, %s[%d]" % (self.where, key, i)) for i, item in enumerate(value)]

    def settings(self, settings_class):
        """This mapping as an instance of a dataclass, see `risc_lab.settings`. Raises ValueError."""
        return settings_from(settings_class, self._content, self.where)

    def keys(self):
        """Names of all keys, in the order of the file."""
        return list(self._content)

    def done(self):
        """Raises ValueError naming the keys that are present but unknown: most are spelling mistakes."""
        unknown = sorted(str(key) for key in set(self._content) - self._asked)
        if unknown:
            raise ValueError(
                "%s: unknown key(s) %s; known are %s" % (self.where, ", ".join(unknown), ", ".join(sorted(self._asked)))
            )
