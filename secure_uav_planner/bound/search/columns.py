"""
The columns of each UAV: candidate places and powers in every slot group.

The value of a column is convex in the multipliers, and so is the largest value of several columns.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .variables import DualPoint
from ..proof.reachable_set import ReachableSet, Team
from ..proof.relaxation import unit_circle
from ...mission.validation import Array

GRID = (11, 13)
"""Numbers of candidate places along and across a reachable set."""

COARSE_GRID = (4, 5)
"""Numbers of places along and across a reachable set whose columns every round uses."""

SILENT_GRID = (5, 5)
"""Numbers of silent places along and across a reachable set."""

RIM = 32
"""Number of silent places on the rim of a reachable set, the farthest in even directions."""

COARSE_POWERS = [0, 4]
"""Indices of a jammer's powers at the places of the coarse grid."""

KEPT = 45
"""Number of the best columns that a round uses."""

RECENT = 8
"""Number of latest rounds whose columns serve to choose v."""

BASE_RIM = 16
"""Number of places on the rim of the reachable set that every round uses, without jamming."""

FRESH = 5
"""Number of columns that a round improves by a compass search."""

OLD = 15
"""Number of columns improved in earlier rounds that a round keeps."""

EXACT = 16
"""Number of latest rounds whose best places of branch and bound are kept."""

SILENT = 24
"""Number of latest silent places that are kept beside the fixed ones."""


@dataclass(frozen=True, eq=False)
class Columns:
    """
    Places and powers of one UAV in every group.

    :param place: (G, C, 2) in units.
    :param power: (G, C) in W; 0 for the transmitter, whose best power has a closed form.
    :param ground: factor of w0 in the column's value, (G, C) in nats.
    :param leaks: factors of v in the column's value, (G, C, E) in nats.
    """

    place: Array
    power: Array
    ground: Array
    leaks: Array

    @classmethod
    def of(cls, region: ReachableSet, place: Array, power: Array) -> Columns:
        """
        Return the columns of places (G, C, 2) and powers (G, C) in W.

        For the transmitter `ground` is a log gain, and `leaks` are minus log gains. For a jammer
        they are -log(1 + SNR) and log(1 + SNR) of its power.
        """
        ground, leaks = region.log_squares(place)
        if region.transmits:
            return cls(place, power, region.log_gain - ground, leaks - region.log_gain)
        return cls(place, power, -np.log1p(power * np.exp(region.log_gain - ground)),
                   np.log1p(power[..., None] * np.exp(region.log_gain - leaks)))

    @classmethod
    def product(cls, region: ReachableSet, place: Array, levels: Array) -> Columns:
        """
        Return the K P columns of every place (G, K, 2) with every power in `levels` (G, P).

        Column k P + p of a group has place k and power p.
        """
        places, powers = place.shape[1], levels.shape[1]
        return cls.of(region, np.repeat(place, powers, axis=1), np.tile(levels, (1, places)))

    def take(self, index: NDArray[np.intp]) -> Columns:
        """Return the columns with given indices in every group, (G, C')."""
        row = np.arange(len(index))[:, None]
        return Columns(self.place[row, index], self.power[row, index],
                       self.ground[row, index], self.leaks[row, index])

    @staticmethod
    def choose(parts: list[Columns], number: NDArray[np.intp]) -> Columns:
        """
        Return columns (G, C) whose row g is row g of parts[number[g]].

        C is the largest number of columns of a part. Parts with fewer repeat their last column.

        :param number: for each group the index of its Columns in `parts`, (G,).
        """
        group, counts = np.arange(len(number)), [part.power.shape[1] for part in parts]
        columns = np.minimum(np.arange(max(counts)), np.array(counts)[:, None] - 1)
        return Columns(*(np.stack([
            getattr(part, name)[:, column] for part, column in zip(parts, columns)])[number, group]
            for name in ('place', 'power', 'ground', 'leaks')))

    def spread(self, group: NDArray[np.intp], groups: int) -> Columns:
        """
        Return columns (G, C) made of these columns (M, 1): row g has the columns of group g.

        C is the largest number of columns in a group. Rows with fewer repeat their last column.

        :param group: group of each column, (M,); every group occurs.
        :param groups: G.
        """
        order = np.argsort(group, kind='stable')
        count = np.bincount(group, minlength=groups)[:, None]
        first = np.cumsum(count)[:, None] - count
        index = order[first + np.minimum(np.arange(count.max()), count - 1)]
        return Columns(*(getattr(self, name)[index, 0]
                         for name in ('place', 'power', 'ground', 'leaks')))

    @staticmethod
    def concatenate(parts: list[Columns]) -> Columns:
        """Return the columns of several Columns (G, C_i) side by side, (G, sum of C_i)."""
        return Columns(*(np.concatenate([getattr(part, name) for part in parts], 1)
                         for name in ('place', 'power', 'ground', 'leaks')))


