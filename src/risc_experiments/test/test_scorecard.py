"""The scorecard: its figures and bounds, resuming after an interruption, all its files, and members of others."""

import csv
import json
import pathlib
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from data_extraction.report import page
from risc_experiments.scorecard import __main__ as command
from risc_experiments.scorecard import flights, output
from risc_experiments.scorecard.figures import compare, rate_bounds, row_of, share_bounds, totals_of
from risc_experiments.scorecard.plan import NONE, RANDOM, Cell, Plan, load_params, safe_members
from risc_lab.lab.arena import Arena
from risc_lab.lab.yaml_reader import package_file
from risc_simulator.faults import fault_settings
from risc_simulator.models.integrator import REST_HEIGHT_M

MEMBERS = pathlib.Path(__file__).parent / "members"
CELL = Cell("jump", "mild", "least_squares", "differential_flatness")
ROW_KEYS = {
    "fault", "severity", "estimator", "controller", "minutes", "rmse_m", "worst_m", "detect_p50_ms", "detect_p99_ms",
    "false_alarms", "breaches", "contacts",
}  # fmt: skip


def flown(rmse_m, minutes=1.0, delays_ms=(), missed=0, **counted):
    """Figures of a flight."""
    events = [["jump:0.1,risc1", 10.0, "held", True, delay_ms, "hold"] for delay_ms in delays_ms]
    events += [["jump:0.1,risc1", 10.0, "completed", True, None, None]] * missed
    figures = {
        "minutes": minutes,
        "vehicle_minutes": 2.0 * minutes,
        "square_m2": 100 * rmse_m**2,
        "samples": 100,
        "worst_m": 2 * rmse_m,
        "net_m": 1.0 - rmse_m,
    }
    return figures | {"events": events, "false_alarms": 0, "breach": [], "contact": []} | counted


def test_bounds_are_those_of_the_tables():
    assert rate_bounds(0, 10000.0) == [0.0, pytest.approx(3e-4)]
    assert rate_bounds(5, 100.0) == [pytest.approx(0.016235, abs=1e-6), pytest.approx(0.116683, abs=1e-6)]
    assert rate_bounds(0, 0.0) is None
    assert share_bounds(5, 10) == [pytest.approx(0.187086, abs=1e-6), pytest.approx(0.812914, abs=1e-6)]
    assert share_bounds(0, 300) == [0.0, pytest.approx(0.009936, abs=1e-6)]  # a little less than 3 / 300
    assert share_bounds(3, 3) == [pytest.approx(0.368403, abs=1e-6), 1.0] and share_bounds(0, 0) is None


@pytest.mark.parametrize(
    "count, minutes, text",
    [(0, 10000.0, "< 3e-4"), (0, 1234.0, "< 2.5e-3"), (0, 10.0, "< 0.3"), (5, 100.0, "0.016 to 0.12"), (0, 0.0, "–")],
)
def test_rates_are_said_with_bounds_that_are_rounded_outwards(count, minutes, text):
    row = {"breaches": count, "breaches_per_minute_bounds": rate_bounds(count, minutes)}
    assert output.rate(row, "breaches") == text


def test_a_row_is_made_of_all_its_flights():
    row = row_of(
        CELL,
        {
            1: flown(0.01, delays_ms=[90.0, 100.0], contact=["risc1 and risc2"]),
            2: flown(0.03, minutes=0.5, missed=1, delays_ms=[110.0], false_alarms=2),
            3: {"minutes": 0.0, "vehicle_minutes": 0.0, "error": "not on the course", "took_s": 1.0},
        },
    )
    assert row.keys() >= ROW_KEYS
    assert (row["flights"], row["failed"], row["minutes"], row["vehicle_minutes"]) == (2, 1, 1.5, 3.0)
    assert row["net_m"] == 0.97, "the least"
    assert row["rmse_m"] == pytest.approx((0.5 * (0.01**2 + 0.03**2)) ** 0.5, abs=1e-6) and row["worst_m"] == 0.06
    assert (row["events"], row["detected"], row["detect_p50_ms"], row["detect_p99_ms"]) == (4, 3, 100.0, 110.0)
    assert row["detected_by"] == {"hold": 3} and row["outcomes"] == {"held": 3, "completed": 1}
    assert (row["false_alarms"], row["breaches"], row["contacts"]) == (2, 0, 1)
    totals = totals_of([row, row])
    assert (totals["minutes"], totals["breaches"], totals["contacts"]) == (3.0, 0, 2)
    nowhere = row_of(CELL, {1: {"minutes": 0.0, "vehicle_minutes": 0.0, "error": "not on the course"}})
    assert totals["net_m"] == totals_of([row, nowhere])["net_m"] == 0.97 and totals_of([nowhere])["net_m"] is None
    assert totals["breaches_per_minute_bounds"] == [0.0, 1.0]


