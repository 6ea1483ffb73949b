"""Monte Carlo: the rates of a plan in many random worlds."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import repeat
import math
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .world import draw_fading, draw_places, draw_sights, draw_tracking_errors, World
from ..errors import name_missing_package, OptionError, quote
from ..mission.fields import check_argument, Number
from ..mission.scenario import Array, read_only, Scenario
from ..mission.validation import checked_array, checked_kind, rate_text
from ..model.channel.links import make_link
from ..model.channel.rates import (
    combine_leaks, compute_rate, find_rate_scale, include_listeners)
from ..plan.plan import Plan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_DRAWS = 10**6
"""Largest number of draws, with which a slot of two UAVs takes about 0.2 GB."""

_ROUNDING = 1e-9  # Shortfall of a rate, times find_rate_scale, that is not yet an outage.

FAN = (0.05, 0.25, 0.5, 0.75, 0.95)
"""The quantiles of the rate in each slot."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """
    Secrecy rates of a plan in the drawn worlds, and outages of its slots.

    The secrecy rate of a mission is the mean over its slots of [r_0 - r_e]^+, as in the paper's
    equation (6), with the drawn gains of the channel. If the plan promises only some slots, it is
    the mean over these. With several ground nodes, the rate of a
    mission is the least of the nodes' mean rates, each divided by the node's weight. The rate of a
    slot is the sum over the nodes.

    :ivar plan: the Plan.
    :ivar world: how the world may differ.
    :ivar draws: D, how many worlds were drawn.
    :ivar seed: seed of the draws.
    :ivar rates: secrecy rate of the mission in each draw, (D,) in bit/s/Hz.
    :ivar fan: quantiles FAN of the secrecy rate in each slot, (5, N) in bit/s/Hz.
    :ivar outages: share of the draws in which the rate of a slot is below the promised one, (N,).
    :ivar delivered: bits delivered in secret at the promised rate, in the slots without an outage,
        in each draw, (D,) in bit/Hz.
    :ivar promised_rates: rate of each slot by the plan's objective, at least 0, (N,) in bit/s/Hz;
        0 in slots that are not promised. A promise only if the channel gives a guarantee.
    :ivar is_flown: whether positions of a flight are assessed instead of the plan's positions.
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
                f'{rate_text(self.promised_rate)} {self.claim}; outage of a slot at most '
                f'{self.outage:.2%}, promised: {self.promised_outage_text}>')

    @property
    def mean(self) -> float:
        """Mean over the draws of the secrecy rate in the promised slots in bit/s/Hz."""
        return float(self.rates.mean())

    def plot(self) -> 'Figure':
        """
        Return a picture: rates and outages of the slots over time, and rates of the mission.

        :return: a matplotlib Figure, which notebooks show and whose savefig writes it to a file.
        :raises MissingPackageError: when Matplotlib is not installed.
        """
        with name_missing_package():
            from ..output.figures import draw_assessment
        return draw_assessment(self)

    def quantile(self, share: float) -> float:
        """Return a quantile of the mission's secrecy rate over the draws in bit/s/Hz."""
        return float(np.quantile(self.rates, check_argument('share', share, Number(0.0, 1.0))))

    @property
    def claim(self) -> str:
        """
        Name the kind of the plan's rates: 'promised', or such as 'at mean gains'.

        If not all slots are promised, text that says which follows.
        """
        channel, promise = self.plan.scenario.channel, self.plan.promise
        kind = 'promised' if channel.is_guarantee else channel.promise
        return f'{kind} ({promise.text})' if promise.text else kind

    @property
    def promised_rate(self) -> float:
        """
        Rate of the plan's objective in the promised slots in bit/s/Hz; NaN without any.

        It is a promise only if the channel gives a guarantee.
        """
        return self.plan.promise.rate

    @property
    def outage(self) -> float:
        """Largest of the outages."""
        return float(self.outages.max())

    @property
    def promised_outage(self) -> float:
        """Outage that the plan allows in each slot; 0 where it states none."""
        return self.plan.scenario.channel.outage or 0.0

    @property
    def promised_outage_text(self) -> str:
        """Outage that the plan promises as a percentage, or 'no promise' at mean gains."""
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
        """Rates [bit/s/Hz], outages and deliveries [bit/Hz] by name, as columns of a campaign."""
        return {'mean': self.mean, 'quantile_5': self.quantile(0.05),
                'quantile_50': self.quantile(0.5), 'promised': self.promised_rate,
                'outage': self.outage, 'promised_outage': (
                    self.promised_outage if self.plan.scenario.channel.is_guarantee else math.nan),
                'delivered': float(self.delivered.mean()),
                'promised_delivery': self.promised_delivery}


