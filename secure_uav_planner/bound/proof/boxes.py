"""
Lemma 5: the maximum of one UAV's term over its reachable set and its powers.

The branch and bound is compiled: kernel/bound_boxes.cpp has its bounds and derives them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array
from .detours import detour_fields
from .reachable_set import ReachableSet
from ...model.kernel import core

Index = NDArray[np.intp]

BUDGET = 20000
"""Boxes for one function; what is left then counts with the bound it has."""


@dataclass(frozen=True, eq=False)
class Terms:
    """
    M functions of one UAV's place, and a jammer's power, each with the reachable set of its stage.

    :param region: of the UAV.
    :param stage: of every function, (M,).
    :param weight: w0, (M,).
    :param shares: v, (M, E).
    :param slope: linear part of the potential, (G, 2) in nats per unit.
    :param bend: quadratic part as (S_11, S_12, S_22), (G, 3) in nats per unit^2.
    :param tilt: a term f |u + S q| as (f, u_1, u_2, S_11, S_12, S_22), (G, 6); zeros for none.
    :param margin: for rounding, added to every bound, (G,).
    :param price: lam in nats per W.
    :param powers: lower and upper limits of a jammer's log p, or None where no power counts.
    """

    region: ReachableSet
    stage: Index
    weight: Array
    shares: Array
    slope: Array
    bend: Array
    tilt: Array
    margin: Array
    price: float = 0.0
    powers: tuple[float, float] | None = None

    def __len__(self) -> int:
        return len(self.stage)

    def maxima(self, known: Array, tolerance: Array, budget: float = BUDGET,
               stop: Callable[[], bool] = lambda: False) -> Array:
        """
        Return an upper bound of every function's maximum, (M,) in nats.

        A box is dropped when it misses one of the reachable set's discs or when its bound is below
        the best value known plus the tolerance: if none is left, the maximum is not above that.

        :param known: values that the functions come close to, (M,); any are valid.
        :param tolerance: what the bound may be too large, (M,) in nats.
        :param budget: boxes for each function.
        :param stop: asked now and then; True leaves all others with bounds of their first boxes.
        """
        best, tolerance = np.array(known, float), np.array(tolerance, float)
        # The functions of a stage share their boxes.
        order = np.argsort(self.stage, kind='stable')
        for some in np.split(order, np.flatnonzero(np.diff(self.stage[order])) + 1):
            budget = 0.0 if stop() else budget
            core.bound_maxima(self.fields, some, best, tolerance, budget)
        return best

    @cached_property
    def fields(self) -> dict[str, Any]:
        """Return what the kernel reads."""
        region = self.region
        low, high = region.sides
        arrays = {name: getattr(region, name) for name in (
            'ground', 'eavesdroppers', 'radii', 'log_advantages', 'from_start', 'to_goal',
            'corner')}
        arrays |= {name: getattr(self, name) for name in (
            'weight', 'shares', 'slope', 'bend', 'tilt', 'margin')}
        return {
            **{name: np.ascontiguousarray(array, float)
               for name, array in (*arrays.items(), ('low', low), ('high', high),
                                   ('powers', self.powers or (0.0, 0.0)))},
            **detour_fields(region.detours), 'stage': np.ascontiguousarray(self.stage, np.int64),
            'altitude': region.altitude, 'distance': region.distance, 'price': float(self.price),
            'log_gain': region.log_gain, 'jams': self.powers is not None}

    def bounds(self, function: int, centre: Array, half: Array) -> tuple[float, float]:
        """
        Return a function's value at the centre of a box, and its bound over the box in the set.

        :param centre: (2,), or (3,) with log p.
        :param half: half the sides, alike.
        """
        return core.bound_box(self.fields, function, centre, half)
