"""The course's plots: tables with known contents, segments, pages with the right lines, and all of it from bags."""

import csv
import math
import pathlib
import runpy
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import rosbag
import rospy
from run_programs import run_program

from data_extraction.bags import BagError
from data_extraction.course_plots import PageWriter, file_stem, plot_bag
from data_extraction.plots import course_limits_m, course_page
from data_extraction.recording import COMMANDS, REFERENCES, STATES
from data_extraction.segments import (
    COLUMNS,
    DESIRED_POSITION,
    OPERATOR,
    PHASES,
    POSITION,
    SENT,
    PlotParams,
    Recorder,
    full_scales_deg,
)
from risc_lab.lab import load_fleet
from risc_lab.phases import OperatorPhase, TrajectoryPhase
from risc_maap_msgs.msg import CommandSent, OperatorState, TrajectoryPhases, VehiclePhase
from risc_msgs.msg import Control, Controls, Cortex, States, Trajectories, Trajectory

NODE = pathlib.Path(__file__).resolve().parents[1] / "nodes" / "DF_Plots.py"
FLEET = pathlib.Path(__file__).resolve().parents[3] / "launch" / "fleets" / "ardrones3.yaml"
T0_S = 1400000000.0
LEGACY_PARAMS = PlotParams(skip_phases=())


def path_m(t_s):
    """Desired position: straight and accelerated, so that positions between two samples are known."""
    return 0.3 * t_s - 1.0, 0.2 * t_s, 1.0 + 0.01 * t_s


def reference(name, t_s, psi_rad=0.0):
    x, y, z = path_m(t_s)
    return Trajectory(name=name, x=x, y=y, z=z, xdot=0.3, ydot=0.2, zdot=0.01, psi=psi_rad)


def state(name, t_s, **changed):
    """0.05 m behind in x, 0.02 m too far right, and slower than it should be."""
    x, y, z = path_m(t_s)
    values = {"name": name, "visible": True, "x": x - 0.05, "y": y - 0.02, "z": z, "u": 0.2, "v": 0.2, "w": 0.01}
    values.update(phi=3.0, theta=-4.0, psi=170.0)
    values.update(changed)
    return States(**values)


def fly(recorder, begin_s, end_s, name="fluffy_II", course=None, stamped=True, see=state):
    """States and commands at 100 Hz with known delays, references at 50 Hz."""
    for k in range(round(100 * begin_s), round(100 * end_s)):
        t_s = 0.01 * k
        stamp_s = T0_S + t_s
        if k % 2 == 0:
            entries = [reference(course or name, t_s)]
            recorder.add(REFERENCES, stamp_s + 0.001, Trajectories(Obj=entries), stamp_s if stamped else 0.0)
        recorder.add(STATES, stamp_s + 0.004, Cortex(Obj=[see(name, t_s)]), stamp_s)
        recorder.add(
            COMMANDS, stamp_s + 0.006, Controls(Obj=[Control(name=name, phi=0.25, theta=-0.5, T=4.4)]), stamp_s
        )


def column(segment, name):
    return segment.columns([name])[:, 0]


def test_the_sixteen_columns_are_those_of_the_flight():
    recorder = Recorder(PlotParams())
    fly(recorder, 0.0, 5.0)
    recorder.finish()
    (segment,) = recorder.segments()
    assert len(COLUMNS) == 16 and segment.table.shape[1] == 16
    t_s = column(segment, "time_s") - T0_S
    assert len(t_s) > 480 and t_s[0] < 0.03  # references before the first state are not used: their vehicle is unknown
    # every desired position is that of the state's own time, and each axis has its own column (D-54)
    assert segment.columns(DESIRED_POSITION) == pytest.approx(np.column_stack(path_m(t_s) + ()), abs=1e-6)
    assert segment.columns(POSITION)[:, 2] == pytest.approx(path_m(t_s)[2], abs=1e-6)
    assert segment.position_error_m == pytest.approx(np.tile([0.05, 0.02, 0.0], (len(t_s), 1)), abs=1e-6)
    assert segment.position_rmse_m == pytest.approx(math.hypot(0.05, 0.02), abs=1e-6)
    expected = {
        "u_error_m_s": 0.1, "v_error_m_s": 0.0, "w_error_m_s": 0.0,
        "phi_deg": 3.0, "theta_deg": -4.0, "psi_deg": 170.0,
        "phi_desired_deg": -5.0, "theta_desired_deg": 10.0, "psi_desired_deg": 0.0,
    }  # fmt: skip
    for name, value in expected.items():
        assert column(segment, name) == pytest.approx(value, abs=1e-4), name


