"""`./maap machines check`: would roslaunch start this file on all of its computers, and would it fly?"""

import contextlib
import json
import os
import shlex
import socket
import sys
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

from rosgraph.network import get_local_addresses

from risc_doctor.findings import RED, Finding, count_text, exit_code, green, print_findings, red, yellow
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
    remote = [computer for computer in experiment.computers if needs_login(computer)]
    description = workspace_digest.describe(root) if remote else None
    findings = []
    if remote and here is not None:
        findings.append(check_shell(os.environ, here))
        print("this computer", file=out)
        print_findings(findings, out)
        print(file=out, flush=True)
    with contextlib.ExitStack() as stack:
        master = stack.enter_context(contextlib.closing(topics.Master())) if remote else None
        pool = stack.enter_context(ThreadPoolExecutor(max(len(experiment.computers), 1)))
        jobs = [
            pool.submit(_guarded, computer, number, root, description, master, here)
            for number, computer in enumerate(experiment.computers)
        ]
        for computer, job in zip(experiment.computers, jobs):
            try:
                with waiting_for(computer.name):
                    found = job.result()
            except KeyboardInterrupt:  # what runs on the other computers ends by its own limits
                print("\nmaap machines: interrupted", file=sys.stderr, flush=True)
                if master is not None:
                    master.close()
                os._exit(1)
            print("%s (%s)" % (computer.name, "this computer" if computer.local else computer.login), file=out)
            print_findings(found, out)
            print(file=out, flush=True)
            findings += found
    print("%d machines: %s" % (len(experiment.computers), count_text(findings)), file=out)
    if exit_code(findings) == 0:
        print("start it with\n  " + launch_line(experiment, here), file=out)
    return exit_code(findings)


@contextlib.contextmanager
def waiting_for(name):
    """Tell a person at a terminal what is being waited for, on a line that vanishes."""
    if sys.stderr.isatty():
        print("\r\033[K%s ..." % name, end="", file=sys.stderr, flush=True)
    yield
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)


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
        return green("shell", "a roslaunch from this shell names %s=%s and %s" % (variable, environment[variable], uri))
    hostname = "unset ROS_HOSTNAME; " if "ROS_HOSTNAME" in environment else ""
    return yellow(
        "shell",
        "a roslaunch from this shell would not tell the others this computer's address: " + ", ".join(wrong),
        "start with the line that check prints at the end when nothing is red; or here, before anything else:\n"
        "%sexport ROS_IP=%s ROS_MASTER_URI=http://%s:%d" % (hostname, here, here, ssh.MASTER_PORT),
    )


def _is_ours(name, here):
    """Whether a name or address is one by which other computers may find this one."""
    try:
        address = socket.gethostbyname(name) if name else ""
    except (OSError, UnicodeError):
        return False
    return name == here or (address in get_local_addresses() and not address.startswith("127."))


def _guarded(computer, *arguments):
    """check_computer; whatever breaks in it is a red finding: the others are worth having."""
    try:
        return check_computer(computer, *arguments)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        text = "the check itself failed: %s: %s (%s, line %d)"
        text %= (type(error).__name__, error, os.path.basename(place.filename), place.lineno)
        return [red("check", text, "look at that computer by hand; and please report this")]


