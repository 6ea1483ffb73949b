"""
Where UAVs are beside their plan: how far from it, where they will be, and the rate they achieve.

A UAV is predicted as autopilots fly: towards the place of the plan at every moment, with the
plan's velocity and a speed of GAIN times the distance, within its own limits of speed and
acceleration. With a limit of acceleration it closes in no faster than it can brake.
"""

from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .playback import Playback
from ..errors import OptionError, shown
from ..mission.kinematics import shortened
from ..mission.scenario import Array, Point, Uav
from ..model import channel

GAIN = 1.0
"""Approach to the plan, in 1/s. It is the default of two common autopilots within 5%."""

_STEP = 0.05  # Of the prediction, in s.
_MOST_STEPS = 20000
_ROUNDING = 1e-8  # s; stamps are whole ns
_LONGEST_GAP = 2.0  # Between two samples of a Track, in s; nothing is known about a longer one.


class Flight(NamedTuple):
    """The flight of a plan."""

    playback: Playback
    time: float  # To which it has come, in s from point 0.
    rate: float  # How fast that goes on; 1 is real time, 0 stands still.
    is_reported: bool  # By a follower; otherwise the stamps say so.

    @property
    def state(self) -> str:
        """Return 'waiting' at the start, 'flying', 'held' on the way or 'ended'."""
        if self.time >= self.playback.duration - _ROUNDING:
            return 'ended'
        if self.time <= self.playback.begin + _ROUNDING:
            return 'waiting'
        return 'flying' if self.rate > 0 else 'held'

    @property
    def is_under_way(self) -> bool:
        """Return whether it has begun and not ended."""
        return self.state in ('flying', 'held')


class MeasuredState(NamedTuple):
    """The measured state of a UAV."""

    time: float  # Of the measurement, in s from point 0 of the plan.
    position: Point  # (x, y) in m
    velocity: Point | None = None  # (x, y) in m/s


def deviation(playback: Playback, uav: int, state: MeasuredState) -> Array:
    """Return the offset of a UAV from its plan when it was measured, (2,) in m."""
    return np.array(state.position) - playback.curve.at([state.time]).positions[uav, 0]


def predict_return(playback: Playback, uav: int, state: MeasuredState, times: ArrayLike
                   ) -> tuple[Array, Array]:
    """
    Return where a UAV will be that flies back to its plan by the law above, and how fast.

    :param times: (K,) in s from point 0, increasing; before the measurement its values hold.
    :return: positions (K, 2) in m, velocities (K, 2) in m/s.
    """
    times = np.asarray(times, float)
    horizon = max(0.0, float(times[-1]) - state.time)
    # Always the same steps, so that a prediction does not depend on how far it goes.
    step = max(_STEP, horizon / _MOST_STEPS)
    count = max(1, math.ceil(horizon / step))
    grid = state.time + step * np.arange(count + 1)
    motion = playback.curve.at(grid)
    places, speeds = motion.positions[uav].tolist(), motion.velocities[uav].tolist()
    member = playback.plan.scenario.uavs[uav]
    # NumPy would take longer for two coordinates than Python does.
    (x, y), (u, v) = state.position, state.velocity or speeds[0]
    found = [(x, y, u, v)]
    for place, speed in zip(places[1:], speeds[1:], strict=True):
        before = (u, v)
        # As seen from where it would be without a change of velocity.
        u, v = _wanted(place[0] - x - u * step, place[1] - y - v * step, speed,
                       member.max_speed, member.max_acceleration, step)
        if member.max_acceleration is None:
            before = (u, v)
        else:
            du, dv = shortened(u - before[0], v - before[1], member.max_acceleration * step)
            u, v = before[0] + du, before[1] + dv
        x, y = x + (before[0] + u) / 2 * step, y + (before[1] + v) / 2 * step
        found.append((x, y, u, v))
    states = np.array(found)
    picked = np.stack([np.interp(times, grid, states[:, column]) for column in range(4)], axis=1)
    return picked[:, :2], picked[:, 2:]