def test_what_was_really_sent_counts_before_the_controllers_wish():
    recorder = Recorder(PlotParams())
    for k in range(120):
        stamp_s = T0_S + k / 30.0
        command = CommandSent("fluffy_II", rospy.Time(), rospy.Time(), 0.1, -0.05, 0.0, 0.0, 0)
        recorder.add(SENT, stamp_s + 0.01, command, stamp_s)
    fly(recorder, 0.0, 3.0)
    recorder.finish()
    (segment,) = recorder.segments()
    assert column(segment, "phi_desired_deg") == pytest.approx(math.degrees(0.1))
    assert column(segment, "theta_desired_deg") == pytest.approx(math.degrees(-0.05))


def test_commands_that_ended_in_the_segment_before():
    """Their remaining data ends with that segment: the next one has no commands, and is logged nevertheless."""
    recorder = Recorder(LEGACY_PARAMS)
    recorder.add(PHASES, T0_S, told("coop", TrajectoryPhase.COURSE))
    fly(recorder, 0.0, 3.0)
    for k in range(300, 900):
        stamp_s = T0_S + 0.01 * k
        if k == 400:
            recorder.add(PHASES, stamp_s, told("coop", TrajectoryPhase.HOLD))
        recorder.add(REFERENCES, stamp_s, Trajectories(Obj=[reference("fluffy_II", 0.01 * k)]), stamp_s)
        recorder.add(STATES, stamp_s, Cortex(Obj=[state("fluffy_II", 0.01 * k)]), stamp_s)
        if k % 100 == 0:
            recorder.ended()  # as the node does, every second
    recorder.finish()
    _, after = recorder.segments()
    assert after.duration_s > 4.5 and np.isnan(column(after, "phi_desired_deg")[-100:]).all()


def test_full_scale_of_the_commands():
    fleet = load_fleet(FLEET)
    of_fleet, others = full_scales_deg(PlotParams(), fleet.vehicles)
    # 20 degrees, + left and + forward; the controllers of this workspace divide by the gains of the attitude loops
    assert others == pytest.approx((-20.0, -20.0), abs=1e-4)
    assert of_fleet["fluffy_II"] == pytest.approx((-20.0 * 1.1714, -20.0 * 1.10714), abs=1e-4)
    assert full_scales_deg(PlotParams(euler_angle_max=0.1))[1] == pytest.approx((-math.degrees(0.1),) * 2)
    assert full_scales_deg(PlotParams(vehicle_type="iris"))[1] == pytest.approx((45.0, 45.0), abs=0.01)
    with pytest.raises(ValueError, match="boat"):
        full_scales_deg(PlotParams(vehicle_type="boat"))


def told(course, phase):
    """TrajectoryPhases of fluffy_II, and of another vehicle that holds."""
    vehicles = [VehiclePhase("Raven", TrajectoryPhase.HOLD), VehiclePhase("fluffy_II", phase)]
    return TrajectoryPhases(course=course, vehicles=vehicles)


def test_a_segment_for_each_course_and_phase():
    recorder = Recorder(PlotParams())
    recorder.add(OPERATOR, T0_S, OperatorState(phase=OperatorPhase.FLY))
    hold, approach, course, home, _ = TrajectoryPhase
    for begin_s, name, phase in ((0.0, "origin", hold), (3.0, "slanted8", approach), (6.0, "slanted8", course)):
        recorder.add(PHASES, T0_S + begin_s, told(name, phase))
        fly(recorder, begin_s, begin_s + 3.0)
    fly(recorder, 9.0, 9.5)
    recorder.add(PHASES, T0_S + 9.5, told("slanted8", home))
    fly(recorder, 9.5, 10.0)  # too short for a page
    assert (recorder.ended(), [s.label for s in recorder.segments(growing=False)]) == (2, ["slanted8 approach"])
    recorder.finish()
    assert recorder.ended() == 3
    found = [(s.label, round(s.start_s - T0_S, 1), round(s.duration_s, 1)) for s in recorder.segments()]
    assert found == [("slanted8 approach", 3.0, 3.0), ("slanted8", 6.0, 3.5)]


