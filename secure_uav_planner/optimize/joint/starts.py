"""Where the joint method begins: random hovering places and powers, made strictly feasible."""

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from ..initial import (
    Check, flights_to, fly_hover_fly_positions, free_places, projected, route, settled)
from ..search import powers_without_jamming
from ...errors import NumericalError
from ...mission.scenario import Array, Scenario
from ...model.grid import Grid, resampled, resampled_flights
from ...model.limits import is_open, limits_of
from ...model.limits.norm import NormLimit, reference_flight

STARTS = 15  # For each UAV,
MOST_STARTS = 60  # and for all.
FIRST = 8  # How many go first; where they agree, the others are not begun.
PLACES = 13  # Hovering places where flights around zones, fence or UAVs must be found first.
ENOUGH = 0.5  # Share of the first flights that a coarse grid must have room for.
OTHER_WAYS = 8  # The most starts that pass what is in the way on other sides; they go first, too.
DISTANCE = (0.03, 1.0)  # From targets to hovering places, in mean altitudes, log-uniform.
JAMMING = (1e-4, 1e-2)  # Jamming powers in units of the average power, log-uniform.
MU = (0.006, 0.05)  # Barrier parameters to begin with, log-uniform.
MORE_JAMMING = 0.05  # The jamming power of every fourth start,
CLOSE_MU = 3e-3  # and the barrier parameter of every second.

_ON = 0.9  # Power of a UAV that is on, in units of its average power.
_SILENT = 1e-5  # Power of one that is off.
_MARGIN = 0.01  # Share of a limit of acceleration that is left where it can be.
_SHARE = 0.05  # Of the slack that a start leaves.
_MARGIN_OF_POWERS = 0.2  # Of limits of powers, as a share of such a share.
_REFINED_SHARE = 1e-3  # The same for flights that are refined.

_Ways: TypeAlias = tuple[tuple[int, int], ...] | None


def hovering_places(scenario: Scenario, count: int) -> Array:
    """
    Return S hovering places of fly-hover-fly flights, (S, U, 2) in m.

    First the paper's, the transmitter above the ground node and the jammers above the
    eavesdroppers in turn; then random places around these, each jammer's around any eavesdropper.
    They turn and shift with the map.
    """
    rng = np.random.default_rng(0)
    ground, eavesdroppers = np.array(scenario.ground_node), scenario.eavesdropper_positions
    uavs = len(scenario.uavs)
    target = rng.integers(len(eavesdroppers), size=(count, uavs))
    target[0, 1:] = np.arange(uavs - 1) % len(eavesdroppers)
    targets = eavesdroppers[target]
    targets[:, 0] = ground
    distances = scenario.altitudes.mean() * _log_uniform(rng, DISTANCE, (count, uavs, 1))
    distances[0] = 0.0
    x, y = eavesdroppers[0] - ground
    axes = np.array([[x, y], [-y, x]]) / np.hypot(x, y) if x or y else np.eye(2)
    return targets + distances * rng.normal(size=targets.shape) @ axes


def several_starts(grid: Grid, check: Check = lambda: None
                   ) -> Iterator[tuple[Array, Array]]:
    """
    Give two batches of strictly feasible starts: those that go first, and the others.

    :param check: called before each flight; what it raises is passed on, as everywhere here.
    :return: the starts, (S, N, U, 3), and the barrier parameters to begin with, (S,).
    :raises NumericalError: when no flights strictly inside the limits are found, or too few on a
        grid that can be finer.
    """
    scenario = grid.scenario
    count = min(STARTS * len(scenario.uavs), MOST_STARTS)
    places, ways = hovering_places(scenario, count), []
    if not is_open(scenario):
        places = free_places(scenario, places[:PLACES], check)
        ways = list(_other_ways(scenario, places[0]))[:OTHER_WAYS]
    shortest = [(place, None, False) for place in places]
    first, others = shortest[:FIRST] + [(places[0], *way) for way in ways], shortest[FIRST:]
    rng = np.random.default_rng(1)
    flights: list[tuple[Array, Array]] = []
    for asked, size in ((first, len(first)), (others, count - FIRST)):
        flights = [*_flights(grid, asked, check), *flights]
        if len(flights) < ENOUGH * len(first) and grid.slots < scenario.slots:
            raise NumericalError('the grid is too coarse for most flights')
        if not flights:
            known = fly_hover_fly_positions(scenario, check)
            inside = interior(grid, known, _SHARE, check)
            if inside is None:
                raise NumericalError('no flight strictly inside the limits was found')
            flights = [(known, inside)]
        yield _with_powers(grid, [flights[number % len(flights)] for number in range(size)], rng)


def _flights(grid: Grid, asked: Iterable[tuple[Array, _Ways, bool]],
             check: Check) -> Iterator[tuple[Array, Array]]:
    """
    Give flights on the scenario's slots and, strictly inside the limits, on a grid.

    :param asked: hovering places, (U, 2) in m, ways to them, and whether UAVs that meet pass each
        other on another side than the nearest.
    """
    for place, ways, other_side in asked:
        check()
        flight = flights_to(grid.scenario, place, ways, check)
        inside = interior(grid, flight, _SHARE, check, other_side)
        if inside is not None:
            yield flight, inside


