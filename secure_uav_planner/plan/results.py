"""Results of methods: rates of a flight, iterations, why they stopped, and a proven bound."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
import math
from typing import Any, get_args, Literal, TypeAlias

import numpy as np

from ..errors import OptionError, PlanError, quote
from ..mission import Objective, OBJECTIVES
from ..mission.fields import (
    check_items, Checked, checked_by, checked_text, Choice, Instance, Number, read_object, refuse,
    TIME, WholeNumber)
from ..mission.scenario import Array, read_only, Scenario
from ..model import channel
from ..model.channel.links import make_link
from ..model.channel.rates import find_least_rate
from ..model.curve import Curve, mean_node_rates

Status: TypeAlias = Literal['given', 'converged', 'iteration_limit', 'time_limit', 'cancelled',
                            'numerical_trouble']
"""Why a method stopped; its plan is feasible, or its bound valid, whatever the reason."""

STATUS_TEXTS: dict[Status, str] = {
    'given': 'given by hand',
    'converged': 'converged',
    'iteration_limit': 'stopped at the iteration limit',
    'time_limit': 'stopped at time_limit with the best feasible plan so far',
    'cancelled': 'cancelled, with the best feasible plan so far',
    'numerical_trouble': 'a step of the solver failed, the best feasible plan is kept',
}
"""A text for each status."""

_RATE = Number(-math.inf, math.inf, 'bit/s/Hz')

_ROUNDING = 1e-9  # Rate [bit/s/Hz] by which a bound may be below its plan's own rate.

LEAST_RATE = 5e-5
"""Smallest rate [bit/s/Hz] that a text with four digits does not show as 0."""

_LOWEST_SNR_DB = -30.0  # An SNR [dB] below this carries less than 0.0015 bit/s/Hz.

STATUSES: tuple[Status, ...] = get_args(Status)


def explain_silence(scenario: Scenario, bits: float | None = None, slots: int | None = None
                    ) -> str:
    """
    Say why no plan of a scenario can carry anything in secret, or return an empty string.

    An empty string does not mean that a plan can: only two reasons are looked for. In each slot
    the disc of an eavesdropper that receives no worse covers a ground node, or a ground node that
    is not trusted is always where another one is.

    :param bits: delivery [bit/Hz] that is asked for, by default LEAST_RATE times the duration. A
        ground node whose head start over weight is at least that needs nothing, and is left out.
    :param slots: number of slots that are looked at, from slot 1 on. By default it is the number
        of slots of the scenario; a larger number looks at later slots of the same length, too.
    """
    grounds, centres, radii = scenario.receivers if slots is None else scenario.receivers_at(
        scenario.slot_duration * np.arange(1, slots + 1))
    hears_all = np.array([eve.receiver_advantage_db >= 0 for eve in scenario.eavesdroppers])
    # The axes of `covers` are ground nodes, eavesdroppers and slots.
    covers = hears_all[:, np.newaxis] & (
        np.linalg.norm(centres - grounds[:, np.newaxis], axis=-1) <= radii)
    names = scenario.ground_node_names
    heads = np.array(scenario.head_starts or [0.0] * len(names))
    asked = LEAST_RATE * scenario.duration if bits is None else bits
    for node in np.flatnonzero(heads < asked * scenario.node_weights):
        discs = covers[node]
        if discs.any(axis=0).all():
            name = scenario.eavesdropper_names[int(discs.sum(axis=1).argmax())]
            label = f' {names[node]}' if len(names) > 1 else ''
            return (f'the disc of {name} covers the ground node{label}, where it would receive '
                    'the same: no plan can carry anything')
        for listener in scenario.listeners:
            if listener != node and np.array_equal(grounds[listener], grounds[node]):
                return (f'{names[listener]} is not trusted and is where {names[node]} is, where '
                        'it receives the same: no plan can carry anything')
    return ''


def explain_zero_rate(scenario: Scenario) -> str:
    """Say why a plan of a scenario carries nothing in secret, or what may help."""
    sender = scenario.uavs[0]
    gain = make_link(scenario, 'ground_node').gain(np.zeros((len(scenario.uavs), 1)))
    snr = 10 * math.log10(max(float(gain[0, 0]) * sender.peak_power, 1e-300))
    if (reason := explain_silence(scenario)):
        return reason
    if snr < _LOWEST_SNR_DB:
        return (f'straight below {sender.name} at peak power the SNR is {snr:.0f} dB; is '
                f'reference_snr_db, {scenario.reference_snr_db:g}, right? `secure_uav_planner '
                'link-budget` computes it')
    return 'more time or power may help'


@dataclass(frozen=True)
class Iteration(Checked):
    """
    One iteration of a method, for callbacks and Plan.history, or the progress of a bound.

    :param number: number of the iteration. 0 is the starting point, or the bound before a search.
    :param step: 'start', or the variables that were optimised: 'power', 'trajectory' or 'joint';
        'bound' for a bound.
    :param rate: objective of the best feasible plan so far, or the smallest bound so far: a mean
        over all slots [bit/s/Hz].
    :param elapsed: time since the call [s].
    :param solver_time: part of `elapsed` [s] spent inside Clarabel. For 'joint' it is the part
        spent on solving for Newton steps.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    number: int = field(metadata=checked_by(WholeNumber(0, 1e9)))
    step: str = field(metadata=checked_by(checked_text))
    rate: float = field(metadata=checked_by(_RATE))
    elapsed: float = field(metadata=checked_by(TIME))
    solver_time: float = field(metadata=checked_by(TIME))

    @property
    def guaranteed_rate(self) -> float:
        """Rate; version 0.1 had this name for it."""
        return self.rate


