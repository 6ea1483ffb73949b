"""From a scenario to a plan: the two methods by name, and the baselines."""

from contextlib import suppress
import math
from typing import Any, get_args

from . import joint
from .deadline import Deadline, OnIteration, run_to_end
from .incumbent import Incumbent
from .initial import adapt_plan, constant_powers, fly_hover_fly_positions
from .node_order import find_common_start, order_nodes, reorder_nodes, restore_nodes
from ..errors import (
    FieldPath, format_path, name_missing_package, OptionError, PlanningError, quote)
from ..mission import Method, METHODS, Objective, OBJECTIVES, Power
from ..mission.fields import check_argument, Choice
from ..mission.scenario import Array, Scenario
from ..mission.validation import checked_callback, checked_kind, checked_time_limit
from ..model.channel.links import has_free_space_links
from ..model.problem import Problem
from ..plan.plan import Plan, Status

__all__ = ['METHODS', 'Method', 'Power', 'check_objective', 'fly_hover_fly', 'solve']

MAX_GAINS = 50_000
"""
Largest slots * uavs * eavesdroppers that the alternating method accepts.

A deadline cannot interrupt CVXPY while it compiles a problem, which takes two seconds at this
size.
"""

_PERIOD = 0.05  # Longest time [s] between calls of the callback in a search for flights.


def solve(scenario: Scenario, method: Method = 'joint',
          on_iteration: OnIteration | None = None, time_limit: float | None = None,
          initial: Plan | None = None, *, objective: Objective | None = None) -> Plan:
    """
    Plan trajectories and powers that maximise a secrecy rate.

    The result is feasible and no worse than `initial`, or than fly-hover-fly with constant
    power, whatever happens; `status` says why the method stopped.

    :param scenario: a Scenario.
    :param method: one of METHODS: 'joint', positions and powers together from several starts, or
        'alternating', the paper's Section III.
    :param on_iteration: called with an Iteration after every step; returning True stops the run.
        In a mission with zones, a fence or a separation it is also called several times a second
        between steps, with the last Iteration. Before the first step this Iteration has rate 0.
    :param time_limit: time [s] after which the best feasible plan so far is returned.
    :param initial: a Plan to start from, by default fly-hover-fly with constant power. It may be
        for another scenario with as many UAVs. It is then made feasible in this scenario, and
        'joint' also plans from scratch if the time limit leaves time for it.
    :param objective: one of plan.OBJECTIVES: 'worst_case' is the true worst case of problem (P1),
        which only 'joint' has; 'guaranteed' is the lower bound by formula of problem (P2). By
        default it is the objective of the initial plan if the same method made this plan.
        Otherwise it is 'worst_case' for 'joint' and 'guaranteed' for 'alternating'.
    :return: a Plan.
    :raises OptionError: for an unknown method or objective, a scenario too large for
        'alternating' or with limits or a channel that it does not have, a time limit that is not
        positive, or an initial plan with another number of UAVs.
    :raises InfeasibleMissionError: when speed, acceleration, zones, fence or separation leave no
        flights in the duration, naming the UAV, what is in its way, and the shortest duration
        found; or when no flights within max_energy are found, naming the least energy found.
    :raises StoppedError: when the run is stopped before flights were found that keep these limits.
    :raises TimeLimitError: when the time limit is over before flights were found that keep these
        limits.
    :raises MissingPackageError: when 'alternating' is asked for, and CVXPY is not installed.
    """
    checked_kind('scenario', scenario, Scenario)
    if initial is not None:
        checked_kind('initial', initial, Plan)
    if objective is None and initial is not None and initial.method == method:
        objective = initial.objective
    objective = check_objective(method, objective)
    if method == 'alternating':
        _check_scope(scenario)
        with name_missing_package():
            from .alternating import alternate  # Here, because CVXPY takes a second to import.
    # Nodes are planned in a canonical order, so that a plan does not depend on the scenario's, and
    # without a common head start.
    order = order_nodes(scenario)
    problem = Problem(reorder_nodes(scenario, order))
    deadline = _build_deadline(problem, on_iteration, time_limit)
    # The start is the initial plan, made feasible, or fly-hover-fly.
    positions, powers, baseline = None, constant_powers(scenario), None
    if initial is not None:
        positions, powers = adapt_plan(problem, initial, deadline.raise_if_over)
    if positions is None:
        positions = baseline = fly_hover_fly_positions(problem, deadline.raise_if_over)
    incumbent = Incumbent(problem, positions, powers, deadline, warm=initial is not None,
                          objective=objective, common_start=find_common_start(scenario))
    if method == 'joint':
        status = joint.improve(incumbent)
        if initial is not None and initial.scenario != scenario:
            status = _improve_from_scratch(incumbent, status, baseline)
        return restore_nodes(incumbent.to_plan(method, status), scenario, order)
    if not incumbent.warm:
        # Powers have local optima: the result is no worse than the baseline with optimised powers.
        joint.optimise_powers(incumbent)
    return incumbent.to_plan(method, run_to_end(alternate, incumbent))


