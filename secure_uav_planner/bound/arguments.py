"""What upper_bound and Bound refuse, and how they say so: the only place that raises."""

from __future__ import annotations

import math
from typing import Any

from ..plan import Plan
from ..scenario import Scenario


OBJECTIVES = ('guaranteed', 'worst_case')
"""The paper's (P2), the rate by formula, and its (P1), the rate against the worst place."""

STATUSES = ('converged', 'time_limit', 'cancelled')
"""Why the search ended; the bound is valid whatever the reason."""


def checked_scenario(scenario: Any) -> Scenario:
    """Return the scenario, or raise ValueError for anything else."""
    if not isinstance(scenario, Scenario):
        raise ValueError(f'scenario is {scenario!r}; it must be a Scenario')
    return scenario


def checked_objective(objective: Any) -> str:
    """Return the objective, or raise ValueError naming those that there are."""
    return _one_of('objective', objective, OBJECTIVES)


def checked_status(status: Any) -> str:
    """Return the status, or raise ValueError naming those that there are."""
    return _one_of('status', status, STATUSES)


def _one_of(field: str, value: Any, allowed: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f'{field} is {value!r}; it must be one of {allowed!r}')
    return value


def checked_time_limit(time_limit: Any) -> float | None:
    """Return the time limit as a float or None; raise ValueError unless it is above 0 s."""
    if time_limit is None:
        return None
    try:
        number = float(time_limit)
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(time_limit, bool) or not number > 0:
        raise ValueError(f'time_limit is {time_limit!r}; it must be above 0 s, or None')
    return number


def checked_callback(on_progress: Any) -> Any:
    """Return the callback; raise ValueError unless it is None or can be called."""
    if on_progress is not None and not callable(on_progress):
        raise ValueError(f'on_progress is {on_progress!r}; it must be callable, or None')
    return on_progress


def checked_plan(plan: Any, scenario: Scenario) -> Plan:
    """Return the plan; raise ValueError unless it is one of this very scenario."""
    if not isinstance(plan, Plan):
        raise ValueError(f'plan is {plan!r}; it must be a Plan')
    if plan.scenario != scenario:
        raise ValueError('plan is for another scenario; '
                         'it must be a plan of the scenario that the bound is for')
    return plan


def checked_rate(rate: Any) -> float:
    """Return a bound as a float; raise ValueError unless it is a number or infinite."""
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or math.isnan(rate):
        raise ValueError(f'rate is {rate!r}; it must be a number in bit/s/Hz')
    return float(rate)


def checked_fields(data: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """Return what Bound.to_dict wrote; raise ValueError for missing or unknown fields."""
    if not isinstance(data, dict) or set(data) != set(names):
        found = sorted(map(str, data)) if isinstance(data, dict) else data
        raise ValueError(f'a bound has the fields {found!r}; it must have {sorted(names)!r}')
    return data
