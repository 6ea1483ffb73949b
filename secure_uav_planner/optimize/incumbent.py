"""The state of one call of solve: its best feasible iterate, its history and its end."""

from collections.abc import Callable
from dataclasses import replace
import time
from typing import TypeAlias

import numpy as np

from ..errors import StoppedError, TimeLimitError
from ..mission.scenario import Array, Scenario
from ..model.channel import find_rate_scale, guaranteed_rates, worst_case_rates
from ..model.limits import is_clear, repair, repair_powers
from ..plan.plan import Iteration, Objective, Plan, Status

OnIteration: TypeAlias = Callable[[Iteration], object]

_PERIOD = 0.05  # Between calls of the callback where iterations are far apart, in s.
_NEGLIGIBLE_RATE = 1e-7  # A slot with less, times the mission's scale, is not worth any power.
_IDLE_SHARE = 1e-3  # A slot with a smaller share of the mean rate carries nothing.
_JAMMING_SHARES = (0.1, 0.01, 0.001, 0.0)  # Of the present power, that try_less_jamming tries.


class Termination:
    """
    The deadline and the callback of one call of solve, from its beginning.

    :param on_iteration: called with Iterations; returning True cancels.
    :param time_limit: in s from now, or None.
    :param repeats: whether the callback is also called between iterations, with the last one;
        where first flights are searched for, iterations can be far apart.
    """

    def __init__(self, on_iteration: OnIteration | None = None,
                 time_limit: float | None = None, repeats: bool = False) -> None:
        self._on_iteration = on_iteration
        self._time_limit = time_limit
        self._period = _PERIOD if repeats else np.inf
        self._started = time.monotonic()
        self._last = Iteration(0, 'start', 0.0, 0.0, 0.0)
        self._last_call = -np.inf  # Of the callback, in s from the beginning.
        self._cancelled = False

    @property
    def elapsed(self) -> float:
        """Time since the beginning, in s."""
        return time.monotonic() - self._started

    @property
    def time_left(self) -> float:
        """Time until the deadline in s, infinite without one."""
        return np.inf if self._time_limit is None else self._time_limit - self.elapsed

    def report(self, iteration: Iteration) -> None:
        """Call the callback, which may cancel."""
        self._last, self._last_call = iteration, self.elapsed
        if self._on_iteration is not None and self._on_iteration(iteration):
            self._cancelled = True

    def stop_reason(self) -> Status | None:
        """Return the status in which the call must end now, or None."""
        if not self._cancelled and self.elapsed - self._last_call > self._period:
            self.report(replace(self._last, elapsed=self.elapsed))
        if self._cancelled:
            return 'cancelled'
        return 'time_limit' if self.time_left <= 0 else None

    def check(self) -> None:
        """
        End the search for first flights if the call must end.

        :raises StoppedError: when the callback has cancelled.
        :raises TimeLimitError: past the deadline.
        """
        reason = self.stop_reason()
        if reason == 'cancelled':
            raise StoppedError('cancelled before flights that keep the limits were found')
        if reason is not None:
            raise TimeLimitError(
                f'time_limit is {self._time_limit:g} s; it was over before flights that keep the '
                'limits were found; with more time, or fewer slots, there may be some')


