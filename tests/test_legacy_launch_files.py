"""launch/legacy: the launch files of the original release under their names: what they start, with which numbers; that
each of them starts, and ends without a trace; that docs/legacy_launch_files.md is true."""

import importlib.util
import math
import pathlib
import re
import shlex
import time
from dataclasses import replace

import flying
import numpy as np
import pytest
import rosbag
import roslaunch
import rospy
import yaml
from launch_parameters import Loader, unroll

from risc_doctor import ros_master
from risc_experiments.report import LATE_LIMIT_MS
from risc_lab.lab import Start, load_fleet
from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port, marked_processes
from risc_maap_msgs.msg import TrajectoryPhases, VehiclePhase
from risc_visual.pictures import rviz_pictures

ROOT = pathlib.Path(__file__).resolve().parents[1]
FOLDER = ROOT / "launch/legacy"
PAGE = ROOT / "docs/legacy_launch_files.md"
STARTED_S = 300.0  # until a graph is complete, on a busy computer
FLOWN_S = 150.0  # until a flight has ended, on a busy computer
SOME = ("test_DF",)  # an IRIS+
FLOWN = "Hows_sim"  # from take-off to landing; the others are only started
STILL_S = 0.7  # a graph that has not changed for this time is complete

# ----------------------------------------------------------------------------------- what the original's files say

DRIVER = {"outdoor": 0, "flight_without_shell": 0, "altitude_max": 3000, "altitude_min": 50,
          "euler_angle_max": 0.349066, "control_vz_max": 1000, "control_yaw": 0.349066, "detect_type": 10,
          "detections_select_h": 32, "detections_select_v_hsync": 128, "enemy_colors": 3,
          "enemy_without_shell": 0}  # fmt: skip
JOYSTICK = {"JoytoWay": 0, "ButtonEmergency": 2, "TakeoffLand": 6, "Up": 9, "Down": 10, "ShutDownNode": 7,
            "AxisRoll": 6, "AxisPitch": 7, "AxisYaw": 3, "ScaleRoll": 3, "ScalePitch": 3, "ScaleYaw": 1, "ScaleZ": 1,
            "Simulation": False, "delay": -1}  # fmt: skip  # the type's 0.3 s
FULL_SCALE = dict(JOYSTICK, ScaleRoll=1, ScalePitch=1)
COARSE = dict(JOYSTICK, AxisRoll=0, AxisPitch=1, AxisYaw=3, ScaleRoll=10, ScalePitch=10)
OF_2014 = dict(COARSE, JoytoWay=1, ButtonEmergency=0, TakeoffLand=8, Up=10, Down=11, ShutDownNode=9, AxisYaw=2)

MOCAP = {"/stream_markers": "cortex_ros/stream_markers", "/states_estimation": "risc_estimation/states_estimation.py"}
DRAWING = {"/" + name: "risc_visual/" + name for name in ("draw_risc_maap", "draw_cortex", "draw_trajectories")}
DRAWING["/draw_angle_data"] = "risc_visual/draw_angles"
RVIZ = {"/rviz": "risc_visual/open_rviz"}
VIZ = {**DRAWING, **RVIZ, "/transforms": "risc_control/transforms"}
LAB = {"/virtual_lab": "risc_simulator/virtual_lab_node.py"}
EKF = {"/EKF": "risc_estimation/quad_EKF.py"}
LQR = {"/controller": "risc_control/LQR_DF_controller.py"}


def driver(vehicle="risc1", **params):
    """({node: program}, {parameter: value}) of the driver."""
    node = "/%s/ardrone_driver" % vehicle
    values = dict(DRIVER, **params)
    return {node: "ardrone_autonomy/ardrone_driver"}, {"%s/%s" % (node, key): values[key] for key in values}


