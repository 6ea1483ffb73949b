"""Where the joint method begins: flights to various hovering places."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .schedule import Schedule, StartKind
from ..baselines import constant_powers, flights_to, fly_hover_fly_positions
from ..detours import free_places, route
from ..fitting import Fitting
from ..search import powers_without_jamming
from ...errors import NumericalError
from ...grid import Grid, resampled
from ...limits import is_open, repaired
from ...limits.reference import reference_flight
from ...scenario import Array, Scenario

_TRANSMITTING = 0.9  # Share of its average power with which the transmitter begins.
_MARGIN = 0.01  # Share of a limit of acceleration that is left where it can be.
_SHARE = 0.05  # Of the slack that a start leaves.
_MARGIN_OF_POWERS = 0.2  # Of limits of powers, as a share of such a share.
_REFINED_SHARE = 1e-3  # The same for flights that are refined.
_SILENT = 1e-5  # Power of a jammer that is off, in units of its average power.


def hovering_places(scenario: Scenario, schedule: Schedule) -> Array:
    """
    Return hovering places of fly-hover-fly flights, the paper's first, (S, U, 2) in m.

    The transmitter above the ground node or beside it; the jammers above the eavesdroppers,
    beside, behind or far behind them, as the ground node sees them; the eavesdroppers shared
    among the jammers in turn, in every rotation, or all on the nearest.
    """
    ground = np.array(scenario.ground_node)
    eves = scenario.eavesdropper_positions
    beside = schedule.beside * float(scenario.altitudes.mean())
    jammers = len(scenario.uavs) - 1
    out = eves - ground
    distance = np.linalg.norm(out, axis=1)
    away = -out.mean(axis=0)
    away = away / np.linalg.norm(away) if np.linalg.norm(away) > 1e-9 else np.array([1.0, 0.0])
    out = np.where(distance[:, None] > 1e-9, out / np.maximum(distance, 1e-9)[:, None], -away)
    left = out @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    reach = (beside + scenario.error_radii)[:, None]
    around = {'above': eves, 'behind': eves + reach * out, 'left': eves + reach * left,
              'right': eves - reach * left, 'far': eves + schedule.far * reach * out}

    order = np.argsort(distance)
    shares = [[order[(jammer + turn) % len(eves)] for jammer in range(jammers)]
              for turn in range(len(eves))]
    if jammers > 1 and len(eves) > 1:
        shares.append([order[0]] * jammers)
        shares += [share[::-1] for share in shares[:2]]
    patterns = [('above',), ('behind',), ('left', 'right'), ('right', 'left'), ('far',)]
    places = [[ground] + [around[pattern[jammer % len(pattern)]][eve]
                          for jammer, eve in enumerate(share)]
              for pattern in patterns for share in shares]
    side = np.array([-away[1], away[0]])
    for shift in (away, side, -side):
        places.append([ground + beside * shift] + [eves[eve] for eve in shares[0]])
    found: Array = np.array(places)
    first = np.unique(found.round(6), axis=0, return_index=True)[1]
    return found[np.sort(first)]


def several_starts(grid: Grid, schedule: Schedule,
                   check: Callable[[], None] = lambda: None
                   ) -> tuple[Array, Array, NDArray[np.bool_]]:
    """
    Return strictly feasible starts (S, N, U, 3).

    Each kind of start is spread over the hovering places, and some are sent other ways as well.

    :param check: called before each start; what it raises is passed on.
    :return: the starts, mu to begin each with, (S,), and which are sent other ways, (S,).
    """
    flights = _Flights(grid, schedule, check)
    insides, chosen, leasts, mus, others = [], [], [], [], []
    for kind in schedule.kinds:
        for positions, inside, other in flights.spread(kind.count, kind.other_ways):
            for powers, least in _powers(grid, positions, kind, schedule):
                insides.append(inside)
                chosen.append(powers)
                leasts.append(least)
                mus.append(kind.mu)
                others.append(other)
    x = _variables(grid, np.array(insides), np.array(chosen), np.array(leasts)[:, None, None])
    return x, np.array(mus), np.array(others)


class _Flights:
    """
    The flights of the starts, each on the scenario's own slots and strictly feasible on a grid.

    :param grid: of the starts.
    :param schedule: the tuned numbers.
    :param check: called before each flight; what it raises is passed on.
    """

    def __init__(self, grid: Grid, schedule: Schedule, check: Callable[[], None]) -> None:
        self._grid, self._check = grid, check
        self._scenario = grid.scenario
        places = hovering_places(self._scenario, schedule)
        self._open = is_open(self._scenario)
        if not self._open:
            places = free_places(self._scenario, places)
        self._places = places
        self._known: dict[Any, tuple[Array, Array] | None] = {}

    def spread(self, count: int, other_ways: int) -> Iterator[tuple[Array, Array, bool]]:
        """
        Give flights to hovering places spread over all, and the paper's in other ways.

        Where a mission has no zones, fence or separation there are no other ways.

        :param count: the largest number of hovering places.
        :param other_ways: the largest number of other ways.
        """
        spread = np.linspace(0, len(self._places) - 1, min(count, len(self._places)))
        found = 0
        for index in np.unique(spread.round().astype(int)).tolist():
            flight = self._flight(index)
            if flight is not None:
                found += 1
                yield *flight, False
        if not self._open:
            for choice in list(self._other_ways())[:other_ways]:
                flight = self._flight(*choice)
                if flight is not None:
                    found += 1
                    yield *flight, True
        if not found:
            positions = fly_hover_fly_positions(self._scenario)
            inside = self._inside(positions)
            if inside is None:
                raise NumericalError('no flight strictly inside the limits was found')
            yield positions, inside, False

    def _other_ways(self) -> Iterator[tuple[Any, ...]]:
        """Give the arguments of _flight for the other sides of what is in the way."""
        uavs = len(self._scenario.uavs)
        if uavs > 1 and self._scenario.separation:
            yield 0, None, True
        for way in (1, 2):
            for leg in (0, 1):
                for uav in range(uavs):
                    ways = [(0, 0)] * uavs
                    ways[uav] = (way, 0) if leg == 0 else (0, way)
                    if route(self._scenario, uav, self._places[0, uav], *ways[uav]) is not None:
                        yield 0, tuple(ways), False

    def _flight(self, index: int, ways: tuple[tuple[int, int], ...] | None = None,
                other_way: bool = False) -> tuple[Array, Array] | None:
        """Return flights to hovering places, on both grids, or None where there are none."""
        key = index, ways, other_way
        if key not in self._known:
            self._check()
            positions = flights_to(self._scenario, self._places[index], ways)
            inside = self._inside(positions, other_way)
            self._known[key] = None if inside is None else (positions, inside)
        return self._known[key]

    def _inside(self, positions: Array, other_way: bool = False) -> Array | None:
        return interior(self._grid, positions, _SHARE, other_way)


def _powers(grid: Grid, positions: Array, kind: StartKind,
            schedule: Schedule) -> Iterator[tuple[Array, float]]:
    """Give powers (U, N) in W for a flight, each with the least power of a strict start."""
    scenario = grid.scenario
    if not kind.jamming:
        alone = powers_without_jamming(scenario, positions, _TRANSMITTING)
        if alone is not None:
            yield resampled(alone.T, grid.slots, inner=True).T, _SILENT
        return
    powers = constant_powers(scenario, _TRANSMITTING, kind.jamming, grid.slots)
    if len(powers) > 2:
        factors = np.array([1.0, 1.0, *[schedule.lone_jammer] * (len(powers) - 2)])
        yield powers * factors[:, None], _SILENT
    yield powers, _MARGIN_OF_POWERS * _SHARE


def strictly_feasible(grid: Grid, positions: Array, powers: Array, share: float = _SHARE,
                      least: float | None = None) -> Array:
    """
    Return variables of a grid that are strictly feasible and near a plan, (..., N, U, 3).

    :param positions: feasible, (U, M+2, 2) in m, for any number M of slots.
    :param powers: feasible, (..., U, M) in W.
    :param share: by which to go from the plan into the interior.
    :param least: powers in units of the average power, by default a fifth of the share.
    :raises NumericalError: when no flights strictly inside the limits are found.
    """
    flights = interior(grid, positions, share)
    if flights is None:
        raise NumericalError('no flight strictly inside the limits was found')
    powers = resampled(powers.T, grid.slots, inner=True).T
    if least is None:
        least = _MARGIN_OF_POWERS * share
    flights = np.broadcast_to(flights, (*powers.shape[:-2], *flights.shape))
    return _variables(grid, flights, powers, least, share)


def _variables(grid: Grid, flights: Array, powers: Array, least: float | Array,
               share: float = _SHARE) -> Array:
    """Return variables of flights and powers on the grid, with powers made strictly feasible."""
    average, peak = grid.scenario.average_powers[:, None], grid.scenario.peak_powers[:, None]
    most = 1 - _MARGIN_OF_POWERS * share
    power = np.clip(powers, least * average, most * peak)
    power *= np.minimum(1, most * average / power.mean(axis=-1, keepdims=True))
    return grid.variables(flights[..., 1:-1, :], power)


def interior(grid: Grid, positions: Array, share: float,
             other_way: bool = False) -> Array | None:
    """
    Return flights on a grid that are strictly inside their limits, or None if none are found.

    :param positions: (U, M+2, 2) in m, for any number M of slots.
    :param share: by which to go into the interior.
    :param other_way: whether UAVs that meet pass each other on another side than the nearest.
    """
    flights = np.swapaxes(resampled(np.swapaxes(positions, 0, 1), grid.slots + 2), 0, 1)
    if grid.fixed.all():
        return flights
    if is_open(grid.scenario):
        return inside_limits(grid, flights + share * (reference_flight(grid) - flights))
    found = Fitting(grid, share).near(flights, other_way)
    return found.positions if found.excess < 0 else None


def inside_limits(grid: Grid, positions: Array) -> Array:
    """
    Return positions (U, N+2, 2) in m that are strictly inside the limits of acceleration.

    Blending towards the reference flight and interpolation keep the limit of speed.
    """
    if not np.isfinite(grid.scenario.max_accelerations).any():
        return positions
    powers = np.zeros((len(positions), grid.slots))
    return repaired(grid.scenario, positions, powers, grid, _MARGIN)[0]


def refined(grid: Grid, x: Array, finer: Grid) -> Array | None:
    """
    Return variables (N, U, 3) of a grid on a finer one, strictly inside, or None.

    :param x: (N, U, 3).
    """
    x = grid.refined(x, finer.slots)
    positions = finer.positions(x)
    if is_open(grid.scenario):
        positions = inside_limits(finer, positions)
    else:
        fitting = Fitting(finer, _REFINED_SHARE)
        if not fitting.is_inside(positions):
            found = fitting.near(positions)
            if found.excess >= 0:
                return None
            positions = found.positions
    return finer.variables(positions[:, 1:-1], finer.powers(x))