def _with_powers(grid: Grid, flights: Sequence[tuple[Array, Array]],
                 rng: np.random.Generator) -> tuple[Array, Array]:
    """
    Return starts with random jamming powers and barrier parameters.

    Every second begins close to the boundary. Half of these jam more; the others transmit only in
    the slots that win without jamming, if any do: a mission that is nearly lost is won in a few.

    :param flights: of each start, on the scenario's slots and on the grid.
    """
    scenario, uavs = grid.scenario, len(grid.scenario.uavs)
    shares = np.full((len(flights), uavs, 1), _ON)
    shares[:, 1:, 0] = _log_uniform(rng, JAMMING, (len(flights), uavs - 1))
    shares[1::4, 1:] = MORE_JAMMING
    powers = np.repeat(shares * scenario.average_powers[:, None], grid.slots, axis=-1)
    mu = _log_uniform(rng, MU, (len(flights),))
    mu[1::2] = CLOSE_MU
    for number in range(3, len(flights), 4):
        alone = powers_without_jamming(scenario, flights[number][0], _ON)
        if alone is not None:
            powers[number, 0] = resampled(alone[0], grid.slots, inner=True)
    return _variables(grid, np.array([inside for _, inside in flights]), powers, _SILENT), mu


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float],
                 shape: tuple[int, ...]) -> Array:
    """Return random numbers whose logarithms are uniform between those of two ends."""
    low, high = np.log(ends).tolist()
    return np.exp(rng.uniform(low, high, shape))


def _other_ways(scenario: Scenario, places: Array) -> Iterator[tuple[_Ways, bool]]:
    """
    Give ways to hovering places on the other sides of what is in the way.

    :return: the ways of flights_to, and whether UAVs that meet pass on another side.
    """
    uavs = len(scenario.uavs)
    if uavs > 1 and scenario.separation:
        yield None, True
    for way in (1, 2):
        for ends in ((way, 0), (0, way)):
            for uav in range(uavs):
                if route(scenario, uav, places[uav], *ends) is not None:
                    yield tuple(ends if index == uav else (0, 0) for index in range(uavs)), False


def strictly_feasible(grid: Grid, positions: Array, powers: Array, share: float,
                      check: Check = lambda: None) -> Array:
    """
    Return variables of a grid that are strictly feasible and near a plan, (..., N, U, 3).

    :param positions: feasible, (U, M+2, 2) in m, for any number M of slots.
    :param powers: feasible, (..., U, M) in W.
    :param share: by which to go from the plan into the interior.
    :raises NumericalError: when no flights strictly inside the limits are found.
    """
    flights = interior(grid, positions, share, check)
    if flights is None:
        raise NumericalError('no flight strictly inside the limits was found')
    powers = resampled(powers.T, grid.slots, inner=True).T
    return _variables(grid, flights, powers, _MARGIN_OF_POWERS * share, share)


def _variables(grid: Grid, flights: Array, powers: Array, least: float | Array,
               share: float = _SHARE) -> Array:
    """Return variables of flights and powers on the grid, with powers made strictly feasible."""
    average, peak = grid.scenario.average_powers[:, None], grid.scenario.peak_powers[:, None]
    most = 1 - _MARGIN_OF_POWERS * share
    power = np.clip(powers, least * average, most * peak)
    power *= np.minimum(1, most * average / power.mean(axis=-1, keepdims=True))
    return grid.variables(flights[..., 1:-1, :], power)


def interior(grid: Grid, positions: Array, share: float, check: Check,
             other_way: bool = False) -> Array | None:
    """
    Return flights on a grid that are strictly inside their limits, or None if none are found.

    :param positions: (U, M+2, 2) in m, for any number M of slots.
    :param share: by which to go into the interior.
    :param other_way: whether UAVs that meet pass each other on another side than the nearest.
    """
    flights = resampled_flights(positions, grid.slots)
    if grid.fixed.all():
        return flights
    if not is_open(grid.scenario):
        return projected(grid, positions, share, check, other_way)
    return inside_limits(grid, flights + share * (reference_flight(grid) - flights))


def inside_limits(grid: Grid, positions: Array) -> Array:
    """
    Return positions (U, N+2, 2) in m that are strictly inside the limits of acceleration.

    Blending towards the reference flight and interpolation keep the limit of speed.
    """
    if np.isfinite(grid.scenario.max_accelerations).any():
        for limit in limits_of(grid.scenario, grid):
            if isinstance(limit, NormLimit):
                positions, _ = limit.repair(positions, np.zeros(0), _MARGIN)
    return positions


def refined(grid: Grid, x: Array, finer: Grid, check: Check) -> Array | None:
    """Return variables (N, U, 3) of a grid on a finer one, strictly inside, or None."""
    x = grid.refined(x, finer.slots)
    positions = finer.positions(x)
    inside = (inside_limits(finer, positions) if is_open(grid.scenario) else
              settled(finer, positions, _REFINED_SHARE, check))
    return None if inside is None else finer.variables(inside[:, 1:-1], finer.powers(x))