def sample_grid(region: ReachableSet, along: int, across: int) -> Array:
    """
    Return a grid of places in every reachable set, its boundary included, (G, along * across, 2).

    :param along: number of coordinates x over the bounding box, denser at both of its ends.
    :param across: number of equidistant coordinates y for each x.
    """
    low, high = region.bounding_box
    even = np.linspace(0, 1, along)
    fraction = 0.25 * (1 - np.cos(np.pi * even)) + 0.5 * even
    x = low[:, :1] + (high - low)[:, :1] * fraction
    # |y| <= half, (G, along), in the discs about start and goal at x.
    r1, r2 = region.from_start[:, None], region.to_goal[:, None]
    half = np.sqrt(np.maximum(np.minimum(
        (r1 - x) * (r1 + x), r2**2 - (x - region.distance)**2), 0.0))
    bottom, top = np.maximum(-half, low[:, 1:]), np.minimum(half, high[:, 1:])
    y = bottom[..., None] + (top - bottom)[..., None] * np.linspace(0, 1, across)
    place = np.stack([np.repeat(x, across, 1), y.reshape(len(x), -1)], -1)
    return region.clip(place, np.arange(len(x))[:, None])


def sample_powers(region: ReachableSet, power: Array) -> Array:
    """
    Return 13 powers of a jammer for every group, (G, 13) in W.

    They are 0, seven powers from e^-1.2 to e^1.2 times the plan's power, and five powers from
    1e-4 times the peak to the peak. None exceeds the peak.

    :param power: jamming powers of the plan, (G,) in W.
    """
    about = np.clip(power, 1e-6 * region.peak, region.peak)[:, None]
    return np.asarray(np.minimum(np.concatenate([
        np.zeros_like(about), about * np.exp(np.linspace(-1.2, 1.2, 7)),
        np.broadcast_to(region.peak * np.geomspace(1e-4, 1.0, 5), (len(power), 5))], 1),
        region.peak))


