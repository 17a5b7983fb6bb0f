"""The thesis' method (5.2.2) on the virtual IRIS+: the fit of a flight gives back the lab's own curve."""

import flying
import numpy as np
import pytest
import yaml

from data_extraction.throttle_fit import FitParams, fit_bag
from risc_lab.lab import load_fleet, load_templates, load_vehicle_type
from risc_lab.lab.vehicle_types import own_numbers, vehicle_type_file
from risc_lab.radio_sticks import RadioSticks
from risc_simulator.world import World

SEED, LIFE_S = 1, 300.0  # the battery of this one is small: it drains by 60 % while it flies
ON_COURSE_S = 175.0
HEIGHT_LIMIT_M = 0.03
FLOWN_S = 560.0  # until a flight has ended and been judged, on a computer that does much else


def write_member(folder):
    """A type that is an IRIS+ with a small battery."""
    content = yaml.safe_load(vehicle_type_file("iris").read_text(encoding="utf-8"))
    content.update(name="short_iris", battery_life_s=LIFE_S, driver="iris")
    for name in ("vehicle_types", "virtual_vehicles"):
        (folder / name).mkdir(parents=True)
    (folder / "vehicle_types/short_iris.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    flying_side = "from risc_control.vehicles.iris import Adapter\n\n__all__ = ['Adapter']\n"
    (folder / "vehicle_types/short_iris.py").write_text(flying_side)
    (folder / "virtual_vehicles/short_iris.py").write_text("from risc_simulator.vehicles.iris import *\n")


@pytest.mark.release
@pytest.mark.alone
def test_the_fit_of_a_flight_is_the_labs_curve(tmp_path, monkeypatch):
    write_member(tmp_path / "members")
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(tmp_path / "members"))
    fleet = yaml.safe_load((flying.ROOT / "launch/fleets/iris1.yaml").read_text(encoding="utf-8"))
    fleet["vehicles"][0]["type"] = "short_iris"
    path, folder = tmp_path / "fleet.yaml", tmp_path / "flight"
    path.write_text(yaml.safe_dump(fleet), encoding="utf-8")
    options = ("--fleet", str(path), "--vehicles", "1", "--trajectory", "origin", "--seed", str(SEED))
    process = flying.start(folder, *options, "--duration", str(ON_COURSE_S))
    code, output = flying.finish(process, folder, FLOWN_S)
    assert code == 0, output

    flown = flying.summary_of(folder)["vehicles"]["IRIS"]
    print("off its place by at most %.1f mm" % (1e3 * flown["position_max_m"]))
    assert flown["position_max_m"] < HEIGHT_LIMIT_M, "in height alone, then, too"

    name, found = fit_bag(folder / "flight.bag", params=FitParams())
    assert name == "IRIS" and found.points.pct[0] <= 40.0 and found.points.pct[-1] >= 97.0, found.points.pct
    fleet = load_fleet(path)
    world = World(fleet, {"short_iris": load_vehicle_type("short_iris")}, load_templates(fleet=fleet), seed=SEED)
    pct = np.linspace(found.points.pct[0], found.points.pct[-1], 100)
    true = np.array([world.vehicles["iris1"].firmware.hover_throttle(value) for value in pct])
    off = np.abs(found.scaled(pct) - true).max()
    print("off by %.4f of %.4f, rms of the residuals %.4f" % (off, np.ptp(true), found.rms))
    assert off < 0.01 * np.ptp(true)
    shipped = np.polynomial.polynomial.polyval(pct, own_numbers(load_vehicle_type("iris"), RadioSticks).hover_throttle)
    assert np.abs(shipped - true).max() > 0.01 * np.ptp(true), "this vehicle is another than the nominal one"
