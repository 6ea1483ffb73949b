"""Where the joint method begins: flights to various hovering places."""

from collections.abc import Callable, Iterator

import numpy as np

from .schedule import Schedule, StartKind
from ..baselines import constant_powers, fly_hover_fly_positions
from ..search import powers_without_jamming
from ...grid import Grid, resampled
from ...limits import repaired
from ...limits.reference import reference_flight
from ...scenario import Array, Scenario

_TRANSMITTING = 0.9  # Share of its average power with which the transmitter begins.
_MARGIN = 0.01  # Share of a limit of acceleration that is left where it can be.
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
                   check: Callable[[], None] = lambda: None) -> tuple[Array, Array]:
    """
    Return strictly feasible starts (S, N, U, 3), and mu to begin each with, (S,).

    Each kind of start is spread over the hovering places.

    :param check: called before each start; what it raises is passed on.
    """
    scenario = grid.scenario
    places = hovering_places(scenario, schedule)
    starts, mus = [], []
    for kind in schedule.kinds:
        spread = np.linspace(0, len(places) - 1, min(kind.count, len(places)))
        for hover in places[np.unique(spread.round().astype(int))]:
            check()
            positions = fly_hover_fly_positions(scenario, hover)
            for powers, least in _powers(scenario, positions, kind, schedule):
                starts.append(strictly_feasible(grid, positions, powers, least=least))
                mus.append(kind.mu)
    return np.array(starts), np.array(mus)


def _powers(scenario: Scenario, positions: Array, kind: StartKind,
            schedule: Schedule) -> Iterator[tuple[Array, float | None]]:
    """Give powers (U, N) in W for a flight, each with the least power of a strict start."""
    if not kind.jamming:
        alone = powers_without_jamming(scenario, positions, _TRANSMITTING)
        if alone is not None:
            yield alone, _SILENT
        return
    powers = constant_powers(scenario, _TRANSMITTING, kind.jamming)
    if len(powers) > 2:
        factors = np.array([1.0, 1.0, *[schedule.lone_jammer] * (len(powers) - 2)])
        yield powers * factors[:, None], _SILENT
    yield powers, None


def strictly_feasible(grid: Grid, positions: Array, powers: Array, share: float = 0.05,
                      least: float | None = None) -> Array:
    """
    Return variables of a grid that are strictly feasible and near a plan, (N, U, 3).

    :param positions: feasible, (U, M+2, 2) in m, for any number M of slots.
    :param powers: feasible, (U, M) in W.
    :param share: by which to go from the plan into the interior.
    :param least: powers in units of the average power, by default a fifth of the share.
    """
    flights = np.swapaxes(resampled(np.swapaxes(positions, 0, 1), grid.slots + 2), 0, 1)
    flights = inside_limits(grid, flights + share * (reference_flight(grid) - flights))
    average, peak = grid.scenario.average_powers, grid.scenario.peak_powers
    margin = 0.2 * share
    power = resampled(powers.T, grid.slots, inner=True)
    power = np.clip(power, (margin if least is None else least) * average, (1 - margin) * peak)
    power *= np.minimum(1, (1 - margin) * average / power.mean(axis=0))
    return grid.variables(flights[:, 1:-1], power.T)


def inside_limits(grid: Grid, positions: Array) -> Array:
    """
    Return positions (U, N+2, 2) in m that are strictly inside the limits of acceleration.

    Blending towards the reference flight and interpolation keep the other limits.
    """
    if not np.isfinite(grid.scenario.max_accelerations).any():
        return positions
    powers = np.zeros((len(positions), grid.slots))
    return repaired(grid.scenario, positions, powers, grid, _MARGIN)[0]