class ColumnPool:
    """
    The columns of one UAV: fixed columns, the columns of the latest rounds, and silent places.

    :param region: reachable sets of the UAV.
    :param places: places of a plan, which become columns, (G, 2) in units.
    :param powers: powers of the plan, around which a jammer's powers lie, (G,) in W.
    """

    def __init__(self, region: ReachableSet, places: Array, powers: Array) -> None:
        """
        Lay the fixed columns: `_table`, `_base` and silent places.

        `_table` has a fine grid, the plan's places and the places nearest to receivers, each with
        every power. `_base` has a coarse grid with few powers, and the rim without jamming.
        """
        self.region, count = region, len(places)
        receivers = np.concatenate([region.ground[None], region.eavesdroppers])
        nearest = region.clip(np.broadcast_to(receivers, (count, *receivers.shape)),
                              np.arange(count)[:, None])
        self._grid = np.concatenate(
            [sample_grid(region, *GRID), places[:, None], nearest], 1)
        coarse = np.concatenate([sample_grid(region, *COARSE_GRID), nearest], 1)
        power = np.zeros((count, 1)) if region.transmits else sample_powers(region, powers)
        coarse_power = power if region.transmits else power[:, COARSE_POWERS]
        rim = region.find_farthest(unit_circle(BASE_RIM)[None])
        self._table = Columns.product(region, self._grid, power)
        self._base = Columns.concatenate([
            Columns.product(region, coarse, coarse_power),
            Columns.of(region, rim, np.zeros(rim.shape[:2]))])
        self._improved: list[Columns] = []
        self._rounds: list[Columns] = []
        self._exact: list[Columns] = []
        self._silent_places = np.concatenate(
            [region.find_farthest(unit_circle(RIM)[None]), sample_grid(region, *SILENT_GRID)], 1)

    @property
    def latest(self) -> Columns:
        """Return the columns of the latest round and the columns that every round uses."""
        return Columns.concatenate([self._base, self._rounds[-1], *self._exact])

    @staticmethod
    def join(pools: list[ColumnPool]) -> Columns:
        """
        Return the columns on which v is chosen.

        They are the fixed columns, and each pool's columns of kept rounds and branch and bound.

        :param pools: pools of one UAV, which have the fixed columns in common.
        """
        first = pools[0]
        return Columns.concatenate([
            first._base, first._table,
            *(part for pool in pools for part in (*pool._rounds, *pool._exact))])

    @staticmethod
    def choose(pools: list[ColumnPool], number: NDArray[np.intp]) -> ColumnPool:
        """
        Return a pool that has in every group g the columns that rounds added to pools[number[g]].

        The pools are of one UAV, so their fixed columns are equal. Silent places are pools[0]'s.

        :param number: for each group the index of its pool in `pools`, (G,).
        """
        pool = copy(pools[0])
        for name in ('_improved', '_rounds', '_exact'):
            lists = [getattr(other, name) for other in pools]
            setattr(pool, name, [Columns.choose(list(parts), number) for parts in zip(*lists)])
        return pool

    @property
    def silent(self) -> Columns:
        """Return the columns of silent places, at which no UAV sends."""
        place = self._silent_places
        none = np.zeros(place.shape[:2])
        return Columns(place, none, none, np.zeros((*none.shape, len(self.region.radii))))

    def add_round(self, evaluate: Callable[[Columns], Array]) -> None:
        """
        Add a round: the pool's KEPT best columns and its latest OLD + FRESH improved columns.

        The pool is the table of fixed places and powers, silent places, and improved columns. A
        compass search improves FRESH of the best columns. Only RECENT rounds are kept.

        :param evaluate: returns the values of columns, (G, C) in nats, at the search's w0 and v.
        """
        # A jammer may best be silent in a slot in which the transmitter sends.
        places = self._silent_places
        silent = Columns.of(self.region, places, np.zeros(places.shape[:2]))
        pool = Columns.concatenate([self._table, silent, *self._improved])
        value = evaluate(pool)
        kept = min(KEPT, value.shape[1])
        chosen = pool.take(np.argpartition(value, -kept, axis=1)[:, -kept:])
        self._add_improved(pool, value, evaluate)
        self._rounds = [*self._rounds, Columns.concatenate([chosen, *self._improved])][-RECENT:]

    def _add_improved(self, pool: Columns, value: Array,
                      evaluate: Callable[[Columns], Array]) -> None:
        """
        Improve the FRESH best columns at distinct places; keep the latest OLD + FRESH improved.

        :param pool: the table's columns, then others.
        :param value: values of the pool's columns, (G, C) in nats.
        """
        # Candidates have the best power at each place; starts are the best ones far apart.
        best = self._select_powers(value)
        candidates, value = pool.take(best), np.take_along_axis(value, best, 1)
        starts = candidates.take(_select_distinct(self.region, candidates, value))
        improved = Columns.concatenate([*self._improved, self._improve(starts, evaluate)])
        latest = np.arange(improved.power.shape[1])[-OLD - FRESH:]
        self._improved = [improved.take(np.tile(latest, (len(value), 1)))]

    def add_exact(self, columns: Columns) -> None:
        """Add columns that are better than all others, and drop the oldest of their kind."""
        self._exact = [*self._exact, columns][-EXACT:]

    def _select_powers(self, value: Array) -> NDArray[np.intp]:
        """
        Return indices of the best column at each of K places, then of M columns, (G, K + M).

        The K P columns of the table have P powers at each place: column k P + p has place k and
        power p. M silent and improved columns follow the table.

        :param value: values of the columns in each slot group, (G, K P + M) in nats.
        """
        groups, places, table = len(value), self._grid.shape[1], self._table.power.shape[1]
        powers = table // places
        best_power = value[:, :table].reshape(groups, places, powers).argmax(2)
        others = np.arange(table, value.shape[1])
        return np.concatenate(
            [powers * np.arange(places) + best_power, np.tile(others, (groups, 1))], 1)

    def add_silent_places(self, slope: Array | None, evaluate: Callable[[Columns], Array]) -> None:
        """
        Add the best silent places for the present multipliers, and drop the oldest added ones.

        :param slope: slope of a linear potential's change in each group, (G, 2), for which the
            best place is the farthest one; None for quadratic potentials.
        :param evaluate: returns the values of silent columns, (G, C) in nats.
        """
        region, place = self.region, self._silent_places
        if slope is not None:
            new = region.find_farthest(slope[:, None])
        else:
            pool = self.silent
            start = pool.take(_select_distinct(region, pool, evaluate(pool)))
            new = self._improve(start, evaluate).place
        fixed = RIM + SILENT_GRID[0] * SILENT_GRID[1]
        latest = np.concatenate([place[:, fixed:], new], 1)[:, -SILENT:]
        self._silent_places = np.concatenate([place[:, :fixed], latest], 1)

    def _improve(self, start: Columns, evaluate: Callable[[Columns], Array]) -> Columns:
        """
        Return the columns that a compass search reaches from the columns `start`, (G, C).

        Each of 8 rounds tries for each column moves of the place and, for a jammer, of the log
        power in both directions, and takes the best. If none is better, the moves are shortened.
        """
        region = self.region
        groups, columns = start.power.shape
        low, high = region.bounding_box
        step = np.repeat(((high - low).max(1) / 12)[:, None], columns, 1)
        log_step = np.full((groups, columns), 0.4)
        place, power = start.place, start.power
        # M = 5 or 7 moves of x, y and log power, (M, 3); the first is to stay.
        moves = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0],
                          [0, 0, 1], [0, 0, -1]][:5 if region.transmits else 7], float)
        for _ in range(8):
            places = self._move_places(place, step, moves[:, :2])
            powers = np.minimum(power[..., None] * np.exp(log_step[..., None] * moves[:, 2]),
                                region.peak)
            trials = Columns.of(region, places.reshape(groups, -1, 2), powers.reshape(groups, -1))
            best = evaluate(trials).reshape(groups, columns, len(moves)).argmax(-1)
            place = np.take_along_axis(places, best[..., None, None], 2)[:, :, 0]
            power = np.take_along_axis(powers, best[..., None], 2)[..., 0]
            step, log_step = (np.where(best == 0, size / 2.5, size) for size in (step, log_step))
        return Columns.of(region, place, power)

    def _move_places(self, place: Array, step: Array, moves: Array) -> Array:
        """
        Return places (G, C, 2) plus steps (G, C) times moves (M, 2), (G, C, M, 2).

        A moved place is clipped to its reachable set; if it is still outside, the place stays.
        """
        region, group = self.region, np.arange(len(place))[:, None, None]
        moved = region.clip(place[:, :, None] + step[..., None, None] * moves, group)
        return np.where(region.contains(moved, group)[..., None], moved, place[:, :, None])


