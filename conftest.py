"""For all tests: the first tier and the second, which only --all runs; what runs side by side, and in which order; and
no stopwatch on what hypothesis makes up.
"""

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadFileScheduling

FIRST, SECOND = "first tier", "second tier"  # of tests, for hypothesis
ROSTESTS = "test_ros.py"  # these run last, when no flight is under way beside them any more
LEFT = pytest.StashKey[int]()  # how many tests are left for --all

# neither an example nor making one up has a limit; the first tier tries the same ones every time
NO_STOPWATCH = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile(FIRST, derandomize=True, **NO_STOPWATCH)
settings.register_profile(SECOND, max_examples=1000, **NO_STOPWATCH)


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="also what is marked `release`, and fuzzers try more")


def pytest_configure(config):
    settings.load_profile(SECOND if config.getoption("all") else FIRST)


@pytest.fixture(scope="session")
def inputs(request):
    """inputs(few, many): how many inputs a fuzzer tries; many with --all."""
    return lambda few, many: many if request.config.getoption("all") else few


class _FilesAndRostests(LoadFileScheduling):
    """A process runs a file at a time, whose tests may share a fixture; of rostests, which are long, one."""

    def _split_scope(self, nodeid):
        return nodeid if ROSTESTS + "::" in nodeid else super()._split_scope(nodeid)


def pytest_xdist_make_scheduler(config, log):
    return _FilesAndRostests(config, log)


@pytest.hookimpl(trylast=True)  # what -k and -m leave out is not counted
def pytest_collection_modifyitems(config, items):
    items.sort(key=lambda item: item.path.name == ROSTESTS)
    if config.getoption("all"):
        return
    left = [item for item in items if item.get_closest_marker("release")]
    config.stash[LEFT] = len(left)
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if not item.get_closest_marker("release")]


def pytest_sessionfinish(session):
    if hasattr(session.config, "workeroutput"):  # one of several side by side: who reports has collected nothing
        session.config.workeroutput["left"] = session.config.stash.get(LEFT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    node.config.stash[LEFT] = getattr(node, "workeroutput", {}).get("left", 0)  # equal for all of them


def pytest_terminal_summary(terminalreporter, config):
    left = config.stash.get(LEFT, 0)
    if left:
        terminalreporter.write_line("%d more tests: ./maap test --all" % left)
