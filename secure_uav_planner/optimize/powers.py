"""Section III-A: transmit and jamming powers for given trajectories, as a convex problem."""

import cvxpy as cp
import numpy as np

from .conic import solve_with_clarabel
from ..channel import ground_gains, guaranteed_gains


class PowerProblem:
    """
    The convex restriction (R1_app) of problem (sub_1), built once for a shape.

    All logarithms are natural, their arguments 1 at the local point, and powers are in units of
    the average power: values near one keep the solver accurate.

    :param count: U.
    :param eavesdroppers: E.
    :param slots: N.
    :ivar problem: the cvxpy.Problem.
    :ivar power: its variable, (U, N) in units of the average power.
    """

    def __init__(self, count, eavesdroppers, slots):
        self.power = cp.Variable((count, slots), nonneg=True)
        leak = cp.Variable(slots)
        self._peak = cp.Parameter((count, 1), nonneg=True)
        # log((1 + sum_i g_i p_i) / value at the local point)
        self._ground_constant = cp.Parameter(slots, nonneg=True)
        self._ground_slope = cp.Parameter((count, slots), nonneg=True)
        self._interference_slope = cp.Parameter((count, slots), nonneg=True)
        # For every eavesdropper the same two terms with its own gains, and the leak at the point.
        shapes = range(eavesdroppers)
        self._jam_constant = [cp.Parameter(slots, nonneg=True) for _ in shapes]
        self._jam_slope = [cp.Parameter((count, slots), nonneg=True) for _ in shapes]
        self._total_slope = [cp.Parameter((count, slots), nonneg=True) for _ in shapes]
        self._leak_constant = [cp.Parameter(slots) for _ in shapes]

        def dot(slope):
            return cp.sum(cp.multiply(slope, self.power), axis=0)

        rate = (cp.log(self._ground_constant + dot(self._ground_slope))
                - dot(self._interference_slope) - leak)
        constraints = [self.power <= self._peak @ np.ones((1, slots)),
                       cp.sum(self.power, axis=1) <= slots]
        for eve in shapes:
            constraints.append(
                leak >= self._leak_constant[eve] + dot(self._total_slope[eve])
                - cp.log(self._jam_constant[eve] + dot(self._jam_slope[eve])))
        self.problem = cp.Problem(cp.Maximize(cp.sum(rate)), constraints)

    def solve(self, scenario, positions, powers, time_left=np.inf):
        """
        Return the powers that maximise the restriction at a local point, and the solver's time.

        :param positions: q_i[n], (U, N+2, 2) in m.
        :param powers: the local point p_i^(m)[n], (U, N) in W.
        :param time_left: limit for the solver in s.
        :return: powers, (U, N) in W, nearly feasible, or None if none were found; time in s.
        """
        unit = np.array([uav.average_power for uav in scenario.uavs])[:, None]
        self._peak.value = np.array([[uav.peak_power] for uav in scenario.uavs]) / unit
        received = ground_gains(scenario, positions) * powers
        slopes = ground_gains(scenario, positions) * unit
        total, jamming = 1 + received.sum(axis=0), 1 + received[1:].sum(axis=0)
        self._ground_constant.value = 1 / total
        self._ground_slope.value = slopes / total
        self._interference_slope.value = _of_jammers(slopes) / jamming
        for eve, gains in enumerate(guaranteed_gains(scenario, positions)):
            received, slopes = gains * powers, gains * unit
            total, jamming = 1 + received.sum(axis=0), 1 + received[1:].sum(axis=0)
            self._jam_constant[eve].value = 1 / jamming
            self._jam_slope[eve].value = _of_jammers(slopes) / jamming
            self._total_slope[eve].value = slopes / total
            self._leak_constant[eve].value = (
                np.log(total / jamming) - received.sum(axis=0) / total)
        solved, seconds = solve_with_clarabel(self.problem, time_left)
        return (self.power.value * unit if solved else None), seconds


def _of_jammers(slopes):
    return np.concatenate([np.zeros_like(slopes[:1]), slopes[1:]])
