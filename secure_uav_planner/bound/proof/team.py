"""All UAVs of a scenario as the bound sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .conjugate import Array
from .reachable_set import ReachableSet
from .rounding import negative_power
from .stages import MOST_STAGES, Stages
from .subset import EavesdropperSubset

if TYPE_CHECKING:
    from ...mission.scenario import Scenario

@dataclass(frozen=True, eq=False)
class Team:
    """
    The reachable sets of the UAVs, at most one of which jams, in all stages of a mission.

    :param scenario: the mission.
    :param stages: its slots in stages.
    :param subset: the eavesdroppers.
    :param regions: of the transmitter, and of the jammer.
    :param negative: what powers below zero add to a slot without a transmission, in nats.
    :param delta: largest size of the negative received SNR of every UAV, (U,).
    """

    scenario: Scenario
    stages: Stages
    subset: EavesdropperSubset
    regions: tuple[ReachableSet, ...]
    negative: float
    delta: Array

    @classmethod
    def of(cls, scenario: Scenario, subset: EavesdropperSubset, most: int = MOST_STAGES) -> Team:
        """
        Return the team of a scenario.

        :param scenario: the mission.
        :param subset: the eavesdroppers.
        :param most: how many stages there may be.
        """
        stages = Stages.of(scenario.slots, most)
        regions = tuple(ReachableSet.of(scenario, i, stages, subset)
                        for i in range(len(scenario.uavs)))
        return cls(scenario, stages, subset, regions, *negative_power(scenario))

    @property
    def accelerates(self) -> bool:
        """Return whether any velocity is limited in how fast it changes."""
        return any(region.turn < 2 * region.step for region in self.regions)

    @property
    def eavesdroppers(self) -> int:
        """Return how many eavesdroppers there are."""
        return len(self.subset.places)