def test_two_scorecards_differ_only_where_chance_does_not_explain_it():
    row = row_of(CELL, {seed: flown(0.01 + 1e-4 * seed, delays_ms=[90.0 + seed]) for seed in range(1, 21)})
    assert not any(item["significant"] for item in compare([row], [row]))
    worse = row_of(CELL, {seed: flown(0.011 + 1e-4 * seed, delays_ms=[150.0 + seed]) for seed in range(1, 21)})
    found = {item["figure"] for item in compare([worse], [row]) if item["significant"]}
    assert found == {"rmse_m", "detect_p50_ms"}
    crashes = row_of(CELL, {seed: flown(0.01 + 1e-4 * seed, missed=1, breach=["it"]) for seed in range(1, 21)})
    found = {item["figure"] for item in compare([crashes], [row]) if item["significant"]}
    assert found == {"detected", "breaches"}
    (missed,) = [item for item in compare([crashes], [row]) if item["figure"] == "detected"]
    (hurt,) = [item for item in compare([crashes], [row]) if item["figure"] == "breaches"]
    assert (missed["here"], missed["there"], hurt["here"], hurt["there"]) == (0.0, 1.0, 1.0, 0.0), "shares and rates"
    assert output.compared(hurt)[5:7] == ["1.00 per minute", "0.00 per minute"]
    few = row_of(CELL, {1: flown(1.0)})
    assert not any(item["significant"] for item in compare([few], [row]) if item["figure"] == "rmse_m")
    assert compare([row], [row_of(CELL._replace(severity="severe"), {1: flown(1.0)})]) == []


def plan(*cells, **values):
    defaults = {"flight_s": 60.0, "minutes": 2.0, "seeds": None, "ladder": True, "params": load_params()}
    return Plan(cells=cells, **(defaults | values))


def test_events_are_apart_fit_into_the_flight_and_are_the_same_for_all():
    params = load_params()
    for cell in (CELL, CELL._replace(fault=RANDOM, severity="-")):
        mine = plan(cell)
        events = mine.flight(cell, 3).faults
        assert len(events) > 5 and {event.vehicle for event in events} > {"risc1"}
        assert events[0].start_s >= params.events.first_s
        for event, later in zip(events, events[1:]):
            assert later.start_s - event.start_s - event.duration_s >= params.events.quiet_s[0] - 1e-3
        assert events[-1].start_s + events[-1].duration_s + params.events.settle_s <= 60.0
        assert mine.flight(cell._replace(controller="thesis_lqr"), 3).faults == events
        assert mine.flight(cell, 4).faults != events
    assert mine.flight(CELL._replace(fault=NONE), 1).faults == ()
    drawn = {event.fault for seed in range(1, 60) for event in mine.flight(cell, seed).faults}
    assert drawn == set(safe_members(params)) and not any("breach" in fault_settings(name).safe for name in drawn)


def test_flights_that_end_early_are_made_up_for_but_not_for_ever():
    mine, other = plan(CELL), CELL._replace(severity="severe")
    assert list(mine.wanting({})) == [(CELL, 1), (CELL, 2)]
    assert list(mine.wanting({CELL: {1: 1.0, 2: 0.25}})) == [(CELL, 3), (CELL, 4)]
    assert list(mine.wanting({CELL: {1: 1.0, 2: 1.0}})) == []
    assert len(list(mine.wanting({CELL: dict.fromkeys(range(1, 20), 0.0)}))) == 1, "ten times as many, no more"
    assert list(mine.wanting({CELL: dict.fromkeys(range(1, 21), 0.0)})) == []
    both = plan(CELL, other, seeds=(1, 2))
    assert list(both.wanting({CELL: {1: 0.1, 2: 0.1}, other: {2: 1.0}})) == [(other, 1)]
    assert both.part({CELL: {1: 0.1, 2: 0.1}, other: {2: 1.0}}) == 0.75 and mine.part({CELL: {1: 1.0}}) == 0.5