def test_the_operator_counts_where_no_trajectory_node_speaks():
    recorder = Recorder(PlotParams())
    takeoff, fly_ = OperatorPhase.TAKEOFF, OperatorPhase.FLY
    for begin_s, phase, text in ((0.0, takeoff, ""), (2.0, fly_, ""), (4.0, fly_, "figure 2")):
        recorder.add(OPERATOR, T0_S + begin_s, OperatorState(phase=phase, text=text))
        fly(recorder, begin_s, begin_s + 2.0)
    recorder.finish()
    assert [s.label for s in recorder.segments()] == ["takeoff", "fly"]


def test_the_original_names_the_course_and_stamps_nothing():
    recorder = Recorder(LEGACY_PARAMS)
    for begin_s, course in ((0.0, "Origin"), (2.0, "Slanted Figure Eight"), (4.0, "Origin")):
        fly(recorder, begin_s, begin_s + 2.0, course=course, stamped=False)
    recorder.finish()
    segments = recorder.segments()
    assert [(s.vehicle, s.label) for s in segments] == [
        ("fluffy_II", "Origin"),
        ("fluffy_II", "Slanted Figure Eight"),
        ("fluffy_II", "Origin"),
    ]
    # paired by the times of receipt: the reference arrives 3 ms before the state of the same moment
    assert segments[1].position_error_m[:, 0] == pytest.approx(0.05 + 0.3 * 0.003, abs=1e-6)
    assert len(segments[1].table) > 190


def test_several_vehicles_of_the_original_go_by_their_place():
    recorder = Recorder(PlotParams(vehicles=("Raven",)))
    for k in range(300):
        t_s = 0.01 * k
        stamp_s = T0_S + t_s
        recorder.add(STATES, stamp_s, Cortex(Obj=[state("fluffy_II", t_s), state("Raven", t_s, x=9.0)]), stamp_s)
        entries = [reference("Circle", t_s), reference("Circle", t_s)]
        entries[1].x = 8.0
        recorder.add(REFERENCES, stamp_s, Trajectories(Obj=entries), 0.0)
        commands = [Control(name="fluffy_II", phi=0.1), Control(name="fluffy_II", phi=0.2)]  # D-26
        recorder.add(COMMANDS, stamp_s, Controls(Obj=commands), stamp_s)
    recorder.finish()
    (segment,) = recorder.segments()
    assert recorder.vehicles == ("fluffy_II", "Raven") and segment.vehicle == "Raven" and segment.label == "Circle"
    assert segment.position_error_m[:, 0] == pytest.approx(-1.0)
    assert column(segment, "phi_desired_deg") == pytest.approx(-4.0, abs=1e-4)


def test_vehicles_of_a_fleet_may_be_named_by_namespace():
    recorder = Recorder(PlotParams(vehicles=("risc2",)), load_fleet(FLEET).vehicles)
    for name in ("fluffy_II", "albatross"):
        fly(recorder, 0.0, 2.0, name=name)
    recorder.finish()
    assert recorder.unknown_vehicles == ()
    assert [s.vehicle for s in recorder.segments()] == ["albatross"]


def test_yaw_is_interpolated_over_the_seam():
    recorder = Recorder(PlotParams())
    for k in range(21):
        stamp_s = T0_S + 0.1 * k
        psi_rad = math.radians(178.0) if k % 2 == 0 else math.radians(-178.0)
        recorder.add(REFERENCES, stamp_s, Trajectories(Obj=[reference("fluffy_II", 0.1 * k, psi_rad)]), stamp_s)
        recorder.add(STATES, stamp_s, Cortex(Obj=[state("fluffy_II", 0.1 * k + 0.05)]), stamp_s + 0.05)
    recorder.finish()
    (segment,) = recorder.segments()
    assert np.abs(column(segment, "psi_desired_deg")) == pytest.approx(180.0, abs=1e-3)


