"""A primal-dual interior-point method for (P1) and (P2), for several starts side by side."""

import time
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .starts import refine
from ..deadline import DeadlineCheck
from ..incumbent import Incumbent
from ...errors import NumericalError, StoppedError, TimeLimitError
from ...mission.scenario import Array
from ...model.grid import Grid, Receivers
from ...model.kernel import core
from ...model.limits import build_limits, measure_energies
from ...model.limits.energy import price_energies
from ...plan.plan import Status

COARSE_SLOTS = 40  # Slots of the coarse grid.
COARSE_MU = 1e-3  # The barrier parameter that ends the coarse grid,
FINAL_MU = 1e-8  # and that of the full grid.
REFINED_MU = 0.03  # The least for a finer grid where limits keep interpolation from being centred.
MOST_STEPS = 150  # Newton steps on one grid.
TRY_EVERY = 16  # Steps between proposals, each of which takes as long as several steps.
WARM_SHARE = 0.01  # By which a plan that is improved further is moved into the interior,
WARM_MU = 1e-3  # and the barrier parameter that it begins with.

_REFINEMENT = 8  # Ratio of slots of the next grid and of the last, at most.
_MIDDLE_MU = 1e-4  # The barrier parameter that ends a grid in between.

Discs: TypeAlias = dict[str, NDArray[Any]]
"""The discs of eavesdroppers at places, by the names of core.pyi."""


class InteriorPointSolver:
    """
    Newton's method on the barrier function of `kernel/newton.cpp`, from strictly feasible starts.

    S starts are advanced side by side, on all cores.

    :param x: the starts on a grid, (S, N, U, 3).
    :param mu: the barrier parameter to begin with, in the grid's unit of rates, for all starts or
        for each, (S,).
    :param raise_if_over: called between parts of a step that may take long; what it raises ends
        the step and leaves the starts as they are.
    :param receivers: at places in the discs; by default those of the guarantee.
    :param discs: of the receivers' places.
    :param prices: of energy in nats per J, (U,), or None.
    :ivar x: the iterates of all starts, changed in place.
    :ivar shares: of the slots for the ground nodes, (S, N, G), likewise.
    :ivar mu: their barrier parameters, likewise.
    :ivar finished: True for those that have converged or make no more progress, likewise.
    """

    def __init__(self, grid: Grid, x: Array, mu: float | Array,
                 raise_if_over: DeadlineCheck = lambda: None,
                 receivers: Receivers | None = None, discs: Discs | None = None,
                 prices: Array | None = None) -> None:
        self.grid = grid
        self.raise_if_over = raise_if_over
        self.solver_time = 0.0
        self.x: Array = np.array(x, float, order='C')
        self.mu: Array = np.full(len(x), 1.0) * mu
        self.finished: NDArray[np.bool_] = np.zeros(len(x), bool)
        receivers = receivers or Receivers.of(grid)
        self.shares: Array = np.empty((*self.x.shape[:2], len(receivers.weights)))
        self._core = core.InteriorPointSolver(
            _build_problem(grid, receivers, discs, prices), self.x, self.shares, self.mu,
            self.finished)

    def exchange(self, receivers: Receivers, discs: Discs, worse: bool) -> None:
        """Continue with receivers at exchanged places; `worse` ones need further steps."""
        self._core.exchange_places(
            _to_kernel(**discs), np.ascontiguousarray(receivers.positions, float))
        if worse:
            self.finished[:] = False

    def rates(self) -> Array:
        """Return the mean rates against the receivers, losing slots silenced, in units, (S,)."""
        rates = np.empty(len(self.x))
        self._core.evaluate_rates(rates)
        return rates / self.grid.rate

    @property
    def is_done(self) -> bool:
        """Whether all starts are finished."""
        return bool(self.finished.all())

    def propose(self) -> Array | None:
        """Return the variables of the best start, (N, U, 3)."""
        best: Array = self.x[self.rates().argmax()]
        return best

    def advance(self, steps: int, final: float) -> int:
        """
        Take up to `steps` steps from every start, as many as are short together.

        After a step mu is lowered towards `final` where it may be. Finished starts step, too.

        :return: the number of steps.

        :raises NumericalError: when no step could be computed from any start.
        """
        self.raise_if_over()
        started = time.perf_counter()
        taken, failed = self._core.advance(steps, final, self.raise_if_over)
        self.solver_time += time.perf_counter() - started
        if failed == len(self.x):
            raise NumericalError('no Newton step could be computed')
        return int(taken)


class Optima(NamedTuple):
    """Starts on a grid, (S, N, U, 3), in distinct optima, the best first."""

    grid: Grid
    x: Array


class Solver(Protocol):
    """What a SolverDriver drives: an InteriorPointSolver, or one whose receivers change."""

    grid: Grid

    @property
    def solver_time(self) -> float:
        """Time in the kernel, in s."""

    @property
    def is_done(self) -> bool:
        """Whether nothing more is gained by steps."""

    def advance(self, steps: int, final: float) -> int:
        """Take up to `steps` steps, and return their number."""

    def propose(self) -> Array | None:
        """Return variables (N, U, 3) to be tried, or None if nothing seems worth it."""


