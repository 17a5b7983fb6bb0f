"""A throw-away network of computers for tests: Linux namespaces on one bridge, with a real sshd in each.

Every host has its own network, processes, host name, /etc/hosts, home directory and ssh host key; the file system is
otherwise the one of this computer. The bridge lives in a namespace of its own, so the computer's own interfaces,
addresses and routes are not touched, and nothing in the network can reach anything outside: `assert_isolated`.

    with NetLab({"a": "10.77.0.1/24", "b": "10.77.0.2/24"}, user="pilot") as lab:
        lab.run("a", ["ssh", "b", "hostname"])

Needs root, iproute2, util-linux, procps, openssh-server and openssh-client; `unsupported` gives the reason to skip.
This file is also the first process of each host: `netlab.py FOLDER HOST`.
"""

import contextlib
import functools
import ipaddress
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid

PREFIX = "netlab-"  # of the names of all our namespaces
PATH = "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"  # here and on the hosts
SYSTEM_PYTHON = "/usr/bin/python3"  # any user may execute it
USER_ID = 45001  # of the login that exists only in the lab
PATIENCE_S = 20.0  # for a host to start, or a process to end
COMMAND_S = 60.0  # for a command that `run` runs
MEMORY_BYTES = 2 << 30  # that must be free to have the hosts' disks in memory
MULTICAST = ipaddress.ip_network("224.0.0.0/4")
OUTSIDE = ("192.0.2.1", "198.51.100.1", "1.1.1.1")  # no lab has these; asking for a route sends nothing
UNSHARE = ("unshare", "--mount", "--uts", "--pid", "--ipc", "--fork", "--kill-child", "--mount-proc")
UNSHARE += ("--propagation", "private")  # what a host has of its own, beside the network
# A host that has lost its power does not close its old connections afterwards. Needs a writable /proc/sys.
NO_GOODBYE = ("sysctl", "--write", "net.ipv4.tcp_orphan_retries=1")