def predict_state(state: MeasuredState, time: float, max_acceleration: float | None,
                  playback: Playback | None = None, uav: int = 0, tolerance: float = 0.0
                  ) -> tuple[Point, Point | None]:
    """
    Return where a UAV will be when a new plan begins, in m, and its velocity in m/s, if known.

    A UAV within a tolerance in m of its last plan will be where that plan says, so that its
    setpoints go on without a jump. Any other one brakes and stands, if the time suffices for it;
    else it goes on with its present velocity.
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
    Return a UAV that starts at a position in m with a velocity in m/s, if that is known.

    With a limit of acceleration the curve leaves that state half a slot before point 0, with at
    most its largest speed. Without one, or without a velocity, point 0 is the position.
    """
    if uav.max_acceleration is None or velocity is None:
        return replace(uav, start=position)
    u, v = shortened(*velocity, uav.max_speed)
    return replace(uav, start_velocity=(u, v), start=(
        position[0] + u * slot_duration / 2, position[1] + v * slot_duration / 2))


def _wanted(dx: float, dy: float, speed: tuple[float, float], max_speed: float,
            max_acceleration: float | None, step: float) -> tuple[float, float]:
    """Return the velocity that closes a distance to a place that moves with a velocity."""
    distance = math.hypot(dx, dy)
    closing = min(GAIN, 1 / step) * distance
    if max_acceleration is not None and distance > max_acceleration / GAIN**2:
        # Braking with the largest acceleration ends in the linear law, with the same slope.
        closing = math.sqrt(2 * max_acceleration * distance - (max_acceleration / GAIN)**2)
    factor = closing / max(distance, 1e-300)
    return shortened(speed[0] + factor * dx, speed[1] + factor * dy, max_speed)


def _point(vector: Array) -> Point:
    x, y = vector.tolist()
    return (x, y)


class Track:
    """
    The guaranteed rates of a flight so far, where the UAVs were and where they should have been.

    Both are means over the time in which something is transmitted and all UAVs were seen, with
    the planned powers and the estimates of the plan that was in force.
    """

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._last = math.inf
        self._sums = np.zeros(3)  # Time in s, achieved and planned in bit/Hz.

    def add(self, playback: Playback, time: float, positions: Array) -> None:
        """
        Note where the UAVs are, (U, 2) in m, at a time in s from point 0 of a plan.

        A plan with another start begins a new flight.
        """
        scenario, start_ns = playback.plan.scenario, playback.plan.start_ns
        if np.shape(positions) != (len(scenario.uavs), 2):
            raise OptionError(f'positions has the shape {shown(np.shape(positions))}; it must be '
                              f'{(len(scenario.uavs), 2)}')
        if start_ns != self._start_ns:
            self._start_ns, self._last, self._sums = start_ns, math.inf, np.zeros(3)
        last, self._last = self._last, time
        if not 0 < time - last <= _LONGEST_GAP:
            return
        inside = scenario.slot_duration * np.array([1, scenario.slots + 1])
        elapsed = min(time, inside[1]) - max(last, inside[0])
        if elapsed <= 0:
            return
        moment = playback.at(min(time, inside[1] - 1e-6 * scenario.slot_duration))
        both = np.stack([positions, moment.positions], axis=1)
        rates = channel.guaranteed_rates(
            scenario, np.pad(both, ((0, 0), (1, 1), (0, 0))),
            np.stack([moment.powers] * 2, axis=1))
        self._sums += elapsed * np.array([1.0, *np.maximum(rates, 0.0)])

    @property
    def rates(self) -> tuple[float, float] | None:
        """Return the achieved and the planned mean in bit/s/Hz, or None before any slot."""
        if self._sums[0] == 0:
            return None
        achieved, planned = (self._sums[1:] / self._sums[0]).tolist()
        return achieved, planned
