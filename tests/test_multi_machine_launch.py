"""launch/Multi_Machine_Experiment.launch against the thesis' Appendix C."""

import pathlib
import shlex

import pytest
import roslaunch
import yaml
from launch_parameters import Loader, unroll

from ardrone_autonomy.ros.params import parse_params

ROOT = pathlib.Path(__file__).resolve().parents[1]
FILE = ROOT / "launch/Multi_Machine_Experiment.launch"
ADDRESSES = {"risc1": "129.123.5.240", "risc2": "129.123.5.200", "risc3": "129.123.5.59", "risc4": "129.123.85.143"}
BASE_STATION = {
    "/stream_markers": "cortex_ros/stream_markers",
    "/states_estimation": "risc_estimation/states_estimation.py",
    "/trajectory": "risc_control/circles3_traj.py",
    "/controller": "risc_control/generic_DF_controller.py",
    "/landmarks": "risc_visual/risc_landmarks",
    "/angles": "risc_estimation/angle_estimation.py",
    "/draw_angles": "risc_visual/draw_angles",
    "/transform_tuner": "risc_control/transforms",
    "/draw_risc_maap": "risc_visual/draw_risc_maap",
    "/draw_cortex": "risc_visual/draw_cortex",
    "/rviz": "risc_visual/open_rviz",  # rviz, at a low priority
    "/bagger": "data_extraction/recorder",
}
OURS = {"/draw_trajectories", "/risc1/ardrone/compress_images", "/risc2/ardrone/compress_images",
        "/risc3/ardrone/compress_images"}  # fmt: skip
PARAMETERS = {
    "ardrone_driver": {"euler_angle_max": 0.349066, "control_vz_max": 1000, "control_yaw": 0.349066},  # not of its YAML
    "joy_node": {"dev": "/dev/input/js0"},
    "joystick_controller": {"JoytoWay": 0, "ButtonEmergency": 2, "TakeoffLand": 6, "Up": 9, "Down": 10,
                            "ShutDownNode": 7, "AxisRoll": 6, "AxisPitch": 7, "AxisYaw": 3, "ScaleRoll": 3,
                            "ScalePitch": 3, "ScaleYaw": 1, "ScaleZ": 1, "Simulation": False,
                            "delay": -1},
}  # fmt: skip


FLEET = ROOT / "launch/fleets/ardrones3.yaml"  # any with these vehicles


def read(*argv):
    config = roslaunch.config.ROSLaunchConfig()
    Loader().load(str(FILE), config, argv=list(argv), verbose=False)
    config.assign_machines()
    unroll(config)
    return config


def load(**arguments):
    """The file as for the thesis' laboratory, but for these arguments."""
    named = {"%s_address" % name: address for name, address in ADDRESSES.items()}
    return read(*("%s:=%s" % item for item in {**named, "fleet": FLEET, **arguments}.items()))


def load_local(*argv):
    """The file for one computer."""
    return read("machine:=local", *argv)


def nodes_of(config):
    return {node.namespace + node.name: node for node in config.nodes}


@pytest.fixture(scope="module")
def appendix():
    """The file with the one argument that gives the appendix' own node under the tuner's name."""
    return load(tuner="false")


def test_every_node_of_the_appendix_is_there_on_its_machine(appendix):
    found = {name: (n.package + "/" + n.type, n.machine.name) for name, n in nodes_of(appendix).items()}
    wanted = {name: (program, "risc1") for name, program in BASE_STATION.items()}
    for vehicle, machine in (("risc1", "risc2"), ("risc2", "risc3"), ("risc3", "risc4")):
        wanted["/%s/ardrone_driver" % vehicle] = ("ardrone_autonomy/ardrone_driver", machine)
        wanted["/%s/joy_node" % vehicle] = ("joy/joy_node", machine)
        wanted["/%s/joystick_controller" % vehicle] = ("risc_control/%s_controller.py" % vehicle, machine)
        wanted["/%s/ardrone/image_proc" % vehicle] = ("image_proc/image_proc", machine)
    assert {name: found.get(name) for name in wanted} == wanted
    assert set(found) - set(wanted) == OURS


@pytest.mark.parametrize("vehicle", ["risc1", "risc2", "risc3"])
def test_every_parameter_of_the_appendix_has_its_value(appendix, vehicle):
    for node, values in PARAMETERS.items():
        for key, value in values.items():
            assert appendix.params["/%s/%s/%s" % (vehicle, node, key)].value == value, (node, key)
    assert appendix.params["/controller_status"].value is False  # one for all, though each joystick node had it
    url = appendix.params["/%s/ardrone_driver/camera_info_url" % vehicle].value
    assert url.startswith("file://") and pathlib.Path(url[len("file://") :]).exists()
    assert pathlib.Path(url).name == vehicle + ".yaml"


