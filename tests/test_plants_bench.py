"""The benchmark of plants that differ from their type: what its rows fly, and that all of them are flown well."""

import json
from dataclasses import replace

import plants as bench
import pytest

from risc_experiments.offline import Flight, fly


def test_a_row_flies_the_plant_that_it_names():
    changes = bench.changes()
    assert len(changes) == 15
    assert changes["as the type"][0] == {} and changes["link +50 ms"][0] == {"command_delay_s": pytest.approx(0.15)}
    slow, fast = (changes[name][0]["roll"] for name in ("loops x 0.7, link +40 ms", "loops x 1.3"))
    assert slow.natural_frequency_rad_s == pytest.approx(0.7 / 1.3 * fast.natural_frequency_rad_s)
    base = Flight(vehicles=1, types=(bench.TYPE,), delay_s=bench.DELAY_S, duration_s=2.0, perturbed=False)
    slower = fly(replace(base, plant=changes["loops x 0.7, link +40 ms"][0]))
    assert slower.rmse_m[0] > 2.0 * fly(base).rmse_m[0]


def test_a_flight_that_does_not_end_misses_the_limit():
    row = bench.row_of("x", 15.0, {course: [RuntimeError("it crashed")] for course in bench.COURSES})
    assert not row["ok"] and row["circle"]["failed"] == 1


@pytest.mark.release
def test_all_are_flown_within_their_limits(tmp_path):
    file = tmp_path / "figures.json"
    assert bench.main(["--seeds", "3", "--json", str(file)]) == 0
    rows = json.loads(file.read_text(encoding="utf-8"))["rows"]
    assert [row["limit_mm"] for row in rows] == 13 * [bench.ONE_MM] + 2 * [bench.SEVERAL_MM]
