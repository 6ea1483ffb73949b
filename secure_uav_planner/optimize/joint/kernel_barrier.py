"""The barrier method by the compiled kernel, behind the interface of Barrier."""

from collections.abc import Callable, Iterable
from functools import cache
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .barrier import Barrier
from .schedule import Schedule
from .worst_places import WorstPlaces
from ...channel.derivatives import Receivers
from ...channel.links import FreeSpace
from ...errors import NumericalError
from ...grid import Grid
from ...kernel import compiled
from ...limits import (
    AccelerationLimit, AveragePower, FenceLimit, limits_of, PeakPower, SeparationLimit, SpeedLimit,
    ZoneLimit)
from ...limits.base import Limit
from ...limits.lines import LineLimit
from ...limits.norm import NormLimit
from ...scenario import Array

SUPPORTED = frozenset({SpeedLimit, AccelerationLimit, PeakPower, AveragePower, FenceLimit,
                       SeparationLimit, ZoneLimit})
"""The limits that the kernel knows. With another one, the mission is left to NumPy."""


class UnknownProblemError(ValueError):
    """The kernel is not there, or does not know a limit or the channel of a mission."""


class KernelBarrier(Barrier):
    """
    The same as Barrier, with the same arguments and attributes.

    Only `x`, `mu` and `finished` differ: they are changed in place.

    :raises UnknownProblemError: for a problem that the kernel does not know.
    """

    def __init__(self, grid: Grid, x: Array, mu: float | Array, schedule: Schedule,
                 check: Callable[[], None] = lambda: None,
                 places: WorstPlaces | None = None) -> None:
        core = compiled()
        self.grid = grid
        self.check = check
        self.receivers = Receivers.of(grid) if places is None else places.receivers
        limits = limits_of(grid.scenario, grid)
        if core is None or not is_known(limits, self.receivers):
            raise UnknownProblemError(
                'the kernel is not there, or does not know a limit or a channel')
        self.solver_time = 0.0
        self.x: Array = np.array(x, float, order='C')
        self.mu: Array = np.full(len(x), 1.0) * mu
        self.finished: NDArray[np.bool_] = np.zeros(len(x), bool)
        self._core = core.Barrier(
            _problem(grid, limits, self.receivers, schedule, places),
            self.x, self.mu, self.finished)

    def keep(self, chosen: NDArray[np.intp]) -> None:
        """Go on with some of the starts only, given as an index array."""
        self.x, self.mu = self.x[chosen], self.mu[chosen]
        self.finished = self.finished[chosen]
        self._core.keep(np.ascontiguousarray(chosen, np.int64), self.x, self.mu, self.finished)

    def exchange(self, places: WorstPlaces, worse: bool) -> None:
        """Go on with places that have been exchanged; see Barrier.exchange."""
        self.receivers = places.receivers
        self._core.exchange(_places(places), _plain(self.receivers.positions))
        if worse:
            self.finished[:] = False

    def rates(self) -> Array:
        """Return the mean rates against the receivers; see Barrier.rates."""
        found = np.empty(len(self.x))
        self._core.rates(found)
        return found

    def iterate(self, final: float) -> None:
        """
        Take one step from every start; see Barrier.iterate.

        :raises NumericalError: when no step can be computed from any start.
        """
        self.advance(1, final)

    def advance(self, steps: int, final: float) -> int:
        """
        Take several steps from every start, side by side on all cores; see Barrier.advance.

        :raises NumericalError: when no step could be computed from any start.
        """
        self.check()
        started = time.perf_counter()
        taken, failed = self._core.advance(steps, final, self.check)
        self.solver_time += time.perf_counter() - started
        if failed == len(self.x):
            raise NumericalError('no Newton step could be computed')
        return int(taken)


def make_barrier(grid: Grid, x: Array, mu: float | Array, schedule: Schedule,
                 check: Callable[[], None] = lambda: None,
                 places: WorstPlaces | None = None) -> Barrier:
    """Return a KernelBarrier where that is possible, else a Barrier; see Barrier."""
    if compiled() is not None:
        try:
            return KernelBarrier(grid, x, mu, schedule, check, places)
        except UnknownProblemError:
            pass
    return Barrier(grid, x, mu, schedule, check, places)


def is_known(limits: Iterable[Limit], receivers: Receivers) -> bool:
    """Return whether the kernel knows all limits and the channel."""
    return (type(receivers.link) is FreeSpace
            and all(type(limit) in SUPPORTED for limit in limits))


def _problem(grid: Grid, limits: Iterable[Limit], receivers: Receivers,
             schedule: Schedule, places: WorstPlaces | None) -> dict[str, Any]:
    """Return what the kernel asks for, by the names of problem.hpp."""
    link, uavs = receivers.link, len(grid.fixed)
    [peaks] = [limit.peaks for limit in limits if isinstance(limit, PeakPower)]
    return {
        'slots': grid.slots, 'uavs': uavs, 'starts': _plain(grid.starts),
        'goals': _plain(grid.goals), 'fixed': _plain(grid.fixed),
        'snr': _plain(np.broadcast_to(link.reference_snr, receivers.edge.shape)),
        'squared_altitudes': _plain(link.squared_altitudes), 'peaks': _plain(peaks),
        'norms': [_norm(limit) for limit in limits if isinstance(limit, NormLimit)],
        'lines': [_lines(limit) for limit in limits if isinstance(limit, LineLimit)],
        'positions': _plain(receivers.positions), 'edge': _plain(receivers.edge),
        'places': None if places is None else _places(places),
        'numbers': _numbers(schedule)}


def _places(places: WorstPlaces) -> dict[str, Array]:
    """Return the places in discs as the kernel asks for them."""
    return {'followed': _plain(places.followed), 'offsets': _plain(places.offsets),
            'radii': _plain(places.radii)}


@cache
def _numbers(schedule: Schedule) -> dict[str, float]:
    """Return the numbers of a schedule by their names."""
    return {name: value for name, value in vars(schedule).items()
            if isinstance(value, (int, float))}


def _norm(limit: NormLimit) -> dict[str, Any]:
    """Return a limit on differences as the kernel asks for it."""
    end_moves = (limit.end_moves if isinstance(limit, AccelerationLimit)
                 else np.zeros((2, len(limit.grid.fixed), 2)))
    return {'order': limit.reach, 'square': _plain(limit.square),
            'ignored': _plain(limit.ignored), 'end_moves': _plain(end_moves)}


def _lines(limit: LineLimit) -> dict[str, Any]:
    """Return a limit with lines as the kernel asks for it."""
    tracks = limit.tracks
    found = {'corners': tracks.weights.shape[2], 'uav': _plain(tracks.uav),
             'weights': _plain(tracks.weights), 'all': _plain(tracks.all_weights),
             'constant': _plain(tracks.constant), 'first': _plain(limit.first),
             'second': None if limit.second is None else _plain(limit.second),
             'ignored': _plain(limit.ignored)}
    if isinstance(limit, ZoneLimit):
        found |= {'polygons': _plain(limit.polygons), 'most_lines': limit.most_lines}
    elif isinstance(limit, SeparationLimit):
        found['radii'] = _plain(limit.radii)
    elif isinstance(limit, FenceLimit):
        found |= {'normals': _plain(limit.normals), 'offsets': _plain(limit.offsets)}
    return found


def _plain(values: NDArray[Any]) -> Array:
    """Return an array as the kernel takes it."""
    return np.ascontiguousarray(values, float)
