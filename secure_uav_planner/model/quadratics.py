"""Exact extremes of motion that is piecewise quadratic in time."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .curve import Curve
from ..mission.validation import Array

_HALVINGS = 45
_POINT = 1e-300  # The square of an edge's length at least, where its corners are equal.
_ROUNDING = 1e-9  # Share by which edges and pieces are made longer, so that no crossing is missed.


class Pieces(NamedTuple):
    """
    Pieces of equal length in which every UAV moves with constant acceleration.

    :ivar times: of the middles, (K,) in s from point 0.
    :ivar half: half the length of a piece, in s.
    :ivar positions: in the middles, (..., K, 2) in m, as the velocities and the accelerations.
    """

    times: Array
    half: float
    positions: Array
    velocities: Array
    accelerations: Array

    @classmethod
    def of(cls, curve: Curve) -> 'Pieces':
        """Return the pieces of a flight from its begin to its end, with arrays (U, K, 2)."""
        count = round((curve.end - curve.begin) / curve.piece)
        times = curve.begin + (np.arange(count) + 0.5) * curve.piece
        motion = curve.at(times)
        return cls(times, curve.piece / 2, motion.positions, motion.velocities,
                   motion.accelerations)

    def select_uav(self, uav: int) -> 'Pieces':
        """Return the pieces of one UAV, with arrays (K, 2)."""
        return self._replace(positions=self.positions[uav], velocities=self.velocities[uav],
                             accelerations=self.accelerations[uav])

    def take(self, index: Array) -> 'Pieces':
        """Return the pieces with these indices, for arrays (K, 2)."""
        return Pieces(self.times[index], self.half, self.positions[index],
                      self.velocities[index], self.accelerations[index])

    def at(self, by: Array) -> Array:
        """Return positions at times from the middles, (..., K) in s."""
        return (self.positions + self.velocities * by[..., None]
                + self.accelerations * (by[..., None]**2 / 2))

    @property
    def reach(self) -> Array:
        """Largest distance from the middle of a piece, (..., K, 2) along x and y in m."""
        return (np.abs(self.velocities) * self.half
                + np.abs(self.accelerations) * (self.half**2 / 2))


def least_distance(position: Array, velocity: Array, acceleration: Array,
                   half: float) -> tuple[Array, Array]:
    """
    Return the least of |position + velocity t + acceleration t^2 / 2| for |t| <= half, and t.

    The square is a quartic of t, convex on both sides of where its second derivative is negative.
    On each side the zero of its derivative is bisected. Arrays are (K, 2), and (K,).
    """
    cubic = 0.5 * (acceleration**2).sum(axis=-1)
    square = 1.5 * (velocity * acceleration).sum(axis=-1)
    linear = ((velocity**2) + position * acceleration).sum(axis=-1)
    constant = (position * velocity).sum(axis=-1)
    first, second = _find_roots(3 * cubic, square, linear, half)
    best, at = np.full(len(position), np.inf), np.zeros(len(position))
    for low, high in ((np.full(len(position), -half), first), (second, np.full_like(at, half))):
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            rises = constant + middle * (linear + middle * (square + middle * cubic)) > 0
            low, high = np.where(rises, low, middle), np.where(rises, middle, high)
        by = (low + high) / 2
        distance = np.linalg.norm(
            position + velocity * by[:, None] + acceleration * (by[:, None]**2 / 2), axis=-1)
        at = np.where(distance < best, by, at)
        best = np.minimum(distance, best)
    return best, at


def find_crossings(pieces: Pieces, edges: Array) -> tuple[Array, NDArray[np.bool_]]:
    """
    Find the crossings of K pieces with arrays (K, 2) and K edges (K, 2, 2) in m, pair by pair.

    :return: two times from the middles, (K, 2) in s, and which are crossings, (K, 2).
    """
    begin, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    places = _find_roots((pieces.accelerations * normal).sum(axis=1) / 2,
                         (pieces.velocities * normal).sum(axis=1) / 2,
                         ((pieces.positions - begin) * normal).sum(axis=1), np.inf)
    times = np.stack(places, axis=1)
    inside = np.abs(times) <= pieces.half * (1 + _ROUNDING)
    times = np.clip(times, -pieces.half, pieces.half)
    share = np.stack([((pieces.at(by) - begin) * along).sum(axis=1) for by in times.T], axis=1)
    share /= np.maximum((along**2).sum(axis=1, keepdims=True), _POINT)
    return times, inside & (np.abs(share - 0.5) <= 0.5 + _ROUNDING)


def least_distance_to_edge(pieces: Pieces, edges: Array) -> tuple[Array, Array]:
    """
    Return the least distances (K,) of pieces to edges, and their times from the middles, (K,).

    Pieces and edges are as in find_crossings. A distance is least where that to the line of the
    edge or to one of its corners is, where the edge is crossed, or at an end of the piece.
    """
    begin, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    half = np.full(len(edges), pieces.half)
    bend, slope = ((part * normal).sum(axis=1)
                   for part in (pieces.accelerations, pieces.velocities))
    line = np.divide(-slope, bend, out=half.copy(), where=np.abs(slope) < np.abs(bend) * half)
    corners = [least_distance(pieces.positions - edges[:, end], pieces.velocities,
                              pieces.accelerations, pieces.half)[1] for end in range(2)]
    crossings, crosses = find_crossings(pieces, edges)
    times = np.stack([line, *corners, -half, half, *np.where(crosses, crossings, half[:, None]).T])
    offsets = pieces.at(times) - begin
    square = np.maximum((along**2).sum(axis=1), _POINT)
    share = np.clip((offsets * along).sum(axis=-1) / square, 0, 1)
    distances = np.linalg.norm(offsets - share[..., None] * along, axis=-1)
    best = distances.argmin(axis=0)[None]
    return (np.take_along_axis(distances, best, axis=0)[0],
            np.take_along_axis(times, best, axis=0)[0])


def _find_roots(square: Array, half_linear: Array, constant: Array,
                most: float) -> tuple[Array, Array]:
    """
    Return the smaller and the larger root of square t^2 + 2 half_linear t + constant.

    They are limited to -most and most, and both are most where there are none.
    """
    discriminant = half_linear**2 - square * constant
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        # Without cancellation, and with a root at infinity where the polynomial is linear.
        scaled = -(half_linear + np.copysign(np.sqrt(discriminant), half_linear))
        first, second = scaled / square, constant / scaled
    first, second = (np.where(np.isnan(first), second, first),
                     np.where(np.isnan(second), first, second))
    exists = (discriminant >= 0) & ((square != 0) | (half_linear != 0))
    low, high = (np.where(exists, np.clip(root, -most, most), most)
                 for root in (np.minimum(first, second), np.maximum(first, second)))
    return low, high