def flight(joystick=JOYSTICK, vehicle="risc1", node="risc_controller.py", mocap=True, **params):
    """As `driver`, for everything that one vehicle needs; params: of its driver."""
    nodes, values = driver(vehicle, **params)
    nodes["/%s/joy_node" % vehicle] = "joy/joy_node"
    nodes["/%s/joystick_controller" % vehicle] = "risc_control/" + node
    values["/%s/joy_node/dev" % vehicle] = "/dev/input/js0"
    values.update(("/%s/joystick_controller/%s" % (vehicle, key), value) for key, value in joystick.items())
    values["/%s/joystick_controller/euler_angle_max" % vehicle] = values["/%s/ardrone_driver/euler_angle_max" % vehicle]
    if mocap:
        nodes.update(MOCAP)
    return nodes, values


def iris_flight():
    """As `flight`, for an IRIS+, which is driven by two nodes."""
    nodes = {
        "/iris1/apm/roscopter": "roscopter/driver.py",
        "/iris1/arduino": "rosserial_python/serial_node.py",
        "/iris1/joy_node": "joy/joy_node",
        "/iris1/joystick_controller": "risc_control/risc_controller.py",
    }
    values = {"/iris1/joystick_controller/" + key: value for key, value in JOYSTICK.items()}
    full_scales = dict.fromkeys(("euler_angle_max", "control_yaw"), -1)  # the type's
    values |= {"/iris1/joystick_controller/" + key: value for key, value in full_scales.items()}
    values |= {"/iris1/arduino/port": "socket://127.77.1.1:11411", "/iris1/arduino/baud": 57600}
    return {**nodes, **MOCAP}, values


def on_one_computer(*vehicles):
    """As `flight`, for several vehicles with one driver and one joystick node for all."""
    both = {}, {}
    for vehicle in vehicles:
        for found, part in zip(both, flight(vehicle=vehicle)):
            for name, value in part.items():
                found[re.sub("^/%s/(ardrone_driver|joystick_controller)" % vehicle, r"/\1", name)] = value
    both[1].pop("/joystick_controller/euler_angle_max")
    return both


def image_proc(vehicle="risc1"):
    return {"/%s/ardrone/image_proc" % vehicle: "image_proc/image_proc"}


def trajectory(program):
    return {"/trajectory": "risc_control/" + program}


def file(base, *nodes, **params):
    """Nodes and parameters of a file; params: of /trajectory and /controller, as trajectory__radius_m=0.7."""
    all_nodes, values = dict(base[0]), dict(base[1])
    for more in nodes:
        all_nodes.update(more)
    values.update(("/" + key.replace("__", "/"), value) for key, value in params.items())
    return all_nodes, values


NOTHING = ({}, {})
WAYPOINTS = trajectory("generic_trajectory.py")
CIRCLE = {"trajectory__course": "circle", "trajectory__radius_m": 0.8, "trajectory__period_s": 10.0}
TARGET = {"controller__range_m": 0.48, "controller__speed_gain_1_s": 0.9}
HOWS = [trajectory("virtual_target.py"), {"/controller": "risc_control/Hows_controller.py"}]
EXPERIMENT = {"/controller": "risc_control/DF_experiment_joy.py"}
FINDER = {"/quad_finder": "risc_visual/quad_tracker"}
CONTROLLER = file(flight(), WAYPOINTS, LQR, trajectory__course="quadrants")
OLD_CONTROLLER = file(flight(OF_2014), WAYPOINTS, LQR, trajectory__course="quadrants")

