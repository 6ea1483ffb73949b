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
        """Return Visits with every array indexed by `index`: some starts, or reordered visits."""
        return Visits(*(values[index] for values in self))


def draw_visits(scenario: Scenario, order: list[int], count: int, powers: Array,
                rng: np.random.Generator) -> Visits:
    """
    Return C = `count` random starts that visit the V ground nodes once each, all in one order.

    A visit lasts longer for a node with a large weight and a small best rate. All starts share the
    configurations (all places and powers of one visit) of _sample_configurations. A start draws
    each with probability 1 / VISITS.drawn. Among the VISITS.kept best drawn configurations of each
    visit _choose_sequence chooses one.

    :param order: indices of the V ground nodes in the order of the visits.
    :param powers: largest power of each UAV in starts, (U,) in W; see limit_powers.
    """
    weights = scenario.node_weights[order]
    expected = np.full(len(order), 1 / len(order))  # Durations in shares of the flight, (V,).
    for _ in range(2):  # The first pass takes equal times, the second the times that are needed.
        middles = (np.cumsum(expected) - expected / 2) * scenario.times[-1]
        pool = _sample_configurations(scenario, order, middles, powers, rng)
        pool_rates = pool[2]
        rates = pool_rates.max(axis=1)
        needs = weights / np.maximum(rates, max(VISITS.least_rate * rates.max(), 1e-9))
        expected = VISITS.equal / len(order) + (1 - VISITS.equal) * needs / needs.sum()
    visit = np.arange(len(order))
    durations = expected * np.exp(VISITS.jitter * rng.normal(size=(count, len(order))))
    all_ends = np.cumsum(durations / durations.sum(axis=1, keepdims=True), axis=1)
    places, shares = [], []
    for ends in all_ends:
        middles = (ends - np.diff(ends, prepend=0.0) / 2) * scenario.times[-1]
        is_drawn = rng.integers(VISITS.drawn, size=pool_rates.shape) == 0
        kept = np.argsort(np.where(is_drawn, -pool_rates, np.inf), axis=1)[:, :VISITS.kept]
        kept_places, kept_shares, kept_rates = (values[visit[:, None], kept] for values in pool)
        chosen = _choose_sequence(scenario, kept_places, kept_rates, middles)
        places.append(kept_places[visit, chosen])
        shares.append(kept_shares[visit, chosen])
    return Visits(np.tile(order, (count, 1)), np.stack(places), np.stack(shares),
                  np.diff(all_ends, axis=1, prepend=0.0))


