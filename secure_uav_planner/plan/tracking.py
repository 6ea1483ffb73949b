"""
Tracking of UAVs against their plan: its time, deviation, prediction of the return, achieved rate.

The prediction is the law of common autopilots: a UAV flies towards the place of its plan with the
plan's velocity plus GAIN times its distance, within its own limits of speed and acceleration. With
an acceleration limit it closes in no faster than it can brake. A UAV that is held by its relay, a
pilot or its autopilot brakes and stands instead.
"""

from collections import deque
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .playback import Playback
from ..errors import OptionError, quote
from ..mission.kinematics import clip_norm
from ..mission.scenario import Array, Point, Uav
from ..model import channel

GAIN = 1.0
"""Gain of the position error in 1/s: the default of two common autopilots within 5%."""

PUNCTUAL = 0.1
"""Time in s by which a flight may leave the clock that its moving receivers are predicted for."""

SILENCE = 1.0
"""Time in s without a report of the follower after which the time of the plan stands still."""

_MEMORY = 10.0  # s for which reports are kept, for odometry that comes later.
_STEADY = 0.03  # Largest change of a constant rate in half a second.
_STEP = 0.05  # Of the prediction, in s.
_MOST_STEPS = 20000
_WATCHED_S, _LEAST_WATCHED_S = 2.0, 0.5  # How much motion tells whether a UAV is held.
_DISTINCT_M = 1.0  # A UAV that is held is nearer to standing than to returning by this distance.
_LONGEST_GAP = 2.0  # Between two samples of AchievedRates, in s; a longer one is left out.


class FollowerReports:
    """
    The reports of one follower about one plan, as pairs of times.

    :param rate: of the plan's time until the second report.
    :param earlier: its reports about another plan of the same flight, which has the same time.
    """

    def __init__(self, follower: str, identity: str, rate: float,
                 earlier: 'FollowerReports | None' = None) -> None:
        self.follower, self.identity, self._first_rate = follower, identity, rate
        self._pairs: deque[tuple[int, int]] = deque(  # Clock and plan in ns.
            earlier._pairs if earlier else ())

    def add(self, clock_ns: int, plan_ns: int) -> None:
        """Add the time of the plan at a time of the clock, both in ns."""
        if self._pairs and clock_ns < self.last_ns:
            self._pairs.clear()  # The clock has jumped back.
        elif self._pairs and clock_ns == self.last_ns:
            self._pairs.pop()  # It stands, as simulated time may.
        self._pairs.append((clock_ns, plan_ns))
        while clock_ns - self._pairs[0][0] > _MEMORY * 1e9:
            self._pairs.popleft()

    @property
    def has_rate(self) -> bool:
        """Whether there are two reports, between which the plan has a rate."""
        return len(self._pairs) > 1

    @property
    def last_ns(self) -> int:
        """Time of the last report in ns."""
        return self._pairs[-1][0]

    @property
    def plan_ns(self) -> int:
        """Time of the plan in the last report in ns."""
        return self._pairs[-1][1]

    def is_current(self, clock_ns: int) -> bool:
        """Return False if the follower is silent at a time in ns."""
        return clock_ns - self.last_ns <= SILENCE * 1e9

    def _since_last(self) -> Array:
        """Return clock and plan relative to the last report, (2, K), for more digits."""
        return np.transpose([(clock - self._pairs[-1][0], plan - self._pairs[-1][1])
                             for clock, plan in self._pairs])

    def is_steady(self) -> bool:
        """
        Return True if the plan is paused, or its rate has been constant over a second.

        A flight that was paused within that second speeds up, however slowly.
        """
        since, plan = self._since_last() * 1e-9
        rates = np.diff(plan) / np.diff(since)
        if len(rates) == 0 or rates[-1] == 0:
            return True
        # Medians, because a busy machine takes single stamps late.
        halves = [rates[(since[:-1] >= begin) & (since[:-1] < begin + 0.5)]
                  for begin in (-1.0, -0.5)]
        if (rates[since[:-1] >= -1.0] == 0).any():
            return False
        if not all(map(len, halves)):
            return True
        before, after = map(np.median, halves)
        return bool(after > 0 and abs(after - before) < _STEADY)

    @property
    def first_ns(self) -> int:
        """Time in ns of the first report that is kept; before it, the plan's time is not known."""
        return self._pairs[0][0]

    def at(self, clock_ns: int, start_ns: int) -> tuple[float, float]:
        """
        Return the time of the plan in s from its point 0, and its rate, at a time in ns.

        Before the first report, its time holds.
        """
        (last, plan), rate = self._pairs[-1], self._first_rate
        if self.has_rate:
            before = self._pairs[-2]
            rate = max(0.0, (plan - before[1]) / (last - before[0]))
        since, time = (clock_ns - last) * 1e-9, (plan - start_ns) * 1e-9
        if since <= 0:
            return time + float(np.interp(clock_ns - last, *self._since_last())) * 1e-9, rate
        return time + rate * min(since, SILENCE), rate if self.is_current(clock_ns) else 0.0