FILES = {
    "Coop_experiment1": file(
        flight(vehicle="albatross", node="albatross_controller.py"),
        trajectory("coop_traj1.py"),
        {"/controller": "risc_control/generic_DF_controller.py", "/transform_tuner": "risc_control/transforms",
         "/angle_estimation": "risc_estimation/angle_estimation.py", "/rois": "risc_visual/risc_landmarks",
         "/draw_angles": "risc_visual/draw_angles"},  # fmt: skip
        {name: program for name, program in DRAWING.items() if name != "/draw_angle_data"},
        RVIZ, image_proc("albatross"),
        trajectory__turn_s=30.0,
    ),
    "DF_demo": file(flight(), EXPERIMENT, VIZ),
    "DiffFlatness_control": file(flight(COARSE), WAYPOINTS, LQR, **CIRCLE),
    "coop_test1": file(flight(COARSE), trajectory("coop_traj1.py"), LQR, trajectory__turn_s=30.0),
    "Hows_launch": file(flight(), *HOWS, **TARGET),
    "2comp_coop_loc": file(
        flight(vehicle="quad1", node="quad1_controller.py", control_yaw=3.490659),
        WAYPOINTS, LQR, image_proc("quad1"), {"/transforms": "risc_control/transforms"},
        trajectory__vehicles="quad1 quad2", controller__control_yaw=3.490659, **CIRCLE,
    ),
    "step_input_controller": file(flight(FULL_SCALE, euler_angle_max=0.209440, control_yaw=0.785398)),
    "controller": CONTROLLER,
    "waypoint": CONTROLLER,
    "cortex_way": CONTROLLER,
    "controller_data": file(CONTROLLER, {"/bagger": "data_extraction/recorder"}),
    "old_controller": OLD_CONTROLLER,
    "controller_test": OLD_CONTROLLER,
    "joyway": file(flight(), trajectory("quadrants_traj.py"), LQR),
    "circle_traj": file(
        flight(), trajectory("circle_traj.py"), LQR, trajectory__radius_m=0.7, trajectory__period_s=5.0
    ),
    "risc_test": file(flight(), VIZ),
    "live_camera_tune": file(
        flight(), VIZ, image_proc(),
        {"/transforms": "risc_visual/transform_tuner", "/landmark_finder": "risc_visual/risc_landmarks",
         "/angle_estimation": "risc_estimation/angle_estimation.py"},
    ),
    "quad_track_test": file(flight(), image_proc(), FINDER),
    "image_cortex": file(flight(), image_proc(), {"/synthetic_angles": "risc_estimation/synthetic_angles.py"}),
    "camera_test": file(driver(), image_proc()),
    "test": file(driver(), image_proc()),
    "quad_detect_test": file(driver(), image_proc(), FINDER),
    "camera_modifier_test": driver(),
    "test_multi_comp": flight(),
    "quad2_joy": flight(vehicle="quad2", node="quad2_controller.py", mocap=False, control_yaw=3.490659),
    "DF_Demo_sim": file(flight(FULL_SCALE), EXPERIMENT, VIZ, LAB, {"/data_logger": "risc_visual/DF_Plots.py"}),
    "DiffFlatness_control_sim": file(
        flight(COARSE, euler_angle_max=0.139626), WAYPOINTS, LQR, LAB, controller__euler_angle_max=0.139626, **CIRCLE
    ),
    "Hows_sim": file(flight(), *HOWS, LAB, **TARGET),
    "risc_viz": file(NOTHING, VIZ),
    "bag_visual": file(NOTHING, DRAWING, RVIZ, {"/player": "rosbag/play"}),
    "IRIS_circle_DF": file(
        iris_flight(), trajectory("circle_traj.py"), {"/controller": "risc_control/IRIS_DF_Controller.py"}, VIZ,
        trajectory__radius_m=0.7, trajectory__period_s=5.0,
    ),
    "IRIS_DF": file(
        iris_flight(), {"/controller": "risc_control/IRIS_origin_hold.py"}, VIZ, controller__height_m=0.5
    ),
    "test_DF": file(iris_flight(), {"/controller": "risc_control/IRIS_origin_hold.py"}, EKF, VIZ),
    "test_tuner_DF": file(iris_flight(), {"/controller": "risc_control/IRIS_origin_hold_tuner.py"}, EKF, VIZ),
    "demonstration": file(
        on_one_computer("risc1", "risc2", "risc3"),
        VIZ, {"/trajectory_node": "risc_control/circles3_traj.py",
              "/controller": "risc_control/generic_DF_controller.py"},
        risc2__joy_node__dev="/dev/input/js1", risc3__joy_node__dev="/dev/input/js2",
    ),
}  # fmt: skip

