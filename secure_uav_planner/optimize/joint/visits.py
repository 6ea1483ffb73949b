"""
Visits of several ground nodes in configurations that serve each node well.

A node without a rate has no gradient. So starts visit every node: all UAVs are at good places for
it, with good powers, for as long as its weight and its rate there ask for. `visit_search.py`
improves such starts.
"""

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .settings import VISITS
from ...mission.scenario import Array, Scenario
from ...model.channel import guaranteed_node_rates
from ...model.grid import Grid

Complex: TypeAlias = NDArray[np.complex128]
"""Vectors x + i y [m]. NumPy measures and scales them in fewer operations than pairs (x, y)."""


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
    weights, offsets = scenario.node_weights[order], scenario.node_offsets[order]
    expected = np.full(len(order), 1 / len(order))  # Durations in shares of the flight, (V,).
    for _ in range(2):  # The first pass takes equal times, the second the times that are needed.
        middles = (np.cumsum(expected) - expected / 2) * scenario.times[-1]
        pool = _sample_configurations(scenario, order, middles, powers, rng)
        pool_rates = pool[2]
        rates = pool_rates.max(axis=1)
        needs = _compute_needs(
            weights, offsets, np.maximum(rates, max(VISITS.least_rate * rates.max(), 1e-9)))
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


def _compute_needs(weights: Array, offsets: Array, rates: Array) -> Array:
    """
    Return the durations of V visits, (V,) in one unit, that give all nodes the same.

    A visit of duration n, in shares of the flight, gives its node offset + n rate. This is to be
    the node's weight times a common level. A node with more than that needs no visit.
    """
    is_needed = np.ones(len(weights), bool)
    for _ in weights:
        level = (1 + (offsets / rates)[is_needed].sum()) / (weights / rates)[is_needed].sum()
        is_needed = level * weights > offsets
    return np.where(is_needed, (weights - offsets / level) / rates, 0.0)


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
    total, place = scenario.times[-1], _to_complex(places)
    start, goal = _to_complex(scenario.starts), _to_complex(scenario.goals)
    straight = start + (times / total) * (goal - start)
    speeds = np.maximum(share * scenario.max_speeds, np.abs(goal - start) / total)
    offsets, scale = place - straight, np.ones(place.shape)
    for end, time in ((start, times), (goal, total - times)):
        scale = np.minimum(scale, _find_scale(straight - end, offsets, speeds * time))
    return _to_real(straight + scale * offsets)


def _to_complex(vectors: Array) -> Complex:
    """Return vectors (..., 2) as complex numbers x + i y, (...)."""
    return np.ascontiguousarray(vectors).view(complex)[..., 0]


def _to_real(vectors: Complex) -> Array:
    """Return complex numbers x + i y, (...), as vectors (..., 2)."""
    return np.ascontiguousarray(vectors)[..., None].view(float)


def _find_scale(vectors: Complex, offsets: Complex, reach: Array) -> Array:
    """
    Return the largest scale s >= 0, (...), with |vector + s offset| <= reach.

    :param vectors: complex vectors (...) that are not longer than reach, (...).
    :param offsets: complex offsets (...), for which s is very large if they are 0.
    """
    square = np.maximum(np.abs(offsets)**2, 1e-9)
    half = (vectors * offsets.conj()).real / square
    rest = np.maximum(reach**2 - np.abs(vectors)**2, 0.0) / square
    return np.asarray(np.sqrt(half**2 + rest) - half)


def _move_towards(points: Complex, targets: Complex, lengths: Array) -> Complex:
    """Return points (...) moved towards targets (...), each by at most its length (...)."""
    offsets = targets - points
    return points + np.minimum(1.0, lengths / np.maximum(np.abs(offsets), 1e-9)) * offsets


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
    goal = _to_complex(scenario.goals)
    points = [np.tile(_to_complex(scenario.starts), (len(ends), 1))]
    if (np.abs(goal - points[0]) > moves * steps).any():
        return np.repeat(grid.reference_flight[None], len(ends), axis=0)
    times = np.arange(1, moves + 1)[:, None] / moves
    visit = (times[..., None] > ends[:, :-1]).sum(axis=-1)  # Number of the visit, (moves, C).
    places = _to_complex(visits.places)
    following = places[start, np.minimum(visit + 1, ends.shape[1] - 1)]
    rests = 2 * moves * (ends[start, visit] - times)[..., None] * steps
    for left, here, there, rest in zip(
            range(moves - 1, -1, -1), places[start, visit], following, rests):
        point = points[-1]
        target = np.where(np.abs(there - point) > rest, there, here)
        moved = _move_towards(point, target, steps)
        # The goal must stay in reach of the moves that are left. The nearest point from which it
        # is may be more than a step away; a step on the straight way to the goal is not.
        if (np.abs(goal - moved) > left * steps).any():
            nearest = _move_towards(goal, moved, left * steps)
            straight = _move_towards(point, goal, steps)
            offset = nearest - straight
            moved = straight + np.minimum(
                1.0, _find_scale(straight - point, offset, steps)) * offset
        points.append(moved)
    path = np.pad(_to_real(np.stack(points, axis=2)), ((0, 0), (0, 0), (width, width), (0, 0)),
                  mode='edge')
    sums = np.cumsum(np.pad(path, ((0, 0), (0, 0), (1, 0), (0, 0))), axis=2)
    flights = (sums[:, :, width + 1:] - sums[:, :, :-width - 1]) / (width + 1)
    flights[:, :, 0], flights[:, :, -1] = scenario.starts, scenario.goals
    return flights


def log_uniform(rng: np.random.Generator, ends: tuple[float, float],
                shape: tuple[int, ...]) -> Array:
    """Return log-uniform random numbers from ends[0] to ends[1], of a shape."""
    low, high = np.log(ends).tolist()
    return np.exp(rng.uniform(low, high, shape))
