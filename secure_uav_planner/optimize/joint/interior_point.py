"""A primal-dual interior-point method for (P1) and (P2), for several starts side by side."""

import time
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .settings import DESCENT
from .starts import refine
from ..deadline import DeadlineCheck
from ..incumbent import Incumbent
from ...errors import NumericalError, StoppedError, TimeLimitError
from ...mission.scenario import Array
from ...model.grid import Grid, Receivers
from ...model.kernel import core
from ...model.limits import build_limits
from ...model.limits.energy import compile_energies
from ...plan.plan import Status

Discs: TypeAlias = dict[str, NDArray[Any]]
"""The discs of eavesdroppers at places, by the names of core.pyi."""


class InteriorPointSolver:
    """
    Newton's method on the barrier function of `kernel/newton.cpp`, from strictly feasible starts.

    S starts are advanced side by side, on all cores.

    :param x: the starts on a grid, (S, N, U, 3).
    :param mu: first barrier parameter in the grid's unit of rates, for all starts or for each,
        (S,).
    :param raise_if_over: called between parts of a long step; an error that it raises ends the
        step and leaves the starts as they are.
    :param receivers: receivers at places in the discs; by default the guarantee's receivers.
    :param discs: discs of the receivers' places.
    :param prices: first prices of limited energies in units of rates per limit, which broadcast
        to (S, U); see `kernel/constraints.hpp`.
    :ivar x: iterates of all starts, changed in place.
    :ivar shares: fraction of each slot for each ground node, (S, N, G), changed in place.
    :ivar mu: barrier parameter of each start, (S,), changed in place.
    :ivar finished: whether each start has converged or stalled, (S,), changed in place.
    :ivar over: whether each energy may exceed its limit, (S, U), changed in place.
    :ivar prices: prices of the energies, or duals of their limits, (S, U), changed in place.
    """

    def __init__(self, grid: Grid, x: Array, mu: float | Array,
                 raise_if_over: DeadlineCheck = lambda: None,
                 receivers: Receivers | None = None, discs: Discs | None = None,
                 prices: float | Array = DESCENT.first_price) -> None:
        self.grid = grid
        self.raise_if_over = raise_if_over
        self.solver_time = 0.0
        self.x: Array = np.array(x, float, order='C')  # (S, N, U, 3)
        self.mu: Array = np.full(len(x), 1.0) * mu
        self.finished: NDArray[np.bool_] = np.zeros(len(x), bool)
        self.over: NDArray[np.bool_] = np.zeros((len(x), len(grid.fixed)), bool)
        self.prices: Array = np.full(self.over.shape, 1.0) * prices
        receivers = receivers or Receivers.of(grid)
        self.shares: Array = np.empty((*self.x.shape[:2], len(receivers.weights)))
        self._core = core.InteriorPointSolver(
            _build_problem(grid, receivers, discs, self.x[0]), self.x, self.shares, self.mu,
            self.finished, self.over, self.prices)

    def exchange(self, receivers: Receivers, discs: Discs, worse: bool) -> None:
        """Replace the places of receivers and discs; `worse` True makes all starts unfinished."""
        self._core.exchange_places(
            _to_kernel(**discs), np.ascontiguousarray(receivers.positions, float))
        if worse:
            self.finished[:] = False

    def rates(self) -> Array:
        """
        Return min over nodes of (offset + mean rate) / weight, (S,), in units of the grid.

        Negative rates of slots are replaced by 0. A start with an energy that may exceed its limit
        has the rate 0.
        """
        rates = np.empty(len(self.x))
        self._core.evaluate_rates(rates)
        return np.where(self.over.any(axis=1), 0.0, rates / self.grid.rate)

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
        Take `steps` steps from every start, or fewer if steps are expensive; change x in place.

        After a step the barrier parameter of a centred or stalled start is lowered towards
        `final`. Finished starts step as well.

        :return: the number of steps taken from each start.
        :raises NumericalError: when a step failed from every start.
        """
        self.raise_if_over()
        started = time.perf_counter()
        taken, failed = self._core.advance(steps, final, self.raise_if_over)
        self.solver_time += time.perf_counter() - started
        if failed == len(self.x):
            raise NumericalError('no Newton step could be computed')
        return int(taken)


class Optima(NamedTuple):
    """Distinct local optima on a grid, (S, N, U, 3), the best first."""

    grid: Grid
    x: Array


class Solver(Protocol):
    """The interface of solvers that a SolverDriver drives, such as InteriorPointSolver."""

    grid: Grid

    @property
    def solver_time(self) -> float:
        """Time [s] spent in the kernel."""

    @property
    def is_done(self) -> bool:
        """Whether further steps gain nothing."""

    def advance(self, steps: int, final: float) -> int:
        """Take up to `steps` steps, and return their number."""

    def propose(self) -> Array | None:
        """Return variables (N, U, 3) to be tried, or None if none seem better than before."""


class SolverDriver:
    """
    Takes the steps of all solvers of the method for one Incumbent.

    Every step is reported to the incumbent, and raises StoppedError or TimeLimitError when the
    method must end.

    :param grid: the full grid, which has the scenario's slots; by default the problem's grid.
    :param elevation_offset: homotopy parameter of links [degrees]; see make_links.
    :ivar optima: optima of a multistart near the best one, if there are several; else None.
    """

    def __init__(self, incumbent: Incumbent, grid: Grid | None = None,
                 elevation_offset: float = 0.0) -> None:
        self.incumbent = incumbent
        self.raise_if_over = incumbent.raise_if_over
        self.grid = incumbent.problem.grid if grid is None else grid
        self._elevation_offset = elevation_offset
        self.optima: Optima | None = None

    def build_solver(self, grid: Grid, x: Array, mu: float | Array,
                     prices: float | Array = DESCENT.first_price) -> InteriorPointSolver:
        """Return an InteriorPointSolver that stops when the method must end."""
        return InteriorPointSolver(grid, x, mu, self.raise_if_over,
                                   Receivers.of(grid, self._elevation_offset), prices=prices)

    def advance(self, solver: Solver, steps: int, mu: float) -> None:
        """Take `steps` steps from every start, finished or not, with mu as the last parameter."""
        self._take_steps(solver, mu, steps, at_once=steps)

    def descend(self, solver: Solver, mu: float, steps: int = DESCENT.most_steps) -> Status:
        """Take at most `steps` steps until a solver is done at mu; propose only after an error."""
        return self._take_steps(solver, mu, steps)

    def finish(self, solver: Solver, mu: float = DESCENT.final_mu,
               steps: int = DESCENT.most_steps) -> Status:
        """Take at most `steps` steps until a solver is done at mu, with proposals in between."""
        return self._take_steps(solver, mu, steps, try_every=DESCENT.try_every)

    def refine_to_full_grid(self, coarse: Grid, x: Array, mu: float | Array,
                            prices: float | Array = DESCENT.first_price,
                            scale: float = 1.0) -> InteriorPointSolver:
        """
        Return a solver of starts (S, N, U, 3) on the full grid, refined through grids in between.

        Starts take steps on the grids in between, not on the coarse and the full one. Starts
        without flights strictly inside the limits of a finer grid are left out.

        :param mu: barrier parameter on the coarse grid, of all starts or of each, (S,).
        :param prices: prices of energies on the coarse grid, of all or of each, (S, U).
        :param scale: factor of DESCENT.middle_mu and DESCENT.refined_mu.
        :raises NumericalError: when no start is left.
        """
        prices = np.full((len(x), len(coarse.fixed)), 1.0) * prices
        full = self.grid.slots
        grid, mu = coarse, np.full(len(x), 1.0) * mu
        while grid.slots < full:
            if grid is not coarse:
                middle = self.build_solver(grid, x, mu, prices)
                self.descend(middle, scale * DESCENT.middle_mu)
                x, mu, prices = middle.x, middle.mu, middle.prices
            # The grids to the full one have a constant ratio of slots, at most DESCENT.refinement.
            grids = int(np.ceil(np.log(full / grid.slots) / np.log(DESCENT.refinement)))
            finer = grid.with_slots(round(grid.slots * (full / grid.slots)**(1 / grids)))
            refined = [refine(grid, start, finer, self.raise_if_over) for start in x]
            inside = [start is not None for start in refined]
            if not any(inside):
                raise NumericalError('no flight strictly inside the limits was found')
            grid, mu, prices = finer, mu[inside], prices[inside]
            x = np.array([start for start in refined if start is not None])
            if grid.scenario.limits_acceleration or not grid.airspace.is_open:
                mu = np.maximum(mu, scale * DESCENT.refined_mu)
        return self.build_solver(grid, x, mu, prices)

    def _take_steps(self, solver: Solver, mu: float, steps: int, at_once: int = 1,
                    try_every: int = 0) -> Status:
        """
        Take steps until a solver is done; report each step to the incumbent.

        If an error ends the steps, the solver's best is proposed before the error is raised.

        :param mu: barrier parameter to which the solver lowers its own.
        :param steps: largest number of steps.
        :param at_once: steps in one call of the solver. Above 1, all `steps` are taken.
        :param try_every: steps between two proposals to the incumbent; 0 for no proposal.
        :return: 'converged' if the solver is done, 'iteration_limit' after all `steps`.
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
        """Propose what the solver proposes, interpolated to the full grid, to the incumbent."""
        x = solver.propose()
        if x is None:
            return
        if solver.grid.slots != self.grid.slots:
            x = solver.grid.refine(x, self.grid.slots)
        self.try_variables(x)

    def try_variables(self, x: Array) -> None:
        """Propose variables (N, U, 3) of the full grid; only powers if all flights are fixed."""
        positions = None if self.grid.fixed.all() else self.grid.positions(x)
        self.incumbent.try_improve(positions, self.grid.powers(x))


