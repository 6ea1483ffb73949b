"""The state of one call of solve: its best feasible iterate, its history and its end."""

import math
import time

import numpy as np

from .deadline import Deadline
from ..mission.scenario import Array, Scenario
from ..model.channel import find_rate_scale, guaranteed_rates, NODE_RATES
from ..model.channel.rates import find_least_rate
from ..model.channel.shares import find_shares
from ..model.limits import lift_limits
from ..model.problem import Problem
from ..plan.plan import Iteration, Objective, Plan, Status

_NEGLIGIBLE_RATE = 1e-7  # Rate [bit/s/Hz] over find_rate_scale below which a rate is set to 0.
_IDLE_SHARE = 1e-3  # Fraction of the incumbent's rate up to which a slot is idle.
_JAMMING_SHARES = (0.1, 0.01, 0.001, 0.0)  # Fractions of the jamming power to try.


class Incumbent:
    """
    The best feasible iterate of a call of solve, which all methods improve.

    A method proposes iterates by try_improve() and ends when its deadline is over or it has
    converged. Only feasible iterates that raise the true objective are kept, so the objective
    is monotone and there is a plan at any time.

    :param problem: the problem to be solved.
    :param positions: start, (U, N+2, 2) in m, feasible except that it may take too much energy.
    :param powers: feasible powers of the start, (U, N) in W.
    :param deadline: deadline of the call, to which every Iteration is reported.
    :param warm: whether the start is an earlier plan.
    :param objective: the rate to be raised.
    :param common_start: addition to reported rates, which the scenario leaves out [bit/s/Hz].
    :param parent: enclosing incumbent, which makes the reports; None for the outermost one.
    :ivar rate: rate of the present iterate [bit/s/Hz]; -infinite if it takes too much energy.
    :ivar shares: fraction of each slot for each ground node in the present iterate, (G, N).
    """

    def __init__(self, problem: Problem, positions: Array, powers: Array,
                 deadline: Deadline | None = None, warm: bool = False,
                 objective: Objective = 'guaranteed', parent: 'Incumbent | None' = None,
                 common_start: float = 0.0) -> None:
        self.problem = problem
        self.scenario = problem.scenario
        self.objective: Objective = objective
        self.warm = warm
        self.solver_time: float = 0.0 if parent is None else parent.solver_time
        self.history: list[Iteration] = []
        self.deadline = Deadline() if deadline is None else deadline
        self._parent, self._common_start = parent, common_start
        self.positions = positions
        self._negligible = _NEGLIGIBLE_RATE * find_rate_scale(self.scenario)
        self.powers, self.rate = powers, -math.inf
        self._keeps_energy = True
        self._longest_try = 0.0  # Longest duration of try_improve [s].
        self.try_improve()
        if not problem.keeps_energy(positions):
            self._keeps_energy, self.rate = False, -math.inf  # Below any flights that keep it.
        if parent is None:
            self.report('start')

    def try_improve(self, positions: Array | None = None, powers: Array | None = None) -> float:
        """
        Retract an iterate to the limits; keep it if it is then feasible and its rate is higher.

        :param positions: (U, N+2, 2) in m, or None for the present positions.
        :param powers: (U, N) in W, or None for the present powers.
        :return: the rise of the rate [bit/s/Hz], or 0 if the iterate is not kept.
        """
        began = time.monotonic()
        if positions is None:
            if not self._keeps_energy:
                return 0.0  # Flights that take too much energy do so with any powers.
            positions = self.positions  # Feasible; retracting them might change a digit.
        else:
            positions = self.problem.retract(positions)
            if not (self.problem.keeps_energy(positions) and self.problem.is_clear(positions)):
                return 0.0
        powers = self.powers if powers is None else self.problem.retract_powers(powers)
        powers, rates = mute_negative_slots(self.scenario, positions, powers, self.objective)
        rates = np.where(rates > self._negligible, rates, 0.0)
        shares = find_shares(self.scenario, rates)
        rate = find_least_rate(self.scenario, (shares * rates).mean(axis=1))
        self._longest_try = max(self._longest_try, time.monotonic() - began)
        gain = rate - self.rate
        if not gain > 0:  # A gain that is NaN is refused as well.
            return 0.0
        self.positions, self.powers, self.shares, self.rate = positions, powers, shares, rate
        self._keeps_energy = True
        self._rates = (shares * rates).sum(axis=0)
        return gain

    def raise_if_over(self) -> None:
        """Raise the deadline's error if no time is left to try an iterate here and in parents."""
        # Enclosing incumbents try the result as well, in at most _longest_try s each.
        reserve, parent = self._longest_try, self._parent
        while parent is not None:
            reserve, parent = reserve + parent._longest_try, parent._parent
        self.deadline.raise_if_over(reserve)

    def try_less_jamming(self) -> None:
        """
        Try the jamming powers times each of _JAMMING_SHARES, then find_powers_without_jamming.

        Powers have local optima, and optima with much jamming are usually worse than others. When
        the deadline is over, nothing more is tried.
        """
        present = self.powers
        for share in _JAMMING_SHARES:
            if self.deadline.poll():
                return
            self.try_improve(powers=np.concatenate([present[:1], share * present[1:]]))
        alone = find_powers_without_jamming(self.scenario, self.positions)
        if alone is not None:
            self.try_improve(powers=alone)

    def try_idle_slots(self) -> None:
        """
        Try the powers of the nearest useful slots in idle slots, then no power in idle slots.

        A slot is idle if its rate is at most _IDLE_SHARE * self.rate, otherwise useful. In idle
        slots powers are in a local optimum: silence, or too much jamming. An idle slot is given
        the better powers of the useful slots before and after it, if it is useful with them. In
        the second try, powers of useful slots are scaled up so that each UAV's mean power stays.
        """
        most = _IDLE_SHARE * self.rate  # Largest rate of an idle slot.
        idle, useful = np.flatnonzero(self._rates <= most), np.flatnonzero(self._rates > most)
        if not len(idle) or not len(useful):
            return
        positions = self.positions[:, [0, *(idle + 1), -1]]
        times = np.asarray((idle + 1) * self.scenario.slot_duration, float)
        after = np.searchsorted(useful, idle)  # Index in `useful` of the next useful slot.
        powers, best = self.powers.copy(), np.full(len(idle), most)
        for neighbour in (after - 1, after):
            tried = self.powers[:, useful[neighbour.clip(0, len(useful) - 1)]]
            _, rates = mute_negative_slots(
                self.scenario, positions, tried, self.objective, times)
            rates = rates.max(axis=0)
            better = rates > best
            powers[:, idle[better]], best[better] = tried[:, better], rates[better]
        self.try_improve(powers=powers)
        quiet = np.where(self._rates > _IDLE_SHARE * self.rate, self.powers, 0.0)
        # The floor avoids a division by 0 for a UAV that sends in idle slots only.
        spent = np.maximum(quiet.mean(axis=1), self.scenario.average_powers * 1e-9)
        self.try_improve(powers=quiet * (self.powers.mean(axis=1) / spent)[:, None])

    def with_objective(self, objective: Objective) -> 'Incumbent':
        """Return an incumbent from this one's iterate for an objective, with this as parent."""
        return Incumbent(self.problem, self.positions, self.powers, self.deadline, self.warm,
                         objective, parent=self)

    def without_energy_limits(self, objective: Objective) -> 'Incumbent':
        """Return an incumbent from this one's iterate without max_energy, with this as parent."""
        return Incumbent(Problem(lift_limits(self.scenario)), self.positions, self.powers,
                         self.deadline, self.warm, objective, parent=self)

    def report(self, step: str) -> None:
        """Add the outermost incumbent's iterate to its history, and report it to the deadline."""
        if self._parent is not None:
            self._parent.solver_time = self.solver_time
            self._parent.report(step)
            return
        iteration = Iteration(
            len(self.history), step, max(self.rate, 0.0) + self._common_start,
            self.deadline.elapsed, self.solver_time)
        self.history.append(iteration)
        self.deadline.report(iteration)

    @property
    def useful_powers(self) -> Array:
        """Powers of the present iterate, 0 in slots whose rate is 0, (U, N) in W."""
        return np.where(self._rates > 0.0, self.powers, 0.0)

    def to_plan(self, method: str, status: Status) -> Plan:
        """Try idle slots if time is left; return a Plan that is silent in slots of rate 0."""
        if not self.deadline.poll():
            self.try_idle_slots()
        if self.rate + self._common_start > self.history[-1].rate:
            self.report(self.history[-1].step)
        return Plan(self.scenario, self.positions, self.useful_powers, method, status,
                    tuple(self.history), self.deadline.elapsed,
                    objective=self.objective, shares=self.shares)


