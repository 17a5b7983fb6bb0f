"""Which estimator a flight has: the one that is named, or the one that belongs to its controller."""

from risc_estimation.filters import DEFAULT, REGISTRY

# Who measures the thesis measures all of it: with a filter without delay its controller errs half as much.
OF_CONTROLLER = {"thesis_lqr": "thesis"}


def add_option(add):
    """Give a parser the option --estimator; `estimator_of` says what it means. add: its add_argument."""
    add(
        "--estimator",
        choices=REGISTRY.names(),
        metavar="NAME",
        help="velocity filter: %s (default: %s; the thesis' controller flies with the thesis' own)"
        % (", ".join(REGISTRY.names()), DEFAULT),
    )


def estimator_of(controller, named=None):
    """Name of the filter of a flight with this controller. named: what the user asked for, None = nothing."""
    return named or OF_CONTROLLER.get(controller, DEFAULT)