class PlanClock(NamedTuple):
    """The time of a plan from its point 0 at a time of the clock, in s, and its rate."""

    time: float
    clock: float
    rate: float = 1.0

    def to_plan(self, clock: float) -> float:
        """Return the time of the plan at a time of the clock."""
        return self.time + self.rate * (clock - self.clock)

    def to_clock(self, time: float) -> float:
        """Return the time of the clock at a time of the plan; the rate must not be 0."""
        return self.clock + (time - self.time) / self.rate


class MeasuredState(NamedTuple):
    """The state of a UAV, measured at a time in s from point 0 of the plan."""

    time: float
    position: Point  # (x, y) in m
    velocity: Point | None = None  # (x, y) in m/s
    is_held: bool = False  # Whether it is expected to stand instead of flying to its plan.


def deviation(playback: Playback, uav: int, state: MeasuredState) -> Array:
    """Return the offset of a UAV from its plan at the time of a measurement, (2,) in m."""
    return np.array(state.position) - playback.curve.at([state.time]).positions[uav, 0]


class Watch:
    """The states of a UAV in the last seconds, which tell whether it flies towards its plan."""

    def __init__(self) -> None:
        self._states = deque[MeasuredState]()

    def add(self, state: MeasuredState) -> None:
        """Add a state; a repeated state is no news."""
        if self._states and state.time < self._states[-1].time - _WATCHED_S:
            self._states.clear()  # The time of the plan went back: another flight has begun.
        if not self._states or state.time > self._states[-1].time:
            self._states.append(state)
        while self._states[-1].time - self._states[0].time > _WATCHED_S:
            self._states.popleft()

    def is_held(self, playback: Playback, uav: int) -> bool:
        """
        Return True for a UAV that moves like a vehicle at rest, or braking to rest.

        A vehicle that returns to its plan is the alternative. Two measurements must agree: the way
        since the first state, and the present velocity where it is known.
        """
        if not self._states or (
                self._states[-1].time - self._states[0].time < _LEAST_WATCHED_S):
            return False
        first, last = self._states[0], self._states[-1]
        limit = playback.plan.scenario.uavs[uav].max_acceleration
        (returning,), _ = predict_return(playback, uav, first, [last.time])
        (standing,), _ = predict_stop(first, [last.time], limit)
        if math.dist(last.position, returning) < math.dist(last.position, standing) + _DISTINCT_M:
            return False
        return last.velocity is None or math.hypot(*last.velocity) < math.dist(
            last.velocity, _command(playback, uav, last))


