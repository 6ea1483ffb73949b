"""
The curve that the UAVs fly, in continuous time, with its mean rates and its energy.

With a limit of acceleration, the points of a UAV are the control points of a uniform quadratic
B-spline: it passes (q[n] + q[n+1]) / 2 half a slot after point n, with the velocity
(q[n+1] - q[n]) / t_s, and between two such moments its acceleration is constant. So it leaves its
start half a slot before point 0 and reaches its goal half a slot after point N+1. Without the
limit, it flies straight from point to point.
"""

from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..mission.scenario import Array, Scenario, Uav

_STANDING = 1e-3  # Share of the largest speed below which a heading is numerical noise.

GAUSS_LEGENDRE = ((-math.sqrt(0.15), 5 / 18), (0.0, 8 / 18), (math.sqrt(0.15), 5 / 18))
"""Places from -1/2 to 1/2 and weights, whose weighted sum is the mean of quintics in between."""

_MOST_PIECES = 64  # Pieces of a slot in which powers are integrated.

HOVERING_SPEED = 0.1
"""A UAV hovers if it is slower than this share of its largest speed. The default rotary wing needs
1% less power at 1 m/s than at rest, and a UAV that loiters in place is as slow."""


class Motion(NamedTuple):
    """
    Motion of the UAVs at K times, (U, K, 2) in m, m/s and m/s^2.

    :ivar headings: directions of travel, held while hovering, (U, K) in rad from x to y.
    """

    positions: Array
    velocities: Array
    accelerations: Array
    headings: Array


class Energy(NamedTuple):
    """
    Energy of one UAV's flight, from when the first UAV leaves until the last one arrives.

    :ivar total: energy of the whole flight [J].
    :ivar hovering: energy while the UAV is slower than HOVERING_SPEED times its max_speed [J].
    :ivar flying: energy while the UAV is not hovering [J].
    """

    total: float
    hovering: float
    flying: float


