"""docker/: the images' steps run here, the files are checked. The images themselves: tests/docker_steps.sh."""

import contextlib
import ipaddress
import json
import os
import pathlib
import re
import shlex
import subprocess
import sys

import compose_spec
import pytest
import yaml

from risc_doctor.machines import keep_alive
from risc_lab.lab import load_fleet

ROOT = pathlib.Path(__file__).resolve().parents[1]
DOCKER = ROOT / "docker"
BIN = pathlib.Path(sys.executable).parent
COMPOSE = "compose.yaml", "compose.x11.yaml", "compose.priority.yaml"
SCRIPTS = sorted(DOCKER.glob("*/*.sh")) + [ROOT / "tests/docker_steps.sh"]
LISTS = sorted(ROOT.glob("apt-packages*.txt"))


def entries(path):
    """The entries of a list: one a line, '#' starts a comment."""
    return [line for line in (line.split("#")[0].strip() for line in path.read_text().splitlines()) if line]


def instructions():
    """The Dockerfile as (stage, instruction, words)."""
    text = re.sub(r"^#.*\n", "", (DOCKER / "Dockerfile").read_text(), flags=re.M).replace("\\\n", " ")
    stage = None
    for line in filter(None, map(str.strip, text.splitlines())):
        instruction, rest = line.split(None, 1)
        words = rest.split()
        if instruction == "FROM":
            stage = words[-1]
        yield stage, instruction, words


@pytest.fixture(scope="module")
def compose():
    return yaml.safe_load((DOCKER / "compose.yaml").read_text())


# ---------------------------------------------------------------- files


