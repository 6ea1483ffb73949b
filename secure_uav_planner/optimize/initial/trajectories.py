"""Initial trajectories and powers: fly-hover-fly of Section IV, or those of an earlier plan."""

import numpy as np

from .feasibility import check_durations, find_flights
from .flights import build_flights, list_hovering_places
from .projection import find_flights_near
from ..deadline import Check
from ...errors import OptionError, TimeLimitError
from ...mission.scenario import Array, Scenario
from ...model.grid import resample
from ...model.problem import Problem
from ...plan.plan import Plan

_ROUNDING = 1e-4  # Move in m by which retract makes up for rounding errors.


def fly_hover_fly_positions(problem: Problem, check: Check = lambda: None) -> Array:
    """
    Return straight flights at full speed to a hovering place and on to the goal, (U, N+2, 2) in m.

    The transmitter hovers above the ground node, the jammers above the eavesdroppers in turn, or
    above where these are at half time if they move. A UAV without the time to reach its hovering
    place flies towards it and turns back at the last moment that still reaches the goal. Flights
    go around obstacles and keep their separation.

    :param check: called now and then in a search for flights around obstacles; what it raises is
        passed on.
    :raises InfeasibleMissionError: when no flights are found that keep the limits.
    """
    check_durations(problem.scenario, check)
    if problem.airspace.is_open:
        return build_flights(problem, list_hovering_places(problem.scenario))
    return find_flights(problem, check)


def constant_powers(scenario: Scenario, transmitting: float = 1.0,
                    jamming: float = 1.0) -> Array:
    """Return shares of the average powers in every slot, (U, N) in W."""
    shares = np.full(len(scenario.uavs), jamming)
    shares[0] = transmitting
    return np.repeat((shares * scenario.average_powers)[:, None], scenario.slots, axis=1)


def is_similar(scenario: Scenario, previous: Scenario) -> bool:
    """
    Return True if a plan for the previous scenario is a good start for a scenario.

    So it is when the same UAVs fly for about as long among positions that have moved by no more
    than the UAVs' altitude: over such distances the gains change little.
    """
    if (len(scenario.uavs) != len(previous.uavs)
            or len(scenario.eavesdroppers) != len(previous.eavesdroppers)
            or len(scenario.ground_nodes) != len(previous.ground_nodes)
            or abs(scenario.duration - previous.duration) > 0.1 * previous.duration):
        return False
    moves = _list_landmarks(scenario) - _list_landmarks(previous)
    return bool(np.linalg.norm(moves, axis=-1).max() <= scenario.altitudes.min())


def _list_landmarks(scenario: Scenario) -> Array:
    """Return starts, goals and receivers at the start, middle and end, (K, 2) in m."""
    grounds, centres, _ = scenario.receivers_at(
        [0.0, scenario.duration / 2, scenario.duration])
    return np.concatenate([scenario.starts, scenario.goals, *grounds, *centres])


def adapt_plan(problem: Problem, plan: Plan,
               check: Check = lambda: None) -> tuple[Array | None, Array]:
    """
    Return the positions and powers of a plan made feasible for another problem.

    Slots are matched by their share of the duration; new starts and goals bend the whole flight.
    What breaks limits moves to the nearest flight that keeps them; without one that clears zones,
    fence and separation, positions are None.

    :param check: as for fly_hover_fly_positions.
    :raises OptionError: when the number of UAVs differs.
    :raises InfeasibleMissionError: when a UAV has not the time from start to goal.
    """
    scenario = problem.scenario
    if len(plan.scenario.uavs) != len(scenario.uavs):
        raise OptionError(f'initial is a plan for {len(plan.scenario.uavs)} UAVs; '
                          f'it must be one for {len(scenario.uavs)}', ('initial',))
    positions = plan.positions
    if scenario.slots != plan.scenario.slots:
        # Between control points, accelerations add up in every second slot; on the curve they
        # stay.
        positions = plan.curve.at(np.linspace(0, plan.times[-1], scenario.slots + 2)).positions
    share = np.linspace(0, 1, scenario.slots + 2)
    ends = np.stack([scenario.starts, scenario.goals], axis=1) - positions[:, [0, -1]]
    positions = positions + (1 - share)[:, None] * ends[:, :1] + share[:, None] * ends[:, 1:]
    powers = resample(plan.powers.T, scenario.slots, inner=True).T
    if not problem.keeps_motion(positions):
        check_durations(scenario, check)
    retracted, powers = problem.retract(positions, powers)
    clear = problem.is_clear(retracted)
    if clear and np.abs(retracted - positions).max() < _ROUNDING:
        return retracted, powers
    try:
        feasible = find_flights_near(problem, positions, check)
    except TimeLimitError:
        if not clear:
            raise
        feasible = None
    if feasible is None and clear:
        feasible = retracted
    return feasible, powers
