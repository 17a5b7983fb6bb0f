"""The steps of docs/add_a_vehicle.md: its files are written, its fleet flies offline, its flight is valid."""

import pathlib
import re
import shlex

import pytest

from risc_control import vehicles
from risc_experiments import fly, offline
from risc_lab.lab import load_fleet

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "add_a_vehicle.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"`(my_lab/[\w/.]+)`:\n\n```\w+\n(.*?)```", PAGE, re.DOTALL))
LIMIT_M = 0.05
ITS_OWN = (
    "src/risc_control/src/risc_control/vehicles",
    "src/risc_simulator/src/risc_simulator/vehicles",
    "src/risc_estimation/src/risc_estimation/sensors",
)  # files of types


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """A folder with the files of the page, and the environment that the page sets in it."""
    for name, content in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")
    name, value = re.search(r"^export (\w+)=\$PWD/(\w+)$", PAGE, re.MULTILINE).groups()
    monkeypatch.setenv(name, str(tmp_path / value))
    monkeypatch.chdir(tmp_path)


def test_the_fleet_of_the_page_flies(reader, monkeypatch):
    (command,) = re.findall(r"^\./maap fly (.*)$", PAGE, re.MULTILINE)
    args = fly.arguments(shlex.split(command))
    fleet = load_fleet(args.fleet).with_vehicles(args.vehicles)
    types = {vehicle.namespace: vehicle.vehicle_type for vehicle in fleet.vehicles}
    assert types["merlin"].name == "my_drone" and types["merlin"].mass_kg == 0.53
    monkeypatch.setattr(offline, "default_fleet", lambda *_: fleet)
    result = offline.fly(offline.Flight(args.trajectory, args.vehicles, duration_s=5.0))
    assert result.names == ("Kestrel", "Merlin")
    assert all(0.0 < rmse_m < LIMIT_M for rmse_m in result.rmse_m)


def test_names_of_types_stand_only_where_the_page_says():
    said = set(re.findall(r"`(\w+\.py)[ `]", PAGE.partition("### What stands elsewhere")[2]))
    name = re.compile(r"[\"'](%s)[\"'/]" % "|".join(vehicles.REGISTRY.names()))
    paths = [path for folder in ("src/*/src/*", "src/*/nodes") for path in ROOT.glob(folder + "/**/*.py")]
    elsewhere = [path for path in paths if not str(path.relative_to(ROOT)).startswith(ITS_OWN)]
    assert len(elsewhere) > 300
    assert {path.name for path in elsewhere if name.search(path.read_text(encoding="utf-8"))} == said