def test_an_interrupted_run_goes_on_and_another_one_begins_anew(tmp_path):
    record = flights.Record(tmp_path, {"code": "a", "settings": 1})
    record.add(CELL, 1, flown(0.01))
    record.add(CELL, 2, flown(0.02))
    record.close()
    path = tmp_path / flights.FILE
    path.write_bytes(path.read_bytes()[:-20])  # killed in the middle of a line
    record = flights.Record(tmp_path, {"code": "a", "settings": 1})
    assert record.minutes() == {CELL: {1: 1.0}} and record.notice.endswith(": 1")
    record.add(CELL, 2, flown(0.02))
    record.close()
    record = flights.Record(tmp_path, {"code": "a", "settings": 1})
    assert record.minutes() == {CELL: {1: 1.0, 2: 1.0}}
    with pytest.raises(ValueError, match="another scorecard"):
        flights.Record(tmp_path, {"code": "a", "settings": 1})
    record.close()
    record = flights.Record(tmp_path, {"code": "b", "settings": 1})
    assert record.minutes() == {} and "another code" in record.notice
    assert len((tmp_path / (flights.FILE + ".old")).read_text(encoding="utf-8").splitlines()) == 3
    record.close()
    path.write_bytes(path.read_bytes() + b"\0\0\n")  # the power failed
    with pytest.raises(ValueError, match="line 2 "):
        flights.Record(tmp_path, {"code": "b", "settings": 1})


def test_more_minutes_are_no_other_scorecard_and_shorter_flights_are():
    few, many, short = (
        command.identity_of(plan(CELL, **values)) for values in ({}, {"minutes": 9.0}, {"flight_s": 30.0})
    )
    assert few == many != short


def test_minutes_of_single_vehicles_are_those_that_they_are_up():
    times_s = 0.02 * np.arange(500)
    actual_m = np.full((500, 2, 3), 1.0)
    actual_m[250:, 1, 2] = REST_HEIGHT_M  # it has landed
    result = SimpleNamespace(times_s=times_s, reached_s=2.0, actual_m=actual_m)
    assert flights._vehicle_minutes(result) == pytest.approx((8.0 + 3.0) / 60.0)


def test_the_distance_to_the_net_is_that_to_its_sides_and_its_ceiling_on_the_course():
    times_s, actual_m = 0.02 * np.arange(500), np.full((500, 2, 3), 1.0)
    result = SimpleNamespace(times_s=times_s, reached_s=2.0, actual_m=actual_m)
    for place_m, net_m in (((1.0, -1.9, 1.0), 0.1), ((-2.2, 1.0, 1.0), 0.3), ((0.0, 0.0, 2.95), 0.05)):
        actual_m[250, 1] = place_m
        assert flights._net_m(Arena(2.5, 2.0, 3.0), result) == pytest.approx(net_m)
        actual_m[50, 0], actual_m[250, 1] = place_m, 1.0  # before the course
        assert flights._net_m(Arena(2.5, 2.0, 3.0), result) == 1.0


def test_other_settings_name_what_differs():
    """Those of the shipped files; the rest is as in scorecard.yaml."""
    usual = load_params()
    for name, types in (("iris", ("iris",) * 3), ("mixed", ("ardrone", "ardrone", "iris"))):
        path = package_file("risc_experiments", "config/scorecard_%s.yaml" % name)
        assert load_params(path) == replace(usual, types=types)