@functools.cache
def unsupported():
    """One line: why no lab can be made on this computer; "" if it can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    for tool in ("ip", "bridge", "tc", "unshare", "nsenter", "setpriv", "sysctl", "ssh", "ssh-keygen", "sshd"):
        if shutil.which(tool, path=PATH) is None:
            return "%s is missing: apt-get install iproute2 util-linux procps openssh-client openssh-server" % tool
    try:
        with _probe() as namespace:
            _run("ip", "-n", namespace, "link", "add", "name", "br0", "type", "bridge")
            _run("ip", "-n", namespace, "link", "add", "name", "veth0", "type", "veth", "peer", "name", "veth1")
            _run("ip", "netns", "exec", namespace, *UNSHARE, "mount", "-t", "tmpfs", "tmpfs", "/run")
            _run("ip", "netns", "exec", namespace, *NO_GOODBYE)
    except RuntimeError as error:
        return "no network namespaces here (a container needs --privileged): %s" % error
    return ""


@functools.cache
def has_netem():
    """Whether the kernel can delay and lose what a card sends (sch_netem). Raises RuntimeError when that is unknown."""
    with _probe() as namespace:
        try:
            _run("tc", "-n", namespace, "qdisc", "add", "dev", "lo", "root", "netem", "delay", "1ms")
        except RuntimeError as error:
            if "qdisc kind is unknown" in str(error):
                return False
            raise
    return True


@contextlib.contextmanager
def _probe():
    """Context manager: a temporary network namespace for a trial; gives its name."""
    name = PREFIX + "probe-" + uuid.uuid4().hex[:8]
    _run("ip", "netns", "add", name)
    try:
        yield name
    finally:
        _run("ip", "netns", "del", name, check=False)


class NetLab:
    """The network. hosts: {name: "address/prefix length"}, names of at most 13 characters.

    user: login that exists only inside (not root, by bind mounts); None = root, with a home of its own there.
    sshd_lines: {host: lines to add to its sshd_config}.
    """

    def __init__(self, hosts, user=None, sshd_lines=None):
        self.hosts = dict(hosts)
        self.user = user
        self.name = uuid.uuid4().hex[:8]
        # in memory: four real computers have four disks, and do not wait for one another's
        memory = pathlib.Path("/dev/shm")
        has_room = memory.is_dir() and shutil.disk_usage(str(memory)).free >= MEMORY_BYTES
        self.folder = (memory if has_room else pathlib.Path(tempfile.gettempdir())) / (PREFIX + self.name)
        self._sshd_lines = sshd_lines or {}
        # {host: {device: (namespace, device) at the other end of its cable}}
        self._far_ends = {host: {"eth0": (self._switch, "p-" + host)} for host in hosts}
        self._processes = {}  # {host: Popen of its `unshare`}
        self._first = {}  # {host: process id of its first process}
        self._is_up = False

    # --- up and down ------------------------------------------------------------------------------------------------

    def __enter__(self):
        return self.up()

    def __exit__(self, *_):
        self.down()

    def up(self):
        """Make the network, and wait until every sshd answers. Raises RuntimeError, and leaves nothing behind then."""
        self.folder.mkdir()
        self.folder.chmod(0o755)
        self._is_up = True
        try:
            self._lay_cables()
            self.assert_isolated()  # before there is any address
            self._give_addresses()
            self.assert_isolated()
            self._make_logins()
            for host in self.hosts:
                self._boot(host)
            for host in self.hosts:
                self._wait_for_sshd(host)
        except BaseException:
            self.down()
            raise
        return self

    def down(self):
        """Remove everything; may be called in any state."""
        self._is_up = False
        for host in list(self._processes):
            with contextlib.suppress(OSError, subprocess.TimeoutExpired):  # the others must go all the same
                self._kill(host)
        for namespace in [self._namespace(host) for host in self.hosts] + [self._switch]:
            for pid in _run("ip", "netns", "pids", namespace, check=False).split():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(pid), signal.SIGKILL)
            _run("ip", "netns", "del", namespace, check=False)
        shutil.rmtree(str(self.folder), ignore_errors=True)

    def cable(self, host, device, address, far_host, far_device, far_address):
        """Connect two hosts by a cable, in addition to the bridge; addresses with their prefix length."""
        near, far = self._namespace(host), self._namespace(far_host)
        _run("ip", "-n", near, "link", "add", device, "type", "veth", "peer", "name", far_device, "netns", far)
        for namespace, name, its_address in ((near, device, address), (far, far_device, far_address)):
            _run("ip", "-n", namespace, "addr", "add", its_address, "dev", name)
            _run("ip", "-n", namespace, "link", "set", name, "up")
        self._far_ends[host][device] = (far, far_device)

    def assert_isolated(self):
        """Nothing in the lab can reach anything outside, and nothing outside the lab. Raises AssertionError."""
        own = {str(ipaddress.ip_interface(address).ip) for address in self.hosts.values()}
        outside = _json("ip", "-json", "addr")
        taken = {entry["local"] for link in outside for entry in link["addr_info"]}
        assert not own & taken, "this computer itself has an address of the lab: %s" % sorted(own & taken)
        names = [self._namespace(host) for host in self.hosts] + [self._switch]
        inside = {_inode("/run/netns/" + name) for name in names}
        assert len(inside) == len(names) and _inode("/proc/self/ns/net") not in inside, "a namespace is shared"
        peers = {}  # {(namespace, interface): namespace that its cable leads to}
        for name in names:
            links = _json("ip", "-n", name, "-json", "-details", "link")  # which gives the numbers that list-id lists
            ids = {entry["nsid"]: entry.get("name") for entry in _json("ip", "-n", name, "-json", "netns", "list-id")}
            for link in links:
                kind = link.get("linkinfo", {}).get("info_kind", "")
                if kind == "veth":
                    peers[name, link["ifname"]] = ids.get(link.get("link_netnsid"), "outside")
                assert kind == "veth" or link["ifname"] in ("lo", "br0"), "%s has %s" % (name, link["ifname"])
        assert set(peers.values()) <= set(names), "a cable leads out: %r" % peers
        nets = self._networks()
        for name in names:
            for entry in _json("ip", "-n", name, "-json", "route", "show", "table", "all"):
                target = entry["dst"]
                assert target != "default", "%s has a default route" % name
                network = ipaddress.ip_network(target, strict=False)
                known = network.version == 6 or network.is_loopback or any(network.subnet_of(net) for net in nets)
                assert known, "%s has a route to %s" % (name, target)
            for address in OUTSIDE:
                answer = _run("ip", "-n", name, "route", "get", address, check=False)
                assert not answer, "%s would send to %s: %s" % (name, address, answer)

    # --- what tests do with it --------------------------------------------------------------------------------------

    def address(self, host):
        """Address of the host on the bridge, without prefix length."""
        return self.hosts[host].partition("/")[0]

    def home(self, host):
        """Home directory of the login on the host, as a path that is valid everywhere."""
        return self.folder / host / "home"

    def command(self, host, argv, env=None, as_root=False):
        """The command line that runs argv on the host, in a fresh environment plus env."""
        login = "root" if as_root or self.user is None else self.user
        command = ["nsenter", "--target", str(self._first[host]), "--mount", "--net", "--uts", "--pid", "--ipc"]
        command += ["--wd=" + str(self.home(host))]
        if login != "root":
            command += ["setpriv", "--reuid", str(USER_ID), "--regid", str(USER_ID), "--clear-groups"]
        environment = {
            "HOME": self.home(host),
            "USER": login,
            "LOGNAME": login,
            "LANG": "C.UTF-8",
            "PATH": PATH,
        }
        environment.update(env or {})
        settings = ["%s=%s" % item for item in environment.items()]
        # tests that were started in the background ignore Ctrl-C, and so would their children
        return command + ["env", "--ignore-environment", "--default-signal=INT"] + settings + [str(a) for a in argv]

    def run(self, host, argv, env=None, as_root=False, check=True):
        """Run a command on the host to its end. Returns CompletedProcess (texts).

        Raises RuntimeError if check and it fails, subprocess.TimeoutExpired after COMMAND_S.
        """
        done = subprocess.run(
            self.command(host, argv, env, as_root),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=COMMAND_S,
            env={"PATH": PATH},
        )
        if check and done.returncode != 0:
            raise RuntimeError("%s on %s: %s%s" % (argv[0], host, done.stdout, done.stderr))
        return done

    def popen(self, host, argv, env=None, as_root=False, **options):
        """Start a command on the host, the leader of a session of its own there. options: of Popen."""
        options.setdefault("stdin", subprocess.DEVNULL)
        command = self.command(host, ["setsid", *argv], env, as_root)
        return subprocess.Popen(command, start_new_session=True, env={"PATH": PATH}, **options)

    def interrupt(self, process, number=signal.SIGINT, timeout=30.0):
        """Send a signal (Ctrl-C) to the program that `popen` started; the process itself is only the nsenter around it.

        Returns its exit code, at once when it has ended already. Raises subprocess.TimeoutExpired.
        """
        if process.poll() is not None:
            return process.returncode
        children = pathlib.Path("/proc/%d/task/%d/children" % (process.pid, process.pid)).read_text().split()
        for pid in children or [process.pid]:
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                os.kill(int(pid), number)
        return process.wait(timeout)

    def processes(self, host):
        """{process id on the host: command line} of everything that runs there; {} when it is off.

        Raises RuntimeError when the whole network is down.
        """
        if not self._is_up:
            raise RuntimeError("the network is down: ask what runs on %s before that" % host)
        if host not in self._first:
            return {}
        found = {}
        for entry in pathlib.Path("/proc/%d/root/proc" % self._first[host]).glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):  # it ended meanwhile
                found[int(entry.parent.name)] = entry.read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
        return found

    def programs(self, host):
        """`processes` without those that show their parent's command line: forks that are about to start their own."""
        found = self.processes(host)

        def parent(pid):
            with contextlib.suppress(OSError):  # it ended meanwhile
                status = pathlib.Path("/proc/%d/root/proc/%d/status" % (self._first[host], pid)).read_text()
                return int(re.search(r"^PPid:\s*(\d+)$", status, re.MULTILINE).group(1))
            return None

        return {pid: command for pid, command in found.items() if found.get(parent(pid)) != command}

    def link(self, host, state, device="eth0"):
        """Pull ("down") or plug ("up") a cable at its other end; addresses and routes of the host stay."""
        namespace, far_device = self._far_ends[host][device]
        _run("ip", "-n", namespace, "link", "set", far_device, state)

    def mute(self, host, is_mute):
        """Let the bridge drop everything from and for the host; the cable keeps its carrier, so the timing is exact."""
        _run("bridge", "-n", self._switch, "link", "set", "dev", "p-" + host, "state", "0" if is_mute else "3")

    def netem(self, host, spec, device="eth0"):
        """Delay and loss on a cable, both ways, e.g. "delay 20ms loss 1%"; "" ends it. Needs `has_netem`."""
        for namespace, name in self._ends(host, device):
            _run("tc", "-n", namespace, "qdisc", "del", "dev", name, "root", check=False)
            if spec:
                _run("tc", "-n", namespace, "qdisc", "add", "dev", name, "root", "netem", *spec.split())

    def lost(self, host, device="eth0"):
        """Fraction of what was sent through a cable with `netem`, both ways, that was lost."""
        sent = lost = 0
        for namespace, name in self._ends(host, device):
            for queue in _json("tc", "-n", namespace, "-s", "-json", "qdisc", "show", "dev", name):
                if queue["kind"] == "netem":
                    sent += queue["packets"] + queue["drops"]
                    lost += queue["drops"]
        return lost / max(sent, 1)

    def sshd(self, host, action):
        """ "stop": the listener and every session of it die at once; "start": it listens again."""
        if action == "start":
            self.run(host, _sshd_command(self.folder / host), as_root=True)
            self._wait_for_sshd(host)
            return
        for pid in self.processes(host):
            folder = pathlib.Path("/proc/%d/root/proc/%d" % (self._first[host], pid))
            with contextlib.suppress(OSError):
                if (folder / "comm").read_text().strip().startswith("sshd"):
                    self.run(host, ["kill", "-KILL", str(pid)], as_root=True, check=False)

    def power_off(self, host):
        """Switch the host off at once: all its processes are killed, and it closes no connection on the wire."""
        self._unplug(host, "down")
        self._kill(host)

    def power_on(self, host):
        """Boot a host that was off."""
        self._unplug(host, "up")
        self._boot(host)
        self._wait_for_sshd(host)

    # --- how it is made ---------------------------------------------------------------------------------------------

    @property
    def _switch(self):
        return self._namespace("switch")

    def _namespace(self, host):
        return "%s%s-%s" % (PREFIX, self.name, host)

    def _ends(self, host, device):
        """Both ends of a cable: (namespace, interface)."""
        return ((self._namespace(host), device), self._far_ends[host][device])

    def _unplug(self, host, state):
        """Set the link state of all cables of a host. A far end at another host, not the switch, keeps listening."""
        for device in self._far_ends[host]:
            if device == "eth0":
                self.link(host, state)
            else:
                _run("ip", "-n", self._namespace(host), "link", "set", device, state)

    def _networks(self):
        """Networks that belong to the lab: those of all addresses that its hosts have, and multicast."""
        nets = {ipaddress.ip_interface(address).network for address in self.hosts.values()} | {MULTICAST}
        for host in self.hosts:
            for link in _json("ip", "-n", self._namespace(host), "-json", "-4", "addr"):
                for entry in link["addr_info"]:
                    address = "%s/%d" % (entry["local"], entry["prefixlen"])
                    nets.add(ipaddress.ip_interface(address).network)
        return nets

    def _lay_cables(self):
        switch = self._switch
        _run("ip", "netns", "add", switch)
        # Without snooping the bridge floods multicast, as a plain switch does; with it, a querier would be needed.
        bridge = ("type", "bridge", "stp_state", "0", "forward_delay", "0", "mcast_snooping", "0")
        _run("ip", "-n", switch, "link", "add", "name", "br0", *bridge)
        _run("ip", "-n", switch, "link", "set", "br0", "up")
        for host in self.hosts:
            namespace, port = self._namespace(host), "p-" + host
            _run("ip", "netns", "add", namespace)
            _run("ip", "netns", "exec", namespace, *NO_GOODBYE)
            _run("ip", "-n", namespace, "link", "set", "lo", "up")
            peer = ("peer", "name", "eth0", "netns", namespace)
            _run("ip", "-n", switch, "link", "add", "name", port, "type", "veth", *peer)
            _run("ip", "-n", switch, "link", "set", port, "master", "br0", "up")

    def _give_addresses(self):
        nets = {ipaddress.ip_interface(address).network for address in self.hosts.values()}
        for host, address in self.hosts.items():
            namespace = self._namespace(host)
            _run("ip", "-n", namespace, "addr", "add", address, "dev", "eth0")
            _run("ip", "-n", namespace, "link", "set", "eth0", "up")
            others = nets - {ipaddress.ip_interface(address).network}
            for network in (*others, MULTICAST):  # a real network has a router between them
                _run("ip", "-n", namespace, "route", "add", str(network), "dev", "eth0", "scope", "link")

    def _make_logins(self):
        """One client key for all hosts; a host key, a home and an account on each."""
        lines = ["127.0.0.1 localhost"] + ["%s %s" % (self.address(host), host) for host in self.hosts]
        (self.folder / "hosts").write_text("\n".join(lines) + "\n")
        key = self.folder / "id_ed25519"
        _run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "netlab", "-f", str(key))
        known = []
        for host in self.hosts:
            folder = self.folder / host
            (self.home(host) / ".ssh").mkdir(parents=True, mode=0o700)
            _run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", host, "-f", str(folder / "host_key"))
            public = " ".join((folder / "host_key.pub").read_text().split()[:2])
            known.append("%s,%s %s\n" % (self.address(host), host, public))
            self._write_sshd_config(host)
            self._write_accounts(host)
        for host in self.hosts:
            ssh = self.home(host) / ".ssh"
            (ssh / "known_hosts").write_text("".join(known))
            for path in (key, key.with_suffix(".pub")):
                shutil.copy(str(path), str(ssh))
            (ssh / "id_ed25519").chmod(0o600)
            for path in (self.home(host), ssh, *ssh.iterdir()):
                if self.user is not None:
                    os.chown(str(path), USER_ID, USER_ID)

    def _write_sshd_config(self, host):
        folder = self.folder / host
        lines = [
            "ListenAddress " + self.address(host),
            "HostKey %s" % (folder / "host_key"),
            "AuthorizedKeysFile %s" % (self.folder / "id_ed25519.pub"),
            "PidFile none",
            "UsePAM no",
            "UseDNS no",
            "StrictModes no",
            "PasswordAuthentication no",
            "KbdInteractiveAuthentication no",
            "PermitRootLogin prohibit-password",
        ]
        (folder / "sshd_config").write_text("\n".join([*lines, *self._sshd_lines.get(host, ())]) + "\n")

    def _write_accounts(self, host):
        login, number = ("root", 0) if self.user is None else (self.user, USER_ID)
        own = {
            "passwd": "%s:x:%d:%d::%s:/bin/bash\n" % (login, number, number, self.home(host)),
            "group": "%s:x:%d:\n" % (login, number),
        }
        for name, line in own.items():
            others = pathlib.Path("/etc", name).read_text().splitlines(True)
            path = self.folder / host / name
            path.write_text("".join([line] + [other for other in others if not other.startswith(login + ":")]))
            path.chmod(0o644)
        shadow = self.folder / host / "shadow"  # no passwords of this computer: no login there has one
        shadow.touch(mode=0o600)
        shadow.write_text("".join("%s:*:19000:0:99999:7:::\n" % name for name in sorted({login, "root"})))

    def _boot(self, host):
        folder = self.folder / host
        ready = folder / "ready"
        if ready.exists():
            ready.unlink()
        # ends with this process, also when it is killed
        command = ["setpriv", "--pdeathsig", "KILL", "ip", "netns", "exec", self._namespace(host), *UNSHARE]
        command += [SYSTEM_PYTHON, os.path.abspath(__file__), str(self.folder), host]
        with (folder / "boot.log").open("ab") as log:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env=dict(os.environ, PATH=PATH),
            )
        self._processes[host] = process
        children = pathlib.Path("/proc/%d/task/%d/children" % (process.pid, process.pid))
        deadline = time.monotonic() + PATIENCE_S
        while not ready.exists():
            if process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("host %s did not start: %s" % (host, (folder / "boot.log").read_text()))
            time.sleep(0.01)
        self._first[host] = int(children.read_text().split()[0])

    def _kill(self, host):
        """Kill the first process of a host: all others of its process namespace die with it."""
        process = self._processes.pop(host)
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._first.pop(host, process.pid), signal.SIGKILL)
        process.wait(PATIENCE_S)

    def _wait_for_sshd(self, host):
        greeting = 'exec 3<>"/dev/tcp/$1/22" && head --bytes=4 <&3'
        deadline = time.monotonic() + PATIENCE_S
        while self.run(host, ["bash", "-c", greeting, "-", self.address(host)], check=False).stdout != "SSH-":
            if time.monotonic() > deadline:
                log = self.folder / host / "sshd.log"
                raise RuntimeError("no sshd on %s: %s" % (host, log.read_text() if log.exists() else "no log"))
            time.sleep(0.05)


