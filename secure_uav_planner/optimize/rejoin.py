"""
The beginning of a replan, and the path of the setpoints to it.

The path of the last plan is kept up to and including the point `last_kept`. From there, the path
of each UAV that is off its plan leads to the predicted state of this UAV at `point`, within the
limits of speed and acceleration, so that setpoints never jump. A UAV that will be back on its
plan at `point` stays on its plan. `point` is the first candidate at which all UAVs can be met and
from which they can reach their goals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from .incumbent import mute_negative_slots
from ..errors import InfeasibleMissionError, PlanError, ScenarioError
from ..mission.kinematics import clip_norm, UTILISATION_TOLERANCE
from ..mission.scenario import Array, Point, Scenario, Uav
from ..model.channel.rates import find_head_starts
from ..model.cone_program import LeastFlights, minimise_utilisation
from ..model.limits import reduce_budgets
from ..plan.plan import Plan
from ..plan.playback import Playback
from ..plan.splice import continue_plan, cut_tail, move_receivers
from ..plan.tracking import deviation, MeasuredState, predict_return, predict_stop

_GROWTH = 1.25  # Ratio of successive distances [slots] between points that are tried.


@dataclass(frozen=True)
class Rejoin:
    """
    The beginning of a replan.

    :param plan: the last plan, which the replan continues.
    :param last_kept: index of the last point of the last plan's path that is kept.
    :param point: the point at which the replan begins.
    :param positions: path from the last plan's start to `point`, (U, point + 1, 2) in m.
    :param powers: powers of the slots before `point`, (U, point) in W.
    :param tail: the rest of the last plan from `point`, as a start for solve.
    :param scenario: the rest of the mission, which the replan solves.
    """

    plan: Plan
    last_kept: int
    point: int
    positions: Array
    powers: Array
    tail: Plan
    scenario: Scenario

    @property
    def effect(self) -> float:
        """Time [s] from point 0 at which the new curve leaves the last plan's curve."""
        scenario = self.plan.scenario
        return (self.last_kept - _find_support_offset(scenario)) * scenario.slot_duration

    def splice(self, replan: Plan) -> Plan:
        """
        Return a plan of the whole mission: the last plan, the path to `point` and a replan.

        :param replan: a Plan of `scenario`.
        """
        return continue_plan(
            self.plan, self.point, replan, (self.positions, self.powers), self.last_kept)


def find_last_kept_point(scenario: Scenario, time: float) -> int:
    """
    Return the index of the last point that must be kept so that the curve before `time` stays.

    All later points may change. The time is from point 0 [s].
    """
    return max(0, math.ceil(time / scenario.slot_duration + _find_support_offset(scenario)))


def find_rejoin(plan: Plan, last_kept: int, states: Sequence[MeasuredState | None],
                tolerance: float, updated: Scenario) -> Rejoin:
    """
    Return the beginning of a replan at the first candidate point at which all UAVs can be met.

    A UAV off its plan is met at its predicted state. If no UAV is off its plan at `last_kept`, the
    replan begins there.

    :param plan: the last plan.
    :param last_kept: index of the last point of the plan's path that must be kept, < slots.
    :param states: measured state of each UAV. None if the UAV is taken to be on its plan.
    :param tolerance: largest distance [m] from the plan of a UAV that is taken to be on its plan.
    :param updated: the plan's scenario with the present estimates of the receivers.
    :raises InfeasibleMissionError: when there is no point at which all UAVs can be met and from
        which all can reach their goals.
    """
    tail, step = cut_tail(plan, last_kept), plan.scenario.slot_duration
    recoveries = _list_recovery_paths(plan, last_kept, tail.scenario, states, tolerance)
    if not recoveries:
        return Rejoin(plan, last_kept, last_kept, plan.positions[:, :last_kept + 1],
                      plan.powers[:, :last_kept], tail,
                      move_receivers(tail.scenario, updated, last_kept * step))
    reason: ScenarioError | PlanError | None = None
    for point in _list_candidates(last_kept, plan.scenario.slots):
        paths = _find_paths(recoveries, point)
        if paths is None:
            continue
        try:
            rejoin = _build_rejoin(plan, last_kept, point, paths, updated)
            _check_transition(rejoin, tail.scenario)
            return rejoin
        except (ScenarioError, PlanError) as error:
            reason = reason or error  # A later point may be better.
    far = ', '.join(f'{plan.scenario.uavs[uav].name} ({recovery.distance:.1f} m from it)'
                    for uav, recovery in recoveries.items())
    raise InfeasibleMissionError(
        f'the plan cannot be continued from where the UAVs are: {far} cannot be met within all '
        'limits in time for the goal' + (f'; {reason}' if reason is not None else ''))


