"""The missions that are flown, and the events on the way."""

from dataclasses import dataclass, replace
from itertools import count

from benchmarks.missions import random_mission
from secure_uav_planner.errors import InfeasibleMissionError
from secure_uav_planner.mission.scenario import Scenario

_RANDOM_LIMIT = 3.0

AT_ONCE = ((-1.0, 'replay/start'),)
"""The call that releases a plan so early that it begins at its time."""


@dataclass(frozen=True)
class Event:
    """An event of a flight; times are in s from point 0 of the first plan."""

    name: str  # In the table.
    calls: tuple[tuple[float, str], ...] = AT_ONCE  # Times, and the services called then.
    push: tuple[float, float] | None = None  # Begin and end of a squall that pushes UAV 0.


EVENTS = {
    'release': Event('released 4 s late', ((4.0, 'replay/start'),)),
    'pause': Event('paused at 30 s for 8 s', (
        *AT_ONCE, (30.0, 'replay/pause'), (38.0, 'replay/start'))),
    'push': Event('uav1 pushed 60 m aside at 30 s', push=(30.0, 33.5)),
    'plan': Event('new plan at 40 s', (*AT_ONCE, (40.0, 'planner/plan'))),
}


def limit_acceleration(scenario, most):
    """Return a scenario with an acceleration limit in m/s^2 and UAVs at rest at both ends."""
    return replace(scenario, uavs=tuple(
        replace(uav, max_acceleration=most, start_velocity=(0.0, 0.0), goal_velocity=(0.0, 0.0))
        for uav in scenario.uavs))


def paper_missions():
    """Yield names and Scenarios of the paper's mission."""
    for duration in (120.0, 200.0):
        for most in (2.0, 3.0):
            yield (f"the paper's, T = {duration:g} s, {most:g} m/s^2",
                   limit_acceleration(Scenario.paper(duration), most))


def random_missions(number):
    """Yield names and Scenarios of random missions, those of the first seeds that can be flown."""
    seeds = count()
    while number > 0:
        seed = next(seeds)
        try:
            scenario = limit_acceleration(random_mission(seed), _RANDOM_LIMIT)
        except InfeasibleMissionError:
            continue
        number -= 1
        yield (f'random {seed}, {len(scenario.uavs)} UAVs, up to {max(scenario.max_speeds):.0f} '
               f'm/s, {_RANDOM_LIMIT:g} m/s^2', scenario)


def event_mission():
    """Return the Scenario of the flights with events."""
    return limit_acceleration(Scenario.paper(120.0), 2.0)