def _run(*command, check=True):
    """Output of a command on this computer. If check and it fails, raises RuntimeError with its output."""
    done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ, PATH=PATH))
    if check and done.returncode != 0:
        raise RuntimeError("%s: %s" % (" ".join(command), (done.stderr or done.stdout).strip()))
    return done.stdout


def _json(*command):
    return json.loads(_run(*command) or "[]")


def _sshd_command(folder):
    return ["/usr/sbin/sshd", "-f", str(folder / "sshd_config"), "-E", str(folder / "sshd.log")]


def _inode(path):
    return os.stat(path).st_ino


def _first_process(folder, host):
    """First process of a host: make its mounts, host name and sshd; then reap dead processes."""
    _run("hostname", host)
    _run("mount", "-t", "tmpfs", "-o", "mode=755", "tmpfs", "/run")
    pathlib.Path("/run/sshd").mkdir(mode=0o755)
    _run("mount", "--bind", str(folder / "hosts"), "/etc/hosts")
    for name in ("passwd", "group", "shadow"):
        _run("mount", "--bind", str(folder / host / name), "/etc/" + name)
    _run(*_sshd_command(folder / host))
    (folder / host / "ready").touch()
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCHLD])
    while True:
        signal.sigwait([signal.SIGCHLD])
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


if __name__ == "__main__":
    _first_process(pathlib.Path(sys.argv[1]), sys.argv[2])
