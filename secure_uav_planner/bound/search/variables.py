"""The unknowns of the search, the multipliers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...mission.validation import Array


class PotentialLayout(NamedTuple):
    """
    The slices of u, S and w in the P numbers of a UAV's potential at an edge; the kernel reads it.

    :param slope: slice of u.
    :param curvature: slice of S; empty if potentials are linear.
    :param acceleration: slice of w; empty if no UAV has a limit of acceleration.
    """

    slope: slice
    curvature: slice
    acceleration: slice

    @classmethod
    def of(cls, quadratic: bool, accelerates: bool) -> PotentialLayout:
        """Return the layout with S if `quadratic`, and with w if `accelerates`."""
        return cls(*_lay_out(2, 3 if quadratic else 0, 2 if accelerates else 0))

    @property
    def quadratic(self) -> bool:
        """Return True if the layout has S."""
        return bool(self.curvature.stop > self.curvature.start)

    @property
    def accelerates(self) -> bool:
        """Return True if the layout has w."""
        return bool(self.acceleration.stop > self.acceleration.start)

    def split(self, x: Array) -> tuple[Array, Array, Array]:
        """Return u, S and w of potentials (..., P), with zeros for parts that the layout lacks."""
        zeros = np.zeros(x.shape[:-1] + (3,))
        return (x[..., self.slope], x[..., self.curvature] if self.quadratic else zeros,
                x[..., self.acceleration] if self.accelerates else zeros[..., :2])


class GroupLayout(NamedTuple):
    """
    The slices of the parts of a slot group's F unknowns.

    The order is: potentials before, v, potentials after, prices.

    :param before: slice of the potentials of all UAVs at the edge before the group.
    :param v: slice of the eavesdropper multipliers of all cells, cell by cell.
    :param after: slice of the potentials of all UAVs at the edge after the group.
    :param prices: slice of the prices lam.
    """

    before: slice
    v: slice
    after: slice
    prices: slice

    def select_uav(self, i: int, v: slice) -> NDArray[np.intp]:
        """
        Return the indices of the unknowns on which UAV i's columns depend, (E + 2 P + 1,).

        They are, in this order, one cell's v, whose slice is given, the UAV's P numbers of the
        potential before and P of the potential after the group, and the UAV's price.
        """
        uavs = self.prices.stop - self.prices.start
        own = np.array_split(np.arange(self.before.stop), uavs)[i]
        return np.r_[v, own, self.after.start + own, self.prices.start + i]


def _lay_out(*sizes: int) -> Iterator[slice]:
    """Return slices of given sizes that follow each other."""
    ends = np.cumsum([0, *sizes]).tolist()
    return map(slice, ends, ends[1:])


@dataclass(frozen=True, eq=False)
class DualPoint:
    """
    The unknowns of the dual function.

    :param layout: layout of the potentials.
    :param potentials: potentials of the UAVs at every edge, (G + 1, U, P).
    :param v: eavesdropper multipliers in each of B cells, (G, B, E).
    :param prices: lam, (U,).
    """

    layout: PotentialLayout
    potentials: Array
    v: Array
    prices: Array

    @property
    def group_layout(self) -> GroupLayout:
        """Return the slices of a group's unknowns: potentials before, v, potentials after, lam."""
        potentials = self.potentials[0].size
        return GroupLayout(*_lay_out(
            potentials, self.v[0].size, potentials, len(self.prices)))

    def move(self, step: DualPoint, length: float) -> DualPoint:
        """Return this point moved along a step times a length."""
        return DualPoint(self.layout, self.potentials + length * step.potentials,
                         self.v + length * step.v, self.prices + length * step.prices)

    def shorten(self, point: DualPoint, slack: Array) -> DualPoint:
        """
        Return this step with v and prices shortened, so that v, slack and prices stay positive.

        The v of a cell in a group have one scale: at most 1, and 0.9 of the way to the first 0 of
        a v or of the slack. Each price has a scale of its own. Potentials keep their whole step.

        :param slack: w0 minus the sum of v at the point, (G, B).
        """
        of_v = np.minimum(_compute_way_to_zero(point.v, self.v).min(-1),
                          _compute_way_to_zero(slack, -self.v.sum(-1)))
        of_prices = _compute_way_to_zero(point.prices, self.prices)
        return replace(self, v=self.v * np.minimum(1.0, 0.9 * of_v)[..., None],
                       prices=self.prices * np.minimum(1.0, 0.9 * of_prices))


def _compute_way_to_zero(values: Array, steps: Array) -> Array:
    """Return by what factor of its step each positive value becomes 0; inf if it never does."""
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where(steps < 0, -values / steps, np.inf)
