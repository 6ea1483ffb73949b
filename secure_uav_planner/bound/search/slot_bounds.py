"""
The bounds of slots on columns at given w0, minimised over v; and where cells make them closer.

A column is a place and a power of a UAV in a group of slots. A UAV's term in the bound is the
largest value over its columns of base + w0 ground + v . leaks.
A slot's bound is the certificate's B without H(w0), with maxima over columns. Over too few columns
the minimum would choose a v that is bad at missing places, so all columns of a pool are used.
Measured: with the columns of the latest rounds alone, the bound of a mission with one jammer is
5.7% above its plan instead of 4.1%.
"""

import numpy as np

from .columns import Columns
from ..proof.reachable_set import Cells, Team
from ...mission.validation import Array
from ...model.kernel import core
from ...optimize.deadline import DeadlineCheck

LEAST_GAIN = 2e-3
"""Least reduction [nats] of a slot's bound for which its reachable set is divided into cells."""

BLOCK = 50
"""Number of cells between two questions whether the search is over."""


class SlotBounds:
    """
    Bounds of all slots on columns.

    They estimate the certificate's bounds from below and prove nothing.

    :param team: the UAVs.
    :param columns: for each UAV its columns, and their values without w0 and v, (G, C) in nats.
    :param price: lam of the transmitter, the multiplier of its average power [nats per W].
    :param raise_if_over: called before every block of cells; an error that it raises ends the
        search.
    """

    def __init__(self, team: Team, columns: list[tuple[Columns, Array]], price: float,
                 raise_if_over: DeadlineCheck = lambda: None) -> None:
        """Begin with each UAV's columns and their values (G, C) without w0 and v; price is lam."""
        self._team, self._price, self._raise_if_over = team, price, raise_if_over
        self._columns = [_arrange(*part) for part in columns]
        # Index of the adversary to which each place belongs, (E,).
        self._adversaries = np.zeros(len(team.regions[0].radii), np.int64)
        for number, places in enumerate(team.adversaries):
            self._adversaries[places] = number

    def add(self, uav: int, columns: Columns, base: Array) -> None:
        """Add columns of a UAV; `base` (G, C) in nats are their values at w0 = 0 and v = 0."""
        self._columns[uav] = tuple(np.concatenate(parts, 1) for parts in zip(
            self._columns[uav], _arrange(columns, base)))

    def minimise(self, weights: Array, cells: Cells, ratio: Array) -> tuple[Array, Array, Array]:
        """
        Minimise over v, approximately, a slot's bound at each of K w0 in each cell.

        :param weights: w0, (K, C), with K values for each cell.
        :param cells: C cells of the last UAV; each belongs to one group of slots.
        :param ratio: v / w0 where each search for v begins, (C, E) or (K, C, E).
        :return: v (K, C, E), the largest value of each UAV's columns (U, K, C) in nats, and the
            bounds without H(w0) (K, C) in nats.
        """
        v = ratio * weights[..., None]
        terms, bounds = np.empty((len(self._columns), *weights.shape)), np.empty(weights.shape)
        for first in range(0, len(cells.group), BLOCK):
            self._raise_if_over()
            block = slice(first, first + BLOCK)
            parts = [np.ascontiguousarray(part) for part in (
                cells.group[block], cells.low[block], cells.high[block], weights[:, block],
                v[:, block], terms[..., block], bounds[:, block])]
            core.minimise_slot_bounds(
                self._columns, self._adversaries, self._price, self._team.regions[0].peak, *parts)
            v[:, block], terms[..., block], bounds[:, block] = parts[4:]
        return v, terms, bounds

    def divide(self, cells: Cells, weight: Array, ratio: Array) -> tuple[Cells, Array]:
        """
        Divide cells into four where this can lower a slot's bound by more than LEAST_GAIN.

        A slot's bound is the largest one of its cells. Let b be the slot's bound with all cells
        divided. A cell is divided if its own bound exceeds b + LEAST_GAIN.

        :param cells: C cells of the last UAV.
        :param weight: w0 at which bounds are compared, (G,).
        :param ratio: v / w0 where each search for v begins, (C, E).
        :return: the cells, and their ratios.
        """
        every = np.arange(len(cells.group))
        quarters, parent = cells.quarter(every), np.tile(every, 4)
        _, _, before = self.minimise(weight[None, cells.group], cells, ratio)
        _, _, after = self.minimise(weight[None, quarters.group], quarters, ratio[parent])
        slot_bounds = np.full(len(weight), -np.inf)
        np.maximum.at(slot_bounds, quarters.group, after[0])
        chosen = np.flatnonzero(before[0] - slot_bounds[cells.group] > LEAST_GAIN)
        # `quarter` keeps one part of a chosen cell in its place and appends the three others.
        return cells.quarter(chosen), ratio[np.concatenate([every, np.tile(chosen, 3)])]


def _arrange(columns: Columns, base: Array) -> tuple[Array, ...]:
    """Return (place, base, ground, leaks), where base + w0 ground + v . leaks is a value."""
    return tuple(np.ascontiguousarray(values) for values in (
        columns.place, base, columns.ground, columns.leaks))
