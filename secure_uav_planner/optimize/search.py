"""The state of one call of solve: the best feasible iterate, and what was reported of it."""

import numpy as np

from .termination import Termination
from ..mission.scenario import Array, Scenario
from ..model.channel import guaranteed_rates, worst_case_rates
from ..model.limits import is_clear, repaired, repaired_powers
from ..plan.plan import Iteration, Objective, Plan, Status

_NEGLIGIBLE_RATE = 1e-7  # A slot with a lower rate, in bit/s/Hz, is not worth any power.
_IDLE_SHARE = 1e-3  # A slot with a smaller share of the mean rate carries nothing.
_JAMMING_SHARES = (0.1, 0.01, 0.001, 0.0)  # Of the present power, that try_less_jamming tries.


class Search:
    """
    What every method shares.

    A method proposes iterates by try_improve() and ends when stop_reason() is not None or it has
    converged. Only feasible iterates that raise the true objective are kept, so the objective
    is monotone and there is a plan at any time.

    :param positions: feasible start, (U, N+2, 2) in m.
    :param powers: feasible start, (U, N) in W.
    :param termination: the deadline and the callback, to which every Iteration is reported.
    :param warm: whether the start is an earlier plan rather than a guess.
    :param objective: which rate is to be raised.
    :param parent: a search of which this one is a part, and which reports in its place.
    :ivar rate: that of the present iterate, in bit/s/Hz.
    """

    def __init__(self, scenario: Scenario, positions: Array, powers: Array,
                 termination: Termination | None = None, warm: bool = False,
                 objective: Objective = 'guaranteed', parent: 'Search | None' = None) -> None:
        self.scenario = scenario
        self.objective: Objective = objective
        self.warm = warm
        self.solver_time = 0.0
        self.history: list[Iteration] = []
        self.termination = Termination() if termination is None else termination
        self._parent = parent
        self.positions = positions
        self.powers, self._rates = without_losing_slots(
            scenario, positions, powers, objective)
        self.rate = float(self._rates.mean())
        if parent is None:
            self.report('start')

    def stop_reason(self) -> Status | None:
        """Return the status in which the search must end now, or None."""
        return self.termination.reason()

    def try_improve(self, positions: Array | None = None, powers: Array | None = None) -> float:
        """
        Keep the iterate if, made feasible, it is better; return by how much in bit/s/Hz, or 0.

        :param positions: (U, N+2, 2) in m, or None for the present ones.
        :param powers: (U, N) in W, or None for the present ones.
        """
        # What stays the same stays so to the last bit.
        if positions is None:
            positions = self.positions
        else:
            positions, _ = repaired(self.scenario, positions, self.powers)
            if not is_clear(self.scenario, positions):
                return 0.0
        powers = (self.powers if powers is None else
                  repaired_powers(self.scenario, positions, powers))
        powers, rates = without_losing_slots(
            self.scenario, positions, powers, self.objective)
        rate = float(rates.mean())
        gain = rate - self.rate
        if not gain > 0:  # also when it is NaN
            return 0.0
        self.positions, self.powers, self._rates, self.rate = positions, powers, rates, rate
        return gain

    def try_less_jamming(self) -> None:
        """
        Try shares of the present jamming power, and no jamming in the slots that win without it.

        Powers have local optima, and those with much jamming are usually the worse.
        """
        present = self.powers
        for share in _JAMMING_SHARES:
            self.try_improve(powers=np.concatenate([present[:1], share * present[1:]]))
        alone = powers_without_jamming(self.scenario, self.positions)
        if alone is not None:
            self.try_improve(powers=alone)

    def settle_idle_slots(self) -> None:
        """
        Try, in slots that carry nothing, the powers of the nearest slots that do, or none.

        Powers have local optima in every slot by itself: silence between slots that transmit, or
        so much jamming that nothing arrives.
        """
        slots = np.flatnonzero(self._rates <= _IDLE_SHARE * self.rate)
        useful = np.flatnonzero(self._rates > _IDLE_SHARE * self.rate)
        if not len(slots) or not len(useful):
            return
        positions = self.positions[:, [0, *(slots + 1), -1]]
        after = np.searchsorted(useful, slots)
        powers, best = self.powers.copy(), np.full(len(slots), _IDLE_SHARE * self.rate)
        for near in (after - 1, after):
            tried = self.powers[:, useful[near.clip(0, len(useful) - 1)]]
            _, rates = without_losing_slots(self.scenario, positions, tried, self.objective)
            better = rates > best
            powers[:, slots[better]], best[better] = tried[:, better], rates[better]
        self.try_improve(powers=powers)
        quiet = np.where(self._rates > _IDLE_SHARE * self.rate, self.powers, 0.0)
        spent = np.maximum(quiet.mean(axis=1), self.scenario.average_powers * 1e-9)
        self.try_improve(powers=quiet * (self.powers.mean(axis=1) / spent)[:, None])

    def with_objective(self, objective: Objective) -> 'Search':
        """Return a search for another objective from the present iterate, a part of this one."""
        return Search(self.scenario, self.positions, self.powers, self.termination, self.warm,
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
        self.termination.tell(iteration)

    @property
    def useful_powers(self) -> Array:
        """Powers of the present iterate without those of slots that carry nothing, (U, N) in W."""
        return np.where(self._rates > _NEGLIGIBLE_RATE, self.powers, 0.0)

    def plan(self, method: str, status: Status) -> Plan:
        """Return the best iterate as a Plan, in which slots that carry nothing are silent."""
        if self.stop_reason() is None:
            self.settle_idle_slots()
        last = self.history[-1]
        if self.rate > last.rate and self.stop_reason() is None:  # Found after the last report.
            self.report(last.step)
        return Plan(self.scenario, self.positions, self.useful_powers, method, status,
                    tuple(self.history), self.termination.elapsed,
                    objective=self.objective)


def without_losing_slots(scenario: Scenario, positions: Array, powers: Array,
                         objective: Objective = 'guaranteed') -> tuple[Array, Array]:
    """Return powers (U, N) in W, silent where the rate is negative, and the rates (N,)."""
    rates = (guaranteed_rates if objective == 'guaranteed' else worst_case_rates)(
        scenario, positions, powers)
    powers = powers.copy()
    powers[0, rates < 0] = 0.0
    return powers, np.maximum(rates, 0.0)  # Where nothing is transmitted, nothing leaks.


def powers_without_jamming(scenario: Scenario, positions: Array,
                           share: float = 1.0) -> Array | None:
    """
    Return powers that transmit only in the slots that win without any jamming, (U, N) in W.

    These have a share of the transmitter's average power. None where no slot wins.
    """
    powers = np.zeros((len(scenario.uavs), scenario.slots))
    powers[0] = share * scenario.average_powers[0]
    winning = guaranteed_rates(scenario, positions, powers) > 0
    if not winning.any():
        return None
    powers[0] *= winning / winning.mean()
    return powers
