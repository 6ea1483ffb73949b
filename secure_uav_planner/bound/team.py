"""All UAVs of a scenario as the bound sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .conjugate import Array
from .lens import Lens
from .rounding import negative_power
from .stages import MOST_STAGES, Stages

if TYPE_CHECKING:
    from ..scenario import Scenario


@dataclass(frozen=True, eq=False)
class Team:
    """
    The UAVs' lenses in all stages of a mission.

    :param scenario: the mission.
    :param stages: its slots in stages.
    :param lenses: one of each UAV, the transmitter's first.
    :param negative: what powers below zero add to a slot without a transmission, in nats.
    :param delta: largest size of each UAV's negative received SNR, (U,).
    """

    scenario: Scenario
    stages: Stages
    lenses: tuple[Lens, ...]
    negative: float
    delta: Array

    @classmethod
    def of(cls, scenario: Scenario, most: int = MOST_STAGES) -> Team:
        """Return the team of a scenario, with at most `most` stages."""
        stages = Stages.of(scenario.slots, most)
        negative, delta = negative_power(scenario)
        return cls(scenario, stages, tuple(
            Lens.of(scenario, i, stages) for i in range(len(scenario.uavs))), negative, delta)

    @property
    def jammers(self) -> int:
        """Number of jammers."""
        return len(self.lenses) - 1

    @property
    def eavesdroppers(self) -> int:
        """Number of eavesdroppers."""
        return len(self.scenario.eavesdroppers)
