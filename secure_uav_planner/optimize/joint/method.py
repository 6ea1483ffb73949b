"""
The joint method: positions and powers together.

Several starts are improved for problem (P2), `multistart.py`; the best plan is then improved for
problem (P1), `exchange.py`, where that is the objective.
"""

from collections.abc import Callable

import numpy as np

from .exchange import improve_by_exchange
from .multistart import improve_from_several_starts, improve_present
from .powers import improve_powers
from .stepper import Stepper, Stop
from ..search import Search
from ...errors import NumericalError
from ...model.limits import is_open
from ...plan.plan import Status


def improve(search: Search) -> Status:
    """
    Improve a Search by the joint method until it has converged or must stop; return its status.

    Whatever happens, the search keeps the best feasible iterate.

    :param search: a Search; when `warm`, its present plan is the only start.
    """
    stepper = Stepper(search)
    if search.objective == 'worst_case' and search.scenario.error_radii.any():
        if not search.warm:
            # The plan of (P2) is where (P1) begins, and what it is never below.
            guaranteed = search.with_objective('guaranteed')
            improve(guaranteed)
            search.try_improve(guaranteed.positions, guaranteed.useful_powers)
            reason = search.stop_reason()
            if reason is not None:
                return reason
        return _until_stopped(improve_by_exchange, stepper)
    if search.warm:
        return _until_stopped(improve_present, stepper)
    if not is_open(search.scenario):
        # Where few flights are tried, none of them need be better than the baseline's.
        optimise_powers(search)
    return _until_stopped(improve_from_several_starts, stepper)


def optimise_powers(search: Search) -> Status:
    """Improve only the powers of a Search, as improve does all; return its status."""
    return _until_stopped(improve_powers, Stepper(search))


def _until_stopped(improve: Callable[[Stepper], Status], stepper: Stepper) -> Status:
    """Return the status in which a part of the method ends."""
    try:
        return improve(stepper)
    except Stop as stop:
        return stop.status
    except (NumericalError, np.linalg.LinAlgError):
        return 'numerical_trouble'
