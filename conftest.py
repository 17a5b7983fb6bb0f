"""Pytest set-up of all tests: two tiers, the second only with --all; seeds; and no time limits for hypothesis."""

import gc

import pytest
from hypothesis import HealthCheck, settings

FIRST, SECOND = "first tier", "second tier"  # names of hypothesis profiles
LEFT = pytest.StashKey[int]()  # how many tests are left for --all

# no time limit for running or generating an example; the first tier tries the same examples every time
NO_STOPWATCH = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile(FIRST, derandomize=True, **NO_STOPWATCH)
settings.register_profile(SECOND, max_examples=1000, **NO_STOPWATCH)


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="also what is marked `release`, and fuzzers try more")
    parser.addoption("--pass", type=int, default=1, dest="number", help="of `./maap test --repeat`: see `seed`")


def pytest_configure(config):
    settings.load_profile(SECOND if config.getoption("all") else FIRST)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Keep the garbage collector off the tests: they live all session, and scanning them takes a fifth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session")
def inputs(request):
    """inputs(few, many): how many inputs a fuzzer tries; many with --all."""
    return lambda few, many: many if request.config.getoption("all") else few


@pytest.fixture(scope="session")
def seed(request):
    """seed(usual): a seed for what must hold whatever the seed: the usual one, and another in each pass of --repeat."""
    return lambda usual: usual + 1000 * (request.config.getoption("number") - 1)


@pytest.hookimpl(trylast=True)  # what -k and -m leave out is not counted
def pytest_collection_modifyitems(config, items):
    if config.getoption("all"):
        return
    left = [item for item in items if item.get_closest_marker("release")]
    config.stash[LEFT] = len(left)
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if not item.get_closest_marker("release")]


def pytest_sessionfinish(session):
    if hasattr(session.config, "workeroutput"):  # an xdist worker: the controller, which reports, has collected nothing
        session.config.workeroutput["left"] = session.config.stash.get(LEFT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    node.config.stash[LEFT] = getattr(node, "workeroutput", {}).get("left", 0)  # equal for all workers


def pytest_terminal_summary(terminalreporter, config):
    left = config.stash.get(LEFT, 0)
    if left:
        terminalreporter.write_line("%d more tests: ./maap test --all" % left)