class SolverDriver:
    """
    Steps of InteriorPointSolvers that all parts of the method take for one Incumbent.

    Every step is reported to the incumbent, and raises as Deadline.raise_if_over does.

    :ivar grid: the full grid, of the scenario's own slots.
    :ivar elevation_offset: of the links, see make_links.
    :ivar prices: of energy in nats per J, (U,), or None.
    :ivar optima: those of a multistart that are near the best, once there are several.
    """

    def __init__(self, incumbent: Incumbent) -> None:
        self.incumbent = incumbent
        self.raise_if_over = incumbent.deadline.raise_if_over
        self.grid = incumbent.problem.grid
        self.elevation_offset = 0.0
        self.prices: Array | None = None
        self.optima: Optima | None = None

    def find_cost(self, grid: Grid, x: Array) -> float:
        """Return the price of the energy of variables (N, U, 3) in nats per slot."""
        if self.prices is None:
            return 0.0
        return float(self.prices @ measure_energies(grid.scenario, grid.positions(x))) / grid.slots

    def build_solver(self, grid: Grid, x: Array, mu: float | Array) -> InteriorPointSolver:
        """Return an InteriorPointSolver that stops when the method must end."""
        return InteriorPointSolver(grid, x, mu, self.raise_if_over,
                                   Receivers.of(grid, self.elevation_offset), prices=self.prices)

    def advance(self, solver: Solver, steps: int, mu: float) -> None:
        """Take a number of steps from every start."""
        self._take_steps(solver, mu, steps, at_once=steps)

    def descend(self, solver: Solver, mu: float, steps: int = MOST_STEPS) -> Status:
        """Take steps until a solver is done, at most a number."""
        return self._take_steps(solver, mu, steps)

    def finish(self, solver: Solver, mu: float = FINAL_MU, steps: int = MOST_STEPS) -> Status:
        """Descend as far as that, and propose what is found now and then."""
        return self._take_steps(solver, mu, steps, try_every=TRY_EVERY)

    def refine_to_full_grid(self, coarse: Grid, x: Array,
                            mu: float | Array) -> InteriorPointSolver:
        """
        Return a solver of starts (S, N, U, 3) on the full grid, refined through grids in between.

        :param mu: the barrier parameter that they have on the coarse grid, for all or for each.
        """
        full = self.grid.slots
        grid, mu = coarse, np.full(len(x), 1.0) * mu
        while grid.slots < full:
            if grid is not coarse:
                middle = self.build_solver(grid, x, mu)
                self.descend(middle, _MIDDLE_MU)
                x, mu = middle.x, middle.mu
            grids = int(np.ceil(np.log(full / grid.slots) / np.log(_REFINEMENT)))
            finer = grid.with_slots(round(grid.slots * (full / grid.slots)**(1 / grids)))
            refined = [refine(grid, start, finer, self.raise_if_over) for start in x]
            inside = [start is not None for start in refined]
            if not any(inside):
                raise NumericalError('no flight strictly inside the limits was found')
            grid, mu = finer, mu[inside]
            x = np.array([start for start in refined if start is not None])
            if grid.scenario.limits_acceleration or not grid.airspace.is_open:
                mu = np.maximum(mu, REFINED_MU)
        return self.build_solver(grid, x, mu)

    def _take_steps(self, solver: Solver, mu: float, steps: int, at_once: int = 1,
                    try_every: int = 0) -> Status:
        """
        Take steps until a solver is done; report each to the incumbent.

        Whatever ends the steps by an error, the best that they have found is proposed before.

        :param mu: to which the barrier parameter is lowered.
        :param steps: the most steps.
        :param at_once: steps between two looks at whether the solver is done, in which case it
            takes all of them.
        :param try_every: steps between two proposals on the full grid; 0 for no proposal.
        """
        taken = 0
        try:
            while taken < steps:
                before = solver.solver_time
                count = solver.advance(min(at_once, steps - taken), mu)
                self.incumbent.solver_time += solver.solver_time - before
                taken += count
                is_done = at_once == 1 and solver.is_done
                if try_every and (is_done or taken == steps or taken % try_every == 0):
                    self.try_best(solver)
                for _ in range(count):
                    self.incumbent.report('joint')
                    self.raise_if_over()
                if is_done:
                    return 'converged'
        except (StoppedError, TimeLimitError, NumericalError):
            self.try_best(solver)
            raise
        return 'iteration_limit'

    def try_best(self, solver: Solver) -> None:
        """Propose what a solver proposes to the incumbent, on the full grid."""
        x = solver.propose()
        if x is None:
            return
        if solver.grid.slots != self.grid.slots:
            x = solver.grid.refine(x, self.grid.slots)
        self.try_variables(x)

    def try_variables(self, x: Array) -> None:
        """Propose variables of the full grid, (N, U, 3), to the incumbent."""
        positions = None if self.grid.fixed.all() else self.grid.positions(x)
        self.incumbent.try_improve(positions, self.grid.powers(x))


def _build_problem(grid: Grid, receivers: Receivers, discs: Discs | None,
                   prices: Array | None) -> dict[str, Any]:
    """Return the problem of the kernel, by the names of core.pyi."""
    limits = [limit.compiled for limit in build_limits(grid)]
    return {
        'slots': grid.slots, 'uavs': len(grid.fixed), 'colluding': grid.scenario.colluding,
        'rate_unit': grid.rate, 'listeners': list(receivers.listeners),
        'energy': None if prices is None else price_energies(grid, prices),
        'limits': [limit for limit in limits if limit is not None],
        'gains': receivers.link.compiled(receivers.radii.shape[1], len(grid.fixed)),
        'places': None if discs is None else _to_kernel(**discs),
        **_to_kernel(starts=grid.starts, goals=grid.goals, fixed=grid.fixed,
                     peaks=grid.scenario.peak_powers / grid.power,
                     positions=receivers.positions, radii=receivers.radii,
                     weights=receivers.weights, offsets=receivers.offsets)}


def _to_kernel(**arrays: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return arrays as the kernel takes them."""
    return {name: np.ascontiguousarray(values, bool if values.dtype == bool else float)
            for name, values in arrays.items()}
