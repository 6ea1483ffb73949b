"""The answer of an assessment."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .world import World
from ..mission import make_view
from ..mission.scenario import Array
from ..mission.validation import checked_real
from ..plan.plan import Plan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAN = (0.05, 0.25, 0.5, 0.75, 0.95)
"""The quantiles of the rate in each slot."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """
    What a plan is worth in the drawn worlds.

    The secrecy rate of a mission is the mean over its slots of [r_0 - r_e]^+, as in the paper's
    equation (6), with the gains that the channel has in each slot.

    :ivar plan: the Plan.
    :ivar world: how the world may differ.
    :ivar draws: D, how many worlds were drawn.
    :ivar seed: of the draws.
    :ivar rates: secrecy rate of the mission in each draw, (D,) in bit/s/Hz.
    :ivar fan: quantiles FAN of the secrecy rate in each slot, (5, N) in bit/s/Hz.
    :ivar outages: share of the draws in which the rate of a slot is below the promised one, (N,).
    :ivar delivered: what a transmitter delivers in secret that sends at the promised rate: the sum
        over the slots without an outage, in each draw, (D,) in bit/Hz.
    :ivar promised_rates: the rates of the plan's objective, where they are above 0, (N,) in
        bit/s/Hz.
    :ivar is_flown: whether the UAVs were where a flight was, and not where the plan is.
    """

    plan: Plan
    world: World
    draws: int
    seed: int
    rates: Array
    fan: Array
    outages: Array
    delivered: Array
    promised_rates: Array
    is_flown: bool = False

    def __repr__(self) -> str:
        return (f'<Assessment of {self.draws} draws: secrecy rate {self.mean:.4f} bit/s/Hz in the '
                f'mean, {self.quantile(0.05):.4f} at 5%, {self.quantile(0.5):.4f} at 50%, '
                f'{self.promised_rate:.4f} {self.claim}; outage of a slot at most '
                f'{self.outage:.2%}, promised: {self.promised_outage_text}>')

    @property
    def mean(self) -> float:
        """Mean of the mission's secrecy rate over the draws in bit/s/Hz."""
        return float(self.rates.mean())

    def plot(self) -> 'Figure':
        """
        Return a picture: rates and outages of the slots over time, and rates of the mission.

        :return: a matplotlib Figure, which notebooks show and whose savefig writes it to a file.
        :raises MissingPackageError: when Matplotlib is not installed.
        """
        figure: Figure = make_view('plot_assessment', self)
        return figure

    def quantile(self, share: float) -> float:
        """Return the secrecy rate in bit/s/Hz below which it is in such a share of the draws."""
        return float(np.quantile(self.rates, checked_real('share', share, 0.0, 1.0)))

    @property
    def claim(self) -> str:
        """Name the plan's rates: 'promised', or, where they are not, such as 'at mean gains'."""
        channel = self.plan.scenario.channel
        return 'promised' if channel.is_guarantee else channel.promise

    @property
    def promised_rate(self) -> float:
        """Mean of promised_rates in bit/s/Hz."""
        return float(self.promised_rates.mean())

    @property
    def outage(self) -> float:
        """Largest of the outages."""
        return float(self.outages.max())

    @property
    def promised_outage(self) -> float:
        """Outage that the plan allows in each slot; 0 without fading."""
        return self.plan.scenario.channel.outage or 0.0

    @property
    def promised_outage_text(self) -> str:
        """Outage that the plan promises, in words."""
        if not self.plan.scenario.channel.is_guarantee:
            return 'no promise'
        return f'{self.promised_outage:.4%}'

    @property
    def shortfall(self) -> str:
        """How often a slot has a lower rate than the plan says, in words."""
        return (f'a slot has less in {self.outages.mean():.1%} of {self.draws} draws in the mean, '
                f'the worst slot in {self.outage:.1%}')

    @property
    def promised_delivery(self) -> float:
        """Bits delivered in secret without any outage, in bit/Hz."""
        return float(self.promised_rates.sum() * self.plan.scenario.slot_duration)

    @property
    def summary(self) -> dict[str, float]:
        """Numbers of the answer by name, as in the columns of a campaign."""
        return {'mean': self.mean, 'quantile_5': self.quantile(0.05),
                'quantile_50': self.quantile(0.5), 'promised': self.promised_rate,
                'outage': self.outage, 'promised_outage': self.promised_outage,
                'delivered': float(self.delivered.mean()),
                'promised_delivery': self.promised_delivery}
