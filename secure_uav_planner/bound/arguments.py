"""What upper_bound and Bound refuse, and how they say so: the only place that raises."""

from __future__ import annotations

import math
from typing import Any

from ..choices import OBJECTIVES
from ..errors import OptionError, shown
from ..plan import Plan
from ..scenario import Scenario

STATUSES = ('converged', 'time_limit', 'cancelled')
"""Why the search ended; the bound is valid whatever the reason."""


def checked_scenario(scenario: Any) -> Scenario:
    """Return the scenario, or raise OptionError for anything else."""
    if not isinstance(scenario, Scenario):
        raise OptionError(f'scenario is {shown(scenario)}; it must be a Scenario')
    return scenario


def checked_objective(objective: Any) -> str:
    """Return the objective, or raise OptionError naming those that there are."""
    return _one_of('objective', objective, OBJECTIVES)


def checked_status(status: Any) -> str:
    """Return the status, or raise OptionError naming those that there are."""
    return _one_of('status', status, STATUSES)


def _one_of(field: str, value: Any, allowed: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in allowed:
        raise OptionError(f'{field} is {shown(value)}; it must be one of {shown(allowed)}')
    return value


def checked_time_limit(time_limit: Any) -> float | None:
    """
    Return the time limit in s as a float, or None without one.

    :raises OptionError: unless it is above 0 s.
    """
    if time_limit is None:
        return None
    try:
        number = float(time_limit)
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(time_limit, bool) or not number > 0:
        raise OptionError(f'time_limit is {shown(time_limit)}; it must be above 0 s, or None')
    return number if number < math.inf else None


def checked_callback(on_progress: Any) -> Any:
    """Return the callback; raise OptionError unless it is None or can be called."""
    if on_progress is not None and not callable(on_progress):
        raise OptionError(f'on_progress is {shown(on_progress)}; it must be callable, or None')
    return on_progress


def checked_plan(plan: Any, scenario: Scenario) -> Plan:
    """Return the plan; raise OptionError unless it is one of this very scenario."""
    if not isinstance(plan, Plan):
        raise OptionError(f'plan is {shown(plan)}; it must be a Plan')
    if plan.scenario != scenario:
        raise OptionError('plan is for another scenario; '
                          'it must be a plan of the scenario that the bound is for')
    return plan


def checked_rate(rate: Any) -> float:
    """Return a bound as a float; raise OptionError unless it is a number or infinite."""
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or math.isnan(rate):
        raise OptionError(f'rate is {shown(rate)}; it must be a number in bit/s/Hz')
    return float(rate)


def checked_names(ignored: Any) -> tuple[str, ...]:
    """Return the names of limits as a tuple; raise OptionError for anything else."""
    if not isinstance(ignored, (list, tuple)) or not all(
            isinstance(name, str) for name in ignored):
        raise OptionError(f'ignored is {shown(ignored)}; it must be names of limits')
    return tuple(ignored)


def checked_time(solve_time: Any) -> float:
    """Return a time that was taken as a float; raise OptionError unless it is from 0 s."""
    if (isinstance(solve_time, bool) or not isinstance(solve_time, (int, float))
            or not 0 <= solve_time < math.inf):
        raise OptionError(f'solve_time is {shown(solve_time)}; it must be a finite number from 0')
    return float(solve_time)


def checked_fields(data: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """Return what Bound.to_dict wrote; raise OptionError for missing or unknown fields."""
    if not isinstance(data, dict) or set(data) != set(names):
        found = sorted(map(str, data)) if isinstance(data, dict) else data
        raise OptionError(f'a bound has the fields {shown(found)}; it must have {sorted(names)!r}')
    return data