def _sample_configurations(scenario: Scenario, order: list[int], times: Array, powers: Array,
                           rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """
    Return C = VISITS.samples random configurations (places and powers of all UAVs) per visit.

    UAV 0, the transmitter, is near the visited node at its largest power. Each jammer is near a
    random eavesdropper or listening ground node, at a random power. Each offset is a normal vector
    times a log-uniform distance. Places too far for the time are moved by _keep_in_reach.

    :param order: indices of the V ground nodes that are visited.
    :param times: time of the middle of each visit, (V,) in s.
    :param powers: largest power of each UAV, (U,) in W.
    :return: places of the UAVs, (V, C, U, 2) in m; powers as shares of the largest, (V, C, U);
        guaranteed rate of the visited node in bit/s/Hz, (V, C), which may be negative.
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
    """
    Return the index of the configuration that each of V visits takes.

    Dynamic programming maximises the sum of log(rate) over visits minus VISITS.late times the sum
    of [t / (VISITS.flying * T) - 1]^+ over successive visits. T is the time between the middles of
    both visits, and t the time at max_speed of the UAV that takes longest. A smaller rate is
    replaced by VISITS.least_rate * the largest rate.

    :param places: places of the UAVs in each of C configurations of a visit, (V, C, U, 2) in m.
    :param rates: rate of the visited node, (V, C) in bit/s/Hz.
    :param times: time of the middle of each visit, (V,) in s.
    """
    values = np.log(np.maximum(rates, max(VISITS.least_rate * rates.max(), 1e-9)))
    # Best score of a sequence that ends in each configuration of the present visit, (C,).
    score, predecessors = values[0], []
    for before, here, value, time in zip(places, places[1:], values[1:], np.diff(times)):
        flying = np.linalg.norm(before[:, None] - here, axis=-1) / scenario.max_speeds
        late = np.maximum(flying.max(axis=-1) / (VISITS.flying * time) - 1, 0.0)
        scores = score[:, None] - VISITS.late * late
        predecessors.append(scores.argmax(axis=0))
        score = scores.max(axis=0) + value
    chosen = [int(score.argmax())]
    for predecessor in reversed(predecessors):
        chosen.insert(0, int(predecessor[chosen[0]]))
    return chosen


def _keep_in_reach(scenario: Scenario, places: Array, times: Array, share: Array) -> Array:
    """
    Return places (..., U, 2) in m, moved so that UAVs can pass them and still reach their goals.

    A place within reach stays. Any other moves towards the UAV's place at the same time on the
    straight flight from start to goal, until a flight at speed v from the start to the place, and
    on to the goal, is in time. v is share * max_speed, at least the straight flight's speed.

    :param times: time at which each place is passed, in s, with a last axis of length 1 or U.
    :param share: allowed speed over max_speed, in a shape that broadcasts with (..., U).
    """
    total = scenario.times[-1]
    straight = scenario.starts + (times / total)[..., None] * (scenario.goals - scenario.starts)
    speeds = np.maximum(share * scenario.max_speeds, np.linalg.norm(
        scenario.goals - scenario.starts, axis=-1) / total)
    offsets, scale = places - straight, np.ones(places.shape[:-1])
    for end, time in ((scenario.starts, times), (scenario.goals, total - times)):
        scale = np.minimum(scale, _find_scale(straight - end, offsets, speeds * time))
    return straight + scale[..., None] * offsets


def _find_scale(vectors: Array, offsets: Array, reach: Array) -> Array:
    """
    Return the largest scale s >= 0, (...), with |vector + s offset| <= reach.

    :param vectors: vectors (..., 2) that are not longer than reach, (...).
    :param offsets: offsets (..., 2), for which s is very large if they are 0.
    """
    square = np.maximum((offsets**2).sum(axis=-1), 1e-9)
    half = (vectors * offsets).sum(axis=-1) / square
    rest = np.maximum(reach**2 - (vectors**2).sum(axis=-1), 0.0) / square
    return np.asarray(np.sqrt(half**2 + rest) - half)


def _move_towards(points: Array, targets: Array, lengths: Array) -> Array:
    """Return points (..., 2) moved towards targets (..., 2), each by at most its length (...)."""
    offsets = targets - points
    scales = np.minimum(1.0, lengths / np.maximum(_measure_lengths(offsets), 1e-9))
    return np.asarray(points + scales[..., None] * offsets)


def fly_visits(grid: Grid, visits: Visits) -> Array:
    """
    Return the flights of C starts through the places of their visits, (C, U, N+2, 2) in m.

    A UAV flies at full speed to its place of the present visit and waits there. It leaves when
    half of the way to the next place takes the rest of the visit, and stays in reach of its goal.
    Flights are then smoothed by moving averages of points. If a UAV has no time for its straight
    way to the goal, all flights are the grid's reference_flight.
    """
    scenario, ends = grid.scenario, visits.ends
    steps = scenario.max_speeds * grid.slot_duration  # Longest moves in a slot [m], (U,).
    # Averages over the moves in which a UAV reaches full speed limit its acceleration.
    width = max(math.ceil(uav.max_speed / (uav.vehicle.max_acceleration * grid.slot_duration))
                for uav in scenario.uavs)
    moves, start = grid.slots + 1 - width, np.arange(len(ends))
    point = np.repeat(scenario.starts[None], len(start), axis=0)
    if (_measure_lengths(scenario.goals - scenario.starts) > moves * steps).any():
        return np.repeat(grid.reference_flight[None], len(start), axis=0)
    points = [point]
    for number in range(1, moves + 1):
        visit = (number / moves > ends[:, :-1]).sum(axis=1)
        following = visits.places[start, np.minimum(visit + 1, ends.shape[1] - 1)]
        leaves = number / moves + _measure_lengths(following - point) / (2 * moves * steps) > (
            ends[start, visit][:, None])
        target = np.where(leaves[..., None], following, visits.places[start, visit])
        # The goal must stay in reach of the moves that are left. The nearest point from which it
        # is may be more than a step away; a step on the straight way to the goal is not.
        nearest = _move_towards(
            scenario.goals, _move_towards(point, target, steps), steps * (moves - number))
        straight = _move_towards(point, scenario.goals, steps)
        scale = np.minimum(1.0, _find_scale(straight - point, nearest - straight, steps))
        point = straight + scale[..., None] * (nearest - straight)
        points.append(point)
    path = np.pad(np.stack(points, axis=2), ((0, 0), (0, 0), (width, width), (0, 0)), mode='edge')
    sums = np.cumsum(np.pad(path, ((0, 0), (0, 0), (1, 0), (0, 0))), axis=2)
    flights = (sums[:, :, width + 1:] - sums[:, :, :-width - 1]) / (width + 1)
    flights[:, :, 0], flights[:, :, -1] = scenario.starts, scenario.goals
    return flights


def _measure_lengths(offsets: Array) -> Array:
    """Return the lengths (...) of vectors (..., 2)."""
    return np.asarray(np.hypot(offsets[..., 0], offsets[..., 1]))


def log_uniform(rng: np.random.Generator, ends: tuple[float, float],
                shape: tuple[int, ...]) -> Array:
    """Return log-uniform random numbers from ends[0] to ends[1], of a shape."""
    low, high = np.log(ends).tolist()
    return np.exp(rng.uniform(low, high, shape))
