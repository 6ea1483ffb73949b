"""What is answered: a rate that no plan exceeds."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, Protocol

from ..errors import OptionError, shown
from ..mission import OBJECTIVES
from ..mission.scenario import Scenario
from ..mission.validation import checked_kind

STATUSES = ('converged', 'time_limit', 'cancelled')
"""Why the search ended; the bound is valid whatever the reason."""

RATE_NAMES = {'guaranteed': 'guaranteed rate', 'worst_case': 'worst-case rate'}
"""What each objective maximises, in words."""

_FIELDS = ('rate', 'objective', 'ignored', 'solve_time', 'status')


class Rated(Protocol):
    """What a bound needs of a plan: its scenario and its rates in bit/s/Hz."""

    @property
    def scenario(self) -> Scenario:
        """Return what the plan is for."""

    @property
    def guaranteed_rate(self) -> float:
        """Return the mean of the rate of (P2)."""

    @property
    def worst_case_rate(self) -> float:
        """Return the mean of the rate of (P1)."""


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
        checked_kind('scenario', self.scenario, Scenario)
        object.__setattr__(self, 'rate', _checked_rate(self.rate))
        checked_objective(self.objective)
        _checked_status(self.status)
        object.__setattr__(self, 'ignored', _checked_names(self.ignored))
        object.__setattr__(self, 'solve_time', _checked_time(self.solve_time))

    def __repr__(self) -> str:
        return (f'<Bound: no plan has a {RATE_NAMES[self.objective]} above {self.rate:.4f} '
                f'bit/s/Hz, {self.status}>')

    def gap(self, plan: Rated) -> float:
        """
        Return which share of its rate a plan may be missing, (bound - rate) / rate.

        Infinite for a plan without a positive rate, unless nothing can be had: then 0. Negative
        for a bound that is wrong, for no plan has a larger rate than a true one.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        checked_plan(plan, self.scenario)
        rate = plan.guaranteed_rate if self.objective == 'guaranteed' else plan.worst_case_rate
        if rate > 0:
            return (self.rate - rate) / rate
        return math.inf if self.rate > rate else 0.0

    def share_missing(self, plan: Rated) -> float:
        """
        Return which share of the best possible rate a plan misses at most, (bound - rate) / bound.

        :param plan: a Plan of the scenario.
        :raises OptionError: for anything else.
        """
        gap = self.gap(plan)
        return 1.0 if math.isinf(gap) else gap / (1.0 + gap)

    def claim(self, plan: Rated) -> str:
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
        data = dict(_checked_fields(data, _FIELDS))
        if data['rate'] is None:
            data['rate'] = math.inf
        return cls(scenario=scenario, **data)


def checked_objective(objective: Any) -> str:
    """Return the objective, or raise OptionError naming those that there are."""
    return _one_of('objective', objective, OBJECTIVES)


def checked_plan(plan: Any, scenario: Scenario) -> Rated:
    """Return the plan; raise OptionError unless it is one of this very scenario."""
    if not isinstance(getattr(plan, 'scenario', None), Scenario):
        raise OptionError(f'plan is {shown(plan)}; it must be a Plan')
    if plan.scenario != scenario:
        raise OptionError('plan is for another scenario; '
                          'it must be a plan of the scenario that the bound is for')
    rated: Rated = plan
    return rated


def _checked_status(status: Any) -> str:
    """Return the status, or raise OptionError naming those that there are."""
    return _one_of('status', status, STATUSES)


def _checked_rate(rate: Any) -> float:
    """Return a bound as a float; raise OptionError unless it is a number or infinite."""
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or math.isnan(rate):
        raise OptionError(f'rate is {shown(rate)}; it must be a number in bit/s/Hz')
    return float(rate)


def _checked_names(ignored: Any) -> tuple[str, ...]:
    """Return the names of limits as a tuple; raise OptionError for anything else."""
    if not isinstance(ignored, (list, tuple)) or not all(
            isinstance(name, str) for name in ignored):
        raise OptionError(f'ignored is {shown(ignored)}; it must be names of limits')
    return tuple(ignored)


def _checked_time(solve_time: Any) -> float:
    """Return a time that was taken as a float; raise OptionError unless it is from 0 s."""
    if (isinstance(solve_time, bool) or not isinstance(solve_time, (int, float))
            or not 0 <= solve_time < math.inf):
        raise OptionError(f'solve_time is {shown(solve_time)}; it must be a finite number from 0')
    return float(solve_time)


def _checked_fields(data: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """Return what Bound.to_dict wrote; raise OptionError for missing or unknown fields."""
    if not isinstance(data, dict) or set(data) != set(names):
        found = sorted(map(str, data)) if isinstance(data, dict) else data
        raise OptionError(f'a bound has the fields {shown(found)}; it must have {sorted(names)!r}')
    return data


def _one_of(field: str, value: Any, allowed: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in allowed:
        raise OptionError(f'{field} is {shown(value)}; it must be one of {shown(allowed)}')
    return value
