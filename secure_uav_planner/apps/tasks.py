"""Tasks of a campaign: each plans one mission, on this computer's cores or on a Dask cluster."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
import hashlib
from itertools import islice
import json
import math
from pathlib import Path
from pkgutil import resolve_name
import signal
from threading import current_thread, main_thread
import time
import traceback
from typing import Any, TYPE_CHECKING, TypeAlias
import warnings

from ..assessment import assess
from ..assessment.monte_carlo import arguments
from ..bound import explain_refusal, upper_bound
from ..errors import describe_error, name_missing_package, OptionError, PlanningError
from ..mission.scenario import Scenario
from ..optimize import fly_hover_fly, METHODS, solve
from ..plan.plan import Plan
from ..plan.results import check_plan

if TYPE_CHECKING:
    from distributed import Client

Task: TypeAlias = dict[str, Any]
"""A mission and how it is planned, as plain values, with 'key', 'sample' and 'fields'."""

Row: TypeAlias = dict[str, Any]
"""The result of a task: COLUMNS and 'fields', the varied fields by name, all plain values."""

COLUMNS = ('key', 'sample', 'method', 'objective', 'outcome', 'reason', 'rate', 'guaranteed_rate',
           'worst_case_rate', 'promise', 'bound', 'gap', 'status', 'iterations', 'solve_time',
           'time')
"""Columns of every Row beside the varied fields; rates in bit/s/Hz, times in s."""

ERROR, WORKER_LOST = 'error', 'worker_lost'
"""Outcomes of infrastructure failures (memory, disk, worker); such missions are retried."""

FAULT = 'fault'
"""Outcome of an error in the code of this package, or of the user's own planner."""

_QUEUE_LENGTH = 4  # Submitted tasks for each worker of a cluster.
_CONNECT_TIMEOUT = 15.0  # Time in which a scheduler must answer [s].


class ClusterError(PlanningError, RuntimeError):
    """Workers or the scheduler were lost; finished missions are kept."""

    code = 'cluster'


def make_task(mission: Mapping[str, Any], method: str, objective: str,
              settings: Mapping[str, Any], fields: Mapping[str, Any], sample: int = 0) -> Task:
    """
    Return a task, whose key is a digest of the mission, the method, the objective and `settings`.

    :param mission: the result of Scenario.to_dict.
    :param method: one of METHODS or BASELINES, or `module:function`.
    :param settings: 'time_limit' and 'bound_time_limit' in s, None for no limit and for no bound;
        'plans' if the plan is kept; 'assess', the options of an assessment; and whatever else
        changes the result.
    :param fields: the varied fields by name, for the results only.
    :param sample: number of the random draw, for the results only.
    """
    task = {'mission': mission, 'method': method, 'objective': objective, **settings}
    digest = hashlib.sha256(json.dumps(task, sort_keys=True).encode())
    return {**task, 'key': digest.hexdigest()[:24], 'sample': sample, 'fields': fields}


def load_scheme(name: str) -> Callable[[Scenario], Plan]:
    """
    Import the user's own planner, a function from a Scenario to a Plan.

    :param name: `module:function`.
    :raises OptionError: when it cannot be imported.
    """
    try:
        scheme = resolve_name(name)
    except Exception as error:  # The user's module may raise any error.
        raise OptionError(f'{name} cannot be imported: {describe_error(error)}; its module must '
                          'be installed or in a folder that PYTHONPATH names') from None
    if not callable(scheme):
        raise OptionError(f'{name} is {scheme!r}; it must be a function from a Scenario to a Plan')
    return scheme  # type: ignore[no-any-return]


def plan_path(folder: Path, key: str) -> Path:
    """Return the path of the plan of a Row in the folder of the results."""
    return folder / 'plans' / f'{key}.json'


def run_task(task: Task) -> Row:
    """
    Return the Row of a task; a failure is a Row with its reason.

    The Row may have 'more', further results by name. If the task has 'plans' and succeeds, the Row
    has 'plan', the Plan.
    """
    started = time.monotonic()
    row = _make_row(task)
    try:
        row.update(_solve_task(task), outcome='ok')
    except PlanningError as error:
        row.update(outcome=error.code, reason=str(error))
    except (MemoryError, OSError) as error:
        row.update(outcome=ERROR, reason=describe_error(error))
    except (Exception, SystemExit) as error:  # One mission must not end the campaign.
        *_, last = traceback.extract_tb(error.__traceback__)
        row.update(outcome=FAULT, reason=f'{describe_error(error)} '
                   f'({Path(last.filename).name}, line {last.lineno})')
    row['time'] = time.monotonic() - started
    return row


def _make_row(task: Task) -> Row:
    return {**dict.fromkeys(COLUMNS), **{
        name: task[name] for name in ('key', 'sample', 'method', 'objective', 'fields')}}


