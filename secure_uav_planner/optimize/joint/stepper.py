"""Drives a Barrier, reports each step to a Search, and stops where the search must end."""

import numpy as np

from .barrier import Barrier
from .starts import refined
from ..search import Search
from ...errors import NumericalError
from ...mission.scenario import Array
from ...model.grid import Grid
from ...model.limits import is_open
from ...plan.plan import Status

COARSE_SLOTS = 40  # Slots of the coarse grid.
COARSE_MU = 1e-3  # The barrier parameter that ends the coarse grid,
FINAL_MU = 1e-8  # and that of the full grid.
REFINED_MU = 0.03  # The least for a finer grid where limits keep interpolation from being centred.
MOST_STEPS = 150  # Newton steps on one grid.
TRY_EVERY = 16  # Steps between proposals, which take as long as a few to a hundred steps.
WARM_SHARE = 0.01  # How far a plan that is improved further is moved into the interior,
WARM_MU = 1e-3  # and the barrier parameter that it begins with.

_REFINEMENT = 8  # How much finer the next grid is at most.
_MIDDLE_MU = 1e-4  # The barrier parameter that ends a grid in between.


class Stop(Exception):
    """The search must end in a status."""

    def __init__(self, status: Status) -> None:
        super().__init__(status)
        self.status: Status = status


class Stepper:
    """
    What all parts of the method share: they take steps of Barriers for one Search.

    Every step is reported to the search, and raises Stop where the search must end.

    :ivar grid: the full grid, of the search's own slots.
    """

    def __init__(self, search: Search) -> None:
        self.search = search
        self.grid = Grid.of(search.scenario)

    def barrier(self, grid: Grid, x: Array, mu: float | Array) -> Barrier:
        """Return a Barrier that stops when the search must end."""
        return Barrier(grid, x, mu, self.check)

    def check(self) -> None:
        """Raise Stop where the search must end."""
        reason = self.search.stop_reason()
        if reason is not None:
            raise Stop(reason)

    def advance(self, barrier: Barrier, steps: int, mu: float) -> None:
        """Take a number of steps from every start."""
        while steps > 0:
            steps -= self.step(barrier, mu, steps)

    def on_full_grid(self, coarse: Grid, x: Array, mu: float | Array) -> Barrier:
        """
        Return a Barrier of starts (S, N, U, 3) on the full grid, by way of grids in between.

        :param mu: the barrier parameter that they have on the coarse grid, for all or for each.
        """
        full = self.grid.slots
        grid, mu = coarse, np.full(len(x), 1.0) * mu
        while grid.slots < full:
            if grid is not coarse:
                middle = self.barrier(grid, x, mu)
                for _ in range(MOST_STEPS):
                    self.step(middle, _MIDDLE_MU)
                    if middle.finished.all():
                        break
                x, mu = middle.x, middle.mu
            grids = int(np.ceil(np.log(full / grid.slots) / np.log(_REFINEMENT)))
            finer = grid.divided(round(grid.slots * (full / grid.slots)**(1 / grids)))
            found = [refined(grid, one, finer, self.check) for one in x]
            inside = [one is not None for one in found]
            if not any(inside):
                raise NumericalError('no flight strictly inside the limits was found')
            grid, x, mu = finer, np.array([one for one in found if one is not None]), mu[inside]
            if (np.isfinite(grid.scenario.max_accelerations).any()
                    or not is_open(grid.scenario)):
                mu = np.maximum(mu, REFINED_MU)
        return self.barrier(grid, x, mu)

    def finish(self, barrier: Barrier) -> Status:
        """Converge on the full grid; return the status."""
        for step in range(1, MOST_STEPS + 1):
            self.step(barrier, FINAL_MU, try_finished=True)
            if barrier.finished.all():
                return 'converged'
            if step % TRY_EVERY == 0:
                self.try_best(barrier)
        self.try_best(barrier)
        return 'iteration_limit'

    def step(self, barrier: Barrier, mu: float, steps: int = 1,
             try_finished: bool = False) -> int:
        """
        Take up to `steps` steps together, report them, and raise Stop where the search must end.

        :param try_finished: whether to propose what has finished before it is reported.
        :return: how many were taken.
        """
        before = barrier.solver_time
        try:
            taken = barrier.advance(steps, mu)
        except Stop:
            self.try_best(barrier)
            raise
        self.search.solver_time += barrier.solver_time - before
        if self.search.stop_reason() is not None or try_finished and barrier.finished.all():
            self.try_best(barrier)
        for _ in range(taken):
            self.search.report('joint')
            self.check()
        return taken

    def try_best(self, barrier: Barrier) -> None:
        """Propose the best start of a Barrier to the search, on the full grid."""
        x = barrier.x[barrier.rates().argmax()]
        if barrier.grid.slots != self.grid.slots:
            x = barrier.grid.refined(x, self.grid.slots)
        self.try_variables(x)

    def try_variables(self, x: Array) -> None:
        """Propose variables of the full grid, (N, U, 3), to the search."""
        positions = None if self.grid.fixed.all() else self.grid.positions(x)
        self.search.try_improve(positions, self.grid.powers(x))