def _build_rejoin(plan: Plan, last_kept: int, point: int, paths: dict[int, Array],
                  updated: Scenario) -> Rejoin:
    """
    Return the Rejoin of a replan that begins at a point.

    :param paths: new path of each UAV that is off its plan, by its index, (point + 1, 2) in m.
    :raises InfeasibleMissionError: when a UAV cannot reach its goal from the point.
    """
    tail, step = cut_tail(plan, point), plan.scenario.slot_duration
    positions, uavs = plan.positions[:, :point + 1].copy(), list(tail.scenario.uavs)
    for index, path in paths.items():
        positions[index] = path
    reduced = reduce_budgets(plan.scenario, positions, point)
    for index, path in paths.items():
        uavs[index] = replace(
            uavs[index], start=_to_point(path[-1]), max_energy=reduced[index].max_energy,
            start_velocity=clip_norm(
                *_to_point((path[-1] - path[-2]) / step), uavs[index].max_speed))
    scenario = move_receivers(
        replace(tail.scenario, uavs=tuple(uavs)), updated, point * step)
    utilisations = LeastFlights().find_utilisations(scenario)
    late = [uav.name for uav, utilisation in zip(uavs, utilisations, strict=True)
            if not utilisation <= 1 + UTILISATION_TOLERANCE]
    if late:
        raise InfeasibleMissionError(
            f'{" and ".join(late)}, at {point * step:g} s back on the plan, cannot reach the goal '
            f'in the {scenario.duration:g} s that are left then')
    powers = plan.powers[:, :point].copy()
    if point > last_kept:
        # On the new paths, slots whose rates are all negative are silent.
        times: Array = np.arange(last_kept + 1.0, point + 1) * step
        new_paths = np.pad(positions[:, last_kept:], ((0, 0), (0, 1), (0, 0)))
        powers[:, last_kept:], rates = mute_negative_slots(
            updated, new_paths, powers[:, last_kept:], plan.objective, times)
        if len(rates) > 1:
            # The bit/Hz that each ground node has got by then count in the rest of the mission.
            delivered = plan.node_shares[:, :last_kept].sum(axis=1) + (
                plan.shares[:, last_kept:point] * rates).sum(axis=1)
            scenario = replace(scenario, head_starts=find_head_starts(
                plan.scenario, step * delivered))
    return Rejoin(plan, last_kept, point, positions, powers, tail, scenario)


def _check_transition(rejoin: Rejoin, tail: Scenario) -> None:
    """
    Check that the paths from the last kept point to the replan's first point keep all limits.

    :param tail: the rest of the last plan's mission from the last kept point.
    :raises PlanError: naming a limit that a path breaks.
    """
    positions = rejoin.positions[:, rejoin.last_kept:]
    slots = positions.shape[1] - 2
    if slots < 1:
        return
    uavs = tuple(replace(uav, goal=_to_point(path[-1]), goal_velocity=None)
                 for uav, path in zip(tail.uavs, positions, strict=True))
    # A Plan checks its limits when it is made.
    Plan(replace(tail, uavs=uavs, slots=slots, duration=slots * tail.slot_duration), positions,
         np.zeros((len(uavs), slots)))