def _select_distinct(region: ReachableSet, pool: Columns, value: Array) -> NDArray[np.intp]:
    """
    Return the indices of the FRESH best columns at places far from each other, (G, FRESH).

    Each choice excludes the columns that are closer than an eighth of the bounding box's longer
    side in both coordinates.

    :param value: values of the pool's columns, (G, C) in nats.
    """
    low, high = region.bounding_box
    far = ((high - low).max(1) / 8)[:, None]
    value = value.copy()
    group = np.arange(len(value))
    chosen = []
    for _ in range(FRESH):
        best = value.argmax(1)
        chosen.append(best)
        offset = np.abs(pool.place - pool.place[group, best][:, None])
        value[(offset[..., 0] < far) & (offset[..., 1] < far)] = -np.inf
    return np.stack(chosen, 1)


def pack_columns(team: Team, uav: int, point: DualPoint, columns: Columns, weight: Array,
                 v: Array, tau: float = 1e-9) -> dict[str, Any]:
    """
    Return the kernel's arguments by name: columns of a UAV, its potential and price, w0 and v.

    :param weight: w0, (G,).
    :param v: eavesdropper multipliers, (G, E).
    :param tau: temperature [nats].
    """
    potentials, layout = point.potentials[:, uav], point.layout
    arrays = {
        'place': columns.place, 'power': columns.power, 'ground': columns.ground,
        'leaks': columns.leaks, 'potentials': potentials, 'count': team.groups.count,
        'step': team.regions[uav].steps, 'mean': team.groups.means, 'weights': weight,
        'v': v}
    return {**{name: np.ascontiguousarray(array, float) for name, array in arrays.items()},
            'quadratic': layout.quadratic, 'accelerates': layout.accelerates, 'tau': tau,
            'price': float(point.prices[uav])}
