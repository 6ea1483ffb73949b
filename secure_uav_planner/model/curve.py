"""
The curve that the UAVs fly, in continuous time.

The points of a UAV with a limit of acceleration are the control points of a uniform quadratic
B-spline: it passes (q[n] + q[n+1]) / 2 half a slot after point n, with the velocity
(q[n+1] - q[n]) / t_s, and between two such moments its acceleration is constant. So it leaves its
start half a slot before point 0 and reaches its goal half a slot after point N+1. A UAV without
the limit flies straight from point to point.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .channel import guaranteed_rates
from ..mission.scenario import Array, Point, Scenario
from ..mission.validation import RANGES

# Slower than this share of the largest speed, a direction of travel is numerical noise.
_HOVERING = 1e-3
# Smaller velocities in m/s, and changes of velocity in a slot, are those of rounding.
_NOTHING = 1e-9
# How far limits lie above what a flight uses of them, as a share.
_ROUNDING = 1e-6

GAUSS_LEGENDRE = ((-math.sqrt(0.15), 5 / 18), (0.0, 8 / 18), (math.sqrt(0.15), 5 / 18))
"""Places from -1/2 to 1/2 and weights, whose weighted sum is the mean of quintics in between."""


class Motion(NamedTuple):
    """
    How the UAVs move at some times, (U, K, 2) in m, m/s and m/s^2.

    :ivar headings: directions of travel, held while hovering, (U, K) in rad from x to y.
    """

    positions: Array
    velocities: Array
    accelerations: Array
    headings: Array


class Flown(NamedTuple):
    """
    The fields of Uav that a flight tells: its smallest limits, and the velocities at its ends.

    max_acceleration is None for a flight straight from point to point, and a velocity is None
    where the move there goes on as it is.
    """

    max_speed: float
    max_acceleration: float | None
    start_velocity: Point | None
    goal_velocity: Point | None


class Curve:
    """
    The flight of all UAVs as a function of time.

    :param scenario: whose UAVs fly.
    :param positions: points of the flight, (U, N+2, 2) in m, for any N.
    :ivar begin: when the first UAV leaves its start, in s from point 0.
    :ivar end: when the last UAV reaches its goal, likewise.
    :ivar piece: length in s of the pieces, from begin on, in which no acceleration changes.
    """

    def __init__(self, scenario: Scenario, positions: Array) -> None:
        self._points = positions
        self._step = scenario.slot_duration
        self._last = positions.shape[1] - 1
        self._smooth: NDArray[np.bool_] = np.isfinite(scenario.max_accelerations)
        margin = self._step / 2 if self._smooth.any() else 0.0
        self.begin = -margin
        self.end = self._last * self._step + margin
        self.piece = self._step / 2 if margin else self._step
        moves = np.diff(positions, axis=1)
        first, last = end_moves(moves[:, [0, -1]], scenario.end_velocities * self._step)
        # The moves w[-1], w[0], ..., w[N+1].
        self._moves = np.concatenate([first[:, None], moves, last[:, None]], axis=1)
        self._headings = _headings(moves, scenario.max_step)
        self._slow = _HOVERING * scenario.max_speeds[:, None]

    def at(self, times: ArrayLike) -> Motion:
        """Return the motion at times (K,) in s from point 0; it rests before begin, after end."""
        nodes = np.asarray(times, float) / self._step
        straight, smooth = self._straight_at(nodes), self._smooth_at(nodes)
        position, velocity, acceleration = (
            np.where(self._smooth[:, None, None], one, other)
            for one, other in zip(smooth, straight, strict=True))
        velocity, acceleration = velocity / self._step, acceleration / self._step**2
        # A share of a slot late, as times are rounded: the heading of a move holds in all of it.
        node = np.clip(np.floor(nodes + 1e-9), 0, self._last).astype(int)
        held = self._headings[:, node]
        fast = self._smooth[:, None] & (np.linalg.norm(velocity, axis=-1) > self._slow)
        heading = np.where(fast, np.arctan2(velocity[..., 1], velocity[..., 0]), held)
        return Motion(position, velocity, acceleration, heading)

    def _straight_at(self, nodes: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration of the polyline, by slots."""
        inside = np.clip(nodes, 0, self._last)
        node = np.minimum(np.floor(inside + 1e-9).astype(int), self._last)
        by = np.where(node < self._last, inside - node, 0.0)[:, None]
        flying = (nodes >= -1e-9) & (node < self._last)
        move = np.where(flying[:, None], self._moves[:, 1 + node], 0.0)
        return self._points[:, node] + by * move, move, np.zeros_like(move)

    def _smooth_at(self, nodes: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration of the B-spline, by slots."""
        inside = np.clip(nodes, -0.5, self._last + 0.5)
        position, velocity, bend = spline_at(self._points, self._moves, inside)
        flying = (inside == nodes)[:, None]
        return position, np.where(flying, velocity, 0.0), np.where(flying, bend, 0.0)


def end_moves(moves: Array, given: Array) -> Array:
    """Return the moves at both ends (2, U, 2): those of a flight (U, 2, 2) where none is given."""
    return np.where(np.isnan(given), np.swapaxes(moves, 0, 1), given)


def spline_at(points: Array, moves: Array, nodes: Array) -> tuple[Array, Array, Array]:
    """
    Return position, velocity and acceleration of a B-spline by slots, (U, K, 2) each.

    :param points: its control points, (U, M, 2).
    :param moves: w[-1], w[0], ..., w[M-1] between these and beyond, (U, M+1, 2).
    :param nodes: times in slots from the first point, from -1/2 to M - 1/2, (K,).
    """
    node = np.clip(np.round(nodes), 0, points.shape[1] - 1).astype(int)
    by = (nodes - node)[:, None]
    before, after = moves[:, node], moves[:, 1 + node]
    slope, bend = (before + after) / 2, after - before
    return points[:, node] + slope * by + bend * (by**2 / 2 + 0.125), slope + bend * by, bend


def mean_guaranteed_rates(scenario: Scenario, curve: Curve, powers: Array) -> Array:
    """Return the means of R-bar in each slot along a curve, before [x]^+, (N,) in bit/s/Hz."""
    rates = np.zeros(scenario.slots)
    for place, weight in GAUSS_LEGENDRE:
        times = (np.arange(1, scenario.slots + 1) + 0.5 + place) * scenario.slot_duration
        positions = np.pad(curve.at(times).positions, ((0, 0), (1, 1), (0, 0)))
        rates += weight * guaranteed_rates(scenario, positions, powers)
    return rates


def flown(points: Array, step: float, velocities: Array | None = None,
          accelerations: Array | None = None) -> Flown:
    """
    Return the limits and the ends with which the Curve of some points is a given motion.

    :param points: of one UAV, (N+2, 2) in m.
    :param step: the length of a slot in s.
    :param velocities: at the times of the points, (N+2, 2) in m/s; None, as for the accelerations,
        if the UAV flies straight from point to point.
    :param accelerations: likewise, (N+2, 2) in m/s^2.
    """
    moves = np.diff(points, axis=0) / step
    fastest = float(np.linalg.norm(moves, axis=-1).max())
    least_speed, least = RANGES['max_speed'][0], RANGES['max_acceleration'][0]
    if velocities is None or accelerations is None or not (
            np.abs(accelerations * step).max() > _NOTHING
            or np.abs(velocities[-1]).max() > _NOTHING):
        return Flown(max(fastest * (1 + 1e-9), least_speed), None, (0.0, 0.0), (0.0, 0.0))
    ends = [_end(moves[0], -accelerations[0] * step), _end(moves[-1], accelerations[-1] * step)]
    given = [end for end in ends if end is not None]
    fastest = max([fastest, *(math.hypot(*end) for end in given)])
    changes = np.diff(np.concatenate([
        moves[:1] if ends[0] is None else [ends[0]], moves,
        moves[-1:] if ends[1] is None else [ends[1]]]), axis=0)
    most = float(np.linalg.norm(changes, axis=-1).max()) / step
    return Flown(max(fastest * (1 + _ROUNDING), least_speed),
                 max(most * (1 + _ROUNDING), least), *ends)


def _end(velocity: Array, change: Array) -> Point | None:
    """Return the velocity at an end, from that of the move there and the change to it."""
    if np.abs(change).max() <= _NOTHING:
        return None
    x, y = (velocity + change).tolist()
    return (0.0, 0.0) if max(abs(x), abs(y)) <= _NOTHING else (x, y)


def _headings(moves: Array, max_step: Array) -> Array:
    """Return the direction of travel from every point, (U, N+2) in rad, held while hovering."""
    moves = np.concatenate([moves, np.zeros_like(moves[:, :1])], axis=1)
    moving = np.linalg.norm(moves, axis=-1) > _HOVERING * max_step[:, None]
    # The index of the last point at which the UAV moved; before the first, that of the first.
    index = np.where(moving, np.arange(moves.shape[1]), -1)
    last = np.maximum.accumulate(index, axis=1)
    first = np.argmax(moving, axis=1)[:, None]
    angle = np.arctan2(moves[..., 1], moves[..., 0])
    held = np.take_along_axis(angle, np.where(last < 0, first, last), axis=1)
    return np.where(moving.any(axis=1, keepdims=True), held, 0.0)
