"""
One UAV's term of the Lagrangian: its potential, lemmas 2 and 8, and its maximum, lemma 5.

The branch and bound for the maximum is compiled: bound/kernel/boxes.cpp computes and derives the
bounds of boxes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .reachable_set import Cells, ReachableSet
from .relaxation import margin, SlotGroups
from ...mission.validation import Array
from ...model.kernel import core

Index = NDArray[np.intp]

BUDGET = 20000
"""Largest number of boxes for one function; boxes that are left then keep their bounds."""

TOLERANCE = 2e-4
"""Tolerance of every maximum, in nats."""

NOTHING = -1e9
"""Bound [nats] of a function over a cell that misses the reachable set."""


@dataclass(frozen=True, eq=False)
class Potential:
    """
    The potentials W_n of one UAV, quadratic in its place, at every edge between groups.

    Lemma 2. For any functions W_0..W_N and any path, start = q[0], .., q[N+1] = goal,

        sum over n = 0..N of W_n(q[n+1]) - W_n(q[n])
            = W_N(goal) - W_0(start) + sum over n = 1..N of W_{n-1}(q[n]) - W_n(q[n]).

    On a path that can be flown every term on the left is at most T_n(q[n]), the largest of
    W_n(q[n] + d) - W_n(q[n]) over |d| <= step. Hence

        0 <= T_0(start) + W_0(start) - W_N(goal)
             + sum over n = 1..N of W_n(q[n]) - W_{n-1}(q[n]) + T_n(q[n]),

    and the summand of slot n may be added to the slot's rate before the slot's place is chosen
    freely in the reachable set. The sum of all slots remains an upper bound, and a place that
    gains in one slot pays for what it costs other slots. With W_n(q) = u_n . q + q . S_n q / 2

        T_n(q) <= step |u_n + S_n q| + step^2 / 2 max(0, the largest eigenvalue of S_n).

    S = 0 is Lagrangian duality, which lets a UAV be in two places, each half of the time; S makes
    this cost something. W estimates what a place is worth for the rest of the flight.

    Lemma 8 (acceleration). With the moves d_n = q[n+1] - q[n], where d_{-1} and d_{N+1} are the
    moves beyond the ends, and |d_n - d_{n-1}| <= A_n, for any vectors w_0..w_{N+1}

        0 <= sum over n = 0..N of (w_{n+1} - w_n) . d_n + sum over n = 0..N+1 of A_n |w_n|
             + w_0 . d_{-1} - w_{N+1} . d_{N+1},

    because w_n . (d_n - d_{n-1}) >= -A_n |w_n| for n = 0..N+1, summed by parts. Added to
    W_n(q + d) - W_n(q) it turns u_n in T_n, not in W_n, into u_n + w_{n+1} - w_n: a costly move
    is paid for where its velocity was gained. With w_0 = 0, or with w_0 equal to the slope g = u_0
    + w_1, T_0(start) is at most the smaller of step |g| and A_0 |g| + g . d_{-1}.
    A velocity that is free at an end is d = 0 there with A = step.

    Within a group of several slots u and w are interpolated between the edges. T is convex in (u,
    S, w), so it is at most the interpolated T. For S = 0 the interpolated T does not depend on the
    place, and only its mean over the slots of the group matters. S must be 0 in groups of several
    slots.

    :param slope: u, (G + 1, 2) in nats per unit.
    :param curvature: S as (S_11, S_12, S_22), (G + 1, 3) in nats per unit^2.
    :param acceleration: w_{n+1} at the edge after slot n, (G + 1, 2) in nats per unit.
    :param groups: the G groups between the G + 1 edges.
    :param region: reachable sets of the UAV.
    :raises AssertionError: if S is not 0 in groups of several slots.
    """

    slope: Array
    curvature: Array
    acceleration: Array
    groups: SlotGroups
    region: ReachableSet

    def __post_init__(self) -> None:
        if self.is_quadratic and (self.groups.count > 1).any():
            raise AssertionError('quadratic potentials are for groups of one slot')

    @property
    def change(self) -> tuple[Array, Array]:
        """Change of (u, S) in one slot of every group, (G, 2) and (G, 3)."""
        count = self.groups.count[:, None]
        return np.diff(self.slope, axis=0) / count, np.diff(self.curvature, axis=0) / count

    @property
    def is_quadratic(self) -> bool:
        """Whether any S is not zero."""
        return bool(self.curvature.any())

    def curvature_cost(self) -> Array:
        """Return step^2 / 2 max(0, largest eigenvalue of S) at every edge, (G + 1,) in nats."""
        s11, s12, s22 = self.curvature.T
        largest = (s11 + s22) / 2 + np.hypot((s11 - s22) / 2, s12)
        steps = np.append(self.region.step, self.region.steps)
        return np.asarray(steps**2 / 2 * np.maximum(largest, 0))

    @cached_property
    def move_slopes(self) -> Array:
        """Return u + w_{n+1} - w_n at the edges before and after every group, (2, G, 2)."""
        change = np.diff(self.acceleration, axis=0) / self.groups.count[:, None]
        return np.stack([self.slope[:-1] + change, self.slope[1:] + change])

    def constant(self) -> Array:
        """
        Return for a slot of every group the terms without the place, (G,) in nats.

        These are A |w| and, of T_n, either step^2 / 2 max(0, largest eigenvalue of S) or, if all S
        are 0, the whole step |u + change of w|; within a group both are means over its slots.
        """
        if self.is_quadratic:
            return np.asarray(self.curvature_cost()[1:] + self.acceleration_cost())
        before, after = self.groups.means
        length = self.region.steps * np.hypot(*np.moveaxis(self.move_slopes, 2, 0))
        return np.asarray(before * length[0] + after * length[1] + self.acceleration_cost())

    def acceleration_cost(self) -> Array:
        """Return the terms A |w| of a slot of every group, (G,) in nats; part of `constant`."""
        before, after = self.groups.means
        cost = self.region.max_move_change * np.hypot(*self.acceleration.T)
        return np.asarray(before * cost[:-1] + after * cost[1:])

    def speed_cost(self) -> Array:
        """
        Return the terms step |u + change of w + S q| of lemmas 2 and 8, as coefficients, (G, 6).

        A row belongs to the edge after a group: (step, u + change of w, S_11, S_12, S_22). If all
        S are 0, the rows are zeros, because the term is then part of `constant`.
        """
        cost = np.concatenate(
            [self.region.steps[:, None], self.move_slopes[1], self.curvature[1:]], axis=1)
        return cost if self.is_quadratic else 0.0 * cost

    def end_cost(self) -> float:
        """
        Return the bound's terms of start and goal [nats], with all tolerances; lemmas 2 and 8.

        They are T_0(start) + W_0(start) - W_N(goal) + A |w_1|, and for w = w_{N+1} at the goal
        max(A_{N+1} - A, 0) |w| - w . d_{N+1}. The start is the origin, so W_0(start) is 0.
        """
        region = self.region
        miss = 2e-6 / region.unit + 1e-12  # Above sqrt(2) POSITION_TOLERANCE, in units.
        goal = region.distance
        first, last = self.slope[0], self.slope[-1]
        size0, size1 = np.abs(self.curvature[0]).sum(), np.abs(self.curvature[-1]).sum()
        g, w_goal = first + self.acceleration[0], self.acceleration[-1]  # g = u_0 + w_1.
        limits = region.end_move_changes
        start = float(self.curvature_cost()[0]
                      + region.max_move_change * np.hypot(*self.acceleration[0])
                      + min(region.step * np.hypot(*g),
                            limits[0] * np.hypot(*g) + region.end_moves[0] @ g)
                      + max(limits[1] - region.max_move_change, 0.0) * np.hypot(*w_goal)
                      - region.end_moves[1] @ w_goal)
        at_goal = last[0] * goal + self.curvature[-1, 0] * goal**2 / 2
        # A miss of the start changes T_0 + W_0 by at most (|grad W_0| + |S| step) times the miss.
        # A miss of the goal changes W_N by at most |grad W_N| times the miss.
        first_slope = np.hypot(*first) + size0 * (region.step + miss)
        last_slope = np.hypot(*last) + size1 * (goal + miss)
        return float(start - at_goal + miss * (first_slope + last_slope)
                     + margin(region.altitude, self.magnitude()[[0, -1]].sum()))

    def magnitude(self) -> Array:
        """Return an upper bound of the size of the potential's terms in a group, (G,) in nats."""
        region = self.region  # `reach` is the distance of the farthest place from the start.
        reach = np.minimum(region.from_start, region.distance + region.to_goal)
        slope = np.hypot(*self.slope.T) + 2 * np.hypot(*self.acceleration.T)
        curvature = np.abs(self.curvature).sum(1)
        slope = np.maximum(slope[:-1], slope[1:])
        curvature = np.maximum(curvature[:-1], curvature[1:])
        return np.asarray((slope + curvature * (reach + region.step)) * (reach + region.step)
                          + np.abs(self.constant()))


