"""From a scenario to a plan: the methods and the baselines."""

import time

from .feasible import adapted
from .fly_hover_fly import constant_powers, fly_hover_fly_positions
from .joint import joint
from .run import Run
from ..plan import Plan


def _alternating():
    # Here and not above: CVXPY takes a second to import, and who plans jointly does not need it.
    from .alternating import alternate
    return alternate


METHODS = {'joint': lambda: joint, 'alternating': _alternating}
"""How to get what improves a Run until it has converged or must stop, by the method's name."""


def solve(scenario, method='joint', on_iteration=None, time_limit=None, initial=None):
    """
    Plan trajectories and powers that maximise the guaranteed secrecy rate, problem (P2).

    The result is feasible and no worse than `initial`, or than fly-hover-fly with constant
    power, whatever happens on the way; `status` tells why the method stopped.

    :param scenario: a Scenario.
    :param method: one of METHODS: 'joint', positions and powers together from several starts, or
        'alternating', the paper's Section III.
    :param on_iteration: called with an Iteration after every step; returning True stops the run.
    :param time_limit: in s; past it the best feasible plan so far is returned.
    :param initial: a Plan to start from, by default fly-hover-fly with constant power. It may be
        for another scenario with as many UAVs; it is then bent to be feasible in this one.
    :return: a Plan.
    :raises ValueError: for an unknown method, a time limit that is not positive, or an initial
        plan with another number of UAVs.
    """
    if method not in METHODS:
        raise ValueError(f'method is {method!r}; it must be one of {sorted(METHODS)!r}')
    if time_limit is not None and not time_limit > 0:
        raise ValueError(f'time_limit is {time_limit!r}; it must be above 0 s, or None')
    improve = METHODS[method]()
    started = time.monotonic()
    positions, powers = (fly_hover_fly_positions(scenario), constant_powers(scenario)
                         ) if initial is None else adapted(scenario, initial)
    run = Run(scenario, positions, powers, on_iteration, time_limit, started,
              warm=initial is not None)
    status = improve(run)
    return run.plan(method, status)


def fly_hover_fly(scenario, power='constant', on_iteration=None, time_limit=None):
    """
    Return the paper's baselines: fly-hover-fly with constant or with optimised powers.

    With constant power a slot's guaranteed rate can be negative; it then counts as it is, before
    the [x]^+ of equation (R_sec).

    :param scenario: a Scenario.
    :param power: 'constant', the average power in every slot, or 'optimised', by Section III-A.
    :param on_iteration: as for solve.
    :param time_limit: as for solve.
    :return: a Plan.
    :raises ValueError: for another power.
    """
    if power not in ('constant', 'optimised'):
        raise ValueError(f"power is {power!r}; it must be 'constant' or 'optimised'")
    method = f'fly_hover_fly_{power}'
    positions, powers = fly_hover_fly_positions(scenario), constant_powers(scenario)
    if power == 'constant':
        return Plan(scenario, positions, powers, method)
    from .alternating import optimise_powers  # CVXPY, as above
    run = Run(scenario, positions, powers, on_iteration, time_limit)
    return run.plan(method, optimise_powers(run))