# Files in other folders, and the arguments that start them here: IP is the virtual vehicle's address.
ELSEWHERE = {
    "Multi_Machine_Experiment": None,  # has tests of its own
    "risc_camera_setup": ("gui:=false", "ip:=IP", "bag:=FOLDER/front.bag"),
    "risc_camera_setup_bottom": ("gui:=false", "ip:=IP", "bag:=FOLDER/bottom.bag"),
    "risc_camera_transforms": ("fleet:=FLEET", "rviz:=false"),
    "risc_visualize": ("rviz:=false",),
    "dense_dronejoy": ("ip:=IP",),
    "edge_dronejoy": ("ip:=IP",),
    "vert_dronejoy": ("ip:=IP",),
    "edge_uvc": ("device:=PICTURES",),
}
# Files of the original whose absence the page must explain.
ABSENT = {"tum_ardrone", "IP_origin", "DF_pen_sim", "IP_Simulation_verification"}


def load(path, *argv):
    """The configuration of a launch file, which gets a fleet with its vehicles where it wants one."""
    text = path.read_text()
    if 'name="lab"' in text and "lab:=true" not in argv:
        (fleet,) = re.findall(r"dirname\(\) \+ '/(.*?)' if lab", text) or ["../fleets/ardrones3.yaml"]
        fleet = FOLDER / fleet
        argv += ("fleet:=%s" % fleet,)
    config = roslaunch.config.ROSLaunchConfig()
    Loader().load(str(path), config, argv=list(argv), verbose=False)
    config.assign_machines()
    unroll(config)
    return config


# ------------------------------------------------------------------------------------------------------ what they say


@pytest.mark.parametrize("name", sorted(FILES))
def test_it_starts_the_originals_nodes_with_the_originals_numbers(name):
    path = FOLDER / (name + ".launch")
    text = path.read_text()
    argv = ["bag:=/tmp/x.bag"] if name == "bag_visual" else []
    config = load(path, *argv, *(["operator:=false"] if "operator" in text else []))  # with a joystick, then
    nodes, params = FILES[name]
    found = [node.namespace + node.name for node in config.nodes]
    assert sorted(found) == sorted(nodes), "every name once"
    assert {n.namespace + n.name: n.package + "/" + n.type for n in config.nodes} == nodes
    given = {key: config.params[key].value if key in config.params else "not set" for key in params}
    assert given == params
    addresses = found_in(config, "ardrone_driver", "drone_ip")
    assert len(addresses) == len(set(addresses)), "one computer reaches each of its vehicles by another address"
    for node in config.nodes:
        assert roslaunch.node_args.create_local_process_args(node, roslaunch.core.Machine("local", "localhost"))
        assert roslaunch.core.is_machine_local(node.machine)
        assert node.name == "virtual_lab" or not node.required, "no node that ends ends the others"
    assert "password=" not in text and "/home/" not in text.replace("file:///home/me", "")


def found_in(config, node, key):
    """Values of that parameter of all nodes of that name."""
    return [param.value for name, param in config.params.items() if name.endswith("/%s/%s" % (node, key))]


def test_simulation_is_the_virtual_lab_and_nothing_else():
    """A file that is told lab:=true differs by the lab, and flies the same wire: no other simulator, no joystick."""
    config = load(FOLDER / "Hows_launch.launch", "lab:=true")
    nodes = {node.namespace + node.name: node.package + "/" + node.type for node in config.nodes}
    expected = {**FILES["Hows_launch"][0], **LAB, "/operator": "risc_experiments/virtual_operator.py"}
    del expected["/risc1/joy_node"]
    assert nodes == expected
    assert config.params["/risc1/ardrone_driver/drone_ip"].value == "127.77.1.1"


def test_the_remote_joystick_runs_on_the_computer_that_it_is_told():
    config = load(FOLDER / "test_multi_comp.launch", "second_address:=10.0.0.2", "user:=pilot", "workspace:=/ws")
    (joy,) = (node for node in config.nodes if node.name == "joy_node")
    machine = joy.machine
    assert (machine.address, machine.user, machine.env_loader) == ("10.0.0.2", "pilot", "/ws/devel/coop.sh")
    assert all(roslaunch.core.is_machine_local(node.machine) for node in config.nodes if node is not joy)


