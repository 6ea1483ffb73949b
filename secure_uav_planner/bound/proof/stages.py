"""Slots in stages: what is the same for a few neighbouring slots is computed once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_STAGES = 400
"""More slots than that share stages; time and memory are then those of as many slots."""


@dataclass(frozen=True, eq=False)
class Stages:
    """
    The slots 1..N in G stages of neighbouring slots, of one slot each where N is small.

    All slots of a stage share one reachable set, which holds the reachable sets of all of them,
    and one set of multipliers; so one bound serves for all of them.

    :param edges: number of slots before each stage, and N, (G + 1,).
    """

    edges: NDArray[np.int64]

    @classmethod
    def of(cls, slots: int, most: int = MOST_STAGES) -> Stages:
        """Return the stages of a mission of `slots` slots, at most `most`, as even as can be."""
        count = min(slots, most)
        return cls(np.arange(count + 1) * slots // count)

    @property
    def first(self) -> NDArray[np.int64]:
        """First slot of every stage, (G,)."""
        return self.edges[:-1] + 1

    @property
    def last(self) -> NDArray[np.int64]:
        """Last slot of every stage, (G,)."""
        return self.edges[1:]

    @property
    def count(self) -> NDArray[np.int64]:
        """Return how many slots every stage has, (G,)."""
        return np.diff(self.edges)

    @property
    def means(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the mean weights in a stage of the edge before and of the edge after, (G,)."""
        count = self.count.astype(float)
        return (count - 1) / (2 * count), (count + 1) / (2 * count)

    @property
    def slots(self) -> int:
        """N."""
        return int(self.edges[-1])

    def of_slots(self) -> NDArray[np.int64]:
        """Stage of every slot, (N,)."""
        return np.repeat(np.arange(len(self.count)), self.count)