def assess(plan: Plan, draws: int = 1000, seed: int = 0, world: World | None = None,
           flown: ArrayLike | None = None) -> Assessment:
    """
    Return the Assessment of a plan in random worlds, which differ from the planned one.

    :param plan: a Plan.
    :param draws: how many worlds are drawn.
    :param seed: seed of the draws; the same seed gives the same draws on any machine.
    :param world: how the world may differ; by default only in what the plan allows for: the
        eavesdroppers are anywhere in their discs, lines of sight and fading are drawn.
    :param flown: positions of the UAVs in a flight at the points 1..N, (U, N, 2) in m, instead of
        the plan's positions.
    :raises OptionError: naming the argument, its value and what is allowed.
    """
    checked_kind('plan', plan, Plan)
    world = World() if world is None else checked_kind('world', world, World)
    _check_numbers(draws, seed)
    scenario = replace(plan.scenario, channel=world.channel or plan.scenario.channel)
    if world.positions is not None and len(world.positions) != len(scenario.eavesdroppers):
        raise OptionError(f'positions has {len(world.positions)} places; it must have one for '
                          f'each of the {len(scenario.eavesdroppers)} eavesdroppers')
    positions = plan.positions[:, 1:-1] if flown is None else _checked_flown(flown, plan, world)
    promised, rounding = promised_rates(plan), _ROUNDING * find_rate_scale(plan.scenario)
    step, count = scenario.slot_duration, scenario.slots
    # Rates of the ground nodes summed over the slots, (G, D), and bit/Hz delivered in each draw. A
    # slot delivers its promised rate, and nothing if the rate of the draw is lower.
    # The mission's rate is over the promised slots, as the plan's rate is; over all without any.
    counted = plan.promised_slots if plan.promised_slots.any() else np.ones(count, bool)
    sums, delivered = np.zeros((len(plan.shares), draws)), np.zeros(draws)
    fan, outages = np.empty((len(FAN), count)), np.empty(count)
    for slot, node_rates in enumerate(
            _simulate_rates(scenario, positions, plan.powers, draws, seed, world)):
        # Rates of the ground nodes times their shares of the slot, (G, D), and their sum.
        shared = plan.shares[:, slot, None] * np.maximum(node_rates, 0.0)
        rates = shared.sum(axis=0)
        is_kept = rates >= promised[slot] - rounding
        sums += shared * counted[slot]
        delivered += step * promised[slot] * is_kept
        outages[slot] = np.count_nonzero(~is_kept) / draws
        fan[:, slot] = np.quantile(rates, FAN)
    # The rate of a draw is the least of (mean rate + offset) / weight over the ground nodes.
    least = ((sums / counted.sum() + scenario.node_offsets[:, None])
             / scenario.node_weights[:, None]).min(axis=0)
    return Assessment(plan, world, draws, seed, read_only(least), read_only(fan),
                      read_only(outages), read_only(delivered), promised, flown is not None)