@pytest.mark.parametrize("lab", ["true", "false"])
def test_the_second_vehicle_can_fly_from_the_same_computer(lab):
    config = load(FOLDER / "2comp_coop_loc.launch", "second:=true", "lab:=" + lab)
    names = [node.namespace + node.name for node in config.nodes]
    assert sorted(names) == sorted(set(names)) and "/quad2/joystick_controller" in names
    assert len(set(found_in(config, "ardrone_driver", "drone_ip"))) == 2
    if lab == "true":
        assert config.params["/operator/vehicles"].value == "quad1 quad2"


def test_full_scales_reach_every_node_that_reckons_with_them():
    declare = [path for path in sorted(FOLDER.glob("*.launch")) if 'name="control_yaw" default=' in path.read_text()]
    assert len(declare) >= 9
    for path in declare:
        two = path.stem == "2comp_coop_loc"
        config = load(path, "euler_angle_max:=0.2", "control_yaw:=1.5", *(["second:=true"] if two else []))
        flies = any(node.type == "LQR_DF_controller.py" for node in config.nodes)
        vehicles = 2 if two else 1
        for key, value in (("euler_angle_max", 0.2), ("control_yaw", 1.5)):
            found = [found_in(config, node, key) for node in ("ardrone_driver", "joystick_controller")]
            assert found == [[value] * vehicles] * 2, (path.stem, key)
            assert found_in(config, "controller", key) == [value] * flies, (path.stem, key)


@pytest.mark.parametrize(
    ("name", "vehicle"), [("Coop_experiment1", "quad1"), ("2comp_coop_loc", "albatross"), ("quad2_joy", "albatross")]
)
def test_another_vehicle_has_the_joystick_node_without_a_legacy_name(name, vehicle):
    config = load(FOLDER / (name + ".launch"), "vehicle:=" + vehicle)
    (node,) = (node for node in config.nodes if node.name == "joystick_controller")
    assert (node.namespace, node.type) == ("/%s/" % vehicle, "risc_controller.py")


def test_a_bag_that_is_drawn_moves_nothing():
    """bag_visual.launch plays what `./maap screenshot` plays, and no command."""
    vehicles = ("risc1", "quad2")
    config = load(FOLDER / "bag_visual.launch", "bag:=/tmp/a bag.bag", "vehicles:=" + " ".join(vehicles))
    (player,) = (node for node in config.nodes if node.name == "player")
    args = shlex.split(player.args)
    topics = args[args.index("--topics") + 1 : args.index("--bags")]
    of_vehicles = {"/%s/%s" % (vehicle, topic) for vehicle in vehicles for topic in rviz_pictures.OF_VEHICLES}
    assert args[-2:] == ["--bags", "/tmp/a bag.bag"]
    assert set(topics) == {*rviz_pictures.DRAWN, *rviz_pictures.FRAMES, *of_vehicles}
    commands = {"cmd_vel", "takeoff", "land", "reset", "joy", "controls", "target_velocity"}
    assert not commands & {topic.rpartition("/")[2] for topic in topics}


def test_the_operators_joystick_has_every_button_that_a_file_names():
    path = ROOT / "src/risc_experiments/nodes/virtual_operator.py"
    spec = importlib.util.spec_from_file_location("virtual_operator", path)
    node = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(node)
    buttons = ("JoytoWay", "ButtonEmergency", "TakeoffLand", "Up", "Down", "ShutDownNode")
    last = max(table[key] for table in (JOYSTICK, OF_2014) for key in buttons)
    assert last < node.BUTTONS


def test_the_operator_knows_the_buttons_that_the_vehicle_node_knows():
    config = load(FOLDER / "controller_test.launch", "lab:=true")
    for key in ("JoytoWay", "TakeoffLand"):
        assert config.params["/operator/" + key].value == OF_2014[key]


# ------------------------------------------------------------------------------------------------------------ the page