@dataclass(frozen=True, eq=False)
class Terms:
    """
    M functions of one UAV's place and power, each over a cell of its reachable set.

    Each is the sum of the UAV's terms of the rates, its price of power, and its potential.

    :param potential: potential of the UAV.
    :param cells: cells of the UAV's reachable set.
    :param cell: index of every function's cell, (M,).
    :param weight: w0 of every function, (M,).
    :param v: eavesdropper multipliers of every function, (M, E).
    :param price: lam [nats per W].
    :param powers: range of a jammer's log p; None for a function of the place only.
    """

    potential: Potential
    cells: Cells
    cell: Index
    weight: Array
    v: Array
    price: float = 0.0
    powers: tuple[float, float] | None = None

    def bound_maxima(self, incumbents: Array, stop: Callable[[], bool] = lambda: False,
                     budget: float = BUDGET, maximisers: Array | None = None) -> Array:
        """
        Return upper bounds of the functions' maxima, (M,) in nats.

        A box is dropped if it misses the reachable set, or if its bound is at most the incumbent
        plus TOLERANCE. Larger values that are found replace the incumbent. Over a cell that misses
        the reachable set the bound is NOTHING plus the potential's constant.

        :param incumbents: guesses of the maxima, (M,). Any values give a bound; values near the
            maxima give a tight one.
        :param stop: asked before every cell. After True the remaining functions keep the bounds
            of their first boxes.
        :param budget: largest number of boxes for each function.
        :param maximisers: filled with the place in units and log p of the best point of every
            function, (M, 3), where a point exceeds the incumbent. It proves nothing.
        """
        constant = self.potential.constant()[self.cells.group[self.cell]]
        bounds, tolerance = incumbents - constant, np.full(len(self.cell), TOLERANCE)
        if maximisers is None:
            maximisers = np.empty((len(self.cell), 3))
        # The functions of a cell share their boxes.
        order = np.argsort(self.cell, kind='stable')
        for functions in np.split(order, np.flatnonzero(np.diff(self.cell[order])) + 1):
            budget = 0.0 if stop() else budget
            self.compiled.bound_maxima(functions, bounds, tolerance, budget, maximisers)
        return np.asarray(np.maximum(bounds, NOTHING) + constant)

    @cached_property
    def margin(self) -> Array:
        """Margin for rounding, added to every bound, (G,) in nats."""
        region = self.potential.region
        return margin(region.altitude, self.potential.magnitude() + self.price * region.peak)

    @cached_property
    def compiled(self) -> core.Terms:
        """Return the kernel's form of the functions, without the potential's constant."""
        region = self.potential.region
        # The potential's arrays have a row for each group, and the kernel's a row for each cell.
        slope, curvature, speed_cost, margins, weight, v = (
            np.ascontiguousarray(values, float) for values in (
                *(values[self.cells.group] for values in (
                    *self.potential.change, self.potential.speed_cost(), self.margin)),
                self.weight, self.v))
        return core.Terms(
            self.cells.restrict(region), region.compiled_links,
            np.ascontiguousarray(self.cell, np.int64),
            weight, v, slope, curvature, speed_cost, margins, float(self.price), self.powers)
