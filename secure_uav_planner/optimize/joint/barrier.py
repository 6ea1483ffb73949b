"""A primal-dual interior-point method for (P1) and (P2), for several starts side by side."""

from collections.abc import Callable
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .worst_places import WorstPlaces
from ...errors import NumericalError
from ...mission.scenario import Array
from ...model.channel.receivers import Receivers
from ...model.grid import Grid
from ...model.kernel import core
from ...model.limits import limits_of


class Barrier:
    """
    Newton's method on the barrier function of `kernel/newton.hpp`, from strictly feasible starts.

    S starts are advanced side by side, on all cores.

    :param x: the starts on a grid, (S, N, U, 3).
    :param mu: the barrier parameter to begin with, for all starts or for each, (S,).
    :param check: called between parts of a step that may take long; what it raises ends the
        step and leaves the starts as they are.
    :param places: of the eavesdroppers in every slot; by default the guarantee counts.
    :ivar x: where the starts are, changed in place.
    :ivar mu: their barrier parameters, likewise.
    :ivar finished: which have converged, or make no more progress, likewise.
    """

    def __init__(self, grid: Grid, x: Array, mu: float | Array,
                 check: Callable[[], None] = lambda: None,
                 places: WorstPlaces | None = None) -> None:
        self.grid = grid
        self.check = check
        receivers = Receivers.of(grid) if places is None else places.receivers
        self.solver_time = 0.0
        self.x: Array = np.array(x, float, order='C')
        self.mu: Array = np.full(len(x), 1.0) * mu
        self.finished: NDArray[np.bool_] = np.zeros(len(x), bool)
        self._core = core.Barrier(
            _problem(grid, receivers, places), self.x, self.mu, self.finished)

    def exchange(self, places: WorstPlaces, worse: bool) -> None:
        """Go on with places that have been exchanged; `worse` ones need further steps."""
        self._core.exchange(
            _plain(**places.compiled), np.ascontiguousarray(places.receivers.positions, float))
        if worse:
            self.finished[:] = False

    def rates(self) -> Array:
        """Return the mean rates against the receivers, losing slots silenced, in nats, (S,)."""
        found = np.empty(len(self.x))
        self._core.rates(found)
        return found

    def advance(self, steps: int, final: float) -> int:
        """
        Take up to `steps` steps from every start, as many as are short together; return how many.

        After each its mu is lowered towards `final` where it may be; `finished` ones go on.

        :raises NumericalError: when no step could be computed from any start.
        """
        self.check()
        started = time.perf_counter()
        taken, failed = self._core.advance(steps, final, self.check)
        self.solver_time += time.perf_counter() - started
        if failed == len(self.x):
            raise NumericalError('no Newton step could be computed')
        return int(taken)


def _problem(grid: Grid, receivers: Receivers, places: WorstPlaces | None) -> dict[str, Any]:
    """Return what the kernel asks for, by the names of problem.hpp."""
    limits = [limit.compiled for limit in limits_of(grid.scenario, grid)]
    return {
        'slots': grid.slots, 'uavs': len(grid.fixed), 'colluding': grid.scenario.colluding,
        'limits': [limit for limit in limits if limit is not None],
        'channel': receivers.link.compiled(*receivers.edge.shape),
        'places': None if places is None else _plain(**places.compiled),
        **_plain(starts=grid.starts, goals=grid.goals, fixed=grid.fixed,
                 peaks=grid.scenario.peak_powers / grid.power,
                 positions=receivers.positions, edge=receivers.edge)}


def _plain(**arrays: NDArray[Any]) -> dict[str, Array]:
    """Return arrays as the kernel takes them."""
    return {name: np.ascontiguousarray(values, float) for name, values in arrays.items()}