def arguments(data: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the arguments of assess from plain values: draws, seed and fields of World.

    :raises OptionError: naming an unknown field or a wrong value.
    """
    defaults = {'draws': 1000, 'seed': 0}
    if not isinstance(data, Mapping):
        raise OptionError(f'assess is {quote(data)}; it must be a mapping with draws, seed and '
                          'fields of World')
    numbers = {name: data.get(name, default) for name, default in defaults.items()}
    _check_numbers(**numbers)
    world = World.from_dict({name: data[name] for name in data if name not in defaults})
    return {**numbers, 'world': world}


def _check_numbers(draws: Any, seed: Any) -> None:
    """Raise an OptionError unless both numbers are whole and within their ranges."""
    for name, value, least, most in (('draws', draws, 1, MOST_DRAWS), ('seed', seed, 0, 2**64)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not (
                least <= value <= most):
            raise OptionError(f'{name} is {quote(value)}; it must be a whole number from {least} '
                              f'to {most}', (name,))


def promised_rates(plan: Plan) -> Array:
    """Return the promised rate of each slot by the plan's objective, at least 0, (N,)."""
    rates = plan.guaranteed_rates if plan.objective == 'guaranteed' else plan.worst_case_rates
    return read_only(np.where(plan.promised_slots, np.maximum(rates, 0.0), 0.0))


def _checked_flown(flown: ArrayLike, plan: Plan, world: World) -> Array:
    """Return flown positions, finite, (U, N, 2); refuse them if world has tracking errors."""
    if world.tracking_std:
        raise OptionError(f'tracking_std is {world.tracking_std:g} m; with flown positions it '
                          'must be 0', ('tracking_std',))
    positions = checked_array('flown', flown, plan.powers.shape + (2,))
    if not np.isfinite(positions).all():
        raise OptionError(f'flown is {quote(flown)}; it must be finite positions', ('flown',))
    return positions


def _simulate_rates(scenario: Scenario, positions: Array, powers: Array, draws: int, seed: int,
                    world: World) -> Iterator[Array]:
    """
    Yield, for each slot, the rate minus leak of each ground node, (G, D) in bit/s/Hz, of any sign.

    The leak is the largest rate of an eavesdropper or of another node that is not trusted, or the
    rate of all together if they collude. The R receivers are the G nodes, then the eavesdroppers.

    :param positions: positions of the UAVs at the points 1..N, (U, N, 2) in m.
    :param powers: powers of the UAVs, (U, N) in W.
    :param draws: number D of draws.
    """
    channel, nodes = scenario.channel, len(scenario.ground_nodes)
    count = nodes + len(scenario.eavesdroppers)
    # Drawn in each slot: places (E, D, 2), errors (U, D, 2), sights and fading (U, R, D).
    places = draw_places(scenario, world, draws, seed)
    advantages = [*[1.0] * nodes,
                  *(scenario.receiver_advantages * 10.0 ** (world.receiver_db / 10.0))]
    errors: Iterator[Any] = repeat(0.0)
    sights: Iterator[Any] = repeat(None)
    fading: Iterator[Any] = repeat(np.ones((1, count, 1)))
    if world.tracking_std:
        errors = draw_tracking_errors(scenario, world, draws, seed)
    if channel.los is not None and world.los_distance is not None:
        sights = draw_sights(scenario, positions, world.los_distance, draws, seed)
    if channel.rician_k_db is not None:
        fading = draw_fading(channel.rician_k_db, (len(positions), count), draws, seed)
    # The link of all receivers has mean gains; lines of sight and fading are drawn on top.
    link = make_link(replace(scenario, channel=replace(
        channel, cautious=False, rician_k_db=None, outage=None)), 'ground_node')
    slots = zip(positions.swapaxes(0, 1)[:, :, None], powers.T[..., None],
                scenario.receivers.ground_nodes.swapaxes(0, 1), strict=True)
    for (uavs, watts, grounds), eves, error, sight, fade in zip(
            slots, places, errors, sights, fading):
        flown, rates = uavs + error, []  # Rate of each receiver in each draw, R arrays (D,).
        for number, (place, advantage) in enumerate(
                zip([*grounds, *eves], advantages, strict=True)):
            squared = ((flown - place)**2).sum(axis=-1)
            gains = link.gain(squared) if sight is None else link.draw_gain(
                squared, sight[:, number])
            # Received powers relative to the noise, (U, D), the transmitter first.
            rates.append(compute_rate(gains * (advantage * watts) * fade[:, number]))
        leak = (combine_leaks(np.stack(rates[nodes:], axis=-1)) if scenario.colluding else
                np.max(rates[nodes:], axis=0))
        leak = include_listeners(scenario, leak, [rates[node] for node in scenario.listeners])
        yield np.broadcast_to(np.subtract(rates[:nodes], leak), (nodes, draws))
