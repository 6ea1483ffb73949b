"""
Search for starts that visit several ground nodes: random visits, changed where that raises a rate.

Changes are judged by an estimate of the least rate that takes no Newton step, so that thousands
of orders, places and durations are compared in the time of a few starts.
"""

import numpy as np
from numpy.typing import NDArray

from .settings import VISIT_SEARCH
from .visits import draw_visits, fly_visits, log_uniform, Visits
from ..deadline import DeadlineCheck
from ..initial import list_orders
from ...mission.scenario import Array, Scenario
from ...model.channel import guaranteed_node_rates
from ...model.grid import Grid
from ...model.limits import build_limits, NormLimit


def generate_visits(grid: Grid, count: int, powers: Array, raise_if_over: DeadlineCheck
                    ) -> tuple[Array, Array, Array]:
    """
    Return the S = `count` best starts that visit all ground nodes, the best estimate first.

    Random visits are drawn for every order of list_orders and improved by random changes. Flights
    keep the limits of speed and acceleration; they may break others.

    :param powers: largest power of each UAV in starts, (U, 1) in W; see limit_powers.
    :param raise_if_over: called before each order and each round of changes.
    :return: flights (S, U, N+2, 2) in m on the grid, powers of the slots (S, U, N) in W, and
        estimates of the least mean rates over weight in bit/s/Hz, (S,).
    """
    scenario, rng = grid.scenario, np.random.default_rng(5)
    orders = list_orders(
        scenario, scenario.receivers_at([scenario.duration / 2]).ground_nodes[:, 0])
    per_order = -(-VISIT_SEARCH.drawn * count // len(orders))  # Rounded up.
    batches = []
    for order in orders:
        raise_if_over()
        batches.append(draw_visits(scenario, order, per_order, powers[:, 0], rng))
    visits = Visits(*map(np.concatenate, zip(*batches)))
    coarse = grid.with_slots(min(grid.slots, VISIT_SEARCH.slots))
    visits = _improve_visits(coarse, visits, powers, rng, raise_if_over)
    flights = fly_visits(grid, visits)
    for limit in build_limits(grid):
        if isinstance(limit, NormLimit):
            flights = np.stack([limit.retract(flight) for flight in flights])
    estimates, power, delivers = _estimate(grid, visits, flights, powers)
    best = np.argsort(-estimates, kind='stable')[:count]
    # Every second start transmits only in slots with a positive rate, at the same mean power.
    delivers = delivers[best[1::2]]
    power[best[1::2], 0] *= delivers / np.maximum(delivers.mean(axis=1, keepdims=True), 1e-3)
    return flights[best], power[best], estimates[best]


def _improve_visits(grid: Grid, visits: Visits, powers: Array, rng: np.random.Generator,
                    raise_if_over: DeadlineCheck) -> Visits:
    """
    Return the visits of C starts after rounds of random changes.

    A round changes every start once, and keeps changes that raise the start's estimate. There are
    at least VISIT_SEARCH.changes rounds. More follow until the share VISIT_SEARCH.serving of the
    starts serves all nodes, to at most VISIT_SEARCH.most_changes rounds.

    :param powers: largest power of each UAV in starts, (U, 1) in W.
    """
    drawn, estimates = visits, _estimate(grid, visits, fly_visits(grid, visits), powers)[0]
    for number in range(VISIT_SEARCH.most_changes):
        serving = (estimates >= VISIT_SEARCH.served).mean()
        if number >= VISIT_SEARCH.changes and serving >= VISIT_SEARCH.serving:
            break
        raise_if_over()
        changed = _change(grid.scenario, visits, drawn, rng)
        new = _estimate(grid, changed, fly_visits(grid, changed), powers)[0]
        better, estimates = new > estimates, np.maximum(new, estimates)
        visits = Visits(*(np.where(np.reshape(better, (-1,) + (1,) * (old.ndim - 1)), values, old)
                          for values, old in zip(changed, visits)))
    return visits


def _estimate(grid: Grid, visits: Visits, flights: Array,
              powers: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """
    Return estimates of C starts' least over nodes of mean rate / weight, powers and a mask.

    Weights are in units of grid.weight.

    An estimate is an upper bound by _bound_least_rates for the N slots of the grid.

    :param flights: flights through the visits, (C, U, N+2, 2) in m.
    :param powers: largest power of each UAV in starts, (U, 1) in W.
    :return: the estimates in bit/s/Hz, (C,); the powers of the slots in W, (C, U, N); and True for
        slots in which any node has a positive rate, (C, N).
    """
    scenario = grid.scenario
    slots = np.arange(1, grid.slots + 1) / (grid.slots + 1)
    # Index of the visit in each slot, (C, N).
    visit = (slots[:, None] > visits.ends[:, None, :-1]).sum(axis=-1)
    power = powers * np.moveaxis(np.take_along_axis(visits.shares, visit[..., None], 1), -1, 1)
    rates = guaranteed_node_rates(
        scenario, np.pad(_join(flights[:, :, 1:-1]), ((0, 0), (1, 1), (0, 0))), _join(power),
        times=np.tile(grid.times, len(flights)))
    rates = rates.reshape(len(rates), len(flights), grid.slots)
    delivers = np.asarray((rates > 0).any(axis=0))
    # Rates are at least `lacks`: for a node without a positive rate this is lack * 2^(best rate),
    # which rises with its negative best rate.
    lacks = VISIT_SEARCH.lack * 2.0 ** np.minimum(rates.max(axis=-1, keepdims=True), 0.0)
    scales = grid.weight / scenario.node_weights
    rates = np.moveaxis(np.maximum(rates, lacks) * scales[:, None, None], 0, 1)
    return _bound_least_rates(rates, scenario.node_offsets * scales), power, delivers


def _join(values: Array) -> Array:
    """Return values (C, U, N, ...) of C flights as (U, C N, ...), flight after flight."""
    return np.swapaxes(values, 0, 1).reshape(values.shape[1], -1, *values.shape[3:])


def _bound_least_rates(rates: Array, offsets: Array) -> Array:
    """
    Return upper bounds (C,) of the least sums of offset and mean rate that shares can give.

    For any prices p_g >= 0 of the nodes with sum 1, the mean over slots n of max_g p_g rate_g[n]
    plus the sum of p_g offset_g is a bound. Each round takes the shares that attain this maximum,
    and lowers the prices of nodes with large sums at these shares. The least bound of all rounds
    is returned.

    :param rates: rate over weight of each node in each slot, positive, (C, G, N).
    :param offsets: head start over weight of each node's mean rate, (G,).
    """
    prices = 1 / (offsets + rates.mean(axis=-1))
    prices /= prices.sum(axis=1, keepdims=True)
    bounds = np.full(len(rates), np.inf)
    for number in range(VISIT_SEARCH.rounds):
        priced = prices[..., None] * rates
        most = priced.max(axis=1, keepdims=True)
        bounds = np.minimum(bounds, most.mean(axis=-1)[:, 0] + prices @ offsets)
        gains = offsets + np.where(priced >= most, rates, 0.0).mean(axis=-1)
        gains /= gains.mean(axis=1, keepdims=True)
        prices *= np.exp(-VISIT_SEARCH.price_step / (1 + number / 4) * (gains - 1))
        prices /= prices.sum(axis=1, keepdims=True)
    return bounds


def _change(scenario: Scenario, visits: Visits, drawn: Visits, rng: np.random.Generator) -> Visits:
    """
    Return the visits of C starts, each with one random change of four equally likely kinds.

    Kind 0 reverses a part of the order. Kind 1 takes places and powers of one visit from a
    drawn start's visit of the same node, for one UAV or, with probability 1/2, for all UAVs.
    Kind 2 moves one UAV in one visit, and scales its power if it is a jammer. Kind 3 stretches
    the durations of all visits.

    :param drawn: the starts as first drawn, from which kind 1 takes places and powers.
    """
    starts, (count, stops, uavs) = np.arange(len(visits.nodes)), visits.shares.shape
    kind, stop = rng.integers(4, size=count), rng.integers(stops, size=count)
    part = np.sort(rng.integers(stops, size=(count, 2)), axis=1)[..., None]  # First and last.
    order = np.arange(stops)
    turned = (kind == 0)[:, None] & (part[:, 0] <= order) & (order <= part[:, 1])
    order = np.where(turned, part.sum(axis=1) - order, order)
    nodes, places, shares, durations = visits.take((starts[:, None], order))

    source = rng.integers(len(drawn.nodes), size=count)
    same_node = (drawn.nodes[source] == nodes[starts, stop][:, None]).argmax(axis=1)
    uav = rng.integers(uavs, size=count)
    taken = (rng.random((count, 1)) < 0.5) | (np.arange(uavs) == np.reshape(uav, (-1, 1)))
    taken &= (kind == 1)[:, None]
    places[starts, stop] = np.where(
        taken[..., None], drawn.places[source, same_node], places[starts, stop])
    shares[starts, stop] = np.where(taken, drawn.shares[source, same_node], shares[starts, stop])

    lengths = scenario.altitudes.mean() * log_uniform(rng, VISIT_SEARCH.shift, (count, 1))
    moves = lengths * rng.normal(size=(count, 2))
    places[starts, stop, uav] += np.where((kind == 2)[:, None], moves, 0.0)
    scaled = (kind == 2) & (uav > 0)  # The transmitter keeps its power.
    shares[starts, stop, uav] *= np.exp(scaled * rng.normal(size=count))

    stretches = VISIT_SEARCH.stretch * rng.normal(size=durations.shape)
    durations *= np.exp((kind == 3)[:, None] * stretches)
    return Visits(nodes, places, shares, durations / durations.sum(axis=1, keepdims=True))
