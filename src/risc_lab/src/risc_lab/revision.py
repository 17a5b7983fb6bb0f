"""Which commit of the workspace this is."""

import subprocess

_GIT_PATIENCE_S = 10.0


def revision(root):
    """Git revision of the workspace as text, "with changes" when it is not quite that; None when there is none."""
    git = ["git", "-C", str(root), "describe", "--always", "--exclude=*", "--abbrev=12", "--dirty= with changes"]
    try:
        done = subprocess.run(git, capture_output=True, stdin=subprocess.DEVNULL, text=True, timeout=_GIT_PATIENCE_S)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None
