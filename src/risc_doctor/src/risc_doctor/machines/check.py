"""`./maap machines check`: would roslaunch start this file on all of its computers, and would it fly?"""

import contextlib
import json
import os
import shlex
import socket
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

from rosgraph.network import get_local_addresses

from risc_doctor.findings import RED, Finding, Findings, broken, count_text, exit_code, finding, print_findings
from risc_doctor.machines import clock_offset, keep_alive, ssh, topics, workspace_digest

_LOADER_S = 15.0
_MANIFEST_S = 30.0
_DOCTOR_S = 45.0


def run(experiment, root, out=None):
    """Check every computer, print what was found in the order of the file. Returns the exit code.

    experiment: experiment.Experiment; root: folder of the workspace here; out: text stream, None = stdout.
    """
    out = sys.stdout if out is None else out
    here = own_address(experiment)
    remote = any(map(needs_login, experiment.computers))
    description = workspace_digest.describe(root) if remote else None
    findings = []
    if remote and here is not None:
        findings.append(check_shell(os.environ, here))
        print("this computer", file=out)
        print_findings(findings, out)
        print(file=out, flush=True)
    with ThreadPoolExecutor(max(len(experiment.computers), 1)) as pool:
        arguments = root, description, here
        jobs = {computer: pool.submit(_guarded, computer, *arguments) for computer in experiment.computers}
        try:
            findings += visit_each(jobs, lambda computer: jobs[computer].result(), out)
        except KeyboardInterrupt:  # what runs on the other computers ends by its own limits
            print("\nmaap machines: interrupted", file=sys.stderr, flush=True)
            os._exit(1)
    print("%d machines: %s" % (len(experiment.computers), count_text(findings)), file=out)
    if exit_code(findings) == 0:
        print("start it with\n  " + launch_line(experiment, here), file=out)
    return exit_code(findings)


def visit_each(computers, work, out):
    """Findings of work(computer) for each of them, printed under its name."""
    findings = []
    for computer in computers:
        place = "this computer" if computer.local else computer.login
        print("%s (%s)" % (computer.name, place), file=out, flush=True)
        found = work(computer)
        print_findings(found, out)
        print(file=out, flush=True)
        findings += found
    return findings


def needs_login(computer):
    """Whether roslaunch goes there by ssh."""
    return computer.nodes > 0 and not computer.local and not computer.unresolved


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


def _guarded(computer, *arguments):
    """check_computer; an exception in it is a red finding: the other computers are still checked."""
    try:
        return check_computer(computer, *arguments)
    except Exception as error:
        return [broken("nodes", error)]


def check_computer(computer, root, description, here):
    """Findings about one computer, from the network up to its vehicle; stops at the first that hides the others.

    root, description: folder and content of the workspace here; here: our address.
    """
    found = []
    if computer.nodes == 0:
        return [finding("nodes", "none")]
    if computer.password is not None:
        found.append(finding("password", "in_file" if computer.password else "empty", machine=computer.name))
    try:
        if computer.unresolved:
            raise ssh.unreachable(socket.gaierror(), computer.unresolved, computer.port)
        if computer.local:
            return found + _doctor(ssh.Here(computer))
        ssh.reach(computer)
        found.append(finding("network", "answers", where="%s port %d" % (computer.address, computer.port)))
        with contextlib.closing(ssh.connect(computer)) as session:
            how = "with the password of the file or a key" if computer.password else "without a password"
            found.append(finding("login", "good", login=computer.login, how=how))
            found.append(keep_alive.check(session))
            found.append(_env_loader(session))
            found.append(_workspace(session, description, root))
            found += topics.check(session, here or session.here)
            found.append(clock_offset.check(session))
            found += _doctor(session)
    except ssh.MachineError as problem:
        found.append(problem.finding)
    return found


def own_address(experiment):
    """The address of this computer for the others: that of the file, else the one that leads to the first of them.

    None when nothing leads there.
    """
    for computer in experiment.computers:
        if computer.local:
            with contextlib.suppress(OSError):
                address = socket.gethostbyname(computer.address)
                if not address.startswith("127."):
                    return address
    for computer in filter(needs_login, experiment.computers):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.connect((computer.address, computer.port))  # sends nothing
            return probe.getsockname()[0]
    return None


def launch_line(experiment, here):
    """The command that starts the experiment from any terminal of this computer."""
    inner = shlex.join(["roslaunch", experiment.path, *experiment.arguments])
    if any(map(needs_login, experiment.computers)):
        # the others are told the master's address literally: it must not be localhost
        hostname = "env -u ROS_HOSTNAME " if "ROS_HOSTNAME" in os.environ else ""
        inner = "%sROS_MASTER_URI=http://%s:%d ROS_IP=%s %s" % (hostname, here, ssh.MASTER_PORT, here, inner)
    return "./maap shell -c %s" % shlex.quote(inner)


def _env_loader(session):
    """The Finding that it works. Raises MachineError when it does not: nothing else could run there."""
    loader = session.computer.loader_file
    begin_s = time.monotonic()
    answer = session.loaded(["true"], _LOADER_S)
    took_s, limit_s = time.monotonic() - begin_s, session.computer.timeout_s
    if answer.code == 0 and took_s > limit_s / 2.0:  # roslaunch itself has to start in the other half
        times = {"took_s": took_s, "limit_s": limit_s, "wanted_s": max(20.0, 4.0 * took_s)}
        return finding("env-loader", "slow", loader=loader, **times)
    if answer.code == 0:
        return finding("env-loader", "works", loader=loader)
    quoted = shlex.quote(loader)
    code = "fails"
    if session.shell("test -f %s" % quoted, _LOADER_S).code != 0:
        code = "missing"
    elif session.shell("test -x %s" % quoted, _LOADER_S).code != 0:
        code = "not_executable"
    raise ssh.MachineError("env-loader", code, loader=loader, quoted=quoted, reason=answer.reason())


def _workspace(session, here, root):
    folder = session.computer.workspace
    answer = session.loaded(["python", "-m", "risc_doctor.machines.workspace_digest", folder], _MANIFEST_S)
    try:
        there = workspace_digest.from_output(answer.out)
    except ValueError:
        return finding("workspace", "mute", reason=answer.reason())
    folder = there.get("folder", folder)
    found = workspace_digest.compare(here, there)
    if found.level != RED and os.path.realpath(folder) != os.path.realpath(root):
        return finding("workspace", "other_folder", here=root, there=folder)
    return found


def _doctor(place):
    """Findings of the doctor there: disk, and what the launch file says is connected to that computer."""
    computer = place.computer
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
    if computer.local and computer.fleet:  # another computer need not have it: what is asked there is said in full
        command.insert(3, computer.fleet)
    answer = place.loaded(command, _DOCTOR_S)
    found = []
    with contextlib.suppress(ValueError, IndexError, TypeError):
        found = [Finding.from_dict(content) for content in json.loads(answer.out.splitlines()[-1])]
    return found or Findings("doctor").say("fails", reason=answer.reason())
