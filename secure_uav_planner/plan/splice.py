"""Plans that are cut at a point and continued there, and the receivers of their missions."""

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import TypeVar

import numpy as np

from .plan import Plan
from ..errors import OptionError
from ..mission.fields import check_argument, find_range, TIME, WholeNumber
from ..mission.kinematics import clip_norm, UTILISATION_TOLERANCE
from ..mission.scenario import Array, Eavesdropper, GroundNode, Point, Scenario, Uav
from ..mission.tracks import join_tracks, LEFT_OUT, shift_track, Track
from ..mission.validation import checked_array, checked_kind
from ..model.channel.rates import find_head_starts
from ..model.limits import reduce_budgets

_ROUNDING = 1e-6  # Tolerance of the end of a promise [s].

_Receiver = TypeVar('_Receiver', GroundNode, Eavesdropper)


def cut_tail(plan: Plan, point: int) -> Plan:
    """
    Return the rest of a plan from a point, as a plan of the rest of the mission.

    The average powers and the energy of the rest are what the slots before the point do not use.
    With several ground nodes, what these slots deliver becomes the head_starts of the rest. Each
    UAV begins with the velocity at which it reaches the point. The rest has no history, bound,
    bits and too_short.

    :param plan: a Plan.
    :param point: index of the rest's first point, from 0 to slots - 1.
    :raises OptionError: for any other `point`.
    """
    scenario = checked_kind('plan', plan, Plan).scenario
    point = check_argument('point', point, WholeNumber(0, scenario.slots - 1))
    slots, step = scenario.slots - point, scenario.slot_duration
    least = find_range(Uav, 'average_power').low
    # A plan may exceed limits by a tolerance, which would fall on few slots: the rest is allowed
    # what it has.
    remaining = np.maximum(
        scenario.slots * scenario.average_powers - plan.powers[:, :point].sum(axis=1),
        plan.powers[:, point:].sum(axis=1))
    moves = np.linalg.norm(np.diff(plan.positions[:, point:], axis=1), axis=-1).max(axis=1)
    speeds = np.where(moves / step > (1 + UTILISATION_TOLERANCE) * scenario.max_speeds,
                      moves / step, scenario.max_speeds)
    uavs = tuple(
        replace(uav, start=tuple(path[point].tolist()), max_speed=speed,
                start_velocity=_find_velocity(uav, path, point, step),
                average_power=min(uav.peak_power, max(sum_of_powers / slots, least)))
        for uav, path, sum_of_powers, speed in zip(
            reduce_budgets(scenario, plan.positions, point), plan.positions, remaining.tolist(),
            speeds.tolist(), strict=True))
    rest = replace(move_receivers(scenario, scenario, point * step),
                   uavs=uavs, slots=slots, duration=slots * step,
                   head_starts=() if len(plan.shares) == 1 else find_head_starts(
                       scenario, step * plan.node_shares[:, :point].sum(axis=1)))
    # On the clock the point is due point * step / promise_speed after point 0, but start_ns moves
    # by point * step. The promise_delay has the difference.
    return replace(
        plan, scenario=rest, positions=plan.positions[:, point:], powers=plan.powers[:, point:],
        shares=plan.shares[:, point:], history=(), bound=None, bits=None, too_short=None,
        promised_until=_shift(plan.promised_until, -point * step),
        gaps=_cut_gaps(plan.gaps, -point * step, 0.0, math.inf),
        promise_delay=plan.promise_delay + point * step * (1 / plan.promise_speed - 1),
        start_ns=None if plan.start_ns is None else plan.start_ns + round(point * step * 1e9))


def continue_plan(plan: Plan, point: int, tail: Plan,
                  beginning: tuple[Array, Array] | None = None, first: int | None = None) -> Plan:
    """
    Return a plan up to a point, followed by another plan of the rest of the mission.

    :param plan: a Plan.
    :param point: index of the tail's first point, as passed to cut_tail.
    :param tail: a Plan of the mission of cut_tail, perhaps with other receivers.
    :param beginning: positions (U, M, 2) in m and powers (U, M) in W up to the point, M >= point,
        if they are not the plan's.
    :param first: index of the last point at which the receivers and the promise of the plan
        apply; by default `point`. The tail's receivers and promise apply after it.
    :return: a Plan of the whole mission, with the plan's start and the tail's method. It has no
        bound, bits and too_short.
    :raises OptionError: for another number of UAVs or receivers, or a wrong point.
    """
    scenario = checked_kind('plan', plan, Plan).scenario
    inside = WholeNumber(0, scenario.slots - 1)
    point = check_argument('point', point, inside)
    first = point if first is None else check_argument('first', first, inside)
    checked_kind('tail', tail, Plan)
    for name in ('uavs', 'ground_nodes', 'eavesdroppers'):
        count, wanted = (len(getattr(mission, name)) for mission in (tail.scenario, scenario))
        if count != wanted:
            raise OptionError(f'tail has {count} {name}; it must have {wanted}', ('tail',))
    positions, powers = plan.positions, plan.powers
    if beginning is not None:
        positions, powers = (
            checked_array('beginning', values, (len(powers), None, *rest))
            for values, rest in zip(checked_kind('beginning', beginning, tuple), ((2,), ())))
    delay = point * scenario.slot_duration  # Time [s] of the tail's point 0 in the plan.
    whole = _join_receivers(scenario, move_receivers(scenario, tail.scenario, -delay), first)
    return replace(
        tail, scenario=whole,
        positions=np.concatenate([positions[:, :point], tail.positions], axis=1),
        powers=np.concatenate([powers[:, :point], tail.powers], axis=1),
        shares=np.concatenate([plan.shares[:, :point], tail.shares], axis=1),
        start_ns=plan.start_ns, bound=None, bits=None, too_short=None,
        promised_until=_shift(tail.promised_until, delay),
        gaps=_join_gaps(plan, tail, first, delay),
        # The inverse of the change in cut_tail.
        promise_delay=tail.promise_delay - delay * (1 / tail.promise_speed - 1))


