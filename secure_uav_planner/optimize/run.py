"""The state of one call of solve: its clock, its callback and the best feasible iterate."""

import time

import numpy as np

from .feasible import feasible_positions, feasible_powers, silence_losing_slots
from ..channel import guaranteed_rates
from ..plan import Iteration, Plan

_NOTHING = 1e-7
"""A slot with a lower rate, in bit/s/Hz, is not worth the power."""


class Run:
    """
    What every method shares.

    A method proposes iterates by offer() and ends when stop_reason() is not None or it has
    converged. Only feasible iterates that raise the true objective are kept, so the objective
    is monotone and there is a plan at any time.

    :param scenario: what to plan.
    :param positions: feasible start, (U, N+2, 2) in m.
    :param powers: feasible start, (U, N) in W.
    :param on_iteration: called with every Iteration; stops the run by returning True.
    :param time_limit: in s from `started`, or None.
    :param started: reading of time.monotonic() from which time counts; by default now.
    :param warm: whether the start is somebody's plan rather than a guess.
    """

    def __init__(self, scenario, positions, powers, on_iteration=None, time_limit=None,
                 started=None, warm=False):
        self.scenario = scenario
        self.warm = warm
        self.solver_time = 0.0
        self.history = []
        self._started = time.monotonic() if started is None else started
        self._on_iteration = on_iteration
        self._time_limit = time_limit
        self._cancelled = False
        self.positions = positions
        self.powers = silence_losing_slots(scenario, positions, powers)
        self.rate = self._rate(self.positions, self.powers)
        self.report('start')

    def _rate(self, positions, powers):
        return float(guaranteed_rates(self.scenario, positions, powers).mean())

    @property
    def elapsed(self):
        """Time since the run started, in s."""
        return time.monotonic() - self._started

    @property
    def time_left(self):
        """Time until the deadline in s, infinite without one."""
        return np.inf if self._time_limit is None else self._time_limit - self.elapsed

    def stop_reason(self):
        """Return the status in which the run must end now, or None."""
        if self._cancelled:
            return 'cancelled'
        return 'time_limit' if self.time_left <= 0 else None

    def offer(self, positions=None, powers=None):
        """
        Keep the iterate if, made feasible, it is better; return by how much in bit/s/Hz, or 0.

        :param positions: (U, N+2, 2) in m, or None for the present ones.
        :param powers: (U, N) in W, or None for the present ones.
        """
        positions = (self.positions if positions is None
                     else feasible_positions(self.scenario, positions))
        powers = self.powers if powers is None else feasible_powers(self.scenario, powers)
        powers = silence_losing_slots(self.scenario, positions, powers)
        rate = self._rate(positions, powers)
        gain = rate - self.rate
        if not gain > 0:  # also when it is NaN
            return 0.0
        self.positions, self.powers, self.rate = positions, powers, rate
        return gain

    def report(self, step):
        """Add the present iterate to the history and call the callback."""
        iteration = Iteration(len(self.history), step, self.rate, self.elapsed, self.solver_time)
        self.history.append(iteration)
        if self._on_iteration is not None and self._on_iteration(iteration):
            self._cancelled = True

    def plan(self, method, status):
        """Return the best iterate as a Plan, with the jammers quiet where nothing is sent."""
        rates = guaranteed_rates(self.scenario, self.positions, self.powers)
        powers = np.where(rates > _NOTHING, self.powers, 0.0)
        return Plan(self.scenario, self.positions, powers, method, status,
                    tuple(self.history), self.elapsed)