def predict_return(playback: Playback, uav: int, state: MeasuredState, times: ArrayLike
                   ) -> tuple[Array, Array]:
    """
    Predict the flight of a UAV back to its plan, by the law at the top of this module.

    :param times: (K,) in s from point 0, increasing; before the measurement its values hold.
    :return: positions (K, 2) in m, velocities (K, 2) in m/s.
    """
    times = np.asarray(times, float)
    horizon = max(0.0, float(times[-1]) - state.time)
    # The steps are fixed, so that a prediction does not depend on its horizon.
    step = max(_STEP, horizon / _MOST_STEPS)
    count = max(1, math.ceil(horizon / step))
    grid = state.time + step * np.arange(count + 1)
    motion = playback.curve.at(grid)
    places, velocities = motion.positions[uav].tolist(), motion.velocities[uav].tolist()
    member = playback.plan.scenario.uavs[uav]
    # Plain Python, since NumPy is slower for two coordinates.
    (x, y), (u, v) = state.position, state.velocity or velocities[0]
    rows = [(x, y, u, v)]
    for place, velocity in zip(places[1:], velocities[1:], strict=True):
        before = (u, v)
        # The offset is that from its position after a step at constant velocity.
        u, v = _command_velocity(place[0] - x - u * step, place[1] - y - v * step, velocity,
                                 member.max_speed, member.max_acceleration, step)
        if member.max_acceleration is None:
            before = (u, v)
        else:
            du, dv = clip_norm(u - before[0], v - before[1], member.max_acceleration * step)
            u, v = before[0] + du, before[1] + dv
        x, y = x + (before[0] + u) / 2 * step, y + (before[1] + v) / 2 * step
        rows.append((x, y, u, v))
    states = np.stack([np.interp(times, grid, column) for column in np.transpose(rows)], axis=1)
    return states[:, :2], states[:, 2:]


def predict_stop(state: MeasuredState, times: ArrayLike, max_acceleration: float | None
                 ) -> tuple[Array, Array]:
    """
    Predict the flight of a UAV that brakes to rest and stands.

    :param times: (K,) in s from point 0; before the measurement its values hold.
    :return: positions (K, 2) in m, velocities (K, 2) in m/s.
    """
    velocity = np.array(state.velocity or (0.0, 0.0))
    braking = math.hypot(*velocity) / (max_acceleration or math.inf)  # s
    ahead = np.clip(np.asarray(times, float) - state.time, 0.0, braking)[:, None]
    left = 1.0 - ahead / braking if braking else 0.0 * ahead  # Share of the velocity.
    return state.position + ahead * (1.0 + left) / 2 * velocity, left * velocity


def predict_state(state: MeasuredState, time: float, max_acceleration: float | None,
                  playback: Playback | None = None, uav: int = 0, tolerance: float = 0.0
                  ) -> tuple[Point, Point | None]:
    """
    Predict the position in m and the velocity in m/s of a UAV at the beginning of a new plan.

    A UAV within a tolerance in m of its last plan follows that plan, so that its setpoints do not
    jump. Any other UAV brakes to rest, if there is time, or else keeps its velocity. The velocity
    is None if it was not measured.
    """
    if playback is not None and math.hypot(*deviation(playback, uav, state)) <= tolerance:
        motion = playback.curve.at([time])
        return _point(motion.positions[uav, 0]), _point(motion.velocities[uav, 0])
    if state.velocity is None:
        return state.position, None
    (x, y), (u, v) = state.position, state.velocity
    ahead, braking = max(0.0, time - state.time), math.hypot(u, v) / (max_acceleration or math.inf)
    if ahead >= braking:
        return (x + braking / 2 * u, y + braking / 2 * v), (0.0, 0.0)
    return (x + ahead * u, y + ahead * v), (u, v)


def start_from_state(uav: Uav, position: Point, velocity: Point | None, slot_duration: float
                     ) -> Uav:
    """
    Return a UAV with the start of a position in m and a velocity in m/s, None for an unknown one.

    With an acceleration limit and a velocity, clipped to max_speed, the curve begins in that state
    half a slot before point 0. Otherwise point 0 is the position.
    """
    if uav.max_acceleration is None or velocity is None:
        return replace(uav, start=position)
    u, v = clip_norm(*velocity, uav.max_speed)
    return replace(uav, start_velocity=(u, v), start=(
        position[0] + u * slot_duration / 2, position[1] + v * slot_duration / 2))


