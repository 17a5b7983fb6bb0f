"""Choice of a flight's estimator: the named one, or the one that belongs to its controller."""

from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_estimation.filters import DEFAULT, REGISTRY


def add_option(add):
    """Add the option --estimator to a parser; `estimator_of` evaluates it. add: the parser's add_argument."""
    add(
        "--estimator",
        choices=REGISTRY.names(),
        metavar="NAME",
        help="velocity filter: %s (default: the controller's, else %s)" % (", ".join(REGISTRY.names()), DEFAULT),
    )


def estimator_of(controller, named=None):
    """Name of the filter of a flight with this controller. named: what the user asked for, None = nothing.

    Raises ValueError for an unknown controller.
    """
    return named or CONTROLLERS.module(controller).Controller.ESTIMATOR or DEFAULT
