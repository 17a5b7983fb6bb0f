"""Members of a kind, by name: controllers, vehicle types, estimators, bodies, faults ... See `Registry`."""

import importlib
import os
import pkgutil
from dataclasses import is_dataclass

from risc_lab.lab.yaml_reader import MEMBERS_VARIABLE, check_once, config_files, load_yaml, member_folders
from risc_lab.settings import settings_from

VARIABLE = MEMBERS_VARIABLE


class Registry:
    """Finds the members of a kind by name: each is one Python file and one YAML file.

    A member of the tree is PACKAGE/NAME.py and config/KIND/NAME.yaml of its ROS package. One from elsewhere, e.g. a
    student's, is KIND/NAME.py and KIND/NAME.yaml in a folder that the environment variable RISC_MAAP_MEMBERS names
    (several: with ":" between). It is imported as a module of the same package, so it works everywhere like one of
    the tree; a name that the tree has already is an error. Modules whose name begins with _ are not members.

        REGISTRY = Registry("controllers", __name__)    # in risc_control/controllers/__init__.py
        REGISTRY.module("lqr").Controller(...)
    """

    def __init__(self, kind, package):
        """kind: name of the folders.  package: the Python package of the tree's own members, imported already."""
        self.kind = kind
        self._package = importlib.import_module(package)
        self._own_path = list(self._package.__path__)
        self._known = {}  # {(name, folders of members): module}

    def names(self):
        """Names of all members, sorted. Raises ValueError for a missing folder or a duplicate name."""
        folders = [str(folder / self.kind) for folder in member_folders()]
        self._package.__path__[:] = self._own_path + folders
        found = [module.name for folder in self._package.__path__ for module in pkgutil.iter_modules([folder])]
        names = sorted(name for name in found if not name.startswith("_"))
        check_once(self.kind, names)
        return names

    def module(self, name):
        """The member's module, imported. Raises ValueError that names the known ones when there is no such member."""
        key = name, os.environ.get(VARIABLE)
        if key not in self._known:
            self._known[key] = self._imported(name)
        return self._known[key]

    def _imported(self, name):
        known = self.names()
        if name not in known:
            raise ValueError("unknown name '%s' among the %s; known are: %s" % (name, self.kind, ", ".join(known)))
        importlib.invalidate_caches()  # files may be newer than the cached list of their folder
        try:
            return importlib.import_module("%s.%s" % (self._package.__name__, name))
        except (ImportError, SyntaxError) as error:
            raise ValueError("%s: %s cannot be imported: %s" % (self.kind, name, error)) from error

    def settings(self, name, kind=dict):
        """Content of the member's YAML file, as an instance of a dataclass of settings if one is given.

        Raises ValueError, also when that class, which the member's module names, is no dataclass.
        """
        self.module(name)
        path = config_files(self.kind, self._package.__name__.split(".")[0]).get(name)
        if path is None:
            raise ValueError("%s '%s' has no %s.yaml" % (self.kind, name, name))
        if kind is dict:
            return load_yaml(path)
        if not (isinstance(kind, type) and is_dataclass(kind)):
            raise ValueError("%s '%s': its PARAMS must be a dataclass of settings, found %r" % (self.kind, name, kind))
        return settings_from(kind, load_yaml(path), str(path))