def _command(playback: Playback, uav: int, state: MeasuredState) -> tuple[float, float]:
    """Return the velocity in m/s with which an autopilot returns to its plan."""
    member, (dx, dy) = playback.plan.scenario.uavs[uav], -deviation(playback, uav, state)
    velocity = _point(playback.curve.at([state.time]).velocities[uav, 0])
    return _command_velocity(dx, dy, velocity, member.max_speed, member.max_acceleration, _STEP)


def _command_velocity(dx: float, dy: float, velocity: tuple[float, float], max_speed: float,
                      max_acceleration: float | None, step: float) -> tuple[float, float]:
    """Return the velocity that closes an offset to a place that moves at a velocity."""
    distance = math.hypot(dx, dy)
    closing = min(GAIN, 1 / step) * distance
    if max_acceleration is not None and distance > max_acceleration / GAIN**2:
        # Braking at max_acceleration meets the linear law with the same slope.
        closing = math.sqrt(2 * max_acceleration * distance - (max_acceleration / GAIN)**2)
    factor = closing / max(distance, 1e-300)
    return clip_norm(velocity[0] + factor * dx, velocity[1] + factor * dy, max_speed)


def _point(vector: Array) -> Point:
    x, y = vector.tolist()
    return (x, y)


class AchievedRates:
    """
    Mean guaranteed rates of a flight so far, at the measured and at the planned positions.

    Both are means over the slots during which all UAVs were measured, with the powers and the
    estimates of the plan that was flown then.
    """

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._last = math.inf
        self._flown = 0.0  # Time in slots so far, in s.
        self._sums = np.zeros(3)  # Time in s, achieved and planned in bit/Hz.

    def add(self, playback: Playback, time: float, positions: Array, rate: float = 1.0) -> None:
        """
        Add measured positions (U, 2) in m, at a time in s from point 0 of a plan.

        A plan with another start begins a new flight.

        :param rate: of the plan's time; faster flights are measured at longer intervals of it.
        :raises OptionError: for positions of another shape.
        """
        scenario, start_ns = playback.plan.scenario, playback.plan.start_ns
        if np.shape(positions) != (len(scenario.uavs), 2):
            raise OptionError(f'positions has the shape {quote(np.shape(positions))}; it must be '
                              f'{(len(scenario.uavs), 2)}')
        if start_ns != self._start_ns:
            self._start_ns, self._last, self._sums = start_ns, math.inf, np.zeros(3)
        last, self._last = self._last, time
        inside = scenario.slot_duration * np.array([1, scenario.slots + 1])
        self._flown = max(0.0, min(time, inside[1]) - inside[0])
        if not 0 < time - last <= _LONGEST_GAP * max(1.0, rate):
            return
        elapsed = min(time, inside[1]) - max(last, inside[0])
        if elapsed <= 0:
            return
        time = min(time, inside[1] - 1e-6 * scenario.slot_duration)
        moment = playback.at(time)
        both = np.stack([positions, moment.positions], axis=1)
        rates = channel.guaranteed_node_rates(
            scenario, np.pad(both, ((0, 0), (1, 1), (0, 0))),
            np.stack([moment.powers] * 2, axis=1), times=np.full(2, time))
        shared = (playback.shares_at(np.array([time])) * np.maximum(rates, 0.0)).sum(axis=0)
        self._sums += elapsed * np.array([1.0, *shared])

    @property
    def measured(self) -> float:
        """Share of the slots so far that the rates are means over, from 0 to 1."""
        return float(min(1.0, self._sums[0] / self._flown)) if self._flown else 0.0

    @property
    def rates(self) -> tuple[float, float] | None:
        """Achieved and planned mean in bit/s/Hz, or None before the first slot."""
        if self._sums[0] == 0:
            return None
        achieved, planned = (self._sums[1:] / self._sums[0]).tolist()
        return achieved, planned
