"""
Tracking of UAVs against their plan: its time, deviation, prediction of the return, achieved rate.

The prediction is the law of common autopilots: a UAV flies towards its planned position with the
planned velocity plus GAIN times its distance, within its own limits of speed and acceleration.
With an acceleration limit it closes in no faster than it can brake. A UAV that is held by its
relay, a pilot or its autopilot brakes and stands instead.
"""

from collections import deque
from collections.abc import Callable
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
"""Gain of the position error [1/s]: the default of two common autopilots within 5%."""

PUNCTUAL = 0.1
"""Largest lateness or earliness [s] of a flight at which its promise still holds."""

SILENCE = 1.0
"""Time [s] without a report of the follower after which the time of the plan stands still."""

LONGEST_GAP = 2.0
"""Largest time [s] between two measured positions of a flight that is not a gap."""

_MEMORY = 10.0  # Time [s] for which reports are kept, because odometry may arrive late.
_STEADY = 0.03  # Largest change within half a second of a playback speed that is constant.
_STEP = 0.05  # Time step [s] of the prediction.
_MOST_STEPS = 20000  # Largest number of steps of a prediction.
_WATCHED_S = 2.0  # Duration [s] of the motion by which a UAV is judged to be held or not.
_LEAST_WATCHED_S = 0.5  # Shortest motion [s] by which a UAV is judged to be held.
_DISTINCT_M = 1.0  # Distance [m] by which a held UAV is nearer to standing than to returning.


