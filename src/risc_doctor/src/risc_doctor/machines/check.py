"""`./maap machines check`: would roslaunch start this file on all of its computers, and would it fly?"""

import concurrent.futures
import contextlib
import os
import shlex
import socket
import time
from urllib.parse import urlsplit

from rosgraph.network import get_local_addresses

from risc_doctor.findings import RED, Finding, FoundError, finding, guarded
from risc_doctor.interfaces import source_towards
from risc_doctor.machines import clock_offset, keep_alive, ssh, topic_flow, workspace_digest

_LOADER_S = 15.0
_MANIFEST_S = 30.0
_DOCTOR_S = 45.0


def begin(experiment, root, _yes):
    """([Finding about this computer], function of a computer that returns its findings); all are asked in parallel.

    experiment: experiment.Experiment; root: folder of the workspace here.
    """
    here, found, description = own_address(experiment), [], None
    if any(computer.needs_login for computer in experiment.computers):
        description = workspace_digest.describe(root)
        found = [check_shell(os.environ, here)] if here is not None else []
    pool = concurrent.futures.ThreadPoolExecutor(max(len(experiment.computers), 1))
    jobs = {c: pool.submit(guarded, "nodes", check_computer, c, description, here) for c in experiment.computers}
    return found, lambda computer: jobs[computer].result()


def check_shell(environment, here):
    """The Finding about what roslaunch, started from this shell, would tell the others. here: our address for them."""
    uri = environment.get("ROS_MASTER_URI", "")
    wrong = []
    if not _is_ours(urlsplit(uri).hostname or "", here):
        wrong.append("ROS_MASTER_URI=%s" % uri if uri else "ROS_MASTER_URI is not set")
    variable = next((name for name in ("ROS_HOSTNAME", "ROS_IP") if name in environment), "")  # the first one wins
    if not variable:
        wrong.append("ROS_IP is not set (nodes here would be announced as '%s')" % socket.gethostname())
    elif not _is_ours(environment[variable], here):
        wrong.append("%s=%s" % (variable, environment[variable]))
    if not wrong:
        return finding("shell", "good", variable=variable, value=environment[variable], uri=uri)
    unset = "unset ROS_HOSTNAME; " if "ROS_HOSTNAME" in environment else ""
    return finding("shell", "wrong", wrong=", ".join(wrong), unset=unset, here=here, port=ssh.MASTER_PORT)


def _is_ours(name, here):
    """Whether a name or address is one by which other computers may find this one."""
    try:
        address = socket.gethostbyname(name) if name else ""
    except (OSError, UnicodeError):
        return False
    return name == here or (address in get_local_addresses() and not address.startswith("127."))


def check_computer(computer, description, here):
    """Yields findings about one computer, from the network up to its vehicle. Raises FoundError, which is the last one.

    description: of the workspace here; here: our address.
    """
    if computer.nodes == 0:
        yield finding("nodes", "none")
        return
    if computer.password is not None:
        yield finding("password", "in_file" if computer.password else "empty", machine=computer.name)
    if computer.unresolved:
        raise ssh.unreachable(socket.gaierror(), computer.unresolved, computer.port)
    if computer.local:
        yield from _doctor(computer, ssh.loaded_here)
        return
    ssh.reach(computer)
    yield finding("network", "answers", where="%s port %d" % (computer.address, computer.port))
    with contextlib.closing(ssh.connect(computer)) as session:
        how = "with the password of the file or a key" if computer.password else "without a password"
        yield finding("login", "good", login=computer.login, how=how)
        yield keep_alive.check(session)
        yield _env_loader(session)
        yield _workspace(session, description)
        yield from topic_flow.check(session, here or session.here)
        yield clock_offset.check(session)
        yield from _doctor(computer, session.loaded)


def own_address(experiment):
    """This computer's address for the others: that of the launch file, else the one with a route to the first of them.

    None when there is no route.
    """
    for computer in experiment.computers:
        if computer.local:
            with contextlib.suppress(OSError):
                address = socket.gethostbyname(computer.address)
                if not address.startswith("127."):
                    return address
    ways = (source_towards(computer.address) for computer in experiment.computers if computer.needs_login)
    return next(filter(None, ways), None)


def launch_line(experiment):
    """The command that starts the experiment from any terminal of this computer."""
    inner = shlex.join(["roslaunch", experiment.path, *experiment.arguments])
    if any(computer.needs_login for computer in experiment.computers):
        # the others are told the master's address literally: it must not be localhost
        hostname = "env -u ROS_HOSTNAME " if "ROS_HOSTNAME" in os.environ else ""
        here = own_address(experiment)
        inner = "%sROS_MASTER_URI=http://%s:%d ROS_IP=%s %s" % (hostname, here, ssh.MASTER_PORT, here, inner)
    return "./maap shell -c %s" % shlex.quote(inner)


def _env_loader(session):
    """The Finding that the env-loader works. Raises FoundError when it does not: nothing else could run there."""
    loader = session.computer.loader_file
    begin_s = time.monotonic()
    answer = session.loaded(["true"], _LOADER_S)
    took_s, limit_s = time.monotonic() - begin_s, session.computer.timeout_s
    if answer.code == 0:
        code = "slow" if took_s > limit_s / 2.0 else "works"  # roslaunch itself has to start in the other half
        wanted_s = max(20.0, 4.0 * took_s)
        return finding("env-loader", code, loader=loader, took_s=took_s, limit_s=limit_s, wanted_s=wanted_s)
    quoted, code = shlex.quote(loader), "fails"
    if session.shell("test -f %s" % quoted, _LOADER_S).code != 0:
        code = "missing"
    elif session.shell("test -x %s" % quoted, _LOADER_S).code != 0:
        code = "not_executable"
    raise FoundError("env-loader", code, loader=loader, quoted=quoted, reason=answer.reason())


def _workspace(session, here):
    folder = session.computer.workspace
    answer = session.loaded(["python", "-m", "risc_doctor.machines.workspace_digest", folder], _MANIFEST_S)
    try:
        there = answer.told(workspace_digest.Workspace)
    except ValueError:
        return finding("workspace", "mute", reason=answer.reason())
    found = workspace_digest.compare(here, there)
    if found.level != RED and os.path.realpath(there.folder) != os.path.realpath(here.folder):
        return finding("workspace", "other_folder", here=here.folder, there=there.folder)
    return found


def _doctor(computer, loaded):
    """Findings of the doctor there: disk, and what the launch file says is connected to that computer.

    loaded: function of a command and its limit [s] that runs it there and returns an Answer.
    """
    checks, options = ["disk"], []
    if computer.cortex and computer.local and computer.fleet:  # the fleet file says where the stream comes in
        checks += ["subnets", "multicast", "ports", "cortex"]
    if computer.bag_folder:
        options += ["--bag-folder", computer.bag_folder]
    if computer.joysticks:
        checks.append("joystick")
        options += ["--joystick", *computer.joysticks]
    if computer.vehicles:
        checks += ["subnets", "vehicles"]
        options += ["--vehicle", *computer.vehicles]
    command = ["python", "-m", "risc_doctor", "--json", "--only", ",".join(dict.fromkeys(checks)), *options]
    if computer.local and computer.fleet:  # another computer may not have it: options say all
        command.insert(3, computer.fleet)
    answer = loaded(command, _DOCTOR_S)
    with contextlib.suppress(ValueError):
        found = answer.told(list[Finding])
        if found:
            return found
    return [finding("doctor", "fails", reason=answer.reason())]
