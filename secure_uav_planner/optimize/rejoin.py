"""
Where a replan begins, and how the setpoints get there.

The path of the last plan stays as it is up to a point `first`. From there it leads each UAV that
is off its plan to the place where that UAV will be, within the limits of speed and acceleration,
so that setpoints never jump; at `point` both are there, with the same velocity, and the replan
begins. A UAV that will be back on its plan by then stays on it. `point` is the soonest for which
all UAVs can do so and can reach their goals from there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from .search import without_losing_slots
from ..errors import InfeasibleMissionError, PlanError, ScenarioError
from ..mission.kinematics import clip_norm
from ..mission.scenario import Array, Eavesdropper, Point, Scenario, Uav
from ..plan.plan import Plan
from ..plan.playback import Playback
from ..plan.tracking import deviation, MeasuredState, predict_return

_GROWTH = 1.25  # Of the numbers of slots that are tried for the way to the UAVs.


@dataclass(frozen=True)
class Rejoin:
    """
    The beginning of a replan.

    :param plan: the plan that it continues.
    :param first: the last point of its path that stays as it is.
    :param point: the point at which the replan begins.
    :param positions: the path up to there, (U, point + 1, 2) in m.
    :param powers: likewise, (U, point) in W.
    :param tail: the rest of the last plan, as a start for solve.
    :param scenario: what is left of the mission.
    """

    plan: Plan
    first: int
    point: int
    positions: Array
    powers: Array
    tail: Plan
    scenario: Scenario

    @property
    def effect(self) -> float:
        """When the curve leaves that of the last plan, in s from point 0."""
        return (self.first - _lead_in(self.plan.scenario)) * self.plan.scenario.slot_duration

    def continued(self, found: Plan) -> Plan:
        """Return the plan of the whole mission, of which one for the scenario was found."""
        return self.plan.continued(self.point, found, (self.positions, self.powers))


def first_point(scenario: Scenario, time: float) -> int:
    """Return the first point that can change without changing the curve before a time in s."""
    return max(0, math.ceil(time / scenario.slot_duration + _lead_in(scenario)))


def find_rejoin(plan: Plan, first: int, states: Sequence[MeasuredState | None],
                tolerance: float, ground_node: Point, eavesdroppers: tuple[Eavesdropper, ...]
                ) -> Rejoin:
    """
    Return the beginning of a replan from where the UAVs will be.

    :param first: the last point of the plan's path that must stay, from 0 to slots - 1.
    :param states: where each UAV is; None for one that counts as on its plan.
    :param tolerance: the distance in m from the plan within which a UAV counts as on it.
    :param ground_node: as it is now, as the eavesdroppers are.
    :raises InfeasibleMissionError: when a UAV cannot be met, or not reach its goal from there.
    """
    tail = plan.tail(first)
    now = replace(tail.scenario, ground_node=ground_node, eavesdroppers=eavesdroppers)
    ways = _ways(plan, first, tail.scenario, states, tolerance)
    if not ways:
        return Rejoin(plan, first, first, plan.positions[:, :first + 1], plan.powers[:, :first],
                      tail, now)
    reason: ScenarioError | PlanError | None = None
    for point in _candidates(first, plan.scenario.slots):
        found = {uav: way.to(point) for uav, way in ways.items()}
        paths = {uav: path for uav, path in found.items() if path is not None}
        if len(paths) < len(found):
            continue
        try:
            beginning = _begun(plan, first, point, paths, now)
            _check_way(beginning, now)
            return beginning
        except (ScenarioError, PlanError) as error:
            reason = reason or error  # A later point may be better.
    far = ', '.join(f'{plan.scenario.uavs[uav].name} ({way.distance:.1f} m from it)'
                    for uav, way in ways.items())
    raise InfeasibleMissionError(
        f'the plan cannot be continued from where the UAVs are: {far} cannot be met within all '
        'limits in time for the goal' + (f'; {reason}' if reason is not None else ''))


def _begun(plan: Plan, first: int, point: int, paths: dict[int, Array], now: Scenario) -> Rejoin:
    """Return the Rejoin at a point with other paths of some UAVs, each (point + 1, 2)."""
    tail, step = plan.tail(point), plan.scenario.slot_duration
    positions, uavs = plan.positions[:, :point + 1].copy(), list(tail.scenario.uavs)
    for index, path in paths.items():
        positions[index] = path
        uavs[index] = replace(
            uavs[index], start=_point(path[-1]), start_velocity=clip_norm(
                *_point((path[-1] - path[-2]) / step), uavs[index].max_speed))
    scenario = replace(tail.scenario, uavs=tuple(uavs), ground_node=now.ground_node,
                       eavesdroppers=now.eavesdroppers)
    powers = plan.powers[:, :point].copy()
    if point > first:
        # On the way the powers stay, except that nothing is sent where it would only leak.
        powers[:, first:] = without_losing_slots(
            scenario, np.pad(positions[:, first:], ((0, 0), (0, 1), (0, 0))),
            powers[:, first:], plan.objective)[0]
    return Rejoin(plan, first, point, positions, powers, tail, scenario)


def _check_way(beginning: Rejoin, now: Scenario) -> None:
    """Check all limits between the points at which the path and the replan begin to differ."""
    positions = beginning.positions[:, beginning.first:]
    slots = positions.shape[1] - 2
    if slots < 1:
        return
    uavs = tuple(replace(uav, goal=_point(path[-1]), goal_velocity=None)
                 for uav, path in zip(now.uavs, positions, strict=True))
    Plan(replace(now, uavs=uavs, slots=slots, duration=slots * now.slot_duration), positions,
         np.zeros((len(uavs), slots)))


class _Way:
    """The way of one UAV's path from a point of the plan to the UAV."""

    def __init__(self, playback: Playback, uav: int, first: int, begin: Uav,
                 state: MeasuredState, tolerance: float) -> None:
        self._path, self._first, self._begin = playback.plan.positions[uav], first, begin
        self._step = playback.plan.scenario.slot_duration
        self._tolerance = tolerance
        self._points = _candidates(first, playback.plan.scenario.slots)
        self._smooth = begin.max_acceleration is not None
        times = (np.array(self._points) - (0.5 if self._smooth else 0.0)) * self._step
        self._states = predict_return(playback, uav, state, times)
        self._planned = playback.curve.at(times).positions[uav]
        self.distance = math.hypot(*deviation(playback, uav, state))

    def stays(self, index: int) -> bool:
        """Return whether the UAV is back on its plan at one of the candidates."""
        return math.dist(self._states[0][index], self._planned[index]) <= self._tolerance

    def to(self, point: int) -> Array | None:
        """Return the path up to a point, (point + 1, 2) in m, or None if it cannot be flown."""
        index = self._points.index(point)
        if self.stays(index):
            return self._path[:point + 1]
        position, velocity = (state[index] for state in self._states)
        end = position[None]
        if self._smooth:
            # A state is two control points, half a slot before and after it.
            move = np.array(clip_norm(*_point(velocity), self._begin.max_speed))
            move *= self._step / 2
            end = np.stack([position - move, position + move])
        slots = point - self._first - len(end)
        if slots < 0:
            return None
        begin = self._path[self._first]
        vehicle = replace(self._begin.vehicle, displacement=_point(end[0] - begin))
        if self._smooth:
            vehicle = replace(vehicle, goal_velocity=_point(2 * move / self._step))
        if math.hypot(*vehicle.displacement) > (slots + 1) * self._step * vehicle.max_speed:
            return None
        effort, points = vehicle.least_effort(slots, self._step)
        if effort > 1:
            return None
        return np.concatenate([self._path[:self._first], begin + points, end[1:]])


def _ways(plan: Plan, first: int, now: Scenario, states: Sequence[MeasuredState | None],
          tolerance: float) -> dict[int, _Way]:
    """Return the ways of the UAVs that are not back on their plan at the first point."""
    if first == 0 or all(state is None for state in states):
        return {}  # Nobody flies yet, or nobody is seen.
    playback = Playback(plan)
    ways = {uav: _Way(playback, uav, first, now.uavs[uav], state, tolerance)
            for uav, state in enumerate(states) if state is not None}
    return {uav: way for uav, way in ways.items() if not way.stays(0)}


def _candidates(first: int, slots: int) -> list[int]:
    """Return the points at which a replan may begin."""
    found, step = [first], 1.0
    while found[-1] + 1 < slots:
        found.append(min(slots - 1, found[-1] + math.floor(step)))
        step *= _GROWTH
    return found


def _lead_in(scenario: Scenario) -> float:
    """Return how many slots before a point the curve begins to depend on it."""
    # The point after the last one that stays moves the curve from half a slot before that.
    return 0.5 if np.isfinite(scenario.max_accelerations).any() else 0.0


def _point(vector: Array) -> Point:
    x, y = vector.tolist()
    return (x, y)
