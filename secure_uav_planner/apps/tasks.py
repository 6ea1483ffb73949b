"""A task of a campaign: one mission, how it is planned, and its row of results."""

from collections.abc import Mapping
import hashlib
import json
import math
from pathlib import Path
import time
from typing import Any, TypeAlias

from ..errors import PlanningError
from ..mission.scenario import Scenario
from ..plan.plan import Plan

Task: TypeAlias = dict[str, Any]
"""A mission and how it is planned, as plain values, with 'key', 'sample' and 'fields'."""

COLUMNS = ('key', 'sample', 'method', 'objective', 'outcome', 'reason', 'rate', 'guaranteed_rate',
           'worst_case_rate', 'promise', 'bound', 'gap', 'status', 'iterations', 'solve_time',
           'time')
"""What every row has beside the fields that are varied; rates in bit/s/Hz, times in s."""

ERROR, WORKER_LOST = 'error', 'worker_lost'
"""Outcomes that say nothing of the mission: memory, a disk or a worker failed. It is planned again
when the campaign is started again. All other outcomes are results, also those of refusals."""


def task_of(mission: Mapping[str, Any], method: str, objective: str, settings: Mapping[str, Any],
            fields: Mapping[str, Any], sample: int = 0) -> Task:
    """
    Return a task; its key is the same for the same mission, planned in the same way.

    :param mission: what Scenario.to_dict returns.
    :param method: one of METHODS or BASELINES.
    :param settings: 'time_limit' and 'bound_time_limit' in s, None for no limit and for no bound;
        'plans' if the plan is to be kept; 'assess' if it is to be assessed, and how; and whatever
        else makes the result another one.
    :param fields: what tells this mission from the others, for its row.
    """
    task = {'mission': mission, 'method': method, 'objective': objective, **settings}
    digest = hashlib.sha256(json.dumps(task, sort_keys=True).encode())
    return {**task, 'key': digest.hexdigest()[:24], 'sample': sample, 'fields': fields}


def plan_file(folder: Path, key: str) -> Path:
    """Return where the plan of a row is kept, in the folder of the results."""
    return folder / 'plans' / f'{key}.json'


def row_of(task: Task) -> dict[str, Any]:
    """
    Return the row of a task; a failure is a row with its reason.

    It has COLUMNS and 'fields', the varied fields by name, all plain values; 'more', further
    results by name, where the mission has any; and 'plan', the Plan, if the task has 'plans'.
    """
    started = time.monotonic()
    row = empty_row(task)
    try:
        row.update(_results(task), outcome='ok')
    except PlanningError as error:
        row.update(outcome=error.code, reason=str(error))
    except Exception as error:  # Whatever it is, the other missions go on.
        row.update(outcome=ERROR, reason=f'{type(error).__name__}: {error}'[:500])
    row['time'] = time.monotonic() - started
    return row


def empty_row(task: Task) -> dict[str, Any]:
    """Return the row of a task without any result."""
    return {**dict.fromkeys(COLUMNS), **{
        name: task[name] for name in ('key', 'sample', 'method', 'objective', 'fields')}}


def _results(task: Task) -> dict[str, Any]:
    from ..assessment import assess
    from ..assessment.monte_carlo import arguments
    from ..bound import explain_refusal, upper_bound
    scenario = Scenario.from_dict(task['mission'])
    plan = _plan(scenario, task)
    objective, limit = task['objective'], task['bound_time_limit']
    found: dict[str, Any] = {
        'guaranteed_rate': plan.guaranteed_rate, 'worst_case_rate': plan.worst_case_rate,
        'promise': scenario.channel.promise,
        'status': plan.status,
        'iterations': max(0, len(plan.history) - 1),  # The first entry is the start.
        'solve_time': plan.solve_time}
    found['rate'] = found[f'{objective}_rate']
    more = _energies(plan)
    if 'assess' in task:
        more.update({f'assess.{name}': number for name, number in assess(
            plan, **arguments(task['assess'])).summary.items()})
    if more:
        found['more'] = more
    if limit is not None and not explain_refusal(scenario):
        bound = upper_bound(scenario, objective=objective, plan=plan, time_limit=limit)
        gap = bound.gap(plan)
        found.update(bound=bound.rate if math.isfinite(bound.rate) else None,
                     gap=gap if math.isfinite(gap) else None)
        plan = plan.with_bound(bound)
    return {**found, 'plan': plan} if task.get('plans') else found


def _energies(plan: Plan) -> dict[str, float]:
    """Return the energy of each UAV that has a propulsion in J, by the names of columns."""
    return {f'{name}.{uav.name}': joules
            for uav, energy in zip(plan.scenario.uavs, plan.energies, strict=True)
            if energy is not None for name, joules in (
                ('energy', energy.total), ('hovering_energy', energy.hovering),
                ('flying_energy', energy.flying))}


def _plan(scenario: Scenario, task: Task) -> Plan:
    from ..optimize import fly_hover_fly, METHODS, solve
    method, limit = task['method'], task['time_limit']
    if method in METHODS:
        return solve(scenario, method, time_limit=limit, objective=task['objective'])
    return fly_hover_fly(scenario, method.rpartition('_')[2], time_limit=limit)