@pytest.mark.parametrize("vehicle", ["risc1", "risc2", "risc3"])
def test_every_key_of_the_drivers_yaml_is_written_to_the_vehicle(appendix, vehicle):
    said = yaml.safe_load((ROOT / "launch/drivers/ardrone.yaml").read_text(encoding="utf-8"))
    parts = [(*name.rpartition("/"), param.value) for name, param in appendix.params.items()]
    given = {key: value for node, _, key, value in parts if node == "/%s/ardrone_driver" % vehicle}
    assert said.items() <= given.items()
    configuration = parse_params(given)
    assert said.keys() <= configuration.texts.keys() and configuration.warnings == []


def test_machines_have_the_appendix_addresses_and_no_passwords(appendix):
    machines = {name: machine for name, machine in appendix.machines.items() if name}
    assert {name: machine.address for name, machine in machines.items()} == ADDRESSES
    for machine in machines.values():
        assert machine.password is None and machine.user is None
        assert pathlib.Path(machine.env_loader).resolve() == ROOT / "devel/coop.sh"
    assert "password=" not in FILE.read_text()


def test_addresses_logins_and_workspaces_are_arguments():
    config = load(risc3_address="10.0.0.3", user="pilot", workspace="/home/pilot/ws")
    machine = config.machines["risc3"]
    assert (machine.address, machine.user, machine.env_loader) == ("10.0.0.3", "pilot", "/home/pilot/ws/devel/coop.sh")
    assert config.machines["risc1"].user is None, "the login of the laptops is not that of the base station"


def test_a_base_station_with_another_login_does_not_go_to_itself_by_ssh():
    config = load(risc1_address="127.0.0.1", user="nobody_here")
    assert roslaunch.core.is_machine_local(config.machines["risc1"])


def test_on_one_computer_every_node_runs_there_with_a_joystick_of_its_own():
    config = load_local("user:=somebody", "fleet:=%s" % FLEET)
    assert all(roslaunch.core.is_machine_local(node.machine) for node in config.nodes)
    devices = [config.params["/risc%d/joy_node/dev" % k].value for k in (1, 2, 3)]
    assert devices == ["/dev/input/js0", "/dev/input/js1", "/dev/input/js2"]
    assert not any(name.endswith("joy_node") for name in nodes_of(load_local("lab:=true")))


def test_one_computer_reaches_each_vehicle_by_another_address():
    config = load_local("lab:=true")
    addresses = [config.params["/risc%d/ardrone_driver/drone_ip" % k].value for k in (1, 2, 3)]
    assert len(set(addresses)) == 3 and all(address.startswith("127.77.1.") for address in addresses), addresses


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"machine": "locl"}, "machine:=locl .* machine:=local or machine:=remote"),
        ({"lab": "true"}, "lab:=true without machine:=local"),
        ({"lab": "true", "fleet": ""}, "lab:=true .* machine:=local, or fleet:=FILE"),
        ({"fleet": ""}, "fleet:=FILE"),
        ({"fleet": "", "machine": "local"}, "fleet:=FILE"),
        ({"risc2_address": "", "risc4_address": ""}, "risc2_address:=ADDRESS risc4_address:=ADDRESS"),
    ],
)
def test_what_cannot_fly_is_refused_with_the_reason(arguments, reason):
    with pytest.raises(roslaunch.xmlloader.XmlParseException, match=reason):
        load(**arguments)


def test_laptops_may_reach_a_virtual_lab_at_other_addresses():
    assert "/virtual_lab" in nodes_of(load(lab="true", fleet=ROOT / "launch/fleets/ardrones5.yaml"))


def test_no_node_that_ends_ends_the_others():
    """One vehicle's node must not take the other vehicles down with it; the virtual lab is all of them."""
    simulated = nodes_of(load_local("lab:=true"))
    assert {name for name, node in simulated.items() if node.required} == {"/virtual_lab"}
    assert not any(node.required for node in load().nodes)


def test_the_topics_of_all_three_vehicles_are_recorded(appendix):
    arguments = nodes_of(appendix)["/bagger"].args
    assert "/.*/(cmd_vel" in arguments and "image_rect_color/compressed" in arguments
    for topic in ("cortex_raw", "states3", "controls", "angles", "trajectory", "tf", "rosout"):
        assert topic in arguments
    prefix = shlex.split(arguments)[1]
    assert pathlib.Path(prefix).resolve() == ROOT / "flights" / "coop_loc_data", "a folder that outlives the computer"
