"""
The joint method: positions and powers together.

Several starts are improved for problem (P2), `multistart.py`; where (P1) is the objective, the
best plans are then improved for it, `exchange.py`.
"""

from collections.abc import Callable
from functools import partial

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
    if incumbent.objective == 'guaranteed' or not incumbent.scenario.receivers.radii.any():
        return _improve_guaranteed(stepper)
    if incumbent.warm:
        return _run(improve_by_exchange, stepper)
    # The plan of (P2) is where (P1) begins, and what it is never below.
    guaranteed = Stepper(incumbent.with_objective('guaranteed'))
    plan = guaranteed.incumbent
    _improve_guaranteed(guaranteed)
    incumbent.try_improve(plan.positions, plan.useful_powers)
    status = incumbent.stop_reason()
    if status is None:
        status = _run(partial(improve_by_exchange, optima=guaranteed.optima), stepper)
        if incumbent.stop_reason() is None:
            plan.try_idle_slots()
            incumbent.try_improve(plan.positions, plan.useful_powers)
    return status


def _improve_guaranteed(stepper: Stepper) -> Status:
    """Improve the incumbent of a Stepper for (P2), or where discs are points; see improve."""
    incumbent = stepper.incumbent
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