class Incumbent:
    """
    The best feasible iterate of a call of solve, which all methods improve.

    A method proposes iterates by try_improve() and ends when stop_reason() is not None or it has
    converged. Only feasible iterates that raise the true objective are kept, so the objective
    is monotone and there is a plan at any time.

    :param positions: feasible start, (U, N+2, 2) in m.
    :param powers: feasible start, (U, N) in W.
    :param termination: the deadline and the callback, to which every Iteration is reported.
    :param warm: whether the start is an earlier plan.
    :param objective: the rate to be raised.
    :param parent: the incumbent of the call where this is one of a part, and which reports for it.
    :ivar rate: of the present iterate, in bit/s/Hz.
    """

    def __init__(self, scenario: Scenario, positions: Array, powers: Array,
                 termination: Termination | None = None, warm: bool = False,
                 objective: Objective = 'guaranteed', parent: 'Incumbent | None' = None) -> None:
        self.scenario = scenario
        self.objective: Objective = objective
        self.warm = warm
        self.solver_time: float = 0.0 if parent is None else parent.solver_time
        self.history: list[Iteration] = []
        self.termination = Termination() if termination is None else termination
        self._parent = parent
        self.positions = positions
        self._negligible = _NEGLIGIBLE_RATE * find_rate_scale(scenario)
        self.powers, self._rates = self._silence_losing_slots(positions, powers)
        self.rate = float(self._rates.mean())
        if parent is None:
            self.report('start')

    def stop_reason(self) -> Status | None:
        """Return the status in which the method must end now, or None."""
        return self.termination.stop_reason()

    def try_improve(self, positions: Array | None = None, powers: Array | None = None) -> float:
        """
        Keep an iterate if, made feasible, it is better; return the gain in bit/s/Hz, or 0.

        :param positions: (U, N+2, 2) in m, or None for the present ones.
        :param powers: (U, N) in W, or None for the present ones.
        """
        if positions is None:
            positions = self.positions  # To the last bit.
        else:
            positions, _ = repair(self.scenario, positions, self.powers)
            if not is_clear(self.scenario, positions):
                return 0.0
        powers = (self.powers if powers is None else
                  repair_powers(self.scenario, positions, powers))
        powers, rates = self._silence_losing_slots(positions, powers)
        rate = float(rates.mean())
        gain = rate - self.rate
        if not gain > 0:  # also when it is NaN
            return 0.0
        self.positions, self.powers, self._rates, self.rate = positions, powers, rates, rate
        return gain

    def _silence_losing_slots(self, positions: Array, powers: Array) -> tuple[Array, Array]:
        """Return powers, silent where the rate is negative, and rates, 0 where negligible."""
        powers, rates = silence_losing_slots(self.scenario, positions, powers, self.objective)
        return powers, np.where(rates > self._negligible, rates, 0.0)

    def try_less_jamming(self) -> None:
        """
        Try shares of the present jamming power, and no jamming in the slots that win without it.

        Powers have local optima, and those with much jamming are usually the worse.
        """
        present = self.powers
        for share in _JAMMING_SHARES:
            self.try_improve(powers=np.concatenate([present[:1], share * present[1:]]))
        alone = find_powers_without_jamming(self.scenario, self.positions)
        if alone is not None:
            self.try_improve(powers=alone)

    def try_idle_slots(self) -> None:
        """
        Try, in slots that carry nothing, the powers of the nearest slots that do, or none.

        Powers have local optima in each single slot: silence between slots that transmit, or so
        much jamming that nothing arrives.
        """
        slots = np.flatnonzero(self._rates <= _IDLE_SHARE * self.rate)
        useful = np.flatnonzero(self._rates > _IDLE_SHARE * self.rate)
        if not len(slots) or not len(useful):
            return
        positions = self.positions[:, [0, *(slots + 1), -1]]
        times = np.asarray((slots + 1) * self.scenario.slot_duration, float)
        after = np.searchsorted(useful, slots)
        powers, best = self.powers.copy(), np.full(len(slots), _IDLE_SHARE * self.rate)
        for near in (after - 1, after):
            tried = self.powers[:, useful[near.clip(0, len(useful) - 1)]]
            _, rates = silence_losing_slots(
                self.scenario, positions, tried, self.objective, times)
            better = rates > best
            powers[:, slots[better]], best[better] = tried[:, better], rates[better]
        self.try_improve(powers=powers)
        quiet = np.where(self._rates > _IDLE_SHARE * self.rate, self.powers, 0.0)
        spent = np.maximum(quiet.mean(axis=1), self.scenario.average_powers * 1e-9)
        self.try_improve(powers=quiet * (self.powers.mean(axis=1) / spent)[:, None])

    def with_objective(self, objective: Objective) -> 'Incumbent':
        """Return an incumbent for another objective, from the present iterate, as a part."""
        return Incumbent(self.scenario, self.positions, self.powers, self.termination, self.warm,
                         objective, parent=self)

    def report(self, step: str) -> None:
        """Add the present iterate to the history and call the callback."""
        if self._parent is not None:
            self._parent.solver_time = self.solver_time
            self._parent.report(step)
            return
        iteration = Iteration(len(self.history), step, self.rate, self.termination.elapsed,
                              self.solver_time)
        self.history.append(iteration)
        self.termination.report(iteration)

    @property
    def useful_powers(self) -> Array:
        """Powers of the present iterate, zero in slots that carry nothing, (U, N) in W."""
        return np.where(self._rates > 0.0, self.powers, 0.0)

    def to_plan(self, method: str, status: Status) -> Plan:
        """Return the iterate as a Plan, in which slots that carry nothing are silent."""
        if self.stop_reason() is None:
            self.try_idle_slots()
        last = self.history[-1]
        if self.rate > last.rate and self.stop_reason() is None:
            self.report(last.step)
        return Plan(self.scenario, self.positions, self.useful_powers, method, status,
                    tuple(self.history), self.termination.elapsed,
                    objective=self.objective)


def silence_losing_slots(scenario: Scenario, positions: Array, powers: Array,
                         objective: Objective = 'guaranteed', times: Array | None = None
                         ) -> tuple[Array, Array]:
    """
    Return powers (U, N) in W, silent where the rate is negative, and the rates (N,).

    :param times: as for guaranteed_rates.
    """
    rates = (guaranteed_rates if objective == 'guaranteed' else worst_case_rates)(
        scenario, positions, powers, times=times)
    powers = powers.copy()
    powers[0, rates < 0] = 0.0
    return powers, np.maximum(rates, 0.0)  # Where nothing is transmitted, nothing leaks.


def find_powers_without_jamming(scenario: Scenario, positions: Array,
                                share: float = 1.0) -> Array | None:
    """
    Return powers that transmit only in the slots that win without any jamming, (U, N) in W.

    Their mean is a share of the transmitter's average power. None where no slot wins.
    """
    powers = np.zeros((len(scenario.uavs), scenario.slots))
    powers[0] = share * scenario.average_powers[0]
    winning = guaranteed_rates(scenario, positions, powers) > 0
    if not winning.any():
        return None
    powers[0] *= winning / winning.mean()
    return powers