def test_the_shipped_list_of_faults_flies():
    path = str(package_file("risc_experiments", "config/beyond_grades.yaml"))
    mine = plan(Cell(path, "-", "least_squares", "differential_flatness"))
    events = mine.flight(mine.cells[0], 1).faults
    drawn = {(event.fault, event.severity) for event in events}
    assert drawn == {
        *(("clock_step", step_s) for step_s in (1.0, -1.0)),
        *(("burst", silence_s) for silence_s in (0.02, 5.0)),
        *(("loss", 0.3), ("jitter", 0.05)),
    }
    begins_s = [event.start_s for event in events]
    ends_s = [event.start_s + event.duration_s for event in events]
    quiet_s = [begin_s - end_s for end_s, begin_s in zip(ends_s, begins_s[1:])]
    assert min(quiet_s) >= mine.params.events.settle_s


def run(capsys, folder, vehicles, *options):
    """Run a command line with this number of vehicles. Returns (exit code, the scorecard, what was printed)."""
    path = folder.parent / ("%s_settings.yaml" % folder.name)
    path.write_text("vehicles: %d\n" % vehicles, encoding="utf-8")
    code = command.main([*options, "--settings", str(path), "--workers", "1", "--out", str(folder)])
    return code, json.loads((folder / "scorecard.json").read_text(encoding="utf-8")), capsys.readouterr()


def test_a_students_controller_takes_part_and_all_files_are_written(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(MEMBERS))
    options = ("--faults", "none,mocap_blackout", "--severities", "mild", "--controllers", "toy_pd", "--seeds", "1")
    options += ("--minutes", "0.35")
    done, folder = flights.score, tmp_path / "card"

    def interrupted(item):
        if item[0].faults:
            raise KeyboardInterrupt
        return done(item)

    monkeypatch.setattr(flights, "score", interrupted)
    code, card, said = run(capsys, folder, 1, *options)
    assert code == 130 and not card["complete"] and [row["fault"] for row in card["rows"]] == ["none"]
    monkeypatch.setattr(flights, "score", done)
    code, card, said = run(capsys, folder, 1, *options, "--json", str(tmp_path / "copy.json"))
    assert code == 0 and card["complete"] and card["simulated"] and card["ladder"] is True
    assert "%s: " % (folder / flights.FILE) in said.err
    assert json.loads((tmp_path / "copy.json").read_text(encoding="utf-8")) == card
    quiet, blackout = card["rows"]
    assert all(row.keys() >= ROW_KEYS and row["controller"] == "toy_pd" for row in card["rows"])
    assert quiet["minutes"] == pytest.approx(0.35, abs=0.01) and quiet["rmse_m"] < 0.15 and quiet["events"] == 0
    assert blackout["detected"] == blackout["events"] >= 3 and 80.0 < blackout["detect_p50_ms"] < 125.0
    assert card["totals"].keys() >= {"minutes", "breaches", "contacts"} and card["totals"]["false_alarms"] == 0
    with (folder / "scorecard.csv").open(encoding="utf-8", newline="") as stream:
        assert [row["fault"] for row in csv.DictReader(stream)] == ["none", "mocap_blackout"]
    assert "| mocap_blackout | mild | least_squares | toy_pd |" in (folder / "scorecard.md").read_text(encoding="utf-8")
    text = (folder / "scorecard.html").read_text(encoding="utf-8")
    assert "data:image/svg+xml" in text and "mocap_blackout" in text and "simulated" in text
    assert (folder / "scorecard.png").stat().st_size > 10000
    code, card, said = run(capsys, folder, 1, *options, "--against", str(tmp_path / "copy.json"))
    assert code == 0 and len(card["against"]["differences"]) == 12
    assert not any(item["significant"] for item in card["against"]["differences"])


@pytest.mark.parametrize(
    "options, seeds, flight_s",
    [
        (("--seeds", "3"), (1, 2, 3), 60.0),
        (("--seeds", "4-6", "--minutes", "6"), (4, 5, 6), 120.0),
        (("--seed", "4", "--seeds", "9"), (4,), 60.0),
    ],
)
def test_flights_can_be_shared_out_by_their_seeds(options, seeds, flight_s):
    plan = command.plan_of(command.arguments(["--faults", "none", *options])[1])
    assert plan.seeds == seeds and plan.flight_s == flight_s