def test_what_is_not_known_is_not_invented():
    recorder = Recorder(PlotParams())
    recorder.add(STATES, T0_S, Cortex(Obj=[state("fluffy_II", 0.0)]), T0_S)
    recorder.add(REFERENCES, T0_S + 0.5, Trajectories(Obj=[reference("fluffy_II", 0.5)]), T0_S + 0.5)
    fly(recorder, 1.0, 2.0)
    fly(recorder, 2.0, 3.0, see=lambda name, t_s: state(name, t_s, visible=False))
    fly(recorder, 3.0, 4.0, see=lambda name, t_s: state(name, t_s, x=math.nan))
    fly(recorder, 4.0, 6.0)
    for k in range(200):  # no commands for 2 s
        stamp_s = T0_S + 6.0 + 0.01 * k
        recorder.add(REFERENCES, stamp_s, Trajectories(Obj=[reference("fluffy_II", 6.0 + 0.01 * k)]), stamp_s)
        recorder.add(STATES, stamp_s, Cortex(Obj=[state("fluffy_II", 6.0 + 0.01 * k)]), stamp_s)
    recorder.finish()
    (segment,) = recorder.segments()
    t_s = column(segment, "time_s") - T0_S
    assert t_s[0] > 0.99, "a state whose reference is 0.5 s away has none"
    assert not ((t_s > 2.0) & (t_s < 3.99)).any()
    unknown = np.isnan(column(segment, "phi_desired_deg"))
    assert unknown[t_s > 6.01].all() and not unknown[t_s < 5.98].any()


def test_a_bag_that_is_played_again_begins_anew():
    recorder = Recorder(PlotParams())
    fly(recorder, 0.0, 4.0)
    fly(recorder, 0.0, 4.0)
    recorder.finish()
    assert [round(s.start_s - T0_S, 1) for s in recorder.segments()] == [0.0, 0.0]
    assert all((np.diff(column(s, "time_s")) > 0.0).all() for s in recorder.segments())


def test_a_long_flight_is_cut_and_old_segments_are_forgotten():
    recorder = Recorder(PlotParams(rate_hz=100.0, max_s=2.0, keep_s=3.0))
    fly(recorder, 0.0, 20.0)
    recorder.finish()
    segments = recorder.segments()
    assert [round(s.start_s - T0_S) for s in segments] == [16, 18]
    assert all(s.duration_s == pytest.approx(2.0, abs=0.05) for s in segments)


def rows_kept(recorder):
    return sum(len(samples) for of_topic in recorder._recording._samples.values() for samples in of_topic.values())


def see_none(name, t_s):
    return state(name, t_s, visible=False)


@pytest.mark.parametrize("see", [state, see_none], ids=["states without references", "references without sight"])
@pytest.mark.parametrize("begin_s", [0.0, 3.5], ids=["from the begin", "after a segment"])
def test_what_finds_no_partner_does_not_fill_the_memory(see, begin_s):
    """A vehicle that stands still for a day, or that is lost, beside one that flies."""
    recorder = Recorder(PlotParams(max_s=2.0))
    fly(recorder, 0.0, begin_s)
    kept = []
    for k in range(round(100 * begin_s), 6000):
        stamp_s = T0_S + 0.01 * k
        states = [state("Raven", 0.01 * k), see("fluffy_II", 0.01 * k)]
        entries = [reference("Raven", 0.01 * k)] + ([reference("fluffy_II", 0.01 * k)] if see is see_none else [])
        recorder.add(STATES, stamp_s + 0.001, Cortex(Obj=states), stamp_s)
        recorder.add(REFERENCES, stamp_s + 0.002, Trajectories(Obj=entries), stamp_s)
        if k % 100 == 0:
            recorder.ended()
            kept.append(rows_kept(recorder))
    assert max(kept) < 1500
    fly(recorder, 60.0, 62.0)
    recorder.finish()
    found = [
        (round(s.start_s - T0_S), round(2.0 * s.duration_s) / 2.0)
        for s in recorder.segments()
        if s.vehicle == "fluffy_II"
    ]
    assert found == ([(0, 2), (2, 1.5)] if begin_s else []) + [(60, 2)]


def test_references_of_a_laboratory_without_motion_capture_do_not_fill_the_memory():
    recorder = Recorder(PlotParams())
    for k in range(3000):
        recorder.add(REFERENCES, T0_S + 0.01 * k, Trajectories(Obj=[reference("fluffy_II", 0.01 * k)]), T0_S + 0.01 * k)
        if k % 100 == 0:
            recorder.ended()
    assert rows_kept(recorder) <= 100
    fly(recorder, 30.0, 32.0)
    recorder.finish()
    assert [round(s.duration_s) for s in recorder.segments()] == [2]


