"""Reading YAML files strictly: every problem is one ValueError that names the file, the key and the cure."""

import os
import pathlib
import re

import yaml

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
    """{name: path} of the YAML files of a kind: config/KIND of a ROS package, then those in RISC_MAAP_MEMBERS.

    Raises ValueError for a duplicate name.
    """
    folders = [package_file(package, "config/" + kind)] + [folder / kind for folder in member_folders()]
    paths = [path for folder in folders for path in sorted(folder.glob("*.yaml"))]
    check_once(kind, [path.name for path in paths])
    return {path.stem: path for path in paths}


def check_once(kind, names):
    """Raises ValueError when two files of a kind have the same name."""
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
    """Reads 1e-05, as C++ programs write it, as a number; YAML 1.1 requires a decimal point and reads a string."""


_EXPONENT = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+\Z")
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+0123456789"))


def key_comments(path):
    """{key: comment at the end of its line} of the top-level keys of a YAML file."""
    return dict(re.findall(r"(?m)^(\w+):[^#\n]*# *(.+)$", pathlib.Path(path).read_text(encoding="utf-8")))


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
