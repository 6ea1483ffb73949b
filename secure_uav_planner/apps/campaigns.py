"""Campaigns: `sweep` plans all missions of a campaign and continues one that was stopped."""

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import fcntl
import json
import logging
from pathlib import Path
import sys
from typing import BinaryIO, NoReturn

from .campaign_file import load_campaign
from .cli import DONE, FAILED
from .missions import load_input, make_folder
from .planning import drawing_if_possible
from .results import save_figure, save_tables
from .tasks import COLUMNS, ERROR, plan_path, Row, run_on_cluster, run_on_cores, Task, WORKER_LOST
from ..errors import brief, name_missing_package, OptionError, StoppedError
from ..mission.files import naming

JOURNAL = 'results.jsonl'

_SINCE_0_1_0 = {'promise'}  # Columns that older journals lack.


def run_campaign(tasks: Callable[[], Iterable[Task]], folder: Path, jobs: int = -1,
                 scheduler: str | None = None, title: str = 'sweep') -> list[Row]:
    """
    Return the rows of all missions of a campaign, and plan those that have none.

    Missions with an infrastructure failure, those whose plan was to be kept and is gone, and those
    whose lines in the journal are damaged, which is printed, are planned again. Each finished
    mission is appended to the journal in the folder at once; the last row of a mission counts.

    :param tasks: returns the tasks, the same ones at each call.
    :param folder: of the journal and the kept plans.
    :param jobs: processes on this computer; -1 for as many as there are cores.
    :param scheduler: address of a Dask scheduler, whose workers are used instead.
    :param title: of the progress bar.
    :raises OSError: when a row cannot be written; what is finished is kept.
    :raises OptionError: for a wrong number of jobs, or a journal that another process writes.
    :raises PlanningError: when the scheduler cannot be reached, or workers are lost.
    """
    with name_missing_package():
        from tqdm import tqdm
    if jobs < 1 and jobs != -1:
        raise OptionError(f'jobs is {jobs}; it must be at least 1, or -1 for all cores')
    with _open_journal(folder / JOURNAL) as file:
        kept = _read_rows(file)
        # Two places of a grid may be the same mission, which is planned once.
        rows = {task['key']: _finished_row(kept.get(task['key']), task, folder)
                for task in tasks()}
        missing = sum(row is None for row in rows.values())
        with tqdm(total=len(rows), initial=len(rows) - missing, unit='mission',
                  desc=title, disable=None) as bar:
            queue = _missing_tasks(tasks(), rows)
            for row in () if not missing else run_on_cores(queue, jobs) if (
                    scheduler is None) else run_on_cluster(queue, scheduler):
                plan = row.pop('plan', None)
                if plan is not None:
                    plan_path(folder, row['key']).parent.mkdir(exist_ok=True)
                    plan.save(plan_path(folder, row['key']))
                with naming(folder / JOURNAL):
                    file.write(json.dumps(row, allow_nan=False).encode() + b'\n')
                    file.flush()
                rows[row['key']] = row
                bar.update()
    return [row for row in rows.values() if row is not None]


@contextmanager
def _open_journal(path: Path) -> Iterator[BinaryIO]:
    """
    Open a file of JSON lines to which one process at a time appends; drop an unfinished line.

    :raises OSError: when it cannot be written.
    :raises OptionError: when another process has it open.
    """
    with open(path, 'ab+') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OptionError(f'{path} is being written by another sweep') from None
        file.seek(0)
        file.truncate(sum(len(line) for line in file if line.endswith(b'\n')))
        file.seek(0)
        yield file


def _read_rows(file: BinaryIO) -> dict[str, Row]:
    """Return the rows of a journal by key, and print which of its lines hold none."""
    rows = {number: _read_row(line) for number, line in enumerate(file, start=1)}
    damaged = [str(number) for number, row in rows.items() if row is None]
    if damaged:
        print(f'{file.name}: no result in line {brief(", ".join(damaged), 60)}; a mission without '
              'another line is planned again', file=sys.stderr)
    return {row['key']: row for row in rows.values() if row is not None}


def _read_row(line: bytes) -> Row | None:
    """Return the Row in a line of a journal, or None if it is damaged."""
    try:
        row = json.loads(line.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        return None
    if not isinstance(row, dict) or not row.keys() >= {*COLUMNS, 'fields'} - _SINCE_0_1_0:
        return None
    number = (int, float) if row['outcome'] == 'ok' else (int, float, type(None))
    kinds = {'key': str, 'method': str, 'objective': str, 'outcome': str, 'fields': dict,
             'more': dict, 'rate': number, 'guaranteed_rate': number, 'worst_case_rate': number}
    is_row = all(isinstance(row[name], kind) for name, kind in kinds.items() if name in row)
    return row if is_row else None


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f'{name} is no number of JSON')


def _failed_rows(rows: Iterable[Row]) -> list[Row]:
    """Return the rows with an infrastructure failure."""
    return [row for row in rows if row['outcome'] in (ERROR, WORKER_LOST)]


def _finished_row(row: Row | None, task: Task, folder: Path) -> Row | None:
    """Return a row of the journal, or None if its mission must be planned (again)."""
    if row is None or _failed_rows([row]):
        return None
    lacks_plan = task.get('plans') and row['outcome'] == 'ok' and not plan_path(
        folder, row['key']).exists()
    return None if lacks_plan else row


def _missing_tasks(tasks: Iterable[Task], rows: dict[str, Row | None]) -> Iterator[Task]:
    """Yield the tasks without a row, each once."""
    seen = set()
    for task in tasks:
        if rows[task['key']] is None and task['key'] not in seen:
            seen.add(task['key'])
            yield task


def run_sweep(options: argparse.Namespace) -> int:
    """Run the campaign of a file and summarise it; return the exit status."""
    campaign = load_input(options.mission, load_campaign, OptionError)
    out = make_folder(Path(options.out))
    logging.getLogger('distributed').setLevel(logging.CRITICAL)  # Errors are reported below.
    try:
        rows = run_campaign(campaign.tasks, out, options.jobs, options.scheduler)
    except KeyboardInterrupt:
        file = out / JOURNAL
        count = len(file.read_bytes().splitlines()) if file.exists() else 0
        raise StoppedError(f'stopped; {file} keeps {count} missions, and the same command goes on '
                           'from there') from None
    written = save_tables(rows, out)
    with drawing_if_possible(out / 'summary.png'):
        save_figure(rows, out / 'summary.png')
        written.append(out / 'summary.png')
    outcomes = Counter(row['outcome'] for row in rows)
    print(', '.join(f'{outcomes[outcome]} {outcome}'
                    for outcome in sorted(outcomes, key=lambda name: (name != 'ok', name))))
    print(f'written: {", ".join(map(str, written))}')
    if failed := _failed_rows(rows):
        print(f'secure_uav_planner: {len(failed)} missions failed for reasons outside of them, '
              f'and the same command plans them again: {failed[0]["reason"]}', file=sys.stderr)
        return FAILED
    return DONE