def _build_problem(grid: Grid, receivers: Receivers, discs: Discs | None,
                   x: Array) -> dict[str, Any]:
    """Return the `arguments` of core.InteriorPointSolver, which core.pyi explains."""
    # Energies are by Simpson's rule, plus constants that make them exact at x (N, U, 3).
    limits = [limit.compiled for limit in build_limits(grid)]
    return {
        'slots': grid.slots, 'uavs': len(grid.fixed), 'colluding': grid.scenario.colluding,
        'rate_unit': grid.rate, 'listeners': list(receivers.listeners),
        'energies': (compile_energies(grid, grid.positions(x))
                     if grid.scenario.limits_energy and not grid.fixed.all() else None),
        'limits': [limit for limit in limits if limit is not None],
        'gains': receivers.link.compiled(receivers.radii.shape[1], len(grid.fixed)),
        'places': None if discs is None else _to_kernel(**discs),
        **_to_kernel(starts=grid.starts, goals=grid.goals, fixed=grid.fixed,
                     peaks=grid.scenario.peak_powers / grid.power,
                     positions=receivers.positions, radii=receivers.radii,
                     weights=receivers.weights, offsets=receivers.offsets)}


def _to_kernel(**arrays: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return arrays in the layout and type that the kernel reads: contiguous floats or flags."""
    return {name: np.ascontiguousarray(values, bool if values.dtype == bool else float)
            for name, values in arrays.items()}