def mute_negative_slots(scenario: Scenario, positions: Array, powers: Array,
                        objective: Objective = 'guaranteed', times: Array | None = None
                        ) -> tuple[Array, Array]:
    """
    Return powers with 0 for the transmitter in slots whose rates are all negative, and the rates.

    :param times: as for guaranteed_rates.
    :return: powers (U, N) in W and rates [R]^+ of each ground node (G, N) in bit/s/Hz.
    """
    rates = NODE_RATES[objective](scenario, positions, powers, times=times)
    powers = powers.copy()
    powers[0, (rates < 0).all(axis=0)] = 0.0
    return powers, np.maximum(rates, 0.0)  # A slot without transmission has rate 0.


def find_powers_without_jamming(scenario: Scenario, positions: Array,
                                share: float = 1.0) -> Array | None:
    """
    Return powers without jamming that transmit only in slots with a positive guaranteed rate.

    Rates are judged at `share` times the average power in every slot, not at returned powers.

    :param share: mean of the returned powers over the transmitter's average power.
    :return: powers (U, N) in W, or None if no slot has a positive rate.
    """
    powers = np.zeros((len(scenario.uavs), scenario.slots))
    powers[0] = share * scenario.average_powers[0]
    is_positive = guaranteed_rates(scenario, positions, powers) > 0
    if not is_positive.any():
        return None
    powers[0] *= is_positive / is_positive.mean()
    return powers