class FollowerReports:
    """
    The reports of one follower about one plan: the plan's time at times of the clock.

    :param time_scale: playback speed that is assumed until the second report.
    :param earlier: reports of the follower about an earlier plan of the same flight, which has
        the same time and so continues here.
    """

    def __init__(self, follower: str, identity: str, time_scale: float,
                 earlier: 'FollowerReports | None' = None) -> None:
        """Begin with the reports of `earlier`; time_scale is assumed until the second report."""
        self.follower, self.identity, self._first_scale = follower, identity, time_scale
        self._pairs: deque[tuple[int, int]] = deque(  # Times of the clock and the plan [ns].
            earlier._pairs if earlier else ())
        self._begin_ns: int | None = None  # Time of the first report about this plan.
        self._scale: float | None = None  # Playback speed by all reports, once it is asked for.

    def add(self, clock_ns: int, plan_ns: int) -> None:
        """Add a report: the time of the plan at a time of the clock, both in ns."""
        self._scale = None
        if self._pairs and clock_ns < self.last_ns:
            self._pairs.clear()  # The clock has jumped back.
        elif self._pairs and plan_ns < self.plan_ns - PUNCTUAL * 1e9:
            self._pairs.clear()  # The plan begins anew; a smaller step back is an error.
            self._begin_ns, self._first_scale = None, 0.0
        elif self._pairs and clock_ns == self.last_ns:
            self._pairs.pop()  # The clock stands still, as simulated time may.
        self._pairs.append((clock_ns, plan_ns))
        if self._begin_ns is None or clock_ns < self._begin_ns:
            self._begin_ns = clock_ns
        while clock_ns - self._pairs[0][0] > _MEMORY * 1e9:
            self._pairs.popleft()

    @property
    def has_time_scale(self) -> bool:
        """Whether there are at least two reports, so that a playback speed is known."""
        return len(self._pairs) > 1

    @property
    def last_ns(self) -> int:
        """Time of the clock in the last report in ns."""
        return self._pairs[-1][0]

    @property
    def plan_ns(self) -> int:
        """Time of the plan in the last report in ns."""
        return self._pairs[-1][1]

    def find_first_unpunctual(self, is_unpunctual: Callable[[int, int], bool]) -> int:
        """
        Return the plan's time [ns] in the first of the last unpunctual reports in a row.

        If the last report is punctual, its plan's time is returned. Reports from before the first
        one about this plan are left out.

        :param is_unpunctual: tells for the times of the clock and of the plan [ns] of a report
            whether the flight is off its schedule.
        """
        first_ns = self.plan_ns
        for clock_ns, plan_ns in reversed(self._pairs):
            if clock_ns < (self._begin_ns or 0) or not is_unpunctual(clock_ns, plan_ns):
                break
            first_ns = plan_ns
        return first_ns

    def is_current(self, clock_ns: int) -> bool:
        """Return True if a report arrived within SILENCE before a time of the clock [ns]."""
        return clock_ns - self.last_ns <= SILENCE * 1e9

    def _since_last(self) -> Array:
        """Return each report's times of clock and plan, 0 at the last report, (2, K) in ns."""
        return np.transpose([(clock - self._pairs[-1][0], plan - self._pairs[-1][1])
                             for clock, plan in self._pairs])

    def is_steady(self) -> bool:
        """
        Return True if the plan is paused, or its playback speed was constant over a second.

        Constant means that the median speeds in both halves of the second differ by less than
        _STEADY. After a pause within this second the answer is False: the plan still speeds up.
        With a single report it is True.
        """
        since, plan = self._since_last() * 1e-9  # Clock and plan, 0 at the last report [s].
        scales = np.diff(plan) / np.diff(since)
        if len(scales) == 0 or scales[-1] == 0:
            return True
        # Medians, because a busy machine stamps single reports late.
        halves = [scales[(since[:-1] >= begin) & (since[:-1] < begin + 0.5)]
                  for begin in (-1.0, -0.5)]
        if (scales[since[:-1] >= -1.0] == 0).any():
            return False
        if not all(map(len, halves)):  # Reports are sparse, or the clock has jumped ahead.
            halves = [scales[-2:-1], scales[-1:]] if len(scales) > 1 else [scales, scales]
        before, after = map(np.median, halves)
        return bool(after > 0 and abs(after - before) < _STEADY)

    @property
    def _time_scale(self) -> float:
        """
        Playback speed, the slope of a line through reports; it is assumed until the second report.

        The line is through all reports of the last second if the playback speed is steady, because
        single stamps jitter. Otherwise, and for a pause, it is through the last two reports.
        """
        if not self.has_time_scale:
            return self._first_scale
        if self._scale is None:
            since, plan = self._since_last() * 1e-9
            is_constant = plan[-2] < 0 and self.is_steady()
            count = max(2, int((since >= -1.0).sum())) if is_constant else 2
            clock = since[-count:] - since[-count:].mean()
            self._scale = max(0.0, float(clock @ plan[-count:] / (clock @ clock)))
        return self._scale

    @property
    def first_ns(self) -> int:
        """Clock's time [ns] in the first kept report; the plan's time before is not known."""
        return self._pairs[0][0]

    def at(self, clock_ns: int, start_ns: int) -> tuple[float, float]:
        """
        Return the plan's time [s] from its point 0 at a clock's time [ns], and a playback speed.

        The playback speed is the present one, also for an earlier clock's time. With a single
        report it is assumed. Between reports the plan's time is interpolated, and before the first
        report it is the first reported one. After the last report it advances at the playback
        speed for SILENCE. Then it stands still and the playback speed is 0.
        """
        (last, plan), scale = self._pairs[-1], self._time_scale
        since, time = (clock_ns - last) * 1e-9, (plan - start_ns) * 1e-9
        if since <= 0:
            return time + float(np.interp(clock_ns - last, *self._since_last())) * 1e-9, scale
        return time + scale * min(since, SILENCE), scale if self.is_current(clock_ns) else 0.0


class PlanClock(NamedTuple):
    """A plan's time [s] from its point 0, the clock's time [s] then, and the playback speed."""

    time: float
    clock: float
    time_scale: float = 1.0

    def to_plan(self, clock: float) -> float:
        """Return the time of the plan [s] at a time of the clock [s]."""
        return self.time + self.time_scale * (clock - self.clock)

    def to_clock(self, time: float) -> float:
        """Return the time of the clock [s] at a time of the plan [s]; time_scale is not 0."""
        return self.clock + (time - self.time) / self.time_scale


class MeasuredState(NamedTuple):
    """The state of a UAV, measured at a time [s] from point 0 of the plan."""

    time: float
    position: Point  # (x, y) in m
    velocity: Point | None = None  # (x, y) in m/s
    is_held: bool = False  # Whether it is expected to stand instead of flying to its plan.


def deviation(playback: Playback, uav: int, state: MeasuredState) -> Array:
    """Return measured minus planned position of a UAV at the measurement's time, (2,) in m."""
    return np.array(state.position) - playback.curve.at([state.time]).positions[uav, 0]