class RatedFlight(Checked):
    """
    A flight with its powers and its rates, which are computed when they are first asked for.

    :ivar scenario: the mission.
    :ivar positions: q_i[n], (U, N+2, 2) in m.
    :ivar powers: p_i[n], (U, N) in W.
    :ivar shares: a_k[n], fraction of slot n for ground node k, (G, N).
    :ivar objective: 'guaranteed' or 'worst_case': which rate is `rate`.
    :ivar promised_until: time [s] from point 0 until which rates are promised; None for all.
    :ivar gaps: intervals (begin, end) [s] before promised_until whose rates are not promised.
    """

    scenario: Scenario
    positions: Array
    powers: Array
    shares: Array
    objective: Objective
    promised_until: float | None
    gaps: tuple[tuple[float, float], ...]

    @property
    def times(self) -> Array:
        """Time of every point from point 0, (N+2,) in s."""
        return self.scenario.times

    @cached_property
    def guaranteed_rates(self) -> Array:
        """
        Guaranteed rate of each slot, the sum of share * [R-bar]^+ over nodes, (N,) in bit/s/Hz.

        It holds for every place of the eavesdroppers inside their discs at the times of the
        points. It holds neither outside the discs nor between the points; see curve_rates.
        """
        return read_only(self.guaranteed_shares.sum(axis=0))

    @cached_property
    def guaranteed_shares(self) -> Array:
        """Guaranteed rate [R-bar]^+ of each node times its fraction of each slot, (G, N)."""
        return read_only(self.shares * self._find_node_rates('guaranteed'))

    @cached_property
    def worst_case_rates(self) -> Array:
        """
        Worst-case rate of each slot, the sum of share * [R]^+ over nodes, (N,) in bit/s/Hz.

        R, equation (6), is the least secrecy rate over all eavesdropper places in the discs at
        the times of the points. It does not hold outside the discs or between the points.
        """
        return read_only(self.worst_case_shares.sum(axis=0))

    @cached_property
    def worst_case_shares(self) -> Array:
        """Worst-case rate [R]^+ of each node times its fraction of each slot, (G, N)."""
        return read_only(self.shares * self._find_node_rates('worst_case'))

    @cached_property
    def curve(self) -> Curve:
        """Flight as a function of time."""
        return Curve(self.scenario, self.positions)

    @cached_property
    def curve_rates(self) -> Array:
        """
        Guaranteed rates along the curve, as means over time in each slot, (N,) in bit/s/Hz.

        They differ from guaranteed_rates, the rates at the points, by the discretisation.
        """
        return read_only(self.curve_shares.sum(axis=0))

    @cached_property
    def curve_shares(self) -> Array:
        """Each node's part of curve_rates: share * [slot mean of R-bar]^+, (G, N) in bit/s/Hz."""
        return read_only(self.shares * _positive_part(mean_node_rates(
            self.scenario, channel.guaranteed_node_rates,
            lambda times: (self.curve.at(times).positions, self.powers, times))))

    @property
    def curve_rate(self) -> float:
        """Mean of curve_rates in bit/s/Hz; for several ground nodes as in guaranteed_rate."""
        return find_least_rate(self.scenario, self.curve_shares.mean(axis=1))

    @property
    def node_shares(self) -> Array:
        """Rate of the objective of each ground node times its fraction of each slot, (G, N)."""
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

        With several ground nodes it is the least of the nodes' means, each with its head start
        and divided by its weight. The properties worst_case_rate, curve_rate and rate follow the
        same rule.
        """
        return find_least_rate(self.scenario, self.guaranteed_shares.mean(axis=1))

    @property
    def worst_case_rate(self) -> float:
        """Mean of worst_case_rates [bit/s/Hz], as in (P1); several nodes as in guaranteed_rate."""
        return find_least_rate(self.scenario, self.worst_case_shares.mean(axis=1))

    @property
    def rate(self) -> float:
        """Rate of the plan's objective in bit/s/Hz: guaranteed_rate or worst_case_rate."""
        return self.guaranteed_rate if self.objective == 'guaranteed' else self.worst_case_rate

    def _find_node_rates(self, objective: Objective) -> Array:
        """Return the rate [R]^+ of each ground node in each whole slot, (G, N) in bit/s/Hz."""
        return _positive_part(channel.NODE_RATES[objective](
            self.scenario, self.positions, self.powers))


def _positive_part(rates: Array) -> Array:
    """Return rates with 0 for negative ones: a slot with a negative rate need not transmit."""
    return read_only(np.maximum(rates, 0.0))