class Curve:
    """
    The flight of all UAVs as a function of time.

    :param scenario: Scenario of the UAVs.
    :param positions: points of the flight, (U, N+2, 2) in m, for any N.
    :ivar begin: time at which the UAVs leave their starts, in s from point 0.
    :ivar end: time at which the UAVs reach their goals, in s from point 0.
    :ivar piece: length in s of the pieces with constant acceleration; the first starts at begin.
    """

    def __init__(self, scenario: Scenario, positions: Array) -> None:
        """Compute the times begin and end, and the moves and headings from point to point."""
        self._points = positions
        self._step = scenario.slot_duration
        self._last = positions.shape[1] - 1
        self._smooth = scenario.limits_acceleration
        # A limit of acceleration makes the curve half a slot longer at both ends.
        margin = self._step / 2 if self._smooth else 0.0
        self.begin = 0.0 - margin  # Not -0.0.
        self.end = self._last * self._step + margin
        self.piece = self._step / 2 if margin else self._step
        moves = np.diff(positions, axis=1)
        self._moves = add_end_moves(moves, scenario.end_velocities * self._step)
        self._headings = _find_headings(moves, scenario.max_step)
        self._slow = _STANDING * scenario.max_speeds[:, None]

    def at(self, times: ArrayLike) -> Motion:
        """Return the motion at times (K,) in s from point 0; UAVs rest before begin, after end."""
        slot_times = np.asarray(times, float) / self._step
        evaluate = self._evaluate_spline if self._smooth else self._evaluate_polyline
        position, velocity, acceleration = evaluate(slot_times)
        velocity, acceleration = velocity / self._step, acceleration / self._step**2
        # The 1e-9 of a slot allows for rounded times: the heading of a move holds from its begin.
        point = np.clip(np.floor(slot_times + 1e-9), 0, self._last).astype(int)
        heading = self._headings[:, point]
        if self._smooth:
            fast = np.linalg.norm(velocity, axis=-1) > self._slow
            heading = np.where(fast, np.arctan2(velocity[..., 1], velocity[..., 0]), heading)
        return Motion(position, velocity, acceleration, heading)

    @property
    def slot_velocities(self) -> tuple[Array, Array]:
        """
        Velocities at the beginning and the end of each slot of the curve, (U, M, 2) in m/s.

        With a limit of acceleration M = N + 2. Otherwise M = N + 1, and both velocities are equal.
        """
        velocities = self._moves / self._step
        if self._smooth:
            return velocities[:, :-1], velocities[:, 1:]
        return velocities[:, 1:-1], velocities[:, 1:-1]

    def _evaluate_polyline(self, slot_times: Array) -> tuple[Array, Array, Array]:
        """Return position [m], velocity [m/slot], acceleration 0 of the polyline, (U, K, 2)."""
        inside = np.clip(slot_times, 0, self._last)
        point = np.minimum(np.floor(inside + 1e-9).astype(int), self._last)
        share = np.where(point < self._last, inside - point, 0.0)[:, None]
        flying = (slot_times >= -1e-9) & (point < self._last)
        move = np.where(flying[:, None], self._moves[:, 1 + point], 0.0)
        return self._points[:, point] + share * move, move, np.zeros_like(move)

    def _evaluate_spline(self, slot_times: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity, acceleration on the B-spline in m and slots, (U, K, 2)."""
        inside = np.clip(slot_times, -0.5, self._last + 0.5)
        position, velocity, bend = evaluate_spline(self._points, self._moves, inside)
        flying = (np.abs(inside - slot_times) <= 1e-9)[:, None]
        return position, np.where(flying, velocity, 0.0), np.where(flying, bend, 0.0)


def add_end_moves(moves: Array, ends: Array) -> Array:
    """
    Return the moves w[-1], w[0], ..., w[M] of flights, (U, M+2, 2).

    :param moves: w[0], ..., w[M-1], (U, M, 2).
    :param ends: w[-1] and w[M], (2, U, 2); NaN repeats the neighbouring move.
    """
    ends = np.where(np.isnan(ends), np.swapaxes(moves[:, [0, -1]], 0, 1), ends)
    return np.concatenate([ends[0][:, None], moves, ends[1][:, None]], axis=1)


def evaluate_spline(points: Array, moves: Array, slot_times: Array) -> tuple[Array, Array, Array]:
    """
    Return position, velocity and acceleration of a B-spline, (U, K, 2), with time in slots.

    :param points: control points, (U, M, 2).
    :param moves: w[-1], w[0], ..., w[M-1] between the control points and beyond, (U, M+1, 2). The
        velocity changes linearly from w[n-1] at time n - 1/2 to w[n] at n + 1/2.
    :param slot_times: times in slots from the first point, from -1/2 to M - 1/2, (K,).
    """
    point = np.clip(np.round(slot_times), 0, points.shape[1] - 1).astype(int)
    delay = (slot_times - point)[:, None]
    before, after = moves[:, point], moves[:, 1 + point]
    slope, bend = (before + after) / 2, after - before
    positions = points[:, point] + slope * delay + bend * (delay**2 / 2 + 0.125)
    return positions, slope + bend * delay, bend


def mean_node_rates(scenario: Scenario, find_rates: Callable[..., Array],
                    state_at: Callable[[Array], tuple[Array, Array, Array]],
                    slots: ArrayLike | None = None) -> Array:
    """
    Return each node's mean rate in continuous time over each of M slots, (G, M) in bit/s/Hz.

    Slot i lasts from point i + 1 to point i + 2. Rates at three times of the slot are averaged,
    `place` slots from the middle, by Gauss-Legendre quadrature.

    :param find_rates: rates of the nodes, such as channel.guaranteed_node_rates.
    :param state_at: positions (U, M, 2) in m, powers (U, M) in W, and the times (M,) in s of the
        receivers' places, at times (M,) in s.
    :param slots: indices from 0 of M slots, by default all.
    """
    slots = np.arange(scenario.slots) if slots is None else np.asarray(slots)
    return average_node_rates(scenario, find_rates, state_at, lambda place: np.asarray(
        (slots + 1.5 + place) * scenario.slot_duration, float))


def average_node_rates(scenario: Scenario, find_rates: Callable[..., Array],
                       state_at: Callable[[Array], tuple[Array, Array, Array]],
                       times_at: Callable[[float], Array]) -> Array:
    """
    Return each node's mean rate over each of K intervals by Gauss-Legendre, (G, K) in bit/s/Hz.

    :param find_rates: as in mean_node_rates, and so is state_at.
    :param times_at: times (K,) in s that lie `place` lengths of their interval from its middle.
    """
    rates = np.zeros((len(scenario.ground_nodes), len(times_at(0.0))))
    for place, weight in GAUSS_LEGENDRE if rates.shape[1] else ():
        positions, powers, receiver_times = state_at(times_at(place))
        # The rates ignore the first and the last point, which are padding here.
        rates += weight * find_rates(
            scenario, np.pad(positions, ((0, 0), (1, 1), (0, 0))), powers, times=receiver_times)
    return rates


def compute_energies(scenario: Scenario, curve: Curve) -> tuple[Energy | None, ...]:
    """
    Return the Energy of each UAV along a curve, None for one without a propulsion.

    Propulsion.power at the speed is integrated. Neither the power for changes of velocity nor the
    radio's is included.
    """
    energies = integrate_powers(scenario.uavs, *curve.slot_velocities, scenario.slot_duration)
    return tuple(None if uav.propulsion is None else Energy(hovering + flying, hovering, flying)
                 for uav, (hovering, flying) in zip(scenario.uavs, energies.tolist(), strict=True))


def integrate_powers(uavs: Sequence[Uav], before: Array, after: Array, step: float) -> Array:
    """
    Return the energies of UAVs, hovering and flying, (U, 2) in J.

    The velocity is linear in each slot. Slots are divided into pieces in which it changes by at
    most half of the induced velocity, the width of the power's maximum at rest. Gauss-Legendre
    quadrature of each piece is then within 1e-6 of the integral. A slot has at most _MOST_PIECES
    pieces. A UAV is hovering while it is slower than HOVERING_SPEED times its max_speed.

    :param before: velocities at the beginnings of M slots, (U, M, 2) in m/s.
    :param after: velocities at the ends of the slots, (U, M, 2) in m/s.
    :param step: length of a slot in s.
    :return: 0 for a UAV without a propulsion.
    """
    energies = np.zeros((len(uavs), 2))
    for index, uav in enumerate(uavs):
        if uav.propulsion is None:
            continue
        change = after[index] - before[index]
        pieces = math.ceil(2 * float(np.linalg.norm(change, axis=-1).max(initial=0.0))
                           / uav.propulsion.induced_velocity)
        pieces = min(max(pieces, 1), _MOST_PIECES)
        for piece in range(pieces):
            for place, weight in GAUSS_LEGENDRE:
                velocities = before[index] + (piece + 0.5 + place) / pieces * change
                speeds = np.hypot(velocities[:, 0], velocities[:, 1])
                joules = uav.propulsion.power(speeds) * (weight * step / pieces)
                hovers = speeds < HOVERING_SPEED * uav.max_speed
                energies[index] += joules[hovers].sum(), joules[~hovers].sum()
    return energies


def _find_headings(moves: Array, max_step: Array) -> Array:
    """
    Return the direction of travel from every point, (U, N+2) in rad.

    A UAV hovers after a point if its move is at most _STANDING * max_step. It then keeps the
    direction of its last longer move. Before its first longer move it has this move's direction,
    and 0 if it never moves.

    :param moves: moves from each point to the next, (U, N+1, 2) in m.
    :param max_step: moves at full speed, (U,) in m.
    """
    moves = np.concatenate([moves, np.zeros_like(moves[:, :1])], axis=1)
    moving = np.linalg.norm(moves, axis=-1) > _STANDING * max_step[:, None]
    # The index of the last point at which the UAV moved. Before its first move it is -1.
    index = np.where(moving, np.arange(moves.shape[1]), -1)
    last = np.maximum.accumulate(index, axis=1)
    first = np.argmax(moving, axis=1)[:, None]
    angle = np.arctan2(moves[..., 1], moves[..., 0])
    held = np.take_along_axis(angle, np.where(last < 0, first, last), axis=1)
    return np.where(moving.any(axis=1, keepdims=True), held, 0.0)