def test_parameters_that_make_no_sense_are_refused():
    for key, wrong in (("rate_hz", 0.0), ("min_s", 0.5), ("min_s", 700.0), ("euler_angle_max", 20.0)):
        with pytest.raises(ValueError, match="'%s'" % key):
            PlotParams(**{key: wrong})


# ------------------------------------------------------------------------------------------------------------- pages


@pytest.fixture(scope="module")
def segment():
    recorder = Recorder(PlotParams())
    recorder.add(PHASES, T0_S, told("", TrajectoryPhase.COURSE))
    fly(recorder, 0.0, 3.0)
    fly(recorder, 4.0, 6.0)
    recorder.finish()
    (found,) = recorder.segments()
    return found


def drawn(axes):
    """{label: (n, 2 or 3) points} of the lines with a label of their own."""
    return {
        line.get_label(): np.column_stack(line.get_data_3d() if axes.name == "3d" else line.get_data())
        for line in axes.get_lines()
        if not line.get_label().startswith("_")
    }


def test_the_page_shows_what_is_in_the_table(segment):
    figure = course_page(segment)
    space, roll, pitch, position, velocity = figure.axes
    assert [axes.get_ylabel().split()[0] for axes in figure.axes] == ["y", "roll", "pitch", "position", "velocity"]
    assert (space.get_xlim(), space.get_ylim(), space.get_zlim()) == ((-2.0, 2.0), (-2.0, 2.0), (0.0, 2.0))
    whole = ~np.isnan(drawn(space)["actual"]).any(axis=1)
    assert (~whole).sum() == 1, "the path is broken where the vehicle was not seen for a second"
    assert drawn(space)["actual"][whole] == pytest.approx(segment.columns(POSITION))
    assert drawn(space)["desired"][whole] == pytest.approx(segment.columns(DESIRED_POSITION))
    t_s = column(segment, "time_s") - segment.start_s
    for axes, name in ((roll, "phi"), (pitch, "theta")):
        for label, suffix in (("actual", "_deg"), ("desired", "_desired_deg")):
            wanted = np.column_stack((t_s, column(segment, name + suffix)))
            assert drawn(axes)[label][whole] == pytest.approx(wanted), (name, label)
    for axes, names, errors in (
        (position, "xyz", segment.position_error_m),
        (velocity, "uvw", segment.columns(["u_error_m_s", "v_error_m_s", "w_error_m_s"])),
    ):
        lines = drawn(axes)
        assert list(lines) == list(names)
        assert np.column_stack([line[whole][:, 1] for line in lines.values()]) == pytest.approx(errors)
    assert "fluffy_II: course" in figure.get_suptitle() and "RMSE 54 mm" in figure.get_suptitle()


def test_limits_give_way_to_a_flight_that_leaves_them():
    assert course_limits_m(np.zeros((2, 3))).tolist() == [[-2.0, 2.0], [-2.0, 2.0], [0.0, 2.0]]
    wide = course_limits_m(np.array([[-3.0, 0.0, 0.5], [1.0, 2.5, 2.4]]))
    assert np.ravel(wide) == pytest.approx([-3.1, 2.0, -2.0, 2.6, 0.0, 2.5])


def test_files_are_written_once_and_again_when_a_segment_has_grown(tmp_path):
    recorder = Recorder(PlotParams())
    fly(recorder, 0.0, 3.0)
    writer = PageWriter(tmp_path)
    files = writer.write(recorder.segments())
    assert sorted(path.suffix for path in files) == [".csv", ".pdf", ".png"]
    assert files[1].read_bytes()[:4] in (b"\x89PNG", b"%PDF") and all(f.stat().st_size > 5000 for f in files)
    assert writer.write(recorder.segments()) == []
    fly(recorder, 3.0, 5.0)
    assert writer.write(recorder.segments()) == files, "the same names: it is the same segment"
    with files[0].open() as stream:
        table = list(csv.DictReader(stream))
    assert tuple(table[0]) == COLUMNS
    for row in table[::50]:
        assert float(row["x_desired_m"]) == pytest.approx(path_m(float(row["time_s"]) - T0_S)[0], abs=1e-5)
    assert len(table) == len(recorder.segments()[0].table) > 400


def test_names_of_files_are_plain(segment):
    assert file_stem(SimpleNamespace(vehicle="risc 1", clock=segment.clock, label="Eight/flat")).startswith("risc_1_")
    assert not set(file_stem(segment)) & set(" /:")


