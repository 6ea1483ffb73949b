"""Lemma 2: limits of speed, paid for by potentials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .conjugate import Array
from .reachable_set import ReachableSet
from .rounding import margin
from .stages import Stages


@dataclass(frozen=True, eq=False)
class Potential:
    """
    The potentials W_n of one UAV, quadratic in its place, at every edge between stages.

    Lemma 2. For any functions W_0..W_N and any path, start = q[0], .., q[N+1] = goal,

        sum over n = 0..N of W_n(q[n+1]) - W_n(q[n])
            = W_N(goal) - W_0(start) + sum over n = 1..N of W_{n-1}(q[n]) - W_n(q[n]).

    On a path that can be flown every term on the left is at most T_n(q[n]), the largest of
    W_n(q[n] + d) - W_n(q[n]) over |d| <= step. Hence

        0 <= T_0(start) + W_0(start) - W_N(goal)
             + sum over n = 1..N of W_n(q[n]) - W_{n-1}(q[n]) + T_n(q[n]),

    and whatever stands there for slot n may be added to the slot's rate before its place is
    chosen freely in the reachable set: the bound of the whole remains valid, and the place that
    gains in this slot pays for what it costs the others. With W_n(q) = u_n . q + q . S_n q / 2

        T_n(q) <= step |u_n + S_n q| + step^2 / 2 max(0, the largest eigenvalue of S_n).

    S = 0 is Lagrangian duality, which lets a UAV be in two places, each half of the time; S makes
    that cost something. W is an estimate of what being somewhere is worth for the rest of the
    flight.

    Within a stage of several slots W is interpolated between the edges. T is convex in (u, S), so
    it is at most the interpolated T; where S = 0 that is the same at every place, and its
    mean over the slots of the stage is all that counts. S is for stages of one slot each.

    :param slope: u, (G + 1, 2) in nats per unit.
    :param bend: S as (S_11, S_12, S_22), (G + 1, 3) in nats per unit^2.
    :param stages: between the edges.
    :param region: of the UAV.
    :raises AssertionError: for S in stages of several slots.
    """

    slope: Array
    bend: Array
    stages: Stages
    region: ReachableSet

    def __post_init__(self) -> None:
        if self.curved and (self.stages.count > 1).any():
            raise AssertionError('quadratic potentials are for stages of one slot')

    @property
    def change(self) -> tuple[Array, Array]:
        """Change of (u, S) in one slot of every stage, (G, 2) and (G, 3)."""
        count = self.stages.count[:, None]
        return np.diff(self.slope, axis=0) / count, np.diff(self.bend, axis=0) / count

    @property
    def curved(self) -> bool:
        """Whether any S is not zero."""
        return bool(self.bend.any())

    def jump(self) -> Array:
        """Return step^2 / 2 max(0, the largest eigenvalue of S) at every edge, (G + 1,)."""
        half = (self.bend[:, 0] - self.bend[:, 2]) / 2
        largest = (self.bend[:, 0] + self.bend[:, 2]) / 2 + np.hypot(half, self.bend[:, 1])
        return np.asarray(self.region.step**2 / 2 * np.maximum(largest, 0))

    def constant(self) -> Array:
        """Return what a slot of every stage gets wherever the UAV is, (G,) in nats."""
        if self.curved:
            return self.jump()[1:]
        length = self.region.step * np.hypot(self.slope[:, 0], self.slope[:, 1])
        before, after = self.stages.means
        return np.asarray(before * length[:-1] + after * length[1:])

    def tilt(self) -> Array:
        """
        Return the term f |u + S q| of every stage as (f, u, S), (G, 6).

        Zeros where S = 0: `constant` has it then.
        """
        step = np.full((len(self.slope) - 1, 1), self.region.step)
        found = np.concatenate([step, self.slope[1:], self.bend[1:]], axis=1)
        return found if self.curved else 0.0 * found

    def ends(self) -> float:
        """Return T_0(start) + W_0(start) - W_N(goal) with the ends' tolerance, in nats."""
        region = self.region
        miss = 2e-6 / region.unit + 1e-12
        goal = region.distance
        first, last = self.slope[0], self.slope[-1]
        size0, size1 = np.abs(self.bend[0]).sum(), np.abs(self.bend[-1]).sum()
        start = region.step * np.hypot(*first) + float(self.jump()[0])
        at_goal = last[0] * goal + self.bend[-1, 0] * goal**2 / 2
        # At most |grad W| + |S| step, and |grad W|, times how far an end may be off.
        first_slope = np.hypot(*first) + size0 * (region.step + miss)
        last_slope = np.hypot(*last) + size1 * (goal + miss)
        return float(start - at_goal + miss * (first_slope + last_slope)
                     + margin(region.altitude, self.size()[[0, -1]].sum()))

    def size(self) -> Array:
        """Return how large the terms of every stage can be, (G,) in nats, for `margin`."""
        region = self.region
        reach = np.minimum(region.from_start, region.distance + region.to_goal)
        slope = np.hypot(self.slope[:, 0], self.slope[:, 1])
        bend = np.abs(self.bend).sum(1)
        slope = np.maximum(slope[:-1], slope[1:])
        bend = np.maximum(bend[:-1], bend[1:])
        return np.asarray((slope + bend * (reach + region.step)) * (reach + region.step)
                          + np.abs(self.constant()))
