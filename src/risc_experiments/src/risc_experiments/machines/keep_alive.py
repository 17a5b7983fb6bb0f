"""sshd's settings on another computer that end a dead connection soon: then coop.sh ends the nodes of a lost launch.

Without them the nodes run on for good when the network goes away, and a second launch starts a second set beside them.
"""

from risc_experiments.findings import green, yellow

FILE = "/etc/ssh/sshd_config.d/risc_maap.conf"
TEXT = "ClientAliveInterval 2\nClientAliveCountMax 3\n"
_LIMIT_S = 15.0
_NOT_ROOT = 77
_WELL = "sshd there ends dead connections after 6 s"
_ILL = "sshd there does not notice dead connections: the nodes of a lost launch may run on"
# As root: write the file and let the listening sshd read it (the HUP is what `systemctl reload ssh` sends; the listener
# is an ancestor of this very login, so it is found without systemd, too). Sessions that are open stay open. As that
# does, ask sshd first: with a mistake elsewhere in its settings, the listener would end, and nobody could log in.
_WRITE = """
set -e;
sudo=;
[ "$(id -u)" -eq 0 ] || { sudo -n true 2>/dev/null && sudo=sudo; } || exit %(not_root)d;
printf '%(text)s' | $sudo tee %(file)s >/dev/null;
pid=$$;
while [ "$pid" -gt 1 ]; do
  pid=$(ps -o ppid= -p "$pid" | tr -d " ");
  listener=$(ps -ww -o args= -p "$pid");
  case $listener in
    "sshd: "*" [listener]"*)
      listener=${listener#sshd: };
      $sudo ${listener%% \\[listener]*} -t || { $sudo rm %(file)s; exit 1; };
      $sudo kill -HUP "$pid";
      break;;
  esac;
done
"""
_WRITE = " ".join(_WRITE.split("\n"))  # csh quotes no line ends


def check(session):
    """The Finding whether the settings are there."""
    return green("keep-alive", _WELL) if _is_there(session) else yellow("keep-alive", _ILL, "./maap machines setup")


def write(session):
    """Write the settings when they are missing and the login may. Returns the Finding."""
    if _is_there(session):
        return green("keep-alive", _WELL)
    text = TEXT.replace("\n", "\\n")
    script = _WRITE % {"text": text, "file": FILE, "not_root": _NOT_ROOT}
    answer = session.limited(script, _LIMIT_S)
    if answer.code == 0:
        return green("keep-alive", "wrote %s there: %s" % (FILE, _WELL))
    why = "this login is not root there" if answer.code == _NOT_ROOT else answer.reason()
    line = "printf '%s' | sudo tee %s && sudo systemctl reload ssh" % (text, FILE)
    return yellow("keep-alive", "%s (%s)" % (_ILL, why), "on that computer:\n" + line)


def _is_there(session):
    answer = session.limited("cat " + FILE, _LIMIT_S)
    return answer.code == 0 and answer.out == TEXT