def test_the_page_names_every_file_and_no_other():
    rows = [line for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    named = {}
    for row in rows:
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        for name in re.findall("`([^`]+)`", cells[0]):
            assert name not in named, "%s twice" % name
            named[name] = cells[1:]
    assert set(named) == set(FILES) | set(ELSEWHERE) | ABSENT
    assert {path.stem for path in FOLDER.glob("*.launch")} == set(FILES)
    there = list(ROOT.glob("**/*.launch"))
    for name in ABSENT:
        assert named[name][0].startswith("not here") and len(named[name][0]) > 40, "why"
        assert name not in {path.stem for path in there}
    for name in ELSEWHERE:
        (path,) = (p for p in there if p.stem == name and not {"install", "build", "flights"} & set(p.parts))
        assert str(path.parent.relative_to(ROOT)) in named[name][0]


# ------------------------------------------------------------------------------------------------------- they start


class Graph:
    """A launch file that is started, with a master of its own and its own part of the loopback network."""

    def __init__(self, path, folder, fleet, *argv):
        """argv: arguments of the file; FLEET, IP, FOLDER and PICTURES in them are what they stand for."""
        folder.mkdir()
        self._reservation = PortReservation()
        fleet = fleet.in_subnet(self._reservation.subnet)
        (folder / "fleet.yaml").write_text(yaml.safe_dump(fleet.to_dict()))
        port = free_tcp_port()
        stand_for = {"FLEET": folder / "fleet.yaml", "IP": fleet.vehicles[0].address, "FOLDER": folder,
                     "PICTURES": folder.parent}  # fmt: skip
        values = dict(argument.split(":=", 1) for argument in argv)
        for name, value in values.items():
            for word, meaning in stand_for.items():
                value = re.sub(r"\b%s\b" % word, str(meaning), value)
            values[name] = value
        self.launch = Launch(path, values, folder, port)
        self._uri = "http://127.0.0.1:%d" % port

    def wait(self, nodes):
        """Wait until these nodes answer and the graph has settled. Returns what is wrong, "" if nothing."""
        deadline, seen, since = time.monotonic() + STARTED_S, None, 0.0
        while time.monotonic() < deadline:
            problem = self._problem()
            if problem:
                return problem
            now = self._graph(nodes)
            if now is None or now != seen:
                seen, since = now, time.monotonic()
            elif time.monotonic() - since > STILL_S:
                return ""
            time.sleep(0.1)
        return "not complete within %g s; missing: %s\n%s" % (STARTED_S, self._missing(nodes), self.launch.log_tail())

    def wait_for_line(self, text, timeout_s):
        """Wait until the log has the text. Returns what is wrong, "" if nothing."""
        deadline = time.monotonic() + timeout_s
        while text not in self.launch.log_path.read_text(errors="replace"):
            problem = self._problem() or ("no '%s' in %g s" % (text, timeout_s) if time.monotonic() > deadline else "")
            if problem:
                return problem
            time.sleep(0.1)
        return ""

    def end(self):
        """Send Ctrl-C. Returns what is wrong with how it ended, "" if nothing."""
        killed = self.launch.stop()
        self._reservation.close()
        left = marked_processes(self.launch.identity)
        return ("had to be killed: %s" % killed if killed else "") or ("left behind: %s" % left if left else "")

    def _problem(self):
        if not self.launch.running():
            return "roslaunch ended:\n" + self.launch.log_tail()
        log = self.launch.log_path.read_text(errors="replace")
        for sign in ("process has died", "has finished", "Traceback", "FATAL", "unknown parameter", "is it misspelt"):
            if sign in log:
                return "%r in the log:\n%s" % (sign, "\n".join(log.splitlines()[-25:]))
        return ""

    def _missing(self, nodes):
        return [node for node in nodes if not self._answers(node)]

    def _graph(self, nodes):
        """Who publishes, subscribes and serves what; None while a node is missing or does not answer."""
        if not all(self._answers(node) for node in nodes):
            return None
        try:
            return ros_master.call(self._uri, "getSystemState")
        except ros_master.MasterError:
            return None

    def _answers(self, node):
        try:
            ros_master.call(ros_master.call(self._uri, "lookupNode", node), "getPid")
        except ros_master.MasterError:
            return False
        return True


def starts(name, folder):
    """Start a file once. Returns what is wrong, "" if nothing."""
    if name in FILES:
        path = FOLDER / (name + ".launch")
        declared = re.findall('<arg name="([a-z_]+)"', path.read_text())
        given = {"lab": "true", "operator": "false", "rviz": "false", "fleet": "FLEET", "plots_folder": "FOLDER/plots"}
        argv = ["%s:=%s" % item for item in given.items() if item[0] in declared]
        argv += {"bag_visual": ["bag:=%s" % (folder.parent / "long.bag")],
                 "controller_data": ["bag:=FOLDER/data.bag"]}.get(name, [])  # fmt: skip
        nodes = {node for node in FILES[name][0] if node != "/rviz"}
        if name == "demonstration":
            nodes -= set(VIZ)  # without rviz it draws nothing
        if "lab" in declared:
            nodes |= set(LAB)
    else:
        (path,) = (ROOT / "src/risc_visual/launch").glob(name + ".launch")
        argv = list(ELSEWHERE[name])
        config = load(
            path, *(argument.replace("FLEET", str(ROOT / "launch/fleets/ardrones3.yaml")) for argument in argv)
        )
        nodes = {node.namespace + node.name for node in config.nodes}
    # a virtual lab of one vehicle is started sooner
    fleet = load_fleet(ROOT / "launch/fleets/ardrones3.yaml").with_vehicles(3 if name == "demonstration" else 1)
    if not nodes & {"/ardrone_driver", "/risc1/ardrone_driver"}:
        fleet = load_fleet(
            ROOT / "launch/fleets/iris1.yaml" if "/iris1/arduino" in nodes else FOLDER / "fleets/virtual.yaml"
        )
    graph = Graph(path, folder, fleet, *argv)
    try:
        problem = graph.wait(nodes)
    finally:
        ended = graph.end()
    return problem or ended


@pytest.mark.alone
@pytest.mark.parametrize(
    "names", [pytest.param(SOME, id="some"), pytest.param(None, id="all", marks=pytest.mark.release)]
)
def test_files_start_and_end_without_a_trace(tmp_path, names):
    """All nodes of each file live, with the virtual lab where it has one and no joystick plugged in; after Ctrl-C
    nothing is left. FLOWN does so below."""
    phases = TrajectoryPhases(vehicles=[VehiclePhase("fluffy_II", VehiclePhase.COURSE)])
    with rosbag.Bag(str(tmp_path / "long.bag"), "w") as bag:
        for second in (1, 600):  # played for longer than the test looks
            bag.write("/trajectory_phase", phases, rospy.Time(second))
    picture = b"P6 64 48 255\n" + bytes(64 * 48 * 3)
    (tmp_path / "picture.ppm").write_bytes(picture)
    elsewhere = sorted(name for name, argv in ELSEWHERE.items() if argv is not None)
    names = names or sorted(set(FILES) - {FLOWN}) + elsewhere
    answers = {name: starts(name, tmp_path / name) for name in names}  # two at once take longer than one by one
    problems = {name: answer for name, answer in answers.items() if answer}
    assert not problems, "\n\n".join("%s: %s" % item for item in problems.items())


# --------------------------------------------------------------------------------------------------------- one flies


def pursue(folder):
    """FLOWN from take-off to landing: (what is wrong, distance to the target (k,), distance to the origin (k,), errors
    of /range (m,) [m]).

    The distances are true, and those of the pursuit after it has settled.
    """
    fleet = load_fleet(ROOT / "launch/fleets/ardrones3.yaml").with_vehicles(1)
    at_the_waiting_place = replace(fleet.vehicles[0], start=Start((0.5643, 1.2213, 0.0), -90.0))
    fleet = replace(fleet, vehicles=(at_the_waiting_place,))
    bag = folder / "flight.bag"
    graph = Graph(FOLDER / (FLOWN + ".launch"), folder, fleet, "fleet:=FLEET", "duration:=14", "bag:=%s" % bag)
    try:
        problem = graph.wait_for_line("operator: result ok", FLOWN_S)
    finally:
        ended = graph.end()
    if problem or ended:
        return problem or ended, None, None, None
    target, truth, said, let_go_s, home_s = [], [], [], math.inf, math.inf
    with rosbag.Bag(str(bag)) as recorded:
        for topic, message, stamp in recorded.read_messages(
            ["/trajectory", "/ground_truth", "/range", "/trajectory_phase"]
        ):
            if topic == "/trajectory":
                target.append((message.header.stamp.to_sec(), message.Obj[0].x, message.Obj[0].y))
            elif topic == "/ground_truth":
                truth.append((message.header.stamp.to_sec(), message.Obj[0].x, message.Obj[0].y))
            elif topic == "/range":
                said.append((stamp.to_sec(), message.data))
            elif message.course == "NGC":
                let_go_s = min(let_go_s, stamp.to_sec())
                if message.vehicles[0].phase != VehiclePhase.COURSE:
                    home_s = min(home_s, stamp.to_sec())  # the pursuit has ended, and a way home is planned
    target, truth = np.array(target), np.array(truth)
    settled = truth[(truth[:, 0] > let_go_s + 11.0) & (truth[:, 0] < home_s - 0.1)]
    places = np.column_stack([np.interp(settled[:, 0], target[:, 0], target[:, axis]) for axis in (1, 2)])
    range_m, said = np.linalg.norm(places - settled[:, 1:], axis=1), np.array(said).reshape(-1, 2)
    said = said[(said[:, 0] > settled[0, 0]) & (said[:, 0] < settled[-1, 0])] if len(settled) else said[:0]
    errors_m = said[:, 1] - np.interp(said[:, 0], settled[:, 0], range_m) if len(said) else said[:, 1]
    return "", range_m, np.linalg.norm(settled[:, 1:], axis=1), errors_m


@pytest.mark.alone
@pytest.mark.release  # the pursuit itself: test_offline_guidance.py; that such files start: the test above
def test_hows_sim_chases_its_target_and_comes_home(tmp_path):
    """Take-off, wait, button 1, behind the target on its circle, home, landing: by the buttons of a joystick."""
    problem, range_m, radius_m, errors_m = pursue(tmp_path / "flight")
    if not problem and (len(errors_m) < 400 or np.abs(errors_m).max() > 0.04):
        problem = "%d on /range, wrong by %s m" % (len(errors_m), errors_m[::50].round(2))
    if not problem and (len(range_m) < 400 or np.abs([range_m - 0.48, radius_m - 0.8]).max() > 0.08):
        problem = "to the target %s m, to the origin %s m" % (range_m[::50].round(2), radius_m[::50].round(2))
    if not problem:
        return
    idle_ms = flying.lateness_of_the_lab_alone_ms(tmp_path)
    if idle_ms > LATE_LIMIT_MS:
        pytest.skip("this computer is too busy to fly: the lab alone is late by %.1f ms" % idle_ms)
    pytest.fail(problem)


MODES = {  # of experiments of the IRIS+, in the order in which the bumper steps through them
    "IRIS_DF_Demo.py": ["origin", "slanted8", "origin", "flat8", "origin", "circle", "origin", "knot"],
    "IRIS_exp.py": ["origin", "quadrant 1", "quadrant 2", "quadrant 3", "quadrant 4", "quadrant 1"],
}
ALL_FLOWN_S = 400.0


@pytest.mark.alone
@pytest.mark.release
@pytest.mark.parametrize("experiment", MODES)
def test_experiments_of_the_iris_fly_all_their_modes(tmp_path, experiment):
    bag = tmp_path / "flight.bag"
    argv = "lab:=true", "fleet:=FLEET", "rviz:=false", "experiment:=" + experiment, "duration:=9", "bag:=%s" % bag
    graph = Graph(FOLDER / "test_DF.launch", tmp_path / "graph", load_fleet(ROOT / "launch/fleets/iris1.yaml"), *argv)
    try:
        problem = graph.wait_for_line("operator: result ok", ALL_FLOWN_S)
    finally:
        ended = graph.end()
    assert not (problem or ended)
    with rosbag.Bag(str(bag)) as recorded:
        told = [message for _, message, _ in recorded.read_messages(["/trajectory_phase"])]
    flown = [message.course for message in told if message.vehicles[0].phase == VehiclePhase.COURSE]
    assert [name for name, before in zip(flown, [None, *flown]) if name != before] == MODES[experiment]