def _checked_limit_names(values: Any) -> tuple[str, ...]:
    """Return the names of the limits that a bound ignores as a tuple, or refuse them."""
    if not isinstance(values, (list, tuple)):
        raise refuse(values, 'a list of names of limits')
    return check_items(values, checked_text)


@dataclass(frozen=True)
class Bound(Checked):
    """
    A proven upper bound on the mean rate of every feasible plan of a scenario.

    It holds for everything that a Plan of this scenario accepts, tolerances included. It says
    nothing about another scenario, about the other objective, or about rates between the points.

    :param scenario: the scenario whose plans it bounds.
    :param rate: the bound [bit/s/Hz], perhaps infinite: no feasible plan has a larger rate.
    :param objective: which rate is bounded: 'guaranteed' of problem (P2), or 'worst_case' of
        problem (P1).
    :param ignored: limits of the scenario that the bound does not use. They can only lower the
        rates of plans: the bound is valid, but looser.
    :param solve_time: [s].
    :param status: why the search for a smaller bound ended; one of STATUSES.
    :raises OptionError: naming the field, its value and what is allowed.
    """

    scenario: Scenario = field(metadata=checked_by(Instance(Scenario)))
    rate: float = field(metadata=checked_by(_RATE))
    objective: str = field(default='worst_case', metadata=checked_by(Choice(OBJECTIVES)))
    ignored: tuple[str, ...] = field(default=(), metadata=checked_by(_checked_limit_names))
    solve_time: float = field(default=0.0, metadata=checked_by(Number(0.0, TIME.high, 's')))
    status: Status = field(default='converged', metadata=checked_by(Choice(STATUSES)))

    _ERROR = OptionError

    def __repr__(self) -> str:
        return (f'<Bound: no plan has a {self.scenario.channel.rate_name(self.objective)} above '
                f'{self.rate:.4f} bit/s/Hz, {self.status}>')

    def gap(self, plan: RatedFlight) -> float:
        """
        Return the gap between bound and plan relative to the plan's rate, (bound - rate) / rate.

        For a plan without a positive rate it is infinite, or 0 if the bound is no larger than the
        rate. A negative gap would prove the bound wrong.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        check_plan(plan, self.scenario)
        rate = plan.guaranteed_rate if self.objective == 'guaranteed' else plan.worst_case_rate
        if rate > 0:
            return (self.rate - rate) / rate
        return math.inf if self.rate > rate else 0.0

    def share_missing(self, plan: RatedFlight) -> float:
        """
        Return the gap between bound and plan relative to the bound, (bound - rate) / bound.

        It is 1 if `gap` is infinite.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        gap = self.gap(plan)
        return 1.0 if math.isinf(gap) else gap / (1.0 + gap)

    def claim(self, plan: RatedFlight) -> str:
        """
        Return the proven quality of a plan, such as 'at most 0.9% below the best possible'.

        The percentage is 100 * share_missing, rounded up to 0.1. An infinite bound proves nothing:
        the text is 'perhaps far below the best possible'. If the bound ignores limits, their names
        follow ' without': the best possible plan is then one without them.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        share = self.share_missing(plan)
        without = f' without {", ".join(self.ignored)}' if self.ignored else ''
        if math.isinf(self.rate):
            return f'perhaps far below the best possible{without}'
        return f'at most {math.ceil(1000 * share) / 10:.1f}% below the best possible{without}'

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the scenario as plain values; an infinite rate is None."""
        return {'rate': self.rate if math.isfinite(self.rate) else None,
                'objective': self.objective, 'ignored': list(self.ignored),
                'solve_time': self.solve_time, 'status': self.status}

    @classmethod
    def from_dict(cls, data: dict[str, Any], scenario: Scenario) -> 'Bound':
        """
        Return the bound that to_dict wrote.

        :param data: the dictionary, whose rate None is infinite.
        :param scenario: the scenario whose plans it bounds.
        :raises OptionError: for a missing or unknown field as well as for a wrong value.
        """
        if isinstance(data, Mapping):
            data = {**data, 'scenario': scenario}
            if data.get('rate', 0.0) is None:
                data['rate'] = math.inf
        return read_object(cls, data, 'bound')  # type: ignore[no-any-return]


def check_plan(plan: RatedFlight, scenario: Scenario) -> None:
    """Raise OptionError unless a plan is a Plan of this scenario."""
    if not isinstance(getattr(plan, 'scenario', None), Scenario):
        raise OptionError(f'plan is {quote(plan)}; it must be a Plan', ('plan',))
    if plan.scenario != scenario:
        raise OptionError('plan is for another scenario; it must be a plan of the scenario given',
                          ('plan',))


def check_bound(plan: RatedFlight, bound: Bound | None) -> None:
    """Raise a PlanError if a bound is below the plan's own rate of the bound's objective."""
    if bound is None:
        return
    rate = getattr(plan, f'{bound.objective}_rate')
    if bound.rate < rate - _ROUNDING:
        raise PlanError(f"bound: rate is {bound.rate!r}; it must be at least the plan's own "
                        f'{bound.objective} rate, which is {rate!r} bit/s/Hz', ('bound',))