def _solve_task(task: Task) -> Row:
    """Plan the mission of a task; return results by column, and 'more' and 'plan' of run_task."""
    scenario = Scenario.from_dict(task['mission'])
    method, objective, limit = task['method'], task['objective'], task['time_limit']
    if method in METHODS:
        plan = solve(scenario, method, time_limit=limit, objective=objective)
    elif ':' in method:
        plan = load_scheme(method)(scenario)
        check_plan(plan, scenario)
    else:
        power = method.rpartition('_')[2]  # The baseline's power, 'constant' or 'optimised'.
        plan = fly_hover_fly(scenario, power, time_limit=limit)
    if plan.objective != objective:  # A baseline or the user's own planner does not know it.
        plan = replace(plan, objective=objective)
    results: Row = {
        'guaranteed_rate': plan.guaranteed_rate, 'worst_case_rate': plan.worst_case_rate,
        'promise': scenario.channel.promise, 'status': plan.status,
        'iterations': max(0, len(plan.history) - 1),  # A history begins with the start.
        'solve_time': plan.solve_time}
    results['rate'] = results[f'{objective}_rate']
    more: dict[str, float | None] = {**_energy_columns(plan)}
    if 'assess' in task:
        more.update({
            f'assess.{name}': number if math.isfinite(number) else None for name, number in assess(
                plan, **arguments(task['assess'])).summary.items()})
    if more:
        results['more'] = more
    if task['bound_time_limit'] is not None and not explain_refusal(scenario):
        bound = upper_bound(scenario, objective=objective, plan=plan,
                            time_limit=task['bound_time_limit'])
        gap = bound.gap(plan)
        results.update(bound=bound.rate if math.isfinite(bound.rate) else None,
                       gap=gap if math.isfinite(gap) else None)
        plan = plan.with_bound(bound)
    return {**results, 'plan': plan} if task.get('plans') else results


def _energy_columns(plan: Plan) -> dict[str, float]:
    """Return the energies in J of the UAVs with a propulsion, by the names of columns."""
    return {f'{name}.{uav.name}': joules
            for uav, energy in zip(plan.scenario.uavs, plan.energies, strict=True)
            if energy is not None for name, joules in (
                ('energy', energy.total), ('hovering_energy', energy.hovering),
                ('flying_energy', energy.flying))}


def run_on_cores(tasks: Iterable[Task], jobs: int) -> Iterator[Row]:
    """
    Yield the rows of tasks as they finish.

    :param jobs: processes; -1 for as many as there are cores.
    :raises ClusterError: when a process was killed.
    """
    with name_missing_package():
        import joblib
    # A terminal sends Ctrl-C to all processes; the workers inherit that they ignore it.
    # Only the main thread can set handlers.
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if (
        current_thread() is main_thread()) else None
    try:
        with joblib.parallel_config('loky', inner_max_num_threads=1):
            # Before version 1.4, joblib returns rows in the order of the tasks only.
            is_recent = tuple(map(int, joblib.__version__.split('.')[:2])) >= (1, 4)
            rows = joblib.Parallel(
                jobs, return_as='generator_unordered' if is_recent else 'generator',
                batch_size=1)(joblib.delayed(run_task)(task) for task in tasks)
    finally:
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
    try:
        yield from rows
    except RuntimeError as error:
        raise ClusterError(f'a worker process was killed: {str(error).splitlines()[0]}; the same '
                           'command goes on from here') from None
    finally:
        with warnings.catch_warnings():  # Cancelled tasks need no warning.
            warnings.filterwarnings('ignore', '.*tasks which were still', UserWarning)
            rows.close()


def run_on_cluster(tasks: Iterable[Task], cluster: 'str | Client') -> Iterator[Row]:
    """
    Yield the rows of tasks as they finish on a Dask cluster, whose workers need this package.

    A task whose worker dies is given to another worker. After several deaths, its Row has the
    outcome WORKER_LOST.

    :param cluster: a client, or the address of the scheduler, such as tcp://host:8786.
    :raises MissingPackageError: when Dask is not installed.
    :raises OptionError: when the scheduler does not answer.
    :raises ClusterError: when the scheduler is lost on the way.
    """
    with name_missing_package():
        from distributed import as_completed, Client
    try:
        context = Client(cluster, timeout=_CONNECT_TIMEOUT) if isinstance(cluster, str) else (
            nullcontext(cluster))
    except (OSError, ValueError, TimeoutError) as error:
        raise OptionError(f'the scheduler {cluster} cannot be reached: {error}') from None
    with context as client:
        address = getattr(client.scheduler, 'address', cluster)
        lost = f'the scheduler {address} is lost; the same command goes on from here'
        queue, submitted = iter(tasks), {}

        def submit(count: int) -> list[Any]:
            """Submit the next tasks, at most `count`, and return their futures."""
            futures = []
            for task in islice(queue, count):
                # The client's id makes the key unique: a scheduler may still know the tasks of a
                # client that was killed.
                future = client.submit(
                    run_task, task, key=f'mission-{task["key"]}-{client.id}', pure=False)
                submitted[future.key] = task
                futures.append(future)
            return futures

        try:
            finished = as_completed(
                submit(_QUEUE_LENGTH * max(1, sum(client.nthreads().values()))))
            for future in finished:
                if future.status in ('pending', 'lost'):
                    # The worker died after it had finished the task; Dask runs the task again.
                    finished.add(future)
                    continue
                task = submitted.pop(future.key)
                if future.status == 'cancelled':
                    raise ClusterError(lost)
                yield future.result() if future.status == 'finished' else {
                    **_make_row(task), 'outcome': WORKER_LOST,
                    'reason': str(future.exception())[:500]}
                future.release()
                finished.update(submit(1))
        except OSError:
            raise ClusterError(lost) from None
