"""Monte Carlo: the rates of a plan in many worlds."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import draws as drawn
from .result import Assessment, FAN
from .world import World
from ..errors import OptionError, quote
from ..mission.scenario import Array, read_only, Scenario
from ..mission.validation import checked_kind
from ..model.channel.links import link_of
from ..model.channel.rates import put_together, rate_of
from ..plan.plan import Plan

MOST_DRAWS = 10**6
"""With so many, a slot of two UAVs takes about 0.2 GB."""

_ROUNDING = 1e-9  # bit/s/Hz, by which a rate may be below its promise without an outage.


def assess(plan: Plan, draws: int = 1000, seed: int = 0, world: World | None = None,
           flown: ArrayLike | None = None) -> Assessment:
    """
    Return what a plan is worth when the world differs from what it was made for.

    :param plan: a Plan.
    :param draws: how many worlds are drawn.
    :param seed: of the draws; the same seed gives the same draws on any machine.
    :param world: how the world may differ; by default only in what the plan allows for: the
        eavesdroppers are anywhere in their discs, lines of sight and fading are drawn.
    :param flown: where the UAVs really were at the times of the slots, (U, N, 2) in m, instead of
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
    positions = plan.positions[:, 1:-1] if flown is None else _checked(flown, plan, world)
    promised = promised_rates(plan)
    step, count = scenario.slot_duration, scenario.slots
    sums, delivered = np.zeros(draws), np.zeros(draws)
    fan, outages = np.empty((len(FAN), count)), np.empty(count)
    for slot, rates in enumerate(_rates(scenario, positions, plan.powers, draws, seed, world)):
        np.maximum(rates, 0.0, out=rates)
        kept = rates >= promised[slot] - _ROUNDING
        sums += rates
        delivered += step * promised[slot] * kept
        outages[slot] = np.count_nonzero(~kept) / draws
        fan[:, slot] = np.quantile(rates, FAN)
    return Assessment(plan, world, draws, seed, read_only(sums / count), read_only(fan),
                      read_only(outages), read_only(delivered), promised, flown is not None)


def arguments(data: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the arguments of assess that plain values stand for: draws, seed and fields of World.

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
    for name, value, least, most in (('draws', draws, 1, MOST_DRAWS), ('seed', seed, 0, 2**64)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not (
                least <= value <= most):
            raise OptionError(f'{name} is {quote(value)}; it must be a whole number from {least} '
                              f'to {most}', (name,))


def promised_rates(plan: Plan) -> Array:
    """Return what a plan promises in each slot: its objective's rates, where above 0, (N,)."""
    rates = plan.guaranteed_rates if plan.objective == 'guaranteed' else plan.worst_case_rates
    return read_only(np.maximum(rates, 0.0))


def _checked(flown: ArrayLike, plan: Plan, world: World) -> Array:
    if world.tracking_std:
        raise OptionError(f'tracking_std is {world.tracking_std:g} m; with flown positions it '
                          'must be 0')
    shape = plan.powers.shape + (2,)
    try:
        positions: Array = np.asarray(flown, float)
    except (TypeError, ValueError):
        positions = np.empty(0)
    if positions.shape != shape or not np.isfinite(positions).all():
        raise OptionError(f'flown is {quote(flown)}; it must be finite positions of the shape '
                          f'{shape}')
    return positions


def _rates(scenario: Scenario, positions: Array, powers: Array, draws: int, seed: int,
           world: World) -> Iterator[Array]:
    """Yield r_0 - r_e in each slot, (D,) in bit/s/Hz, a new array every time."""
    channel, count = scenario.channel, len(scenario.eavesdroppers)
    receivers = [np.array([scenario.ground_node]),
                 *drawn.places(scenario, world, draws, seed)]
    advantages = [1.0, *(scenario.receiver_advantages * 10.0 ** (world.receiver_db / 10.0))]
    errors: Iterator[Any] = repeat(0.0)
    sights: Iterator[Any] = repeat(None)
    fading: Iterator[Any] = repeat(np.ones((1, 1 + count, 1)))
    if world.tracking_std:
        errors = drawn.tracking_errors(scenario, world, draws, seed)
    if channel.los is not None and world.los_distance is not None:
        sights = drawn.sights(scenario, positions, world.los_distance, draws, seed)
    if channel.rician_k_db is not None:
        fading = drawn.fading(channel.rician_k_db, (len(positions), 1 + count), draws, seed)
    # The gain without fading; a cautious channel is one for promises.
    link = link_of(replace(scenario, channel=replace(
        channel, cautious=False, rician_k_db=None, outage=None)), 'ground_node')
    slots = zip(positions.swapaxes(0, 1)[:, :, None], powers.T[..., None], strict=True)
    for (uavs, watts), error, sight, fade in zip(slots, errors, sights, fading):
        uavs = uavs + error
        rates = []
        for number, (place, advantage) in enumerate(zip(receivers, advantages, strict=True)):
            squared = ((uavs - place)**2).sum(axis=-1)
            gains = link.gain(squared) if sight is None else link.drawn_gain(
                squared, sight[:, number])
            rates.append(rate_of(gains * (advantage * watts) * fade[:, number]))
        leaks = np.stack(rates[1:], axis=-1)
        leak = put_together(leaks) if scenario.colluding else leaks.max(axis=-1)
        yield np.broadcast_to(rates[0] - leak, (draws,)).copy()