def check_computer(computer, number, root, description, master, here):
    """Findings about one computer, from the network up to its vehicle; stops at the first that hides the others.

    root, description: folder and content of the workspace here; master: topics.Master; here: our address;
    number: one of its own.
    """
    if computer.nodes == 0:
        return [green("nodes", "none in this file: not needed, not checked")]
    findings = _passwords(computer)
    with ssh.visit(findings) as sessions:
        if computer.unresolved:
            raise ssh.MachineError(
                red("network", *ssh.why_unreachable(socket.gaierror(), computer.unresolved, computer.port))
            )
        if computer.local:
            return findings + _doctor(ssh.Here(computer))
        ssh.reach(computer)
        findings.append(green("network", "%s port %d answers" % (computer.address, computer.port)))
        session = sessions.enter_context(contextlib.closing(ssh.connect(computer)))
        how = "with the password of the file or a key" if computer.password else "without a password"
        findings.append(green("login", "host key known, login %s %s" % (computer.login, how)))
        findings.append(keep_alive.check(session))
        findings.append(_env_loader(session))
        findings.append(_workspace(session, description, root))
        findings += topics.check(session, master, here or session.here, number)
        findings.append(clock_offset.check(session))
        findings += _doctor(session)
    return findings


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
    words = ["roslaunch", experiment.path, *experiment.arguments]
    inner = " ".join(shlex.quote(word) for word in words)
    if any(map(needs_login, experiment.computers)):
        # the others are told the master's address literally: it must not be localhost
        hostname = "env -u ROS_HOSTNAME " if "ROS_HOSTNAME" in os.environ else ""
        inner = "%sROS_MASTER_URI=http://%s:%d ROS_IP=%s %s" % (hostname, here, ssh.MASTER_PORT, here, inner)
    return "./maap shell -c %s" % shlex.quote(inner)


def _passwords(computer):
    if computer.password:
        return [
            red(
                "password",
                "the launch file holds a password for %s: everybody who has the file has the computer" % computer.name,
                'remove password="..." from its <machine> tag, change the password, then ./maap machines setup',
            )
        ]
    if computer.password is not None:
        return [
            yellow(
                "password",
                'password="" is not the same as no password: roslaunch then ignores the IdentityFile of ~/.ssh/config',
                "remove the attribute from the <machine> tag",
            )
        ]
    return []


def _env_loader(session):
    """The Finding that it works. Raises MachineError when it does not: nothing else could run there."""
    loader = session.computer.loader_file
    begin_s = time.monotonic()
    answer = session.loaded(["true"], _LOADER_S)
    took_s, limit_s = time.monotonic() - begin_s, session.computer.timeout_s
    if answer.code == 0 and took_s > limit_s / 2.0:  # roslaunch itself has to start in the other half
        text = "%s takes %.1f s, and roslaunch waits %g s for the machine to answer" % (loader, took_s, limit_s)
        return yellow("env-loader", text, 'timeout="%.0f" in its <machine> tag' % max(20.0, 4.0 * took_s))
    if answer.code == 0:
        return green("env-loader", "%s works" % loader)
    quoted = shlex.quote(loader)
    exists = session.shell("test -f %s" % quoted, _LOADER_S).code == 0
    executable = exists and session.shell("test -x %s" % quoted, _LOADER_S).code == 0
    if not exists:
        text, cure = "there is no %s there" % loader, "./maap machines deploy, or ./maap build there"
    elif not executable:
        text, cure = "%s is not executable there" % loader, "on that computer: chmod +x %s" % quoted
    else:
        text = "%s fails there: %s" % (loader, answer.reason())
        cure = "on that computer: %s true; ./maap machines deploy brings ours there" % quoted
    raise ssh.MachineError(red("env-loader", text, cure))


def _workspace(session, here, root):
    folder = session.computer.workspace
    answer = session.loaded(["python", "-m", "risc_doctor.machines.workspace_digest", folder], _MANIFEST_S)
    try:
        there = workspace_digest.from_output(answer.out)
    except ValueError:
        return red("workspace", "it cannot say what it is made of: %s" % answer.reason(), workspace_digest.CURE)
    folder = there.get("folder", folder)
    found = workspace_digest.compare(here, there)
    if found.level != RED and os.path.realpath(folder) != os.path.realpath(root):
        text = "it is %s here, but %s there: $(find ...) in a launch file is a path of this computer" % (root, folder)
        return red("workspace", text, "put it into the same folder on every computer (./maap build after moving it)")
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
    cure = "./maap doctor on that computer; if that does not run either: " + workspace_digest.CURE
    return found or [yellow("doctor", "it does not run there: %s" % answer.reason(), cure)]