def test_dockerfile_is_clean():
    done = subprocess.run([str(BIN / "hadolint"), str(DOCKER / "Dockerfile")], stdout=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stdout


def test_scripts_are_clean_and_executable():
    assert len(SCRIPTS) > 5
    done = subprocess.run(["shellcheck", *map(str, SCRIPTS)], stdout=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stdout
    assert [str(path) for path in SCRIPTS if not os.access(str(path), os.X_OK)] == []


@pytest.mark.parametrize("name", COMPOSE)
def test_compose_file_is_valid(name):
    """Types, keys and networks by the specification; a key that it does not know is an error."""
    file = compose_spec.PyOptions(apply_merge=True).from_yaml((DOCKER / name).read_text())
    file.validate()
    assert file.services


def test_services_and_volumes_that_are_named_exist(compose):
    """The library of the specification does not look at them."""
    services = compose["services"].values()
    awaited = {name for service in services for name in service.get("depends_on", ())}
    assert awaited and awaited <= set(compose["services"])
    assert {volume.split(":")[0] for service in services for volume in service.get("volumes", ())} == set(
        compose["volumes"]
    )


def test_what_a_laptop_runs_instead_of_an_ssh_server_has_a_health_of_its_own(compose):
    """The image's own health check asks for port 22."""
    others = [s for s in compose["services"].values() if s["image"] == "risc_maap:laptop" and "command" in s]
    assert others and all("healthcheck" in service for service in others)
    browser = compose["services"]["browser"]
    ((door,),) = [browser["ports"]]
    assert browser["healthcheck"]["test"] == ["CMD", "docker/run/listens.sh", door.split(":")[-1]]


def test_overrides_change_services_that_exist(compose):
    for name in COMPOSE[1:]:
        assert set(yaml.safe_load((DOCKER / name).read_text())["services"]) <= set(compose["services"])


def test_what_is_copied_is_there_and_is_sent_to_the_engine():
    ignored = entries(ROOT / ".dockerignore")
    stages, copied = set(), []
    for stage, instruction, words in instructions():
        stages.add(stage)
        options = [word for word in words if word.startswith("--")]
        if instruction == "COPY" and any(word.startswith("--from=") for word in options):
            assert {word.split("=")[1] for word in options if word.startswith("--from=")} <= stages
        elif instruction == "COPY":
            copied += [word for word in words if not word.startswith("--")][:-1]
    assert len(copied) > 8
    for pattern in copied:
        assert pattern == "." or list(ROOT.glob(pattern)), pattern
        assert pattern.split("/")[0] not in ignored
    assert {".git/config", ".git/hooks", ".git/logs"} <= set(ignored)  # they may hold the token of a clone's address
    made_by_maap = {line.strip("/\n") for line in (ROOT / ".gitignore").open() if line.startswith("/")}
    assert made_by_maap <= set(ignored)  # none of it is sent: .venv alone would be a gigabyte


def test_packages_are_those_of_setup_and_named_nowhere_else():
    maap = (ROOT / "maap").read_text()
    assert LISTS and all('"$root/%s"' % path.name in maap for path in LISTS)
    read = {word for _, instruction, words in instructions() if instruction == "RUN" for word in words}
    assert {"/steps/" + path.name for path in LISTS} <= read
    known = set(entries(ROOT / "apt-packages.txt"))
    assert not known & set(entries(DOCKER / "packages.txt"))
    assert set(entries(DOCKER / "not-on-a-laptop/debian.txt")) < set(entries(ROOT / "apt-packages.txt"))
    libraries = {entry.split("==")[0] for entry in entries(ROOT / "requirements.txt")}
    assert set(entries(DOCKER / "not-on-a-laptop/python.txt")) < libraries
    for path in [DOCKER / "Dockerfile", *SCRIPTS[:-1]]:
        lines = [line for line in path.read_text().splitlines() if re.search(r"apt-get install|pip3? install", line)]
        assert path.name == "packages.sh" or not lines, path


def test_images_end_as_a_user_who_is_not_root_and_have_a_base_of_their_own_age():
    users, bases = {}, {}
    for stage, instruction, words in instructions():
        if instruction == "FROM":
            bases[stage] = words[0]
            users[stage] = users.get(words[0], "root")
        elif instruction == "USER":
            users[stage] = words[0]
    assert {users[stage] for stage in ("base", "build", "development", "trimmed", "laptop")} == {"risc"}
    assert set(bases.values()) == {"${DEBIAN}", "base", "build"}
    assert ("ARG", ["DEBIAN=debian:bookworm-slim"]) in [(name, words) for _, name, words in instructions()]


def test_no_secret_no_latest_nothing_privileged(compose):
    for path in [*DOCKER.rglob("*"), ROOT / "tests/docker_steps.sh"]:
        if path.is_file():
            text = path.read_text()
            assert not re.search(r"PRIVATE KEY|:latest|chpasswd|NOPASSWD|--privileged", text), path
            assert not re.search(r"(?i)(password|secret|token)['\"]?\s*[:=]", text), path
    for name, service in compose["services"].items():
        assert not {"privileged", "cap_add", "pid", "ipc"} & set(service), name
        assert service["cap_drop"] == ["ALL"] and service["security_opt"] == ["no-new-privileges:true"]
        assert service["image"] in ("risc_maap:development", "risc_maap:laptop")
        for port in service.get("ports", ()):
            assert port.startswith("127.0.0.1:"), "only this computer may press the land buttons"


def test_who_has_a_way_out_shares_nothing_with_the_machines(compose):
    """An intruder by the one network that is not internal finds no key but that of the browser view."""
    services = compose["services"]
    mounted = {name: {volume.split(":")[0] for volume in s.get("volumes", ())} for name, s in services.items()}
    assert [name for name in services if mounted[name] & mounted["browser"]] == ["browser_keys", "browser"]
    let_in = [name for name in services if mounted[name] & mounted["browser_keys"]]
    assert let_in == ["browser_keys", "risc1", "browser"]
    assert "risc1_authorized_keys:/home/risc/.authorized:ro" in services["risc1"]["volumes"]
    own_address = services["browser"]["networks"]["outside"]["ipv4_address"]
    base_station = services["risc1"]["networks"]["lab"]["ipv4_address"]
    assert services["browser"]["command"] == ["docker/run/browser.sh", base_station, own_address]


def test_the_base_station_is_told_the_addresses_that_the_machines_have(compose):
    environment = compose["services"]["risc1"]["environment"]
    told = dict(word.split(":=") for word in environment["ADDRESSES"].split())
    for machine in ("risc1", "risc2", "risc3", "risc4"):
        service = compose["services"][machine]
        assert service["networks"]["lab"]["ipv4_address"] == told.pop(machine + "_address")
        assert service["hostname"] == machine
    assert not told
    base_station = compose["services"]["risc1"]["networks"]["lab"]["ipv4_address"]
    assert environment["ROS_MASTER_URI"] == "http://%s:11311" % base_station


def test_networks_have_no_way_out_and_no_address_twice(compose):
    taken = set()
    for name, network in compose["networks"].items():
        assert network.get("internal", False) is (name != "outside")
        ((config,),) = [network["ipam"]["config"]]
        subnet, gateway = ipaddress.ip_network(config["subnet"]), ipaddress.ip_address(config["gateway"])
        assert gateway in subnet
        taken.add(gateway)
        for service in compose["services"].values():
            if name in service.get("networks", {}):
                address = ipaddress.ip_address(service["networks"][name]["ipv4_address"])
                assert address in subnet and address not in taken
                taken.add(address)
    assert [name for name, s in compose["services"].items() if "outside" in s.get("networks", {})] == ["browser"]


def test_every_laptop_reaches_the_vehicle_it_flies(compose):
    """The fleet file says where vehicles are; the virtual lab and the laptop of each must be in that network."""
    services = compose["services"]
    fleet = load_fleet(str(DOCKER / "fleet.yaml"))
    assert not fleet.own_networks
    assert fleet.mocap.host == services["lab"]["networks"]["lab"]["ipv4_address"]
    assert not fleet.mocap.interface, "all machines read this file: to each the card that leads to the host"
    lowest = services["risc1"]["sysctls"]["net.ipv4.ip_unprivileged_port_start"]
    assert lowest <= fleet.mocap.stream_port
    wifis = {service["ipv4_address"]: name for name, service in services["lab"]["networks"].items()}
    for vehicle, laptop in zip(fleet.vehicles, ("risc2", "risc3", "risc4")):
        assert set(services[laptop]["networks"]) == {"lab", wifis[vehicle.address]}


def test_other_fleet_files_and_this_one_differ_in_addresses_only():
    def without_addresses(path):
        fleet = yaml.safe_load(path.read_text())
        for vehicle in fleet["vehicles"]:
            del vehicle["address"]
        return fleet["vehicles"], fleet["landmarks"]

    assert without_addresses(DOCKER / "fleet.yaml") == without_addresses(ROOT / "launch/fleets/lab3.yaml")


def test_dead_connections_are_noticed_as_machines_setup_wants_it():
    assert (DOCKER / "keep_alive.conf").read_text() == keep_alive.TEXT
    targets = [words[-1] for _, name, words in instructions() if name == "COPY" and "docker/keep_alive.conf" in words]
    assert targets == [keep_alive.FILE] * 2
    assert "Include %s/*.conf" % os.path.dirname(keep_alive.FILE) in (DOCKER / "sshd_config").read_text()


# ---------------------------------------------------------------- steps that run


class Machine:
    """A slim copy of this computer, to change at will: its network is empty, and nothing is left of it afterwards."""

    # $1: its folder, $2: the workspace, $3: its address
    _MOUNT = """
mount -t tmpfs tmpfs "$1"
mkdir "$1/upper" "$1/work" "$1/root" "$1/upper2" "$1/work2"
mount -t overlay overlay -o "lowerdir=/,upperdir=$1/upper,workdir=$1/work" "$1/root"
"""
    _START = """
cd "$1/root"
mount -t proc proc proc
mount --rbind /dev dev
mount -t tmpfs tmpfs tmp
# the workspace may be below /tmp, in a file system of its own (the overlay has only that of /), or in a user's home
mkdir -p "$1/root$2"
cd "$2"
mount -t overlay overlay -o "lowerdir=.,upperdir=$1/upper2,workdir=$1/work2" "$1/root$2"
cd "$1/root$2"
while cd .. && [ "$PWD" != "$1/root" ]; do chmod a+x .; done
ip link set lo up
ip address add "$3/32" dev lo
echo 0 >/proc/sys/net/ipv4/ip_unprivileged_port_start
echo ready
exec cat
"""

    ADDRESS = "192.168.200.12"

    def __init__(self, folder):
        self._root = folder / "root"
        probe = subprocess.run(self._command(self._MOUNT, folder), stderr=subprocess.PIPE, text=True)
        if probe.returncode != 0:
            why = probe.stderr.strip()
            pytest.skip("NO CHECK OF THE IMAGES' STEPS: needs root, namespaces and overlayfs (%s)" % why)
        self._unshare = subprocess.Popen(
            self._command(self._MOUNT + self._START, folder),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        said = []
        while said[-1:] != ["ready\n"]:
            said.append(self._unshare.stdout.readline())
            if not said[-1]:
                self.close()
                raise RuntimeError("".join(said))
        children = pathlib.Path("/proc/%d/task/%d/children" % (self._unshare.pid, self._unshare.pid))
        self._pid = children.read_text().split()[0]

    def _command(self, script, folder):
        return [
            "unshare", "--mount", "--net", "--pid", "--fork", "--kill-child",
            "bash", "-ec", script, "machine", str(folder), str(ROOT), self.ADDRESS,
        ]  # fmt: skip

    def start(self, command, user="root"):
        """Popen of a shell command in there, in the workspace."""
        return subprocess.Popen(
            ["nsenter", "--target", self._pid, "--mount", "--net", "--pid", "chroot", str(self._root),
             *([] if user == "root" else ["setpriv", "--reuid", user, "--regid", user, "--init-groups"]),
             "env", "-i", "HOME=/root" if user == "root" else "HOME=/home/" + user,
             "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
             "bash", "-c", "cd %s && %s" % (shlex.quote(str(ROOT)), command)],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    def run(self, command, user="root", code=0):
        """Output of a shell command in there."""
        process = self.start(command, user)
        output = process.communicate()[0]
        assert process.returncode == code, output[-4000:]
        return output

    def wait_for(self, command):
        """Output of a shell command of the user risc, repeated until it succeeds."""
        return self.run("for k in {1..100}; do %s && exit; sleep 0.1; done; exit 1" % command, "risc")

    def close(self):
        self._unshare.stdin.close()
        self._unshare.wait()


@contextlib.contextmanager
def new_machine(folder):
    machine = Machine(folder)
    try:
        yield machine
    finally:
        machine.close()


@contextlib.contextmanager
def serving(machine, keys):
    """A machine after the laptop image's steps (but for the packages), with its ssh server. keys: what makes them."""
    machine.run("userdel risc; groupdel risc; rm -rf --one-file-system /home/risc; chown root: /home/risc; true")
    machine.run("for group in input video dialout; do groupdel $group; done; true")  # a slim system has not all of them
    machine.run("docker/steps/slim.sh && docker/steps/user.sh 4321")
    machine.run("cp docker/keep_alive.conf %s" % keep_alive.FILE)
    machine.run(keys, "risc")
    server = machine.start("exec docker/run/sshd.sh", "risc")
    machine.wait_for("docker/run/listens.sh 22")
    yield machine
    server.terminate()


def command_of(compose, service):
    return " ".join(map(shlex.quote, compose["services"][service]["command"]))


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    with new_machine(tmp_path_factory.mktemp("machine")) as machine:
        yield machine


@pytest.fixture(scope="module")
def laptop(machine, compose):
    """A laptop that is its own base station, too."""
    with serving(machine, command_of(compose, "keys")) as machine:
        yield machine


@pytest.fixture(scope="module")
def base_station(tmp_path_factory, compose):
    """A base station that is its own service `browser`, too."""
    with (
        new_machine(tmp_path_factory.mktemp("machine")) as machine,
        serving(machine, command_of(compose, "browser_keys")),
    ):
        yield machine


def test_the_user_has_no_password_and_may_use_joysticks(laptop):
    assert laptop.run("getent shadow risc").split(":")[1] == "*"
    assert laptop.run("id -u risc").strip() == "4321"
    assert {"input", "video", "dialout"} < set(laptop.run("id -Gn risc").split())


SSH = "ssh -o BatchMode=yes -o StrictHostKeyChecking=accept-new "
GET = """.venv/bin/python -c 'import urllib.request as r; print(r.urlopen("http://%s:8080/fleet.yaml").read().decode())'"""


def test_the_env_loader_runs_after_a_login_with_the_key_of_the_base_station(laptop):
    loader = "env ROS_MASTER_URI=http://%s:11311 %s/devel/coop.sh" % (laptop.ADDRESS, ROOT)
    environment = laptop.run(SSH + "risc@%s %s env" % (laptop.ADDRESS, loader), "risc").splitlines()
    assert {"USER=risc", "ROS_IP=" + laptop.ADDRESS, "ROS_PACKAGE_PATH=%s/src" % ROOT} < set(environment)
    refused = laptop.run(SSH + "-o PubkeyAuthentication=no risc@%s true" % laptop.ADDRESS, "risc", code=255)
    assert "Permission denied (publickey)" in refused
    assert "Permission denied" in laptop.run(SSH + "root@%s true" % laptop.ADDRESS, "risc", code=255)
    assert "prohibited" in laptop.run(SSH + "-W 127.0.0.1:22 risc@" + laptop.ADDRESS, "risc", code=255)


def test_a_file_of_keys_is_taken_from_root_and_from_the_user_only(laptop):
    """So a folder of the computer itself may be mounted there, if it is root's (docs/docker.md)."""
    folder = "/home/risc/.authorized"
    login = SSH + "risc@%s true" % laptop.ADDRESS
    try:
        laptop.run("chmod 755 %s && chmod 644 %s/authorized_keys && chown -R 1234 %s" % (folder, folder, folder))
        assert "Permission denied (publickey)" in laptop.run(login, "risc", code=255)
        laptop.run("chown -R root %s" % folder)
        laptop.run(login, "risc")
    finally:
        laptop.run("chown -R risc %s && chmod 700 %s" % (folder, folder))


def test_the_key_of_the_browser_view_opens_its_port_and_nothing_else(base_station):
    address = base_station.ADDRESS
    page = base_station.start("exec python3 -m http.server --bind 127.0.0.1 --directory docker 8080", "risc")
    door = base_station.start("exec docker/run/browser.sh %s %s" % (address, address), "risc")
    assert "name: docker" in base_station.wait_for(GET % address)
    assert "uid=" not in base_station.run(SSH + "risc@%s id" % address, "risc", code=1)
    assert "prohibited" in base_station.run(SSH + "-W 127.0.0.1:22 risc@" + address, "risc", code=255)
    page.terminate()
    door.terminate()


def test_health_is_whether_something_listens(laptop):
    laptop.run("docker/run/listens.sh 22")
    laptop.run("docker/run/listens.sh 23", code=1)


def test_keys_are_made_once(laptop, compose):
    files = ".ssh/id_ed25519 .sshd/ssh_host_ed25519_key .authorized/authorized_keys"
    sums = laptop.run("cd && sha256sum " + files, "risc")
    laptop.run(command_of(compose, "keys"), "risc")
    assert laptop.run("cd && sha256sum " + files, "risc") == sums
    assert set(laptop.run("cd && stat -c %a .ssh/id_ed25519 .sshd/ssh_host_ed25519_key", "risc").split()) == {"600"}


def test_a_workspace_is_not_trimmed_by_mistake(machine):
    said = machine.run("docker/steps/trim.sh docker/not-on-a-laptop/python.txt", code=1)
    assert said.startswith("trim.sh: ") and str(ROOT) in said


def test_a_trimmed_workspace_is_the_same_workspace_for_machines_check(machine):
    describe = "devel/env.sh python -m risc_doctor.machines.workspace_digest ."
    whole = json.loads(machine.run(describe))
    for entry in entries(ROOT / ".dockerignore"):
        if entry.startswith(".git/"):
            machine.run("[ ! -d .git ] || rm -rf " + entry)
    machine.run("RISC_MAAP_TRIM=yes docker/steps/trim.sh docker/not-on-a-laptop/python.txt")
    trimmed = json.loads(machine.run(describe))
    assert trimmed["files"] == whole["files"]
    assert (trimmed["built"], trimmed["revision"]) == (True, whole["revision"])
    left = machine.run(".venv/bin/pip list --format=freeze --local 2>/dev/null").lower().replace("_", "-")
    assert not {line.split("==")[0] for line in left.split()} & set(entries(DOCKER / "not-on-a-laptop/python.txt"))
    machine.run("devel/coop.sh roslaunch --nodes launch/Multi_Machine_Experiment.launch machine:=local lab:=true")


@pytest.mark.parametrize(
    "arguments, code, said",
    [
        ("", 2, "usage: packages.sh LIST"),
        ("apt-packages-rviz.txt --without docker/packages.txt", 1, "no list: git"),
    ],
)
def test_package_lists_that_do_not_fit_are_refused(machine, arguments, code, said):
    assert said in machine.run("docker/steps/packages.sh " + arguments, code=code)


# ---------------------------------------------------------------- the images


@pytest.mark.release
@pytest.mark.skipif(
    not os.environ.get("RISC_MAAP_DOCKER_STEPS"),
    reason="takes half an hour and 15 GB: RISC_MAAP_DOCKER_STEPS=FOLDER ./maap test --all images_are_built",
)
def test_images_are_built_and_compose_flies():
    subprocess.run([str(ROOT / "tests/docker_steps.sh"), os.environ["RISC_MAAP_DOCKER_STEPS"]], check=True)
