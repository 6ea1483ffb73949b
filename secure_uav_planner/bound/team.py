"""All UAVs of a scenario as the bound sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .conjugate import Array
from .lens import Lens
from .rounding import negative_power
from .stages import MOST_STAGES, Stages
from .witnesses import Witnesses

if TYPE_CHECKING:
    from ..scenario import Scenario

MOST_JAMMERS = 2
"""How many jammers are followed; more are helpers."""


@dataclass(frozen=True, eq=False)
class Team:
    """
    The UAVs' lenses in all stages of a mission.

    Lemma 9 (more than two jammers). With the SNRs x_j >= 0 received from those that are followed
    and x_k >= 0 from the others, the helpers,

        log(1 + sum_j x_j + sum_k x_k) <= log(1 + sum_j x_j) + sum_k log(1 + x_k)

    at an eavesdropper, and at the ground node the left side is at least log(1 + sum_j x_j). So a
    helper may do no harm, and help on its own from the nearest place in its lens: the bound is
    valid, and loose.

    :param scenario: the mission.
    :param stages: its slots in stages.
    :param witnesses: the eavesdroppers.
    :param lenses: of the transmitter and of the jammers that are followed.
    :param helpers: lenses of the other jammers.
    :param negative: what powers below zero add to a slot without a transmission, in nats.
    :param delta: largest size of the negative received SNR of every one in `lenses`.
    :param spill: what the helpers' powers below zero add to any slot, in nats.
    """

    scenario: Scenario
    stages: Stages
    witnesses: Witnesses
    lenses: tuple[Lens, ...]
    helpers: tuple[Lens, ...]
    negative: float
    delta: Array
    spill: float

    @classmethod
    def of(cls, scenario: Scenario, witnesses: Witnesses, order: tuple[int, ...] | None = None,
           most: int = MOST_STAGES) -> Team:
        """
        Return the team of a scenario.

        :param scenario: the mission.
        :param witnesses: the eavesdroppers; one of them where two jammers are followed.
        :param order: the jammers' indices, the most useful ones first.
        :param most: how many stages there may be.
        """
        jammers = tuple(range(1, len(scenario.uavs))) if order is None else order
        stages = Stages.of(scenario.slots, most)
        negative, delta = negative_power(scenario)
        followed, helping = jammers[:MOST_JAMMERS], jammers[MOST_JAMMERS:]
        if len(followed) > 1 and len(witnesses.places) > 1:
            raise AssertionError('lemma 8 is for one eavesdropper')
        spill = 0.0
        if helping and np.isfinite(negative):
            spill = float(-np.log1p(-delta[list(helping)].sum()
                                    / (1 - delta[list(followed)].sum())) * (1 + 1e-9))
        lenses = [Lens.of(scenario, i, stages, witnesses) for i in (0, *jammers)]
        count = 1 + len(followed)
        return cls(scenario, stages, witnesses, tuple(lenses[:count]), tuple(lenses[count:]),
                   negative, delta[[0, *followed]], spill)

    @property
    def jammers(self) -> int:
        """Return how many jammers are followed."""
        return len(self.lenses) - 1

    @property
    def copies(self) -> int:
        """Return how many times a jammer's gain counts in lemma 8."""
        return max(self.jammers, 1)

    @property
    def eavesdroppers(self) -> int:
        """Return how many witnesses there are."""
        return len(self.witnesses.places)
