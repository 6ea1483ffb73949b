"""The speed limit, equation (trajectory): the largest displacement from one point to the next."""

from importlib import import_module
from typing import Any

import numpy as np

from .base import ConvexVariables, Iterate, Limit, Step
from .reference import straight_line
from ..errors import PlanError
from ..grid import Grid
from ..scenario import Array, Scenario

TOLERANCE = 1e-6
"""How far in m a move of a plan may exceed the largest one."""


class SpeedLimit(Limit):
    """
    No UAV flies faster than its largest speed: c = 1 - |q[n+1] - q[n]|^2 / step^2.

    A UAV that is fixed has no c of its own; its entries are 1.
    """

    of_flights = True
    reach = 1

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        super().__init__(scenario, grid)
        self._fixed = self.grid.fixed
        self._square = (
            scenario.max_speeds * self.grid.slot_duration / self.grid.length)**2
        # The gradient of c by a move is this times the move.
        self._slope = -2.0 / self._square[:, None]

    def check(self, positions: Array, powers: Array) -> None:
        """Check every move of a plan; see Limit."""
        steps = np.linalg.norm(np.diff(positions, axis=1), axis=-1)
        for uav, step, most in zip(
                self.scenario.uavs, steps, self.scenario.max_step.tolist(), strict=True):
            if step.max() > most + TOLERANCE:
                raise PlanError(f'{uav.name} moves {step.max():.9g} m after point '
                                f'{step.argmax()}; at most {most:.9g} m are allowed')

    def repair(self, positions: Array, powers: Array) -> tuple[Array, Array]:
        """
        Return the positions blended with the straight line as far as the largest step asks for.

        No flight has shorter steps than the straight line; when a mission leaves no slack it is
        the only one. An exceedance of 1e-8 costs a share of about 1e-8 of the way towards it.
        """
        line = straight_line(self.scenario)
        positions = np.concatenate([line[:, :1], positions[:, 1:-1], line[:, -1:]], axis=1)
        share = np.zeros(len(positions))
        longest = np.linalg.norm(np.diff(positions, axis=1), axis=-1).max(axis=1)
        shortest = np.linalg.norm(line[:, 1] - line[:, 0], axis=-1)
        excess = longest - self.scenario.max_step
        over = excess > 0
        slack = np.maximum(self.scenario.max_step - shortest, 0)
        share[over] = excess[over] / (excess[over] + slack[over])
        blended = positions + share[:, None, None] * (line - positions)
        blended[:, [0, -1]] = line[:, [0, -1]]
        return blended, powers

    def margin(self, iterate: Iterate) -> Array:
        """Return c, (S, N+1, U)."""
        margin: Array = 1.0 - (iterate.moves**2).sum(axis=-1) / self._square
        margin[..., self._fixed] = 1.0
        return margin

    def add_gradient(self, iterate: Iterate, force: Array, gradient: Array) -> None:
        """Subtract force * dc/dx: a point is the end of one move and the start of another."""
        pull = force[..., None] * self._slope * iterate.moves
        gradient[..., 1:] -= pull[:, :-1] - pull[:, 1:]

    def change(self, iterate: Iterate, step: Step) -> Array:
        """Return the derivative of c along a step, (S, N+1, U)."""
        change: Array = (self._slope * iterate.moves * step.moves).sum(axis=-1)
        return change

    def longest_step(self, iterate: Iterate, step: Step, margin: Array, change: Array,
                     share: float) -> Array:
        """Return the least of the roots of c(x + s step) = (1 - share) c(x), (S, U)."""
        bend = (step.moves**2).sum(axis=-1) / self._square
        half = -0.5 * change
        room = share * margin
        root = np.sqrt(half**2 + bend * room)
        # The positive root of bend s^2 + 2 half s = room, without cancellation.
        length = np.where(half > 0, room / np.maximum(root + half, 1e-300),
                          (root - half) / np.maximum(bend, 1e-300))
        length[..., self._fixed] = 1.0
        least: Array = np.minimum(1.0, length.min(axis=1))
        return least

    def add_curvature(self, iterate: Iterate, dual: Array, margin: Array, matrix: Any) -> None:
        """Add a 2 x 2 block for every move; see Limit."""
        moves = iterate.moves
        block = (4 * dual / (margin * self._square**2))[..., None, None] * (
            moves[..., :, None] * moves[..., None, :])
        block[..., 0, 0] += 2 * dual / self._square
        block[..., 1, 1] += 2 * dual / self._square
        block[..., self._fixed, :, :] = 0.0
        matrix.add_positions(0, block[:, :-1] + block[:, 1:])
        matrix.add_positions(1, -block[:, 1:-1])

    def convex_form(self, variables: ConvexVariables) -> list[Any]:
        """Return a cone for every UAV's moves."""
        if variables.paths is None:
            return []
        # Only here, where a CVXPY problem is being built anyway.
        cp: Any = import_module('cvxpy')
        return [cp.norm(path[1:] - path[:-1], axis=1) <= most * variables.scale
                for path, most in zip(
                    variables.paths, self.scenario.max_step.tolist(), strict=True)]
