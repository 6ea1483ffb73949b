"""One task of a campaign, in a worker process: plan a mission, return a row of results."""

import math
import time
from typing import Any

from ..errors import PlanningError
from ..plan import Plan
from ..scenario import Scenario

COLUMNS = ('key', 'sample', 'method', 'objective', 'outcome', 'reason', 'guaranteed_rate',
           'worst_case_rate', 'bound', 'gap', 'status', 'iterations', 'solve_time', 'time')
"""What every row has beside the fields that are varied; rates in bit/s/Hz, times in s."""


def row_of(task: dict[str, Any]) -> dict[str, Any]:
    """
    Return the row of a task of Campaign.tasks; a failure is a row with its reason.

    :return: COLUMNS and 'fields', the varied fields by name, all plain values.
    """
    started = time.monotonic()
    row = dict.fromkeys(COLUMNS)
    row.update({name: task[name] for name in ('key', 'sample', 'method', 'objective', 'fields')})
    try:
        row.update(_results(task), outcome='ok')
    except PlanningError as error:
        row.update(outcome=error.code, reason=str(error))
    except Exception as error:  # Whatever it is, the other missions go on.
        row.update(outcome='error', reason=f'{type(error).__name__}: {error}'[:500])
    row['time'] = time.monotonic() - started
    return row


def _results(task: dict[str, Any]) -> dict[str, Any]:
    from ..bound import upper_bound
    scenario = Scenario.from_dict(task['mission'])
    plan = _plan(scenario, task)
    found = {'guaranteed_rate': plan.guaranteed_rate, 'worst_case_rate': plan.worst_case_rate,
             'status': plan.status,
             'iterations': max(0, len(plan.history) - 1),  # The first entry is the start.
             'solve_time': plan.solve_time}
    if task['bound_time_limit'] is not None:
        bound = upper_bound(scenario, objective=task['objective'], plan=plan,
                            time_limit=task['bound_time_limit'])
        gap = bound.gap(plan)
        found.update(bound=bound.rate if math.isfinite(bound.rate) else None,
                     gap=gap if math.isfinite(gap) else None)
    return found


def _plan(scenario: Scenario, task: dict[str, Any]) -> Plan:
    from ..optimize import fly_hover_fly, METHODS, solve
    method, limit = task['method'], task['time_limit']
    if method in METHODS:
        return solve(scenario, method, time_limit=limit, objective=task['objective'])
    return fly_hover_fly(scenario, method.rpartition('_')[2], time_limit=limit)
