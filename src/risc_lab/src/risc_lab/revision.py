"""Which commit of the workspace this is."""

import subprocess

_GIT_PATIENCE_S = 10.0


def revision(root):
    """Git revision of the workspace as text, "with changes" when it is not quite that; None when there is none."""
    head = _git(root, "rev-parse", "--short=12", "HEAD")
    if not head:
        return None
    return head + (" with changes" if _git(root, "status", "--porcelain", "--untracked-files=no") else "")


def _git(root, *arguments):
    """Output of a git command; "" when there is no git or no repository."""
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
            text=True,
            timeout=_GIT_PATIENCE_S,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
