"""Starts of the joint method: random hovering places and powers, made strictly feasible."""

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from .settings import STARTS
from .visit_search import generate_visits
from .visits import log_uniform
from ..deadline import DeadlineCheck
from ..incumbent import find_powers_without_jamming
from ..initial import build_flights, fly_around, list_orders, move_inside, project
from ...errors import NumericalError
from ...mission.scenario import Array, Scenario
from ...model.channel import guaranteed_node_rates
from ...model.channel.links import sight_radii
from ...model.grid import Grid, resample, resample_flights
from ...model.limits import build_limits, NormLimit
from ...model.problem import Problem

_Routes: TypeAlias = tuple[tuple[int, int], ...] | None
"""Indices of each UAV's routes (to its hovering place, to its goal); None for the shortest."""


def sample_hovering_places(scenario: Scenario, count: int) -> Array:
    """
    Return hovering places of `count` = S fly-hover-fly flights, (S, U, 2) in m.

    With several ground nodes, _visit_nodes extends the places to (S, G, U, 2). The first start is
    the paper's: the transmitter above the first ground node, the jammers above the eavesdroppers
    in turn. Other starts have random places around this ground node and random eavesdroppers, near
    enough for lines of sight if these count; the places rotate and shift with the map. Receivers
    that move are taken at half time, and in starts 1, 3, 5, ... at random times.
    """
    rng = np.random.default_rng(0)
    uavs = len(scenario.uavs)
    times = np.full((count, uavs), scenario.duration / 2)
    if scenario.has_tracks:
        # Each UAV has its own times: where receivers cross, jammers have a choice of sides.
        times[1::2] = np.random.default_rng(2).uniform(
            0.0, scenario.times[-1], times[1::2].shape)
    grounds, centres, radii = scenario.receivers_at(times.ravel())
    target = rng.integers(len(centres), size=(count, uavs))
    target[0, 1:] = np.arange(uavs - 1) % len(centres)
    ground, eavesdropper = grounds[0, 0], centres[0, 0]
    index = np.arange(count * uavs).reshape(count, uavs)  # Index in times.ravel().
    targets = centres[target, index]
    targets[:, 0] = grounds[0, index[:, 0]]
    distances = scenario.altitudes.mean() * log_uniform(rng, STARTS.distance, (count, uavs, 1))
    distances[0] = 0.0
    x, y = eavesdropper - ground  # Offsets are along and across this line.
    axes = np.array([[x, y], [-y, x]]) / np.hypot(x, y) if x or y else np.eye(2)
    offsets = distances * rng.normal(size=targets.shape) @ axes
    errors = radii[target, index]
    errors[:, 0] = 0.0
    # Largest distance [m] from a target with lines of sight to its whole disc.
    longest = np.maximum(sight_radii(scenario) - errors, 0.0)
    lengths = np.maximum(np.linalg.norm(offsets, axis=-1), 1e-9)
    places: Array = targets + offsets * np.minimum(1.0, longest / lengths)[..., None]
    return places if len(grounds) == 1 else _visit_nodes(scenario, places)


