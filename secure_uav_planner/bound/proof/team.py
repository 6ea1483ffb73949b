"""All UAVs of a scenario as the bound sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .conjugate import Array
from .reachable_set import ReachableSet
from .rounding import negative_power
from .stages import MOST_STAGES, Stages
from .subset import EavesdropperSubset

if TYPE_CHECKING:
    from ...mission.scenario import Scenario

MOST_JAMMERS = 3
"""How many jammers are followed; more are helpers."""


@dataclass(frozen=True, eq=False)
class Team:
    """
    The UAVs' reachable sets in all stages of a mission.

    Lemma 9 (more jammers than are followed). With the SNRs x_j >= 0 received from those and
    x_k >= 0 from the others, the helpers,

        log(1 + sum_j x_j + sum_k x_k) <= log(1 + sum_j x_j) + sum_k log(1 + x_k)

    at an eavesdropper, and at the ground node the left side is at least log(1 + sum_j x_j). So a
    helper may do no harm, and help on its own from the nearest place in its reachable set: the
    bound is valid, and loose.

    :param scenario: the mission.
    :param stages: its slots in stages.
    :param subset: the eavesdroppers.
    :param regions: of the transmitter and of the jammers that are followed.
    :param helpers: reachable sets of the other jammers.
    :param negative: what powers below zero add to a slot without a transmission, in nats.
    :param delta: largest size of the negative received SNR of every one in `regions`.
    :param spill: what the helpers' powers below zero add to any slot, in nats.
    """

    scenario: Scenario
    stages: Stages
    subset: EavesdropperSubset
    regions: tuple[ReachableSet, ...]
    helpers: tuple[ReachableSet, ...]
    negative: float
    delta: Array
    spill: float

    @classmethod
    def of(cls, scenario: Scenario, subset: EavesdropperSubset,
           order: tuple[int, ...] | None = None, most: int = MOST_STAGES) -> Team:
        """
        Return the team of a scenario.

        :param scenario: the mission.
        :param subset: the eavesdroppers.
        :param order: the jammers' indices, the most useful ones first.
        :param most: how many stages there may be.
        """
        jammers = tuple(range(1, len(scenario.uavs))) if order is None else order
        stages = Stages.of(scenario.slots, most)
        negative, delta = negative_power(scenario)
        followed, helping = jammers[:MOST_JAMMERS], jammers[MOST_JAMMERS:]
        spill = 0.0
        if helping and np.isfinite(negative):
            spill = float(-np.log1p(-delta[list(helping)].sum()
                                    / (1 - delta[list(followed)].sum())) * (1 + 1e-9))
        regions, helpers = (
            tuple(ReachableSet.of(scenario, i, stages, subset, follow) for i in some)
            for some, follow in (((0, *followed), True), (helping, False)))
        return cls(scenario, stages, subset, regions, helpers, negative, delta[[0, *followed]],
                   spill)

    @property
    def jammers(self) -> int:
        """Return how many jammers are followed."""
        return len(self.regions) - 1

    @property
    def accelerates(self) -> bool:
        """Return whether any velocity is limited in how fast it changes."""
        return any(region.turn < 2 * region.step for region in self.regions)

    @property
    def copies(self) -> int:
        """Return how many times a jammer's gain counts in lemma 8."""
        return max(self.jammers, 1)

    @property
    def eavesdroppers(self) -> int:
        """Return how many eavesdroppers there are."""
        return len(self.subset.places)
