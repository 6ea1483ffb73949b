"""Section III-A: transmit and jamming powers for given trajectories, as a convex problem."""

from typing import Any, ClassVar, Literal

import cvxpy as cp
import numpy as np

from .clarabel import solve_problem
from ...mission.scenario import Array, Scenario
from ...model.channel import ground_gains, guaranteed_gains


class PowerProblem:
    """
    The convex restriction (13) of problem (11).

    All logarithms are natural, their arguments are 1 at the local point, and powers are in units
    of the average power: values near one keep the solver accurate.

    :cvar step: what a solve is called in the history of a plan.
    :cvar block: which block of the variables a solve improves.
    :ivar problem: the last cvxpy.Problem, which maximises the sum of the slots' rates in nats.
    :ivar powers: its variable, (U, N) in units of the average power.
    :ivar compile_time: the time that CVXPY took in the last solve in s, None before the first.
    """

    step: ClassVar[str] = 'power'
    block: ClassVar[Literal['powers']] = 'powers'

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.compile_time: float | None = None

    def solve(self, positions: Array, powers: Array,
              time_left: float = np.inf) -> tuple[Array | None, float]:
        """
        Return the powers that maximise the restriction at a local point.

        :param positions: q_i[n], (U, N+2, 2) in m.
        :param powers: the local point p_i^(m)[n], (U, N) in W.
        :param time_left: the limit for compiling and solving in s.
        :return: powers, (U, N) in W, nearly feasible, or None if none were found; and the time
            inside the solver in s.
        """
        unit = self._scenario.average_powers[:, None]
        local, gains = powers / unit, ground_gains(self._scenario, positions) * unit
        self.powers: Any = cp.Variable(powers.shape)
        leakage = cp.Variable(powers.shape[1])
        interference = _of_jammers(gains)
        rate = (_log_of_sum(gains, local, self.powers) - leakage
                - _dot(interference / _total(interference, local), self.powers))
        constraints = [
            self.powers >= 0, self.powers <= self._scenario.peak_powers[:, None] / unit
            @ np.ones((1, powers.shape[1])), cp.sum(self.powers, axis=1) <= powers.shape[1]]
        constraints += [leakage >= _leakage_bound(gains * unit, local, self.powers)
                        for gains in guaranteed_gains(self._scenario, positions)]
        self.problem = cp.Problem(cp.Maximize(cp.sum(rate)), constraints)
        solved, seconds, self.compile_time = solve_problem(self.problem, time_left)
        return (self.powers.value * unit if solved else None), seconds


def _log_of_sum(gains: Array, local: Array, powers: Any) -> Any:
    """Return the concave log(1 + sum_i g_i p_i), less its value at the local point, (N,)."""
    total = _total(gains, local)
    return cp.log(1 / total + _dot(gains / total, powers))


def _leakage_bound(gains: Array, local: Array, powers: Any) -> Any:
    """Return a convex upper bound of r-tilde_e in nats, exact at the local point, (N,)."""
    total, jamming = _total(gains, local), _of_jammers(gains)
    constant = np.log(total / _total(jamming, local)) - (total - 1) / total
    return constant + _dot(gains / total, powers) - _log_of_sum(jamming, local, powers)


def _dot(slopes: Array, powers: Any) -> Any:
    return cp.sum(cp.multiply(slopes, powers), axis=0)


def _total(gains: Array, local: Array) -> Array:
    """Return the power received at the local point with the noise, whose power is 1, (N,)."""
    return np.asarray(1 + (gains * local).sum(axis=0))


def _of_jammers(gains: Array) -> Array:
    return np.concatenate([np.zeros_like(gains[:1]), gains[1:]])