class _RecoveryPath:
    """
    Paths of a UAV from the last kept point of its plan to its predicted states.

    :param playback: playback of the plan; `uav` is the UAV's index.
    :param last_kept: index of the last kept point.
    :param begin: the UAV with the plan's state at the last kept point as its start.
    :param state: the measured state of the UAV.
    :param tolerance: largest distance [m] from the plan of a UAV that is back on its plan.
    """

    def __init__(self, playback: Playback, uav: int, last_kept: int, begin: Uav,
                 state: MeasuredState, tolerance: float) -> None:
        self._path, self._last_kept, self._begin = playback.plan.positions[uav], last_kept, begin
        self._step = playback.plan.scenario.slot_duration
        self._tolerance = tolerance
        self._points = _list_candidates(last_kept, playback.plan.scenario.slots)
        self._smooth = begin.max_acceleration is not None
        # Times of predicted states, one for each candidate. The smooth curve of a path has the
        # end's position and velocity half a slot before the time of the path's last point.
        times = (np.array(self._points) - (0.5 if self._smooth else 0.0)) * self._step
        self._states = (predict_stop(state, times, begin.max_acceleration) if state.is_held
                        else predict_return(playback, uav, state, times))
        self._planned = playback.curve.at(times).positions[uav]
        self.distance = math.hypot(*deviation(playback, uav, state))  # Offset to the plan [m].

    def is_on_plan(self, index: int) -> bool:
        """Return True if the UAV is predicted to be on its plan at candidate number `index`."""
        return math.dist(self._states[0][index], self._planned[index]) <= self._tolerance

    def find_path(self, point: int) -> Array | None:
        """
        Return the path up to a candidate point, (point + 1, 2) in m; None if limits allow none.

        The path is the plan's if the UAV is predicted to be on its plan there. Otherwise the path
        from the last kept point to the predicted state has the least utilisation, at most 1.
        """
        index = self._points.index(point)
        if self.is_on_plan(index):
            return self._path[:point + 1]
        position, velocity = (state[index] for state in self._states)
        begin, vehicle, end = self._path[self._last_kept], self._begin.vehicle, position[None]
        if self._smooth:
            # The curve has the predicted state halfway between the last two points.
            move = np.array(clip_norm(*_to_point(velocity), self._begin.max_speed))
            move *= self._step / 2
            end = np.stack([position - move, position + move])
            vehicle = replace(vehicle, goal_velocity=_to_point(2 * move / self._step))
        vehicle = replace(vehicle, displacement=_to_point(end[0] - begin))
        slots = point - self._last_kept - len(end)
        longest = (slots + 1) * self._step * vehicle.max_speed
        if slots < 0 or math.hypot(*vehicle.displacement) > longest:
            return None
        utilisation, points = minimise_utilisation(vehicle, slots, self._step)
        if not utilisation <= 1:
            return None
        return np.concatenate([self._path[:self._last_kept], begin + points, end[1:]])


def _list_recovery_paths(plan: Plan, last_kept: int, tail: Scenario,
                         states: Sequence[MeasuredState | None],
                         tolerance: float) -> dict[int, _RecoveryPath]:
    """Return recovery paths, by UAV, of measured UAVs off their plan at a point last_kept > 0."""
    if last_kept == 0 or all(state is None for state in states):
        return {}
    playback = Playback(plan)
    recoveries = {uav: _RecoveryPath(playback, uav, last_kept, tail.uavs[uav], state, tolerance)
                  for uav, state in enumerate(states) if state is not None}
    return {uav: recovery for uav, recovery in recoveries.items() if not recovery.is_on_plan(0)}


def _find_paths(recoveries: dict[int, _RecoveryPath], point: int) -> dict[int, Array] | None:
    """Return the path to a point, (point + 1, 2) in m, by UAV; None if any of these has none."""
    paths = {}
    for uav, recovery in recoveries.items():
        path = recovery.find_path(point)
        if path is None:
            return None
        paths[uav] = path
    return paths


def _list_candidates(last_kept: int, slots: int) -> list[int]:
    """Return points at which a replan may begin, `last_kept` to slots - 1, ever farther apart."""
    points, step = [last_kept], 1.0
    while points[-1] + 1 < slots:
        points.append(min(slots - 1, points[-1] + math.floor(step)))
        step *= _GROWTH
    return points


def _find_support_offset(scenario: Scenario) -> float:
    """Return the time [slots] before the last kept point at which the curve begins to change."""
    # A point moves the curve from 1.5 slots before its own time with an acceleration limit, and
    # from 1 slot before it without. The first point that changes is one slot after the last kept.
    return 0.5 if scenario.limits_acceleration else 0.0


def _to_point(vector: Array) -> Point:
    x, y = vector.tolist()
    return (x, y)
