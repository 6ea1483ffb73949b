"""Campaigns: `sweep` plans all missions of a campaign; one that was stopped goes on."""

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import fcntl
import json
import logging
from pathlib import Path
import sys
from typing import Any, BinaryIO

from .cli import DONE, FAILED
from .missions import loaded, writable
from .results import save_figure, save_tables
from .specification import load_campaign
from .tasks import ERROR, plan_file, Task, WORKER_LOST
from .workers import on_cluster, on_cores
from ..errors import name_missing_package, OptionError, StoppedError
from ..mission.files import naming

JOURNAL = 'results.jsonl'


def run_campaign(tasks: Callable[[], Iterable[Task]], folder: Path, jobs: int = -1,
                 scheduler: str | None = None, title: str = 'sweep') -> list[dict[str, Any]]:
    """
    Return the rows of all missions of a campaign; only those are planned that have none.

    Missions that failed for reasons outside of them, and those whose plan was to be kept and is
    gone, are planned again. Every finished mission is written to the journal in the folder at
    once; there, the last row of a mission counts.

    :param tasks: returns the tasks, the same ones every time.
    :param folder: where the journal and the kept plans are, or will be.
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
    with _journal(folder / JOURNAL) as file:
        kept = {row['key']: row for row in map(json.loads, file)}
        # Two places of a grid may be the same mission, which is then planned once.
        rows = {task['key']: _finished(kept.get(task['key']), task, folder) for task in tasks()}
        missing = sum(row is None for row in rows.values())
        with tqdm(total=len(rows), initial=len(rows) - missing, unit='mission',
                  desc=title, disable=None) as bar:
            left = _missing(tasks(), rows)
            for row in () if not missing else on_cores(left, jobs) if (
                    scheduler is None) else on_cluster(left, scheduler):
                plan = row.pop('plan', None)
                if plan is not None:
                    plan_file(folder, row['key']).parent.mkdir(exist_ok=True)
                    plan.save(plan_file(folder, row['key']))
                with naming(folder / JOURNAL):
                    file.write(json.dumps(row, allow_nan=False).encode() + b'\n')
                    file.flush()
                rows[row['key']] = row
                bar.update()
    return [row for row in rows.values() if row is not None]


@contextmanager
def _journal(path: Path) -> Iterator[BinaryIO]:
    """
    Open a file with one row a line as JSON, that only one process at a time adds to.

    A line that a stopped process left unfinished is removed.

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


def failed(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of missions that failed for reasons outside of them."""
    return [row for row in rows if row['outcome'] in (ERROR, WORKER_LOST)]


def _finished(row: dict[str, Any] | None, task: Task, folder: Path) -> dict[str, Any] | None:
    """Return a row from the journal, or None if its mission is to be planned again."""
    if row is None or failed([row]):
        return None
    lacks_plan = task.get('plans') and row['outcome'] == 'ok' and not plan_file(
        folder, row['key']).exists()
    return None if lacks_plan else row


def _missing(tasks: Iterable[Task], rows: dict[str, Any]) -> Iterator[Task]:
    """Yield the tasks without a row, each once."""
    seen = set()
    for task in tasks:
        if rows[task['key']] is None and task['key'] not in seen:
            seen.add(task['key'])
            yield task


def sweep(options: argparse.Namespace) -> int:
    """Run a campaign; return the exit status."""
    campaign = loaded(options.mission, load_campaign, OptionError)
    out = writable(Path(options.out))
    # What it says of lost connections is said here in a line.
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    try:
        rows = run_campaign(campaign.tasks, out, options.jobs, options.scheduler)
    except KeyboardInterrupt:
        file = out / JOURNAL
        count = len(file.read_bytes().splitlines()) if file.exists() else 0
        raise StoppedError(f'stopped; {file} keeps {count} missions, and the same command goes on '
                           'from there') from None
    written = save_tables(rows, out)
    try:
        save_figure(rows, out / 'summary.png')
        written.append(out / 'summary.png')
    except ModuleNotFoundError as error:
        print(f'{error.name} is not installed, so there is no figure', file=sys.stderr)
    outcomes = Counter(row['outcome'] for row in rows)
    print(', '.join(f'{outcomes[outcome]} {outcome}'
                    for outcome in sorted(outcomes, key=lambda name: (name != 'ok', name))))
    print(f'written: {", ".join(map(str, written))}')
    if again := failed(rows):
        print(f'secure_uav_planner: {len(again)} missions failed for reasons outside of them, and '
              f'the same command plans them again: {again[0]["reason"]}', file=sys.stderr)
        return FAILED
    return DONE
