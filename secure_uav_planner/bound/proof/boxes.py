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

from .detours import pack_detours
from .reachable_set import ReachableSet
from ...mission.validation import Array
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
    :param curvature: quadratic part as (S_11, S_12, S_22), (G, 3) in nats per unit^2.
    :param speed_cost: a term f |u + S q| as (f, u_1, u_2, S_11, S_12, S_22), (G, 6), or zeros.
    :param margin: for rounding, added to every bound, (G,).
    :param price: lam in nats per W.
    :param powers: lower and upper limits of a jammer's log p, or None where no power counts.
    """

    region: ReachableSet
    stage: Index
    weight: Array
    shares: Array
    slope: Array
    curvature: Array
    speed_cost: Array
    margin: Array
    price: float = 0.0
    powers: tuple[float, float] | None = None

    def __len__(self) -> int:
        return len(self.stage)

    def bound_maxima(self, incumbents: Array, tolerance: Array, budget: float = BUDGET,
                     stop: Callable[[], bool] = lambda: False) -> Array:
        """
        Return upper bounds of the functions' maxima, (M,) in nats.

        A box is dropped when it misses one of the reachable set's discs or when its bound is below
        the incumbent plus the tolerance: if none is left, the maximum is not above that.

        :param incumbents: values near the maxima, (M,); any are valid.
        :param tolerance: of the bounds, (M,) in nats.
        :param budget: boxes for each function.
        :param stop: asked before every stage; True leaves the rest with their first boxes' bounds.
        """
        bounds, tolerance = np.array(incumbents, float), np.array(tolerance, float)
        # The functions of a stage share their boxes.
        order = np.argsort(self.stage, kind='stable')
        for functions in np.split(order, np.flatnonzero(np.diff(self.stage[order])) + 1):
            budget = 0.0 if stop() else budget
            core.bound_maxima(self.kernel_arguments, functions, bounds, tolerance, budget)
        return bounds

    @cached_property
    def kernel_arguments(self) -> dict[str, Any]:
        """Return the kernel's arguments."""
        region = self.region
        low, high = region.bounding_box
        arrays = {name: getattr(region, name) for name in (
            'ground', 'eavesdroppers', 'radii', 'log_advantages', 'from_start', 'to_goal',
            'corner')}
        arrays |= {name: getattr(self, name) for name in (
            'weight', 'shares', 'slope', 'curvature', 'speed_cost', 'margin')}
        return {
            **{name: np.ascontiguousarray(array, float)
               for name, array in (*arrays.items(), ('low', low), ('high', high),
                                   ('powers', self.powers or (0.0, 0.0)))},
            **pack_detours(region.detours), 'stage': np.ascontiguousarray(self.stage, np.int64),
            'altitude': region.altitude, 'distance': region.distance, 'price': float(self.price),
            'log_gain': region.log_gain, 'jams': self.powers is not None}

    def bound_box(self, function: int, centre: Array, half: Array) -> tuple[float, float]:
        """
        Return a function's value at the centre of a box, and its bound over the box in the set.

        :param centre: (2,), or (3,) with log p.
        :param half: half the bounding_box, alike.
        """
        return core.bound_box(self.kernel_arguments, function, centre, half)