@pytest.mark.parametrize("options, minutes", [(("--minutes", "9"), 9.0), (("--seeds", "3", "--minutes", "9"), None)])
def test_a_scorecard_says_how_long_its_rows_were_to_be(options, minutes):
    plan = command.plan_of(command.arguments(["--faults", "none", *options])[1])
    card = command.scorecard_of(plan, SimpleNamespace(flown={}), "./maap scorecard", True)
    assert card["settings"]["minutes"] == minutes


@pytest.mark.parametrize(
    "options, words",
    [
        (("--faults", "plague"), "fault 'plague'"),
        (("--controllers", "plague"), "controller 'plague'"),
        (("--estimators", "plague"), "estimator 'plague'"),
        (("--severities", "plague"), "severity 'plague'"),
        (("--faults", "plague.yaml"), "plague.yaml"),
        (("--against", "plague.json"), "plague.json"),
        (("--minutes", "0"), "argument --minutes: .* 0.01 .*found 0$"),
        (("--seeds", "0"), "argument --seeds: .*found 0$"),
        (("--seeds", "0-4"), "argument --seeds: .*found 0-4$"),
        (("--seeds", "4-"), "argument --seeds: .*found 4-$"),
        (("--seeds", "5-4"), "argument --seeds: .*found 5-4$"),
        (("--faults", "motor_loss"), "no grades"),
        (("--json", "plague/card.json"), " plague$"),
        (("--faults", ","), "argument --faults: "),
    ],
)
def test_a_mistake_on_the_command_line_is_named(tmp_path, capsys, options, words):
    with pytest.raises(SystemExit):
        command.main([*options, "--out", str(tmp_path)])
    said = capsys.readouterr().err
    assert re.search(words, said, re.MULTILINE) and "Traceback" not in said
    assert not list(tmp_path.iterdir())


def test_it_is_said_when_two_were_flown_under_other_conditions():
    card = card_of({CELL: {1: flown(0.01)}})
    other = card | {"ladder": False, "settings": card["settings"] | {"flight_s": 30.0}}
    assert output.differing_conditions(card, json.loads(json.dumps(card))) == []
    assert output.differing_conditions(card, other) == ["ladder", "flight_s"]
    card["against"] = {"file": "other.json", "conditions": ["ladder", "flight_s"], "differences": []}
    text = page.render("scorecard.html", package_file("risc_experiments", "templates"), **output.page_values(card))
    assert "(ladder, flight_s)" in text and "(ladder, flight_s)" in output.markdown(card)


def test_the_page_has_the_style_of_the_reports():
    style = package_file("data_extraction", "templates/page.css").read_text(encoding="utf-8")
    card = card_of({CELL: {1: flown(0.01, breach=["risc1 hit the net <b>"])}})
    text = page.render("scorecard.html", package_file("risc_experiments", "templates"), **output.page_values(card))
    assert style.strip() in text and "{%" not in text and "<b>risc" not in text


def card_of(flights_of):
    """A scorecard of flights that were not flown."""
    rows = [row_of(cell, flights) for cell, flights in flights_of.items()]
    settings = {"trajectories": ("circle",), "vehicles": 3, "flight_s": 60.0}
    words = {"date": "today", "command": "./maap scorecard", "revision": None, "settings": settings}
    card = {"simulated": True, "complete": True, "ladder": True, "rows": rows, "totals": totals_of(rows)}
    return card | words | {"findings": [], "failures": []}


def test_nobody_is_hurt_but_without_the_ladder(tmp_path, capsys):
    """A short run. With the ladder off, the same faults of the same seeds must cause breaches or contacts."""
    options = ("--severities", "severe", "--seeds", "1", "--minutes", "0.35")
    _, card, _ = run(capsys, tmp_path / "on", 2, "--faults", "flip,name_exchange,random", *options)
    assert card["totals"]["failed"] == 0 and card["totals"]["events"] >= 3
    assert (card["totals"]["breaches"], card["totals"]["contacts"], card["totals"]["unsafe"]) == (0, 0, 0), card[
        "findings"
    ]
    _, control, said = run(capsys, tmp_path / "off", 2, "--faults", "flip", *options, "--no-ladder")
    assert control["ladder"] is False and control["totals"]["breaches"] + control["totals"]["contacts"] >= 1
    assert control["totals"]["unsafe"] >= 1 and "breach: flip severe" in said.out
