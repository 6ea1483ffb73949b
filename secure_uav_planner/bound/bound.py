"""What is answered: a rate that no plan exceeds."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

from . import arguments
from ..plan import Plan
from ..scenario import Scenario

STATUSES = arguments.STATUSES

_FIELDS = ('rate', 'objective', 'ignored', 'solve_time', 'status')


@dataclass(frozen=True)
class Progress:
    """
    How far a bound has come, for callbacks.

    :param number: counts from 0, the bound that takes no search.
    :param rate: the best bound so far, in bit/s/Hz.
    :param elapsed: since the call of upper_bound, in s.
    """

    number: int
    rate: float
    elapsed: float


@dataclass(frozen=True)
class Bound:
    """
    A proven upper bound on the mean rate of every feasible plan of a scenario.

    It holds for everything that a Plan accepts, tolerances included.

    :param scenario: what it is a bound for.
    :param rate: in bit/s/Hz, perhaps infinite: no feasible plan has a larger one.
    :param objective: 'guaranteed', the rate of problem (P2), or 'worst_case', that of (P1).
    :param ignored: limits of the scenario that the bound does not use. They can only lower what
        plans reach: the bound is valid, but looser.
    :param solve_time: in s.
    :param status: one of STATUSES, why the search for a smaller bound ended.
    :raises OptionError: naming the field, its value and what is allowed.
    """

    scenario: Scenario
    rate: float
    objective: str = 'worst_case'
    ignored: tuple[str, ...] = ()
    solve_time: float = 0.0
    status: str = 'converged'

    def __post_init__(self) -> None:
        arguments.checked_scenario(self.scenario)
        object.__setattr__(self, 'rate', arguments.checked_rate(self.rate))
        arguments.checked_objective(self.objective)
        arguments.checked_status(self.status)
        object.__setattr__(self, 'ignored', arguments.checked_names(self.ignored))
        object.__setattr__(self, 'solve_time', arguments.checked_time(self.solve_time))

    def gap(self, plan: Plan) -> float:
        """
        Return which share of its rate a plan may be missing, (bound - rate) / rate.

        Infinite for a plan without a positive rate, unless nothing can be had: then 0.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        arguments.checked_plan(plan, self.scenario)
        rate = plan.guaranteed_rate if self.objective == 'guaranteed' else plan.worst_case_rate
        missing = max(self.rate - rate, 0.0)
        if missing == 0.0:
            return 0.0
        return missing / rate if rate > 0 else math.inf

    def share_missing(self, plan: Plan) -> float:
        """
        Return which share of the best possible rate a plan misses at most, from 0 to 1.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        gap = self.gap(plan)
        return 1.0 if math.isinf(gap) else gap / (1.0 + gap)

    def claim(self, plan: Plan) -> str:
        """
        Return in words what it proves of a plan, such as 'at most 0.9% below the best possible'.

        Where the bound does not use a limit, the best is that of a mission without it.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        share = self.share_missing(plan)
        without = f' without {", ".join(self.ignored)}' if self.ignored else ''
        if math.isinf(self.rate):
            return f'perhaps far below the best possible{without}'
        return f'at most {math.ceil(1000 * share) / 10:.1f}% below the best possible{without}'

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the scenario as plain values; an infinite rate is None."""
        return {'rate': self.rate if math.isfinite(self.rate) else None,
                'objective': self.objective, 'ignored': list(self.ignored),
                'solve_time': self.solve_time, 'status': self.status}

    @classmethod
    def from_dict(cls, data: dict[str, Any], scenario: Scenario) -> Bound:
        """
        Return the bound that to_dict wrote.

        :param data: what to_dict returned.
        :param scenario: what the bound is for.
        :raises OptionError: for a missing or unknown field as well as for a wrong value.
        """
        data = dict(arguments.checked_fields(data, _FIELDS))
        if data['rate'] is None:
            data['rate'] = math.inf
        return cls(scenario=scenario, **data)
