"""From a scenario to a plan: the methods and the baselines."""

from typing import Any, get_args

from . import joint
from .initial import constant_powers, fly_hover_fly_positions
from .search import Search
from .termination import OnIteration, Termination
from .warm_start import adapted
from ..errors import format_place, OptionError, Place, quote
from ..mission import Method, METHODS, Objective, OBJECTIVES, Power
from ..mission.scenario import Scenario
from ..mission.validation import checked_callback, checked_kind, checked_time_limit
from ..model.limits import is_open
from ..plan.plan import Plan

__all__ = ['METHODS', 'Method', 'Power', 'checked_objective', 'fly_hover_fly', 'solve']

MAX_GAINS = 500_000
"""
The most gains to eavesdroppers, slots * uavs * eavesdroppers, of the alternating method.

A deadline cannot interrupt CVXPY while it compiles a problem, which takes about a second then.
"""


def solve(scenario: Scenario, method: Method = 'joint',
          on_iteration: OnIteration | None = None, time_limit: float | None = None,
          initial: Plan | None = None, *, objective: Objective | None = None) -> Plan:
    """
    Plan trajectories and powers that maximise a secrecy rate.

    The result is feasible and no worse than `initial`, or than fly-hover-fly with constant
    power, whatever happens on the way; `status` tells why the method stopped.

    :param scenario: a Scenario.
    :param method: one of METHODS: 'joint', positions and powers together from several starts, or
        'alternating', the paper's Section III.
    :param on_iteration: called with an Iteration after every step; returning True stops the run.
        Where flights go around zones or keep a separation, it is also called between steps, some
        times a second from the beginning on, with the last Iteration, before the first with one of
        rate 0.
    :param time_limit: in s; past it the best feasible plan so far is returned.
    :param initial: a Plan to start from, by default fly-hover-fly with constant power. It may be
        for another scenario with as many UAVs; it is then bent to be feasible in this one.
    :param objective: one of plan.OBJECTIVES: 'worst_case' is the true worst case of problem (P1),
        by 'joint' only, 'guaranteed' the lower bound by formula of problem (P2). By default that
        of the initial plan, if the same method made it, or else 'worst_case' for 'joint' and
        'guaranteed' for 'alternating'.
    :return: a Plan.
    :raises OptionError: for an unknown method or objective, a scenario too large for
        'alternating' or with limits or a channel that it does not have, a time limit that is not
        positive, or an initial plan with another number of UAVs.
    :raises InfeasibleMissionError: when zones, fence or separation leave no flights in the
        duration, naming the UAV, what is in its way, and the shortest duration that was found.
    :raises StoppedError: when the run is stopped before flights around zones or apart from each
        other were found.
    :raises TimeLimitError: when the time limit is over before that.
    """
    checked_kind('scenario', scenario, Scenario)
    if initial is not None:
        checked_kind('initial', initial, Plan)
    if objective is None and initial is not None and initial.method == method:
        objective = initial.objective
    objective = checked_objective(method, objective)
    if method == 'alternating':
        _check_size(scenario)
        _check_limits(scenario)
        _check_channel(scenario)
    termination = _termination(scenario, on_iteration, time_limit)
    positions, powers = (
        fly_hover_fly_positions(scenario, termination.check), constant_powers(scenario)
        ) if initial is None else adapted(scenario, initial, termination.check)
    search = Search(scenario, positions, powers, termination, warm=initial is not None,
                    objective=objective)
    if method == 'joint':
        return search.plan(method, joint.improve(search))
    if not search.warm:
        # Powers have local optima: the result is no worse than the baseline with optimised powers.
        joint.optimise_powers(search)
    from .alternating import alternate  # Here, because CVXPY takes a second to import.
    return search.plan(method, alternate(search))


def fly_hover_fly(scenario: Scenario, power: Power = 'constant',
                  on_iteration: OnIteration | None = None,
                  time_limit: float | None = None) -> Plan:
    """
    Return the paper's baselines: fly-hover-fly with constant or with optimised powers.

    :param scenario: a Scenario.
    :param power: 'constant', the average power in every slot, or 'optimised' for these flights,
        as Section III-A does.
    :param on_iteration: as for solve.
    :param time_limit: as for solve.
    :return: a Plan.
    :raises OptionError: for another power, or a time limit that is not positive.
    :raises InfeasibleMissionError: as for solve, as StoppedError and TimeLimitError are.
    """
    checked_kind('scenario', scenario, Scenario)
    if power not in get_args(Power):
        raise OptionError(f"power is {quote(power)}; it must be 'constant' or 'optimised'")
    method = f'fly_hover_fly_{power}'
    termination = _termination(scenario, on_iteration, time_limit)
    positions = fly_hover_fly_positions(scenario, termination.check)
    powers = constant_powers(scenario)
    if power == 'constant':
        return Plan(scenario, positions, powers, method, 'converged')
    search = Search(scenario, positions, powers, termination)
    return search.plan(method, joint.optimise_powers(search))


def _termination(scenario: Scenario, on_iteration: OnIteration | None,
                 time_limit: float | None) -> Termination:
    time_limit = checked_time_limit(time_limit)
    checked_callback('on_iteration', on_iteration)
    return Termination(on_iteration, time_limit, not is_open(scenario))


def checked_objective(method: str, objective: str | None = None) -> Objective:
    """
    Return what a method is to maximise; without an objective, its own.

    :raises OptionError: when there is no such method or objective, or not together.
    """
    if method not in METHODS:
        raise OptionError(f'method is {quote(method)}; it must be one of {sorted(METHODS)!r}')
    if objective is None:
        return 'guaranteed' if method == 'alternating' else 'worst_case'
    if objective not in OBJECTIVES:
        raise OptionError(f'objective is {quote(objective)}; it must be one of {OBJECTIVES}')
    if method == 'alternating' and objective != 'guaranteed':
        raise OptionError(f"objective is {quote(objective)}; the method 'alternating' has only "
                          "'guaranteed'")
    return objective


def _check_size(scenario: Scenario) -> None:
    gains = scenario.slots * len(scenario.uavs) * len(scenario.eavesdroppers)
    if gains > MAX_GAINS:
        raise OptionError(
            f"method is 'alternating'; it takes at most {MAX_GAINS} slots * uavs * eavesdroppers, "
            f"and this scenario has {gains}: use 'joint'")


def _check_limits(scenario: Scenario) -> None:
    limits: dict[Place, Any] = {
        ('no_fly_zones',): scenario.no_fly_zones, ('geofence',): scenario.geofence,
        ('separation',): scenario.separation,
        **{('uavs', number, 'max_acceleration'): uav.max_acceleration
           for number, uav in enumerate(scenario.uavs)}}
    for place, limit in limits.items():
        if limit:
            raise OptionError(
                "method is 'alternating'; it has the paper's limits, of speed and power, and this "
                f"scenario has {format_place(place)}: use 'joint'", place)


def _check_channel(scenario: Scenario) -> None:
    channel = scenario.channel
    if not channel.is_inverse_square:
        raise OptionError(
            f"method is 'alternating'; its convex restriction holds for a channel of exponent 2 "
            f'and a line of sight everywhere, and this one has the exponent {channel.exponent:g} '
            f"and los {quote(channel.los)}: use 'joint'")
    if scenario.colluding:
        raise OptionError("method is 'alternating'; it counts with the best single eavesdropper, "
                          "and the scenario is colluding: use 'joint'")
