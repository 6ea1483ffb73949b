"""Section III-A: transmit and jamming powers for given trajectories, as a convex problem."""

from typing import Any, ClassVar, Literal

import cvxpy as cp
import numpy as np

from . import clarabel
from ...mission.scenario import Array, Scenario
from ...model.channel import ground_gains, guaranteed_gains
from ...model.limits import limits_of
from ...model.limits.base import ConvexVariables


class PowerProblem:
    """
    The convex restriction (13) of problem (11), built once for a scenario.

    All logarithms are natural, their arguments are 1 at the local point, and powers are in units
    of the average power: values near one keep the solver accurate.

    :cvar step: what a solve is called in the history of a plan.
    :cvar block: which block of the variables a solve improves.
    :ivar problem: the cvxpy.Problem, which maximises the sum of the slots' rates in nats.
    :ivar powers: its variable, (U, N) in units of the average power.
    :ivar compile_time: the time that CVXPY took in the last solve in s, None before the first.
    """

    step: ClassVar[str] = 'power'
    block: ClassVar[Literal['powers']] = 'powers'

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.compile_time: float | None = None
        self._unit = scenario.average_powers[:, None]
        shape = (len(scenario.uavs), scenario.slots)
        self.powers: Any = cp.Variable(shape)
        self._limits = limits_of(scenario)
        # The received power at the ground node, and its interference linearised
        self._ground = _LogOfSum(self.powers)
        self._interference_slopes = cp.Parameter(shape, nonneg=True)
        self._leakages = [_LeakageBound(self.powers) for _ in scenario.eavesdroppers]

        leakage = cp.Variable(scenario.slots)
        rate = (self._ground.value - _dot(self._interference_slopes, self.powers) - leakage)
        constraints = [constraint for limit in self._limits
                       for constraint in limit.convex_form(ConvexVariables(powers=self.powers))]
        constraints += [leakage >= bound.value for bound in self._leakages]
        self.problem = cp.Problem(cp.Maximize(cp.sum(rate)), constraints)

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
        for limit in self._limits:
            limit.set_local_point(positions, powers)
        local = powers / self._unit
        slopes = ground_gains(self.scenario, positions) * self._unit
        self._ground.set_local_point(slopes, local)
        self._interference_slopes.value = _of_jammers(slopes) / _total(_of_jammers(slopes), local)
        for bound, gains in zip(
                self._leakages, guaranteed_gains(self.scenario, positions), strict=True):
            bound.set_local_point(gains * self._unit, local)
        solved, seconds, self.compile_time = clarabel.solve_problem(self.problem, time_left)
        return (self.powers.value * self._unit if solved else None), seconds


class _LogOfSum:
    """
    The concave function log(1 + sum_i g_i p_i), less its value at the local point.

    :ivar value: the CVXPY expression, (N,).
    """

    def __init__(self, powers: Any) -> None:
        self._constant = cp.Parameter(powers.shape[1], nonneg=True)
        self._slopes = cp.Parameter(powers.shape, nonneg=True)
        self.value: Any = cp.log(self._constant + _dot(self._slopes, powers))

    def set_local_point(self, slopes: Array, local: Array) -> None:
        """Set the gains and the powers, both (U, N) in units of the average power."""
        total = _total(slopes, local)
        self._constant.value = 1 / total
        self._slopes.value = slopes / total


class _LeakageBound:
    """
    An upper bound of r-tilde_e for one eavesdropper, exact at the local point.

    :ivar value: the convex CVXPY expression, (N,) in nats.
    """

    def __init__(self, powers: Any) -> None:
        self._jamming = _LogOfSum(powers)
        self._constant = cp.Parameter(powers.shape[1])
        self._slopes = cp.Parameter(powers.shape, nonneg=True)
        self.value: Any = self._constant + _dot(self._slopes, powers) - self._jamming.value

    def set_local_point(self, slopes: Array, local: Array) -> None:
        """Set the gains and the powers, both (U, N) in units of the average power."""
        total = _total(slopes, local)
        self._jamming.set_local_point(_of_jammers(slopes), local)
        self._slopes.value = slopes / total
        self._constant.value = (np.log(total / _total(_of_jammers(slopes), local))
                                - (total - 1) / total)


def _dot(slopes: Any, powers: Any) -> Any:
    return cp.sum(cp.multiply(slopes, powers), axis=0)


def _total(slopes: Array, local: Array) -> Array:
    """Return the power received at the local point with the noise, whose power is 1, (N,)."""
    return np.asarray(1 + (slopes * local).sum(axis=0))


def _of_jammers(slopes: Array) -> Array:
    return np.concatenate([np.zeros_like(slopes[:1]), slopes[1:]])
