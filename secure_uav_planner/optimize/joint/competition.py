"""The competition of several starts on a coarse grid."""

import numpy as np
from numpy.typing import NDArray

from .barrier import Barrier
from .schedule import Schedule
from .starts import several_starts
from .stepper import Stepper
from ...errors import NumericalError
from ...grid import Grid
from ...scenario import Array


class Competition:
    """
    Starts that are improved side by side on a coarse grid, where the best are kept in stages.

    :ivar best: the best of them, best first; a single one where all have ended in the same place.
    """

    def __init__(self, stepper: Stepper) -> None:
        self._stepper, self._schedule = stepper, stepper.schedule
        self._left_out: list[tuple[Array, Array]] = []
        self.best = self._compete(*self._starts())

    def left_out(self) -> tuple[Array, Array]:
        """Return the distinct starts that were left out, (S, N, U, 3), and their mu, (S,)."""
        x, mu = (np.concatenate(parts) for parts in zip(*self._left_out, strict=True))
        return x, mu

    def _starts(self) -> tuple[Grid, Array, Array, NDArray[np.bool_]]:
        """Return the coarsest grid on which there are starts, and these."""
        slots = self._schedule.coarse_slots
        while True:
            grid = self._stepper.grid.divided(min(self._stepper.grid.slots, slots))
            try:
                return grid, *several_starts(grid, self._schedule, self._stepper.check)
            except NumericalError:
                if slots >= self._stepper.grid.slots:
                    raise
            slots *= 2

    def _compete(self, grid: Grid, x: Array, mus: Array,
                 others: NDArray[np.bool_]) -> Barrier:
        """
        Return a Barrier of the best starts, best first.

        :param others: which of them are sent other ways.
        """
        schedule = self._schedule
        # A few of every kind first: in an easy mission most of them end in the same place.
        scouts = np.flatnonzero(others | (np.arange(len(x)) % schedule.scouts == 0))
        barrier, together = self._best_of(self._stepper.barrier(grid, x[scouts], mus[scouts]))
        self._stepper.try_best(barrier)
        near = near_best(barrier.rates(), schedule.rival_gap, len(barrier.x), schedule)
        if len(near) == 1 and together >= schedule.agreed * len(scouts):
            barrier.keep(near)
        if len(barrier.x) == 1:
            return barrier
        rest = np.setdiff1d(np.arange(len(x)), scouts)
        later, _ = self._best_of(self._stepper.barrier(grid, x[rest], mus[rest]))
        barrier = self._stepper.barrier(grid, np.concatenate([barrier.x, later.x]),
                                        np.concatenate([barrier.mu, later.mu]))
        self._select(barrier, 0.5)
        self._stepper.advance(barrier, schedule.last_steps, schedule.coarse_mu)
        self._select(barrier, 0.0)
        self._stepper.try_best(barrier)
        return barrier

    def _best_of(self, barrier: Barrier) -> tuple[Barrier, int]:
        """Improve starts and keep the best in stages; return them, and how many met the best."""
        together = 1
        for stage in self._schedule.stages:
            self._stepper.advance(barrier, stage.steps, self._schedule.coarse_mu)
            rates = barrier.rates()
            met = rates >= (1 - self._schedule.distinct) * rates.max()
            together += int(met.sum()) - 1
            self._select(barrier, stage.keep)
            if len(barrier.x) == 1:
                break
        return barrier, together

    def _select(self, barrier: Barrier, share: float) -> None:
        """Keep a share of the distinct starts of a Barrier, and at least all rivals."""
        order = distinct(barrier.rates(), self._schedule)
        kept = max(self._schedule.rivals, int(np.ceil(share * len(order))))
        self._left_out.append((barrier.x[order[kept:]], barrier.mu[order[kept:]]))
        barrier.keep(order[:kept])


def near_best(rates: Array, gap: float, most: int, schedule: Schedule) -> NDArray[np.intp]:
    """Return distinct starts, best first, that are at most a share below the best."""
    chosen = distinct(rates, schedule)
    return chosen[rates[chosen] >= (1 - gap) * rates[chosen[0]]][:most]


def distinct(rates: Array, schedule: Schedule) -> NDArray[np.intp]:
    """Return one start of each rate, best first."""
    order = np.argsort(-rates)
    rates = rates[order]
    new = np.append(True, -np.diff(rates) > schedule.distinct * abs(rates[0]))
    found: NDArray[np.intp] = order[new]
    return found
