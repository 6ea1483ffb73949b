"""
The joint method: positions and powers together.

Several starts are improved for problem (P2), `multistart.py`; where (P1) is the objective, the
best plan is then improved for it, `exchange.py`.
"""

from collections.abc import Callable

import numpy as np

from .barrier import Stepper, Stop
from .exchange import improve_by_exchange
from .multistart import improve_by_multistart, improve_incumbent, improve_powers
from ..incumbent import Incumbent
from ...errors import NumericalError
from ...model.limits import is_open
from ...plan.plan import Status


def improve(incumbent: Incumbent) -> Status:
    """
    Improve an Incumbent by the joint method until it has converged or must stop.

    :param incumbent: when `warm`, it is the only start.
    :return: the status.
    """
    stepper = Stepper(incumbent)
    if incumbent.objective == 'worst_case' and incumbent.scenario.receivers.radii.any():
        if not incumbent.warm:
            # The plan of (P2) is where (P1) begins, and what it is never below.
            guaranteed = incumbent.with_objective('guaranteed')
            improve(guaranteed)
            incumbent.try_improve(guaranteed.positions, guaranteed.useful_powers)
            reason = incumbent.stop_reason()
            if reason is not None:
                return reason
        return _run(improve_by_exchange, stepper)
    if incumbent.warm:
        return _run(improve_incumbent, stepper)
    if not is_open(incumbent.scenario):
        # So few flights are tried there that all may be worse than the baseline's.
        optimise_powers(incumbent)
    return _run(improve_by_multistart, stepper)


def optimise_powers(incumbent: Incumbent) -> Status:
    """Improve only the powers of an Incumbent; return the status."""
    return _run(improve_powers, Stepper(incumbent))


def _run(part: Callable[[Stepper], Status], stepper: Stepper) -> Status:
    """Run a part of the method; return the status in which it ends."""
    try:
        return part(stepper)
    except Stop as stop:
        return stop.status
    except (NumericalError, np.linalg.LinAlgError):
        return 'numerical_trouble'