def move_receivers(scenario: Scenario, source: Scenario, delay: float = 0.0) -> Scenario:
    """
    Return a scenario with the ground nodes and the eavesdroppers of a source.

    :param scenario: the Scenario whose receivers are replaced.
    :param source: the Scenario that has the new receivers.
    :param delay: time [s] from point 0 of the source to point 0 of the scenario.
    """
    checked_kind('scenario', scenario, Scenario)
    checked_kind('source', source, Scenario)
    check_argument('delay', delay, TIME)
    return _set_receivers(scenario, source, [
        shift_track(receiver.track, delay) for receiver in _list_receivers(source)])


def _join_receivers(scenario: Scenario, updated: Scenario, point: int) -> Scenario:
    """Return `updated` with receivers that follow `scenario` up to a point, unless it is 0."""
    if point == 0:
        return updated
    step = scenario.slot_duration
    return _set_receivers(updated, updated, [
        join_tracks(old.knots, new.knots, point * step, step)
        for old, new in zip(_list_receivers(scenario), _list_receivers(updated), strict=True)])


def _list_receivers(scenario: Scenario) -> list[GroundNode | Eavesdropper]:
    return [*scenario.ground_nodes, *scenario.eavesdroppers]


def _set_receivers(scenario: Scenario, source: Scenario, tracks: Sequence[Track | None]
                   ) -> Scenario:
    """
    Return `scenario` with the receivers of the scenario `source`, on new tracks.

    :param tracks: tracks of ground nodes, then of eavesdroppers. None keeps the source's receiver.
    """
    nodes = len(source.ground_nodes)
    return replace(
        scenario,
        ground_nodes=tuple(map(_set_track, source.ground_nodes, tracks[:nodes])),
        eavesdroppers=tuple(map(_set_track, source.eavesdroppers, tracks[nodes:])))


def _set_track(receiver: _Receiver, track: Track | None) -> _Receiver:
    """Return a receiver on a track, or the receiver itself if the track is None."""
    return receiver if track is None else replace(
        receiver, track=track, **dict.fromkeys(receiver.DECIDED, LEFT_OUT))


def _shift(time: float | None, seconds: float) -> float | None:
    return None if time is None else time + seconds


def _join_gaps(plan: Plan, tail: Plan, last_point: int, delay: float
               ) -> tuple[tuple[float, float], ...]:
    """
    Return the gaps (begin, end) [s] in the joint promise of a plan and its tail.

    The plan's promise applies up to `last_point`, the tail's from `last_point` + 1 on.

    :param delay: time [s] of the tail's point 0 in the plan.
    """
    step = plan.scenario.slot_duration
    last, following = last_point * step, (last_point + 1) * step  # Times of these two points.
    before = _cut_gaps(plan.gaps, 0.0, 0.0, following)
    # A promise of the plan that ended earlier leaves a gap up to the tail.
    if plan.promised_until is not None and plan.promised_until < last - _ROUNDING:
        before += ((plan.promised_until, following),)
    after = _cut_gaps(tail.gaps, delay, last, math.inf)
    return _merge_gaps(before + tuple(gap for gap in after if gap[1] > following))


def _cut_gaps(gaps: Sequence[tuple[float, float]], seconds: float, begin: float, end: float
              ) -> tuple[tuple[float, float], ...]:
    """Return gaps delayed by `seconds`, then clipped to `begin`..`end` [s], without empty ones."""
    moved = ((max(first + seconds, begin), min(last + seconds, end)) for first, last in gaps)
    return tuple((first, last) for first, last in moved if first < last)


def _merge_gaps(gaps: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Return sorted gaps, merged if they overlap; if two only touch, the point is promised."""
    merged: list[tuple[float, float]] = []
    for begin, end in sorted(gaps):
        if merged and begin < merged[-1][1]:
            begin, end = merged[-1][0], max(end, merged.pop()[1])
        merged.append((begin, end))
    return tuple(merged)


def _find_velocity(uav: Uav, path: Array, point: int, step: float) -> Point | None:
    """Return the velocity [m/s] of a UAV on the move to a point of path (N+2, 2); None if free."""
    if point == 0:
        return uav.start_velocity
    x, y = ((path[point] - path[point - 1]) / step).tolist()
    # A plan's speed may exceed max_speed by a tolerance, which a start_velocity may not.
    return clip_norm(x, y, uav.max_speed)