def _visit_nodes(scenario: Scenario, places: Array) -> Array:
    """
    Return hovering places of starts in the order of their G visits, (S, G, U, 2) in m.

    In starts 3, 7, 11, ... the transmitter stays at one random place between the ground nodes;
    without a jammer it takes the stops of _find_short_way instead. In other starts it visits the
    nodes in the orders of list_orders in turn: above the nodes in starts before number
    len(orders), and at random distances from them later. Jammers stay at their places.

    :param places: hovering places of the starts for the first ground node, (S, U, 2) in m.
    """
    rng = np.random.default_rng(3)
    grounds = scenario.receivers_at([scenario.duration / 2]).ground_nodes[:, 0]
    stops = np.repeat(places[:, None], len(grounds), axis=1)
    orders = list_orders(scenario, grounds)
    for number, stop in enumerate(stops):
        if number % 4 == 3:
            stop[:, 0] = rng.dirichlet(np.ones(len(grounds))) @ grounds
            if len(scenario.uavs) == 1:
                stop[:, 0] = _find_short_way(scenario, grounds, orders[number // 4 % len(orders)])
            continue
        stop[:, 0] = grounds[orders[(number - number // 4) % len(orders)]]
        if number >= len(orders):
            distances = scenario.altitudes.mean() * log_uniform(
                rng, STARTS.distance, (len(stop), 1))
            stop[:, 0] += distances * rng.normal(size=(len(stop), 2))
    return stops


def _find_short_way(scenario: Scenario, nodes: Array, order: list[int]) -> Array:
    """
    Return stops (G, 2) in m of a short way that serves nodes (G, 2) in m without jamming.

    Stop number i is for node order[i]: the node's place, or a random place around it with a
    positive rate for the node. Dynamic programming finds the stops with the shortest way from
    UAV 0's start to its goal. If node order[i] has no such place, stops i and later are the nodes.
    """
    rng, shape = np.random.default_rng(4), (len(nodes), STARTS.way_places)
    distances = scenario.altitudes.mean() * log_uniform(rng, STARTS.way_distance, (*shape, 1))
    distances[:, 0] = 0.0
    places = nodes[order][:, None] + distances * rng.normal(size=(*shape, 2))
    points = np.pad(places.reshape(1, -1, 2), ((0, 0), (1, 1), (0, 0)))
    powers = np.full((1, points.shape[1] - 2), scenario.average_powers[0])
    rates = guaranteed_node_rates(scenario, points, powers, times=np.full(
        powers.shape[1], scenario.duration / 2)).reshape(len(nodes), *shape)
    penalties = np.where(rates[order, np.arange(len(nodes))] > 0, 0.0, np.inf)
    # Length [m] of the shortest way from the start to each place of the present node.
    lengths = penalties[0] + np.linalg.norm(places[0] - scenario.starts[0], axis=-1)
    predecessors = []
    for before, here, penalty in zip(places, places[1:], penalties[1:]):
        ways = lengths[:, None] + np.linalg.norm(before[:, None] - here, axis=-1)
        predecessors.append(ways.argmin(axis=0))
        lengths = ways.min(axis=0) + penalty
    chosen = [(lengths + np.linalg.norm(places[-1] - scenario.goals[0], axis=-1)).argmin()]
    for predecessor in reversed(predecessors):
        chosen.insert(0, predecessor[chosen[0]])
    return places[np.arange(len(nodes)), chosen]


def generate_starts(grid: Grid, problem: Problem, baseline: Array,
                    raise_if_over: DeadlineCheck = lambda: None) -> Iterator[tuple[Array, Array]]:
    """
    Yield one or two batches of strictly feasible starts with their first barrier parameters.

    With one ground node all starts are random. With several, the first batch joins the first
    batch of random starts and STARTS.first_batch // 2 of the best starts that visit the nodes; the
    second batch has the other starts that visit the nodes.

    :param grid: a grid of any number of slots.
    :param problem: Problem of the grid's scenario.
    :param baseline: feasible flights, (U, N+2, 2) in m, for starts if no random flight is found.
    :param raise_if_over: called before each flight; an error that it raises is passed on.
    :return: each batch: starts (S, N, U, 3) and their first barrier parameters (S,) in units.
    :raises NumericalError: when no flights strictly inside the limits are found, or too few on a
        grid that can be finer.
    """
    scenario = grid.scenario
    count = min(STARTS.per_uav * len(scenario.uavs), STARTS.most)
    if len(scenario.ground_nodes) == 1:
        yield from _generate_random(grid, problem, baseline, count, raise_if_over)
        return
    x, mu, scale = _generate_visiting(
        grid, baseline, round(STARTS.visiting * count), raise_if_over)
    random_x, random_mu = next(_generate_random(
        grid, problem, baseline, STARTS.places, raise_if_over))
    best = STARTS.first_batch // 2  # Number of starts that visit nodes in the first batch.
    yield np.concatenate([random_x, x[:best]]), np.append(scale * random_mu, mu[:best])
    if len(x) > best:
        yield x[best:], mu[best:]


def _generate_visiting(grid: Grid, baseline: Array, count: int,
                       raise_if_over: DeadlineCheck) -> tuple[Array, Array, float]:
    """
    Return `count` starts: the best of generate_visits, the best first, and last the baseline.

    Starts without strictly feasible flights are left out, and not replaced.

    :return: the starts, (S, N, U, 3); their first barrier parameters, (S,); and a factor for the
        barrier parameters of random starts: the best estimated rate in units of grid.rate, clipped
        to STARTS.scales.
    """
    scenario, most = grid.scenario, limit_powers(grid.scenario)
    flights, powers, rates = generate_visits(grid, count - 1, most, raise_if_over)
    rates *= np.log(2) / grid.rate  # bit/s/Hz to units.
    scale = float(np.clip(rates.max(), *STARTS.scales))
    mus = np.maximum(STARTS.visit_mu * rates, STARTS.least_mu)
    constant = np.repeat(most, grid.slots, axis=1)
    starts, first_mus = [], []
    for flight, power, mu in (*zip(flights, powers, mus),
                              (baseline, constant, STARTS.baseline_mu * scale)):
        inside = find_interior(grid, flight, STARTS.visit_share, raise_if_over)
        if inside is not None:
            starts.append(_make_variables(grid, inside, STARTS.on * power, STARTS.silent))
            first_mus.append(mu)
    x = np.array(starts).reshape(-1, grid.slots, len(scenario.uavs), 3)
    return x, np.array(first_mus), scale


def _generate_random(grid: Grid, problem: Problem, baseline: Array, count: int,
                     raise_if_over: DeadlineCheck) -> Iterator[tuple[Array, Array]]:
    """
    Yield two batches of starts through random hovering places, (S, N, U, 3), and their mu (S,).

    With zones, a fence or a separation, the first batch also tries the hovering places of start 0
    with other routes, or with UAVs that pass each other on the other side. If fewer flights than
    starts are found, several starts share a flight and differ in their powers. If no flight is
    found, all share the baseline (U, N+2, 2). NumericalError is raised as in generate_starts.
    """
    scenario = grid.scenario
    places, alternatives = sample_hovering_places(scenario, count), []
    if not grid.airspace.is_open:
        places = problem.find_free_places(places[:STARTS.places], raise_if_over)
        alternatives = list(_list_alternatives(problem, places[0]))[:STARTS.alternatives]
    # A start has hovering places, routes (None for the shortest), and whether UAVs that meet pass
    # each other on the opposite side.
    shortest = [(place, None, False) for place in places]
    first = shortest[:STARTS.first_batch] + [
        (places[0], *alternative) for alternative in alternatives]
    rng = np.random.default_rng(1)
    flights: list[tuple[Array, Array]] = []
    for batch, size in ((first, len(first)),
                        (shortest[STARTS.first_batch:], count - STARTS.first_batch)):
        flights = [*_generate_flights(grid, problem, batch, raise_if_over), *flights]
        if len(flights) < STARTS.enough * len(first) and grid.slots < scenario.slots:
            raise NumericalError('the grid is too coarse for most flights')
        if not flights:
            inside = find_interior(grid, baseline, STARTS.share, raise_if_over)
            if inside is None:
                raise NumericalError('no flight strictly inside the limits was found')
            flights = [(baseline, inside)]
        yield _add_powers(grid, [flights[number % len(flights)] for number in range(size)], rng)


def _generate_flights(grid: Grid, problem: Problem,
                      batch: Iterable[tuple[Array, _Routes, bool]],
                      raise_if_over: DeadlineCheck) -> Iterator[tuple[Array, Array]]:
    """
    Yield pairs of flights, on the scenario's slots and strictly inside a grid's limits, if found.

    :param batch: hovering places, (U, 2) or (G, U, 2) in m, routes as for build_flights, and
        whether UAVs that meet pass each other on the side opposite to the nearest.
    """
    for place, routes, opposite in batch:
        raise_if_over()
        flight = build_flights(problem, place, routes, raise_if_over)
        inside = find_interior(grid, flight, STARTS.share, raise_if_over, opposite)
        if inside is not None:
            yield flight, inside


def _add_powers(grid: Grid, flights: Sequence[tuple[Array, Array]],
                rng: np.random.Generator) -> tuple[Array, Array]:
    """
    Return the variables (S, N, U, 3) of starts with random jamming powers, and their mu (S,).

    Starts 1, 3, 5, ... have the low mu STARTS.close_mu. Starts 1, 5, 9, ... jam more. In starts 3,
    7, 11, ... the transmitter sends only in slots that have a rate without jamming, because in
    some missions few slots deliver. Without such a slot the transmitter sends in all slots.

    :param flights: two flights of each start: on the scenario's slots, and on the grid.
    """
    scenario, uavs = grid.scenario, len(grid.scenario.uavs)
    shares = np.full((len(flights), uavs, 1), STARTS.on)
    shares[:, 1:, 0] = log_uniform(rng, STARTS.jamming, (len(flights), uavs - 1))
    shares[1::4, 1:] = STARTS.more_jamming
    powers = np.repeat(shares * limit_powers(scenario), grid.slots, axis=-1)
    mu = log_uniform(rng, STARTS.mu, (len(flights),))
    mu[1::2] = STARTS.close_mu
    for number in range(3, len(flights), 4):
        alone = find_powers_without_jamming(scenario, flights[number][0], STARTS.on)
        if alone is not None:
            powers[number, 0] = resample(alone[0], grid.slots, inner=True)
    inside = np.array([inside for _, inside in flights])
    return _make_variables(grid, inside, powers, STARTS.silent), mu


def generate_hops(grid: Grid, x: Array, rates: Array, rng: np.random.Generator,
                  raise_if_over: DeadlineCheck) -> tuple[list[int], Array, Array]:
    """
    Return random starts near given ones: one UAV's path and the jamming change for a while.

    Time t is in shares of the flight. In start s the bump b(t) = exp(-((t - t_s) / w_s)^2 / 2),
    with a random time t_s and width w_s, moves the path of a random UAV by b times a random
    vector, and scales the power of each jammer by exp(b z) with a normal z. Start and goal stay.
    Changed starts without strictly feasible flights are left out.

    :param x: variables of the given starts, (S, N, U, 3).
    :param rates: rates of the given starts in units, (S,).
    :return: the indices of the S' given starts that are changed, the changed starts
        (S', N, U, 3), and their first barrier parameters (S',).
    :raises NumericalError: when all are left out.
    """
    scenario, uavs = grid.scenario, len(grid.scenario.uavs)
    along = np.linspace(0, 1, grid.slots + 2)
    limits = [limit for limit in build_limits(grid) if isinstance(limit, NormLimit)]
    hopped, starts = [], []
    for number, variables in enumerate(x):
        width = log_uniform(rng, STARTS.hop_width, ())
        bump = np.exp(-0.5 * ((along - rng.random()) / width)**2) * (along > 0) * (along < 1)
        flights, powers = grid.positions(variables), grid.powers(variables)
        length = scenario.altitudes.mean() * log_uniform(rng, STARTS.hop_size, ())
        flights[rng.integers(uavs)] += length * bump[:, None] * rng.normal(size=2)
        powers[1:] *= np.exp(STARTS.hop_jamming * rng.normal(size=(uavs - 1, 1)) * bump[1:-1])
        for limit in limits:
            flights = limit.retract(flights)
        inside = find_interior(grid, flights, STARTS.share, raise_if_over)
        if inside is not None:
            hopped.append(number)
            starts.append(_make_variables(grid, inside, powers, STARTS.silent))
    if not hopped:
        raise NumericalError('no flight strictly inside the limits was found')
    mus = rates[hopped] * log_uniform(rng, STARTS.hop_mu, (len(hopped),))
    return hopped, np.array(starts), mus


def _list_alternatives(problem: Problem, places: Array) -> Iterator[tuple[_Routes, bool]]:
    """
    Yield alternative routes to hovering places (U, 2) or (G, U, 2) in m.

    If UAVs keep a separation, the first alternative has the shortest routes, and UAVs that meet
    pass on the opposite side. In each other one, a UAV with a single place takes its route 1 or 2,
    if there is one, instead of 0, to its place or to its goal.

    :return: routes as for build_flights, and whether UAVs that meet pass on the opposite side.
    """
    uavs = len(problem.scenario.uavs)
    if uavs > 1 and problem.scenario.separation:
        yield None, True
    for route in (1, 2):
        for legs in ((route, 0), (0, route)):
            for uav in range(uavs):
                stops = places[..., uav, :].reshape(-1, 2)
                if not np.ptp(stops, axis=0).any() and fly_around(
                        problem, uav, stops[0], *legs) is not None:
                    yield tuple(legs if index == uav else (0, 0) for index in range(uavs)), False


def make_strictly_feasible(grid: Grid, positions: Array, powers: Array, share: float,
                           raise_if_over: DeadlineCheck = lambda: None) -> Array:
    """
    Return variables of a grid that are strictly feasible and near a plan, (..., N, U, 3).

    :param positions: feasible, (U, M+2, 2) in m, for any number M of slots.
    :param powers: feasible, (..., U, M) in W.
    :param share: share of each slack that flights keep free. Powers keep the share
        STARTS.power_margin * share of their limits free.
    :raises NumericalError: when no flights strictly inside the limits are found.
    """
    flights = find_interior(grid, positions, share, raise_if_over)
    if flights is None:
        raise NumericalError('no flight strictly inside the limits was found')
    powers = resample(powers.T, grid.slots, inner=True).T
    return _make_variables(grid, flights, powers, STARTS.power_margin * share, share)


def _make_variables(grid: Grid, flights: Array, powers: Array, least: float | Array,
                    share: float = STARTS.share) -> Array:
    """
    Return the variables (..., N, U, 3) of flights and powers, with powers made strictly feasible.

    Powers are clipped to [least * limit_powers, ratio * peak], then scaled down to a mean of at
    most ratio * average, where ratio = 1 - STARTS.power_margin * share.

    :param flights: strictly feasible flights, (..., U, N+2, 2) in m.
    :param powers: powers, (..., U, N) in W.
    :param least: smallest power as a share of limit_powers.
    :param share: share of each slack that the flights keep free.
    """
    average, peak = grid.scenario.average_powers[:, None], grid.scenario.peak_powers[:, None]
    ratio = 1 - STARTS.power_margin * share
    power = np.clip(powers, least * limit_powers(grid.scenario), ratio * peak)
    power *= np.minimum(1, ratio * average / power.mean(axis=-1, keepdims=True))
    return grid.variables(flights[..., 1:-1, :], power)


def limit_powers(scenario: Scenario) -> Array:
    """
    Return the largest powers of starts, (U, 1) in W.

    They are the average powers, and for jammers at most STARTS.most_power times the transmitter's:
    more jamming would drown the transmitter at the ground node.
    """
    most = STARTS.most_power * scenario.average_powers[0]
    return np.minimum(scenario.average_powers, most)[:, None]


def find_interior(grid: Grid, positions: Array, share: float, raise_if_over: DeadlineCheck,
                  opposite: bool = False) -> Array | None:
    """
    Return flights (U, N+2, 2) in m on a grid, strictly inside its limits, or None.

    If all flights of the grid are fixed, they are only interpolated.

    :param positions: (U, M+2, 2) in m, for any number M of slots.
    :param share: share of each slack that the flights keep free.
    :param opposite: whether UAVs that meet pass each other on the side opposite to the nearest.
    """
    flights = resample_flights(positions, grid.slots)
    if grid.fixed.all():
        return flights
    if not grid.airspace.is_open:
        return project(grid, positions, share, raise_if_over, opposite)
    return limit_acceleration(grid, flights + share * (grid.reference_flight - flights))


def limit_acceleration(grid: Grid, positions: Array) -> Array:
    """
    Return positions (U, N+2, 2) in m moved inside limits of acceleration and speed.

    They keep the share STARTS.margin of both limits free if the reference flight does. Without a
    limit of acceleration positions stay: blending and interpolation keep the limit of speed.
    """
    if grid.scenario.limits_acceleration:
        for limit in build_limits(grid):
            if isinstance(limit, NormLimit):
                positions = limit.retract(positions, STARTS.margin)
    return positions


def refine(grid: Grid, x: Array, finer: Grid, raise_if_over: DeadlineCheck) -> Array | None:
    """
    Return variables (N, U, 3) interpolated to a finer grid and moved strictly inside its limits.

    Return None if no flights strictly inside the limits are found. limit_acceleration blends whole
    flights with the reference flight, by which one of several ground nodes may lose its rate. So
    move_inside is used there instead, and with zones, a fence or a separation.

    :param x: variables of the coarser `grid`, (M, U, 3).
    """
    x, scenario = grid.refine(x, finer.slots), grid.scenario
    positions = finer.positions(x)
    is_projected = not grid.airspace.is_open or (
        scenario.limits_acceleration and len(scenario.ground_nodes) > 1)
    inside = (move_inside(finer, positions, STARTS.refined_share, raise_if_over)
              if is_projected else limit_acceleration(finer, positions))
    return None if inside is None else finer.variables(inside[:, 1:-1], finer.powers(x))
