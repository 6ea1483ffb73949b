"""A flight with its powers, and the rates of its slots."""

from functools import cached_property

import numpy as np

from ..mission import Objective
from ..mission.scenario import Array, read_only, Scenario
from ..model import channel
from ..model.channel.rates import find_least_rate
from ..model.curve import Curve, mean_guaranteed_rates


class RatedFlight:
    """
    A flight with its powers, and the rates of its slots, each evaluated when it is first asked.

    :ivar scenario: the mission.
    :ivar positions: q_i[n], (U, N+2, 2) in m.
    :ivar powers: p_i[n], (U, N) in W.
    :ivar shares: a_k[n], of each slot for each ground node, (G, N).
    :ivar objective: whose rate is `rate`.
    :ivar promised_until: time in s from point 0 until which rates are a promise, None for all.
    """

    scenario: Scenario
    positions: Array
    powers: Array
    shares: Array
    objective: Objective
    promised_until: float | None

    @property
    def times(self) -> Array:
        """Time of every point from the start, (N+2,) in s."""
        return self.scenario.times

    @cached_property
    def guaranteed_rates(self) -> Array:
        """Guaranteed rate [R-bar]^+ of each slot, (N,) in bit/s/Hz, of all nodes together."""
        return read_only(self.guaranteed_shares.sum(axis=0))

    @cached_property
    def guaranteed_shares(self) -> Array:
        """Guaranteed rate of each ground node in its share of each slot, (G, N) in bit/s/Hz."""
        return read_only(self.shares * self._find_node_rates('guaranteed'))

    @cached_property
    def worst_case_rates(self) -> Array:
        """Worst-case rate R of each slot, equation (6), (N,), of all nodes together."""
        return read_only(self.worst_case_shares.sum(axis=0))

    @cached_property
    def worst_case_shares(self) -> Array:
        """Worst-case rate of each ground node in its share of each slot, (G, N) in bit/s/Hz."""
        return read_only(self.shares * self._find_node_rates('worst_case'))

    @cached_property
    def curve(self) -> Curve:
        """Flight as a function of time."""
        return Curve(self.scenario, self.positions)

    @cached_property
    def curve_rates(self) -> Array:
        """
        Guaranteed rates along the curve, as means over each slot, (N,) in bit/s/Hz.

        They differ from guaranteed_rates, which are those at the points, by the discretisation.
        """
        return read_only(self.curve_shares.sum(axis=0))

    @cached_property
    def curve_shares(self) -> Array:
        """Guaranteed rates along the curve of each ground node in its shares, (G, N)."""
        return read_only(self.shares * _positive_part(
            mean_guaranteed_rates(self.scenario, self.curve, self.powers)))

    @property
    def curve_rate(self) -> float:
        """Mean of curve_rates in bit/s/Hz: the information delivered per second and Hz."""
        return find_least_rate(self.scenario, self.curve_shares.mean(axis=1))

    @property
    def node_shares(self) -> Array:
        """Rate of the plan's objective of each ground node in its share of each slot, (G, N)."""
        return (self.guaranteed_shares if self.objective == 'guaranteed' else
                self.worst_case_shares)

    @cached_property
    def node_rates(self) -> Array:
        """Mean rate of the plan's objective of each ground node, (G,) in bit/s/Hz."""
        return read_only(self.node_shares.mean(axis=1))

    @property
    def guaranteed_rate(self) -> float:
        """
        Mean of guaranteed_rates, the objective of (P2) with [x]^+, in bit/s/Hz.

        With several ground nodes it is the least of their means, each divided by its weight, as
        are the other rates.
        """
        return find_least_rate(self.scenario, self.guaranteed_shares.mean(axis=1))

    @property
    def worst_case_rate(self) -> float:
        """Mean of worst_case_rates, the objective of problem (P1), in bit/s/Hz."""
        return find_least_rate(self.scenario, self.worst_case_shares.mean(axis=1))

    @property
    def rate(self) -> float:
        """Mean rate of the plan's objective in bit/s/Hz."""
        return self.guaranteed_rate if self.objective == 'guaranteed' else self.worst_case_rate

    def _find_node_rates(self, objective: Objective) -> Array:
        """Return [R]^+ of each ground node, (G, N) in bit/s/Hz."""
        find_rates = (channel.guaranteed_node_rates if objective == 'guaranteed' else
                      channel.worst_case_node_rates)
        return _positive_part(find_rates(self.scenario, self.positions, self.powers))


def _positive_part(rates: Array) -> Array:
    """Return [x]^+ of rates: a slot with a negative rate need not transmit."""
    return read_only(np.maximum(rates, 0.0))