# -------------------------------------------------------------------------------------------------------------- bags


def write_bag(path, seconds, phases=(), legacy=False, skip=()):
    """A bag as record.launch makes them; or one of the original: the course in Trajectory.name, nothing stamped."""
    with rosbag.Bag(str(path), "w") as bag:

        def write(topic, message, t_s, stamp_s=None):
            if stamp_s is not None:
                message.header.stamp = rospy.Time.from_sec(stamp_s)
            if topic not in skip:
                bag.write(topic, message, rospy.Time.from_sec(t_s))

        for t_s, phase in phases:
            write("/trajectory_phase", told("flat8", phase), T0_S + t_s)
        for k in range(int(200 * seconds)):
            t_s = 0.005 * k
            now_s = T0_S + t_s
            course = ("Origin" if t_s < 2.0 else "Flat Figure Eight") if legacy else "fluffy_II"
            write("/trajectory", Trajectories(Obj=[reference(course, t_s)]), now_s, None if legacy else now_s)
            write("/cortex_raw", Cortex(Obj=[state("fluffy_II", t_s)]), now_s + 0.002, now_s)
            write("/controls", Controls(Obj=[Control(name="fluffy_II", phi=0.5)]), now_s + 0.003, now_s)
    return path


def test_pages_from_a_bag(tmp_path):
    phases = [(0.0, TrajectoryPhase.APPROACH), (2.0, TrajectoryPhase.COURSE)]
    bag = write_bag(tmp_path / "flight.bag", 6.0, phases)
    segments, files = plot_bag(bag, tmp_path / "out", PlotParams(), load_fleet(FLEET))
    assert [s.label for s in segments] == ["flat8 approach", "flat8"]
    assert len(files) == 6 and {f.parent for f in files} == {tmp_path / "out"}
    assert len(segments[1].table) == pytest.approx(80, abs=3), "20 Hz"
    assert segments[1].position_error_m[:, 0] == pytest.approx(0.05, abs=1e-5)
    assert column(segments[1], "phi_desired_deg") == pytest.approx(-0.5 * 20.0 * 1.1714, abs=1e-3)


def test_pages_from_a_bag_of_the_original(tmp_path):
    bag = write_bag(tmp_path / "old.bag", 6.0, legacy=True)
    segments, files = plot_bag(bag, tmp_path / "out", PlotParams())
    assert [s.label for s in segments] == ["Origin", "Flat Figure Eight"]
    assert {f.suffix for f in files} == {".csv", ".png", ".pdf"}
    assert column(segments[0], "phi_desired_deg")[1:] == pytest.approx(-10.0, abs=1e-3), "none before the first"


def test_a_bag_without_a_flight_is_said(tmp_path):
    bag = write_bag(tmp_path / "a.bag", 1.0, skip=("/trajectory",))
    with pytest.raises(BagError, match=" /trajectory, .*; .* /controls, /cortex_raw$"):
        plot_bag(bag, tmp_path / "out", PlotParams())
    bag = write_bag(tmp_path / "b.bag", 1.5)
    with pytest.raises(BagError, match=" Raven; .* fluffy_II"):
        plot_bag(bag, tmp_path / "out", PlotParams(vehicles=("Raven",)))
    with pytest.raises(BagError, match=" 3 s"):
        plot_bag(bag, tmp_path / "out", PlotParams(min_s=3.0))
    assert not (tmp_path / "out").exists()


def test_the_program_needs_neither_master_nor_screen(tmp_path):
    write_bag(tmp_path / "flight.bag", 3.0)
    done = run_program(NODE, tmp_path, "flight.bag", "--vehicle", "fluffy_II")
    assert done.returncode == 0, done.stderr
    assert "3 files in flight_plots" in done.stdout and " 53.9 mm" in done.stdout
    assert len(list((tmp_path / "flight_plots").iterdir())) == 3


def test_the_program_says_what_is_wrong_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for arguments, text in ((["none.bag"], "no such file"), (["none.bag", "--type", "boat"], "boat")):
        monkeypatch.setattr(sys, "argv", [str(NODE), *arguments])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(NODE), run_name="__main__")
        out, error = capsys.readouterr()
        assert ended.value.code == 1 and out == ""
        assert error.startswith("DF_Plots.py: ") and error.count("\n") == 1 and text in error
