"""Members of a kind, by name: controllers, vehicle types, estimators, bodies, faults ... See `Registry`."""

import importlib
import os
import pathlib
import pkgutil

from risc_lab.lab.yaml_reader import load_yaml, package_file

VARIABLE = "RISC_MAAP_MEMBERS"


class Registry:
    """Finds the members of a kind by name: each is one Python file and one YAML file.

    A member of the tree is PACKAGE/NAME.py and config/KIND/NAME.yaml of its ROS package. One from elsewhere, e.g. a
    student's, is KIND/NAME.py and KIND/NAME.yaml in a folder that the environment variable RISC_MAAP_MEMBERS names
    (several: with ":" between). It is imported as a module of the same package, so it takes part in everything as one
    of the tree does; a name that the tree has already is an error. Modules whose name begins with _ are no members.

        REGISTRY = Registry("controllers", __name__)    # in risc_control/controllers/__init__.py
        REGISTRY.module("lqr").Controller(...)
    """

    def __init__(self, kind, package):
        """kind: name of the folders.  package: the Python package of the tree's own members, imported already."""
        self.kind = kind
        self._package = importlib.import_module(package)
        self._own_path = list(self._package.__path__)

    def names(self):
        """Names of all members, sorted. Raises ValueError for a folder that is not there, or a name that is twice."""
        folders = [str(folder / self.kind) for folder in member_folders()]
        self._package.__path__[:] = self._own_path + folders
        found = [module.name for module in pkgutil.iter_modules(self._own_path)]
        for folder in folders:
            found += [module.name for module in pkgutil.iter_modules([folder])]
        names = sorted(name for name in found if not name.startswith("_"))
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError("%s: %s is there twice: rename the one in %s" % (self.kind, ", ".join(twice), VARIABLE))
        return names

    def module(self, name):
        """The member's module, imported. Raises ValueError that names the known ones when there is no such member."""
        known = self.names()
        if name not in known:
            raise ValueError("unknown name '%s' among the %s; known are: %s" % (name, self.kind, ", ".join(known)))
        importlib.invalidate_caches()  # files may be younger than the last look at their folder
        return importlib.import_module("%s.%s" % (self._package.__name__, name))

    def settings(self, name):
        """Content of the member's YAML file. Raises ValueError."""
        self.module(name)
        return load_yaml(config_files(self.kind, self._package.__name__.split(".")[0])[name])


def config_files(kind, package):
    """{name: path} of the YAML files of a kind: config/KIND of a ROS package, then the members from elsewhere."""
    folders = [package_file(package, "config/" + kind)] + [folder / kind for folder in member_folders()]
    return {path.stem: path for folder in reversed(folders) for path in sorted(folder.glob("*.yaml"))}


def member_folders():
    """Folders that RISC_MAAP_MEMBERS names. Raises ValueError when one is not there."""
    folders = [pathlib.Path(name) for name in os.environ.get(VARIABLE, "").split(os.pathsep) if name]
    for folder in folders:
        if not folder.is_dir():
            raise ValueError("%s names the folder %s, which is not there" % (VARIABLE, folder))
    return folders
