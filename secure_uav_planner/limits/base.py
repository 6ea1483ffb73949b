"""What every limit answers, whoever asks: a plan, the repair of an iterate, and the methods."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..grid import Grid
from ..scenario import Array, Scenario

ALL_SLOTS = -1
"""The reach of a limit that couples all slots."""


class Limit(ABC):
    """
    One limit of a scenario, written as c(x) >= 0 for inequalities that are met inside.

    A new limit is one subclass of this, named in `limits.LIMITS`. `Plan` calls check; `feasible`
    calls repair; `alternating` calls convex_form; `joint` calls the others on a Grid, always for
    several starts at once, with x (S, N, U, 3) and arrays c whose first axis is the starts.

    :cvar of_flights: whether it limits positions rather than powers.
    :ivar reach: how many slots beyond its own an inequality couples: 0 within a slot, 1 with the
        next one, and so on, or ALL_SLOTS. The optimiser's band is as high as the largest reach.
    :param scenario: whose limit it is.
    :param grid: on which joint asks; by default the scenario's own.
    """

    of_flights: ClassVar[bool] = False
    reach: int

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        self.scenario = scenario
        self.grid = Grid.of(scenario) if grid is None else grid

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return whether a scenario has this limit."""
        return True

    def height(self, size: int) -> int:
        """
        Return how many diagonals of the lower triangle of the Hessian its inequalities fill.

        By default, they couple the variables of a slot, and the two coordinates of a UAV with
        those in slots within reach. Of a limit that couples all slots it does not count.

        :param size: variables of a slot, 3 U.
        """
        # Between slots, one row up or down.
        return self.reach * size + 2 if self.reach > 0 else size

    # For a plan

    @abstractmethod
    def check(self, positions: Array, powers: Array) -> None:
        """
        Check a plan in plain NumPy.

        :param positions: (U, N+2, 2) in m.
        :param powers: (U, N) in W.
        :raises PlanError: naming UAV, place in the plan, value and limit.
        """

    def repair(self, positions: Array, powers: Array,
               margin: float = 0.0) -> tuple[Array, Array]:
        """
        Return nearly feasible positions and powers made feasible.

        :param positions: (U, N+2, 2) in m.
        :param powers: (U, N) in W.
        :param margin: share of the limit that is left, by limits on positions.
        """
        return positions, powers

    # For the joint method

    @property
    def weight(self) -> float:
        """Factor of its logarithms in the barrier function."""
        return 1.0

    @abstractmethod
    def margin(self, iterate: 'Iterate') -> Array:
        """Return c, positive strictly inside the limit, (S, ...)."""

    @abstractmethod
    def add_gradient(self, iterate: 'Iterate', force: Array, gradient: Array) -> None:
        """Subtract the sum of force * dc/dx from a gradient (S, N, U, 3); force is as c."""

    @abstractmethod
    def change(self, iterate: 'Iterate', step: 'Step') -> Array:
        """Return the derivative of c along a step, shaped as c."""

    @abstractmethod
    def longest_step(self, iterate: 'Iterate', step: 'Step', margin: Array, change: Array,
                     share: float) -> Array:
        """
        Return how far each UAV may go along a step, (S, U), at most 1.

        :param share: of the way to the boundary that may be gone.
        """

    def clip(self, x: Array, trial: Array, share: float, factor: float) -> None:
        """
        Stop every entry of a trial at this limit by itself, in place, where that is possible.

        :param x: from where the trial goes, strictly inside.
        :param share: of the way to the boundary that may be gone.
        :param factor: by which a power may fall or rise.
        """

    def add_curvature(self, iterate: 'Iterate', dual: Array, margin: Array,
                      matrix: Any) -> None:
        """
        Add the limit's part of the primal-dual Hessian to a BandMatrix.

        That is -dual d2c/dx2 + dual/c (dc/dx)(dc/dx)^T, summed over its inequalities. A limit
        that couples all slots gives dense_rows instead.
        """

    def dense_rows(self) -> Array | None:
        """
        Return the gradients of inequalities that couple all slots, (K, N * U * 3), or None.

        They must not depend on x.
        """
        return None

    # For the alternating method

    def convex_form(self, variables: 'ConvexVariables') -> list[Any]:
        """
        Return CVXPY constraints on those of the variables that the limit is about.

        A limit that is not convex returns a convex restriction with CVXPY parameters, which it
        keeps and sets in set_local_point.
        """
        return []

    def set_local_point(self, positions: Array, powers: Array) -> None:
        """
        Set the parameters of the convex form for a local point; convex limits have none.

        It is called before every solve. The restriction must hold at the local point itself.

        :param positions: (U, N+2, 2) in m.
        :param powers: (U, N) in W.
        """


class Iterate:
    """
    One x of several starts, and what limits compute from it.

    :param grid: of the variables.
    :param x: (S, N, U, 3).
    :param lines: what limits chose for another x near it and keep here, by limit; without it,
        they choose anew.
    """

    def __init__(self, grid: Grid, x: Array, lines: dict[Any, Any] | None = None) -> None:
        self.grid = grid
        self.x = x
        self.power: Array = x[..., 0]
        self.path: Array = grid.path(x)
        """Points with start and goal in units, (S, N+2, U, 2)."""
        self.moves: Array = np.diff(self.path, axis=1)
        """From each point to the next, (S, N+1, U, 2)."""
        self.lines: dict[Any, Any] = {} if lines is None else lines

    @classmethod
    def of_path(cls, grid: Grid, path: Array) -> 'Iterate':
        """Return an Iterate of flights without powers, (S, N+2, U, 2) in units."""
        x = np.zeros((len(path), grid.slots, path.shape[2], 3))
        x[..., 1:] = path[:, 1:-1]
        return cls(grid, x)

    def moved(self, x: Array, starts: Any = None) -> 'Iterate':
        """
        Return an Iterate at another x with the same choices.

        :param x: (S', N, U, 3).
        :param starts: which of the starts these are, an index array; by default all.
        """
        lines = self.lines
        if starts is not None and lines:
            lines = {limit: type(chosen)(*(
                None if part is None else part[starts] for part in chosen))
                for limit, chosen in lines.items()}
        return Iterate(self.grid, x, lines)


class Step:
    """
    A step from an Iterate.

    :param change: of x, (S, N, U, 3).
    """

    def __init__(self, change: Array) -> None:
        path = np.zeros((len(change), change.shape[1] + 2, change.shape[2], 2))
        path[:, 1:-1] = change[..., 1:]
        self.x = change
        self.power: Array = change[..., 0]
        self.path: Array = path
        """The change of every point, (S, N+2, U, 2)."""
        self.moves: Array = np.diff(path, axis=1)
        """The change of every move, (S, N+1, U, 2)."""


@dataclass(frozen=True)
class ConvexVariables:
    """
    What is variable in a convex problem of the alternating method.

    A problem has either paths or powers, as the other block is given.

    :param paths: affine CVXPY expressions of every UAV's positions, (N+2, 2) in the problem's
        unit of length, or None where positions are given.
    :param scale: the CVXPY parameter 1 / unit of these positions, in 1/m; a length in metres
        times scale is one in units. It changes between solves. None where positions are given.
    :param powers: an affine CVXPY expression of the powers in units of the average power,
        (U, N), or None where they are given.
    """

    paths: list[Any] | None = None
    scale: Any = None
    powers: Any = None


def step_to_zero(amount: Array, change: Array, share: float) -> Array:
    """Return the number of steps, at most 1, that take a share of a positive amount away."""
    most = share * amount
    return most / np.maximum(-change, most)
