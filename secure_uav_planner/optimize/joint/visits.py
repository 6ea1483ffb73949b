"""
Visits of several ground nodes in configurations that serve each node well.

A node without a rate has no gradient. So starts visit every node: all UAVs are at good places for
it, with good powers, for as long as its weight and its rate there ask for. `visit_search.py`
improves such starts.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .settings import VISITS
from ...mission.scenario import Array, Scenario
from ...model.channel import guaranteed_node_rates
from ...model.grid import Grid


class Visits(NamedTuple):
    """
    C starts that visit each of V ground nodes once.

    :param nodes: numbers of the ground nodes in the order of the visits, (C, V).
    :param places: places of the UAVs [m], (C, V, U, 2).
    :param shares: powers of the UAVs in shares of the powers of starts, (C, V, U).
    :param durations: durations of the visits in shares of the flight, (C, V).
    """

    nodes: NDArray[np.intp]
    places: Array
    shares: Array
    durations: Array

    @property
    def ends(self) -> Array:
        """Return the ends of the visits in shares of the flight, (C, V)."""
        return np.cumsum(self.durations, axis=1)

    def take(self, index: Any) -> 'Visits':
        """Return some of the starts, or other orders of visits, by an index of the arrays."""
        return Visits(*(values[index] for values in self))


def draw_visits(scenario: Scenario, order: list[int], count: int, powers: Array,
                rng: np.random.Generator) -> Visits:
    """
    Return random starts that visit ground nodes in an order.

    :param order: numbers of the nodes, V.
    :param count: number of starts.
    :param powers: powers of starts [W], (U,).
    """
    weights = scenario.node_weights[order]
    needs = np.full(len(order), 1 / len(order))
    for _ in range(2):  # The first pass takes equal times, the second the times that are needed.
        ends = np.cumsum(needs)
        times = (ends - needs / 2) * scenario.times[-1]
        pool = _sample_configurations(scenario, order, times, powers, rng)
        rates = pool[2].max(axis=1)
        durations = weights / np.maximum(rates, max(VISITS.least_rate * rates.max(), 1e-9))
        needs = VISITS.equal / len(order) + (1 - VISITS.equal) * durations / durations.sum()
    visit = np.arange(len(order))
    durations = needs * np.exp(VISITS.jitter * rng.normal(size=(count, len(order))))
    all_ends = np.cumsum(durations / durations.sum(axis=1, keepdims=True), axis=1)
    places, shares = [], []
    for ends in all_ends:
        times = (ends - np.diff(ends, prepend=0.0) / 2) * scenario.times[-1]
        drawn = rng.integers(VISITS.drawn, size=pool[2].shape) == 0
        kept = np.argsort(np.where(drawn, -pool[2], np.inf), axis=1)[:, :VISITS.kept]
        some_places, some_shares, some_rates = (values[visit[:, None], kept] for values in pool)
        best = _choose_sequence(scenario, some_places, some_rates, times)
        places.append(some_places[visit, best])
        shares.append(some_shares[visit, best])
    return Visits(np.tile(order, (count, 1)), np.stack(places), np.stack(shares),
                  np.diff(all_ends, axis=1, prepend=0.0))


def _sample_configurations(scenario: Scenario, order: list[int], times: Array, powers: Array,
                           rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """
    Return C = VISITS.samples random configurations for each of some visits at times (V,) in s.

    :param order: numbers of the ground nodes that are visited, V.
    :param powers: largest power of each UAV, (U,) in W.
    :return: places of the UAVs, (V, C, U, 2) in m; powers as shares of the largest, (V, C, U);
        rate of the node that is visited in bit/s/Hz, (V, C).
    """
    visit, uavs = np.arange(len(order)), len(scenario.uavs)
    grounds, centres, _ = scenario.receivers_at(times)
    receivers = np.concatenate([centres, grounds[list(scenario.listeners)]])
    shape = len(order), VISITS.samples, uavs
    targets = receivers[rng.integers(len(receivers), size=shape), visit[:, None, None]]
    targets[:, :, 0] = grounds[order, visit][:, None]
    distances = scenario.altitudes.mean() * log_uniform(rng, VISITS.distance, shape)
    distances[..., 0] = scenario.altitudes.mean() * log_uniform(rng, VISITS.away, shape[:2])
    places = _keep_in_reach(
        scenario, targets + distances[..., None] * rng.normal(size=targets.shape),
        times[:, None, None], rng.uniform(*VISITS.reach, (*shape[:2], 1)))
    shares = log_uniform(rng, VISITS.jamming, shape)
    shares[..., 0] = 1.0
    flights = np.pad(places.reshape(-1, uavs, 2).swapaxes(0, 1), ((0, 0), (1, 1), (0, 0)))
    rates = guaranteed_node_rates(
        scenario, flights, (shares * powers).reshape(-1, uavs).T,
        times=np.repeat(times, VISITS.samples))
    return places, shares, rates.reshape(-1, *shape[:2])[order, visit]


def _choose_sequence(scenario: Scenario, places: Array, rates: Array, times: Array) -> list[int]:
    """Return which configuration (V, C) each visit takes, so that UAVs have time to fly on."""
    values = np.log(np.maximum(rates, max(VISITS.least_rate * rates.max(), 1e-9)))
    total, choices = values[0], []
    for before, here, value, time in zip(places, places[1:], values[1:], np.diff(times)):
        way = np.linalg.norm(before[:, None] - here, axis=-1) / scenario.max_speeds
        late = np.maximum(way.max(axis=-1) / (VISITS.flying * time) - 1, 0.0)
        sums = total[:, None] - VISITS.late * late
        choices.append(sums.argmax(axis=0))
        total = sums.max(axis=0) + value
    best = [int(total.argmax())]
    for choice in reversed(choices):
        best.insert(0, int(choice[best[0]]))
    return best


def _keep_in_reach(scenario: Scenario, places: Array, times: Array, share: Array) -> Array:
    """Return places (..., U, 2) in m, moved to where a share of the speed leads in times in s."""
    total = scenario.times[-1]
    straight = scenario.starts + (times / total)[..., None] * (scenario.goals - scenario.starts)
    speeds = np.maximum(share * scenario.max_speeds, np.linalg.norm(
        scenario.goals - scenario.starts, axis=-1) / total)
    offsets, share = places - straight, np.ones(places.shape[:-1])
    for end, left in ((scenario.starts, times), (scenario.goals, total - times)):
        # |straight + s offset - end| = speed * left, solved for the share s.
        away, reach = straight - end, speeds * left
        square = np.maximum((offsets**2).sum(axis=-1), 1e-9)
        half = (away * offsets).sum(axis=-1) / square
        rest = np.maximum(reach**2 - (away**2).sum(axis=-1), 0.0) / square
        share = np.minimum(share, np.sqrt(half**2 + rest) - half)
    return straight + share[..., None] * offsets


def fly_visits(grid: Grid, visits: Visits) -> Array:
    """Return flights (C, U, N+2, 2) in m on a grid that pursue places as their goals allow."""
    scenario, ends = grid.scenario, visits.ends
    steps = scenario.max_speeds * grid.slot_duration
    # A limit of acceleration is kept by means of velocities over the moves that full speed takes.
    width = max(math.ceil(uav.max_speed / (uav.vehicle.max_acceleration * grid.slot_duration))
                for uav in scenario.uavs)
    moves, each = grid.slots + 1 - width, np.arange(len(ends))
    place = np.repeat(scenario.starts[None], len(each), axis=0)
    if (_measure(scenario.goals - scenario.starts) > moves * steps).any():
        return np.repeat(grid.reference_flight[None], len(each), axis=0)
    points = [place]
    for number in range(1, moves + 1):
        visit = (number / moves > ends[:, :-1]).sum(axis=1)
        following = visits.places[each, np.minimum(visit + 1, ends.shape[1] - 1)]
        # Half the way to the next place is flown in the time for the present one.
        leaves = number / moves + _measure(following - place) / (2 * moves * steps) > (
            ends[each, visit][:, None])
        offset = np.where(leaves[..., None], following, visits.places[each, visit]) - place
        place = place + offset * np.minimum(1.0, steps / np.maximum(_measure(offset), 1e-9)
                                            )[..., None]
        offset = place - scenario.goals
        place = scenario.goals + offset * np.minimum(
            1.0, steps * (moves - number) / np.maximum(_measure(offset), 1e-9))[..., None]
        points.append(place)
    path = np.pad(np.stack(points, axis=2), ((0, 0), (0, 0), (width, width), (0, 0)), mode='edge')
    sums = np.cumsum(np.pad(path, ((0, 0), (0, 0), (1, 0), (0, 0))), axis=2)
    flights = (sums[:, :, width + 1:] - sums[:, :, :-width - 1]) / (width + 1)
    flights[:, :, 0], flights[:, :, -1] = scenario.starts, scenario.goals
    return flights


def _measure(offsets: Array) -> Array:
    return np.asarray(np.hypot(offsets[..., 0], offsets[..., 1]))


def log_uniform(rng: np.random.Generator, ends: tuple[float, float],
                shape: tuple[int, ...]) -> Array:
    """Return random numbers that are log-uniform between two ends."""
    low, high = np.log(ends).tolist()
    return np.exp(rng.uniform(low, high, shape))