def _improve_from_scratch(incumbent: Incumbent, status: Status, baseline: Array | None) -> Status:
    """
    Plan from scratch if time is left; keep the better plan in an Incumbent, and return its status.

    :param status: status of the present plan; 'cancelled' replaces it if the callback cancels.
    :param baseline: fly_hover_fly_positions, or None if they are not yet computed.
    """
    problem, deadline = incumbent.problem, incumbent.deadline
    with suppress(PlanningError):  # The incumbent's plan is an answer without them.
        deadline.raise_if_over()
        if baseline is None:
            baseline = fly_hover_fly_positions(problem, deadline.raise_if_over)
        cold = Incumbent(problem, baseline, constant_powers(problem.scenario), deadline,
                         objective=incumbent.objective, parent=incumbent)
        cold_status = joint.improve(cold)
        if not deadline.poll():
            cold.try_idle_slots()
        if incumbent.try_improve(cold.positions, cold.useful_powers) > 0:
            return cold_status
    return 'cancelled' if deadline.is_cancelled else status


def fly_hover_fly(scenario: Scenario, power: Power = 'constant',
                  on_iteration: OnIteration | None = None,
                  time_limit: float | None = None) -> Plan:
    """
    Return the paper's baselines: fly-hover-fly with constant or with optimised powers.

    :param scenario: a Scenario.
    :param power: 'constant' for the average power in every slot, or 'optimised' for the powers
        that problem (11) of Section III-A asks for on these flights.
    :param on_iteration: as for solve.
    :param time_limit: as for solve.
    :return: a Plan.
    :raises OptionError: for another power, or a time limit that is not positive.
    :raises InfeasibleMissionError: as for solve.
    :raises StoppedError: as for solve.
    :raises TimeLimitError: as for solve.
    :raises PlanError: when fly-hover-fly takes more than max_energy.
    """
    checked_kind('scenario', scenario, Scenario)
    check_argument('power', power, Choice(get_args(Power)))
    method = f'fly_hover_fly_{power}'
    problem = Problem(scenario)
    deadline = _build_deadline(problem, on_iteration, time_limit)
    positions = fly_hover_fly_positions(problem, deadline.raise_if_over)
    powers = constant_powers(scenario)
    if power == 'constant':
        return Plan(scenario, positions, powers, method, 'converged')
    incumbent = Incumbent(problem, positions, powers, deadline)
    return incumbent.to_plan(method, joint.optimise_powers(incumbent))


def _build_deadline(problem: Problem, on_iteration: OnIteration | None,
                    time_limit: float | None) -> Deadline:
    """Return the Deadline of a call; raise OptionError for a wrong callback or time limit."""
    time_limit = checked_time_limit(time_limit)
    checked_callback('on_iteration', on_iteration)
    return Deadline(on_iteration, time_limit, math.inf if problem.airspace.is_open else _PERIOD)


def check_objective(method: str, objective: str | None = None) -> Objective:
    """
    Return an objective that a method has; without one, the default of the method.

    :raises OptionError: for an unknown method or objective, or an objective that the method does
        not have.
    """
    check_argument('method', method, Choice(METHODS))
    if objective is None:
        return 'guaranteed' if method == 'alternating' else 'worst_case'
    if method == 'alternating' and objective != 'guaranteed':
        raise OptionError(f"objective is {quote(objective)}; the method 'alternating' has only "
                          "'guaranteed'", ('objective',))
    return check_argument('objective', objective, Choice(OBJECTIVES))


def _check_scope(scenario: Scenario) -> None:
    """Raise OptionError, naming the field, for a scenario that 'alternating' cannot plan."""
    limits: dict[FieldPath, Any] = {
        ('no_fly_zones',): scenario.no_fly_zones, ('geofence',): scenario.geofence,
        ('separation',): scenario.separation,
        **{('uavs', number, field): getattr(uav, field)
           for field in ('max_energy', 'max_acceleration')
           for number, uav in enumerate(scenario.uavs)}}
    channel = scenario.channel
    gains = scenario.slots * len(scenario.uavs) * len(scenario.eavesdroppers)
    path: FieldPath = ()  # The field of the scenario that the method cannot plan.
    nodes = len(scenario.ground_nodes)
    if nodes > 1:
        path = ('ground_nodes',)
        reason = ('its objective is the mean rate of a single ground node, and this scenario has '
                  f'{nodes} ground_nodes')
    elif gains > MAX_GAINS:
        reason = (f'it takes at most {MAX_GAINS} slots * uavs * eavesdroppers, and this scenario '
                  f'has {gains}')
    elif path := next((path for path, limit in limits.items() if limit), ()):
        reason = ("it has the paper's limits, of speed and power, and this scenario has "
                  f'{format_path(path)}')
    elif not has_free_space_links(scenario):
        reason = (
            'its convex restriction holds for a channel of exponent 2 and a line of sight '
            f'everywhere, and this one has the exponent {channel.exponent:g} and los '
            f'{quote(channel.los)}')
    elif scenario.colluding:
        reason = 'it counts with the best single eavesdropper, and the scenario is colluding'
    else:
        return
    raise OptionError(f"method is 'alternating'; {reason}: use 'joint'", path)