class Watch:
    """The states of a UAV in the last 2 s, by which it is judged to be held or returning."""

    def __init__(self) -> None:
        self._states = deque[MeasuredState]()

    def add(self, state: MeasuredState) -> None:
        """
        Add a state, and forget those over _WATCHED_S older.

        A state not newer than the last one is ignored. A state over _WATCHED_S older than the last
        one begins another flight, and all others are forgotten.
        """
        if self._states and state.time < self._states[-1].time - _WATCHED_S:
            self._states.clear()
        if not self._states or state.time > self._states[-1].time:
            self._states.append(state)
        while self._states[-1].time - self._states[0].time > _WATCHED_S:
            self._states.popleft()

    def is_held(self, playback: Playback, uav: int) -> bool:
        """
        Return True if a UAV stands or brakes to rest instead of returning to its plan.

        From the first state, predict_stop and predict_return give two positions for now. The last
        measured one must be at least _DISTINCT_M nearer to the stop than to the return. The last
        velocity, if known, must be nearer to 0 than to the autopilot's command. The answer is
        False if the states span less than _LEAST_WATCHED_S.
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
    Predict the flight of a UAV back to its plan, as its autopilot would steer it.

    The commanded velocity is the planned velocity plus GAIN times the offset to the plan, at most
    max_speed, and low enough to brake in time. The velocity changes by max_acceleration at most,
    or at once without it. If it was not measured, the UAV begins with the planned velocity.

    :param times: (K,) in s from point 0, increasing. Before the time of the measured state, its
        position and velocity are returned.
    :return: positions (K, 2) in m, velocities (K, 2) in m/s.
    """
    times = np.asarray(times, float)
    horizon = max(0.0, float(times[-1]) - state.time)
    # The step is fixed up to a horizon of 1000 s, so that the last of `times` changes nothing.
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
        # The offset at the end of the step, if the UAV kept its velocity.
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
    Predict the flight of a UAV that brakes to rest and stands; an unknown velocity is taken as 0.

    :param times: (K,) in s from point 0. Before the measurement, its position and velocity are
        returned.
    :param max_acceleration: deceleration of braking [m/s^2]. None stops at once: all velocities
        are then 0.
    :return: positions (K, 2) in m, velocities (K, 2) in m/s.
    """
    velocity = np.array(state.velocity or (0.0, 0.0))
    braking = math.hypot(*velocity) / (max_acceleration or math.inf)  # Duration of braking [s].
    ahead = np.clip(np.asarray(times, float) - state.time, 0.0, braking)[:, None]
    share = 1.0 - ahead / braking if braking else 0.0 * ahead  # Fraction of the first velocity.
    return state.position + ahead * (1.0 + share) / 2 * velocity, share * velocity


def predict_state(state: MeasuredState, time: float, max_acceleration: float | None,
                  playback: Playback | None = None, uav: int = 0, tolerance: float = 0.0
                  ) -> tuple[Point, Point | None]:
    """
    Predict the position [m] and velocity [m/s] of a UAV at the beginning of a new plan.

    A UAV within `tolerance` of its last plan follows that plan, so that its setpoints do not
    jump. Any other UAV brakes to rest if it can come to rest by `time`, and keeps its velocity if
    it cannot. An unmeasured velocity stays None, and its UAV stays in place.

    :param time: beginning of the new plan [s], from point 0 of the last plan.
    :param max_acceleration: deceleration of braking [m/s^2]; None stops at once.
    :param playback: the last plan, if there is one.
    :param tolerance: largest distance [m] from its plan of a UAV that follows it.
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
    Return a UAV that starts at a position [m] with a velocity [m/s], None for an unknown one.

    With an acceleration limit and a known velocity, which is clipped to max_speed, the curve
    begins in this state half a slot before point 0. Otherwise point 0 is the position.
    """
    if uav.max_acceleration is None or velocity is None:
        return replace(uav, start=position)
    u, v = clip_norm(*velocity, uav.max_speed)
    return replace(uav, start_velocity=(u, v), start=(
        position[0] + u * slot_duration / 2, position[1] + v * slot_duration / 2))


def _command(playback: Playback, uav: int, state: MeasuredState) -> tuple[float, float]:
    """Return the velocity [m/s] by which an autopilot returns its UAV to the plan."""
    member, (dx, dy) = playback.plan.scenario.uavs[uav], -deviation(playback, uav, state)
    velocity = _point(playback.curve.at([state.time]).velocities[uav, 0])
    return _command_velocity(dx, dy, velocity, member.max_speed, member.max_acceleration, _STEP)


def _command_velocity(dx: float, dy: float, velocity: tuple[float, float], max_speed: float,
                      max_acceleration: float | None, step: float) -> tuple[float, float]:
    """
    Return the velocity [m/s] by which a UAV closes an offset (dx, dy) [m] to a moving target.

    It is the target's `velocity` plus a closing velocity along the offset, clipped to max_speed.

    :param step: time [s] for which it is commanded; the offset is not closed earlier.
    """
    distance = math.hypot(dx, dy)
    closing = min(GAIN, 1 / step) * distance
    if max_acceleration is not None and distance > max_acceleration / GAIN**2:
        # Braking at max_acceleration, which joins the linear law smoothly at this distance.
        closing = math.sqrt(2 * max_acceleration * distance - (max_acceleration / GAIN)**2)
    factor = closing / max(distance, 1e-300)
    return clip_norm(velocity[0] + factor * dx, velocity[1] + factor * dy, max_speed)


def _point(vector: Array) -> Point:
    x, y = vector.tolist()
    return (x, y)


class AchievedRates:
    """
    Mean guaranteed rates of a flight so far, at the measured and at the planned positions.

    Both are means over the time within the slots during which all UAVs were measured. They use
    the powers and the receivers' discs of the plan that was flown then. They bound nothing while
    a UAV was not measured.
    """

    def __init__(self) -> None:
        # Start of the plan that is flown [ns]. Another start is another flight.
        self._start_ns: int | None = None
        # Time [s] of the plan at the last call of add. It is infinite before the first call, which
        # adds nothing.
        self._last = math.inf
        self._flown = 0.0  # Time [s] that has been flown within slots.
        self._sums = np.zeros(3)  # Measured time [s], achieved and planned information [bit/Hz].

    def add(self, playback: Playback, time: float, positions: Array, time_scale: float = 1.0
            ) -> None:
        """
        Add the rates at measured and planned positions to the means, weighted with their time.

        The weight is the time within slots since the last call. Nothing is added in the first call
        of a flight, or if more than LONGEST_GAP * max(1, time_scale) has passed since the last
        call. A plan with another start begins a new flight, and so does a time more than
        LONGEST_GAP before the last one.

        :param time: time [s] of the positions, from point 0 of the plan.
        :param positions: measured positions, (U, 2) in m.
        :param time_scale: playback speed.
        :raises OptionError: for positions of another shape.
        """
        scenario, start_ns = playback.plan.scenario, playback.plan.start_ns
        if np.shape(positions) != (len(scenario.uavs), 2):
            raise OptionError(f'positions has the shape {quote(np.shape(positions))}; it must be '
                              f'{(len(scenario.uavs), 2)}')
        if start_ns != self._start_ns or time < self._last - LONGEST_GAP:
            self._start_ns, self._last, self._sums = start_ns, math.inf, np.zeros(3)
        last, self._last = self._last, time
        slots_begin, slots_end = scenario.slot_duration * np.array([1, scenario.slots + 1])
        self._flown = max(0.0, min(time, slots_end) - slots_begin)
        if not 0 < time - last <= LONGEST_GAP * max(1.0, time_scale):
            return
        elapsed = min(time, slots_end) - max(last, slots_begin)
        if elapsed <= 0:
            return
        time = min(time, slots_end - 1e-6 * scenario.slot_duration)  # Inside the last slot.
        moment = playback.at(time)
        # Measured and planned positions, as two slots. The rates ignore the padding at both ends.
        both = np.stack([positions, moment.positions], axis=1)
        rates = channel.guaranteed_node_rates(
            scenario, np.pad(both, ((0, 0), (1, 1), (0, 0))),
            np.stack([moment.powers] * 2, axis=1), times=np.full(2, time))
        shared = (playback.shares_at(np.array([time])) * np.maximum(rates, 0.0)).sum(axis=0)
        self._sums += elapsed * np.array([1.0, *shared])

    @property
    def measured(self) -> float:
        """Fraction of the flown time within slots that the rates are means over, from 0 to 1."""
        return float(min(1.0, self._sums[0] / self._flown)) if self._flown else 0.0

    @property
    def rates(self) -> tuple[float, float] | None:
        """Achieved and planned mean rate [bit/s/Hz], or None before the first measurement."""
        if self._sums[0] == 0:
            return None
        achieved, planned = (self._sums[1:] / self._sums[0]).tolist()
        return achieved, planned
