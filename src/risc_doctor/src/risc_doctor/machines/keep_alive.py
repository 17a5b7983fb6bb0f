"""sshd's settings on another computer that end a dead connection soon: then coop.sh ends the nodes of a lost launch.

Without them the nodes run on forever when the network goes away, and a second launch starts a second set beside them.
"""

from risc_doctor.findings import finding

FILE = "/etc/ssh/sshd_config.d/risc_maap.conf"
TEXT = "ClientAliveInterval 2\nClientAliveCountMax 3\n"
_SOON_S = 6
_LIMIT_S = 15.0
_NOT_ROOT = 77
_ILL = "sshd there does not notice dead connections: the nodes of a lost launch may run on"
# Start of each script. It sets $sudo; $listener, the sshd that listens, which is an ancestor of this login and so is
# found without systemd, too; and $sshd, its command.
_AS_ROOT = """
sudo=; [ "$(id -u)" -eq 0 ] || { sudo -n true 2>/dev/null && sudo=sudo; } || exit %d;
sshd=/usr/sbin/sshd;
listener=;
pid=$$;
while [ "$pid" -gt 1 ]; do
  pid=$(ps -o ppid= -p "$pid" | tr -d " ");
  words=$(ps -ww -o args= -p "$pid");
  case $words in
    "sshd: "*" [listener]"*)
      listener=$pid;
      sshd=${words#sshd: };
      sshd=${sshd%%%% \\[listener]*};
      break;;
  esac;
done;
""" % _NOT_ROOT  # fmt: skip
# The settings in sshd's files for a login like this. Whether the listener has read them cannot be found out.
_READ = """
set -- $SSH_CONNECTION;
$sudo $sshd -T -C "user=$(id -un),host=$1,addr=$1,laddr=$3,lport=$4"
"""
_WRITE = """
set -e;
[ -e %s ] || undo="$sudo rm %s";
printf '%s' | $sudo tee %s >/dev/null;
"""
# Let the listener read its files (by HUP, like `systemctl reload ssh`). Open sessions stay open. Like that command,
# have sshd test them first: with an error in its settings the listener would end, and no user could log in any more.
_RELOAD = """
$sudo $sshd -t || { ${undo:-:}; exit 1; };
[ -z "$listener" ] || $sudo kill -HUP "$listener"
"""


def check(session):
    """The Finding whether a dead connection ends soon."""
    good, state = _look(session)
    return finding("keep-alive", "good" if good else "ill", state=state)


def write(session):
    """Write the settings when they are missing, and have sshd read them, if the login may. Returns the Finding."""
    good, state = _look(session)
    content = TEXT.replace("\n", "\\n")
    # good by the files: the setup that wrote them may have been interrupted before it told sshd
    answer = _run(session, _RELOAD if good else _WRITE % (FILE, FILE, content, FILE) + _RELOAD)
    if good and answer.code in (0, _NOT_ROOT):
        return finding("keep-alive", "good", state=state)
    if answer.code == 0:
        good, state = _look(session)
        return finding("keep-alive", "written" if good else "without_effect", file=FILE, state=state)
    why = "this login is not root there" if answer.code == _NOT_ROOT else answer.reason()
    state += ", but could not be told to read its settings" if good else ""
    return finding("keep-alive", "not_written", file=FILE, state=state, why=why, content=content)


def _look(session):
    """(whether the settings are good, text about them)."""
    answer = _run(session, _READ)
    if answer.code == _NOT_ROOT:
        answer = session.limited("cat " + FILE, _LIMIT_S)
        if answer.code == 0 and answer.out == TEXT:
            return True, "%s is there; whether sshd has read it, only root can see there" % FILE
        return False, _ILL
    settings = dict(line.split(None, 1) for line in answer.out.splitlines() if " " in line)
    try:
        limit_s = int(settings["clientaliveinterval"]) * int(settings["clientalivecountmax"])
    except (KeyError, ValueError):
        return False, "sshd there cannot be asked for its settings: %s" % answer.reason()
    if not 0 < limit_s <= _SOON_S:
        return False, _ILL
    return True, "sshd there is set to end dead connections after %d s" % limit_s


def _run(session, script):
    """Run a script as root, after _AS_ROOT. The code of the Answer is _NOT_ROOT where the login cannot be root."""
    return session.limited(" ".join((_AS_ROOT + script).split("\n")), _LIMIT_S)  # csh quotes no line ends
