"""Campaigns: `sweep` plans all missions of a campaign and continues one that was stopped."""

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
import fcntl
import json
import logging
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any, BinaryIO, TYPE_CHECKING

from .campaign_file import load_campaign
from .missions import load_input, make_folder
from .planning import drawing_if_possible
from .results import make_frame, save_tables
from .summary import save_figure
from .tasks import (
    COLUMNS, ERROR, FAULT, plan_path, Row, run_on_cluster, run_on_cores, Task, WORKER_LOST)
from ..errors import (
    brief, name_missing_package, OptionError, PlanningError, quote, StoppedError)
from ..mission.files import naming

if TYPE_CHECKING:
    from distributed import Client
    from pandas import DataFrame

JOURNAL = 'results.jsonl'

_NEWER_COLUMNS = {'promise'}  # Columns that journals of version 0.1.0 lack.
_PERIODS = {True: 0.5, False: 30.0}  # Time between two reports [s]; True for a terminal.


def run_campaign(campaign: Mapping[str, Any] | str | os.PathLike[str],
                 client: 'Client | None' = None, *,
                 folder: str | os.PathLike[str] | None = None, jobs: int = -1) -> 'DataFrame':
    """
    Return the results of all missions of a campaign as a table; plan those without a result.

    :param campaign: path of a campaign file, or a mapping with its fields, whose `mission` may be
        a Scenario.
    :param client: a `distributed.Client` of a Dask cluster, whose workers need this package; None
        for this computer.
    :param folder: folder that keeps each finished mission and plan at once, so that the same call
        continues a campaign that was stopped; None keeps nothing.
    :param jobs: processes on this computer; -1 for as many as there are cores.
    :return: a pandas DataFrame with a row for each mission and the columns of `results.csv`.
    :raises MissionFileError: with all problems of the campaign.
    :raises OptionError: for another argument with a wrong value.
    :raises OSError: when a file cannot be read or written; what is finished is kept.
    :raises PlanningError: when workers are lost, or a package is missing.
    """
    for name, value, is_valid, allowed in (
            ('campaign', campaign, isinstance(campaign, (Mapping, str, os.PathLike)),
             'a path or a mapping of the fields of a campaign'),
            ('client', client, client is None or hasattr(client, 'submit'),
             'None or a client of a Dask cluster'),
            ('folder', folder, folder is None or isinstance(folder, (str, os.PathLike)),
             'None or a path')):
        if not is_valid:
            raise OptionError(f'{name} is {quote(value)}; it must be {allowed}', (name,))
    loaded = load_campaign(campaign)
    if folder is None and loaded.plans:
        raise OptionError('folder is None; it must be a path, since plans are to be kept')
    with name_missing_package():
        import pandas  # noqa: F401  (before all missions are planned)
    with TemporaryDirectory() as temporary:
        place = Path(temporary if folder is None else folder)
        place.mkdir(parents=True, exist_ok=True)
        return make_frame(run_tasks(loaded.tasks, place, jobs, client, title='campaign'))


def run_tasks(tasks: Callable[[], Iterable[Task]], folder: Path, jobs: int = -1,
              cluster: 'str | Client | None' = None, shard: tuple[int, int] | None = None,
              title: str = 'sweep') -> list[Row]:
    """
    Return the row of each mission of a campaign; plan the missions that have no row yet.

    Each finished mission is appended to a journal in the folder at once. A mission is planned
    again after an infrastructure failure, if its plan was to be kept and is gone, or if its line
    in a journal is damaged; numbers of damaged lines are printed. Of several results of a mission,
    the last one counts; an infrastructure failure counts only if there is nothing else.

    :param tasks: function that returns the tasks, the same ones at each call.
    :param folder: folder of the journals and the kept plans.
    :param jobs: processes on this computer; -1 for as many as there are cores.
    :param cluster: a Dask client or the address of a scheduler, whose workers are used instead.
    :param shard: (k, n), k from 1 to n: only the k-th of n shares of the missions is planned and
        returned, with a journal of its own.
    :param title: name in the reports of progress on stderr.
    :raises OSError: when a row cannot be written; what is finished is kept.
    :raises OptionError: for a wrong number of jobs, or a journal that another process writes.
    :raises PlanningError: when the scheduler cannot be reached, or workers are lost.
    """
    if type(jobs) is not int or jobs < 1 and jobs != -1:
        raise OptionError(
            f'jobs is {quote(jobs)}; it must be a whole number from 1, or -1 for all cores')
    journal = folder / journal_name(shard)
    with _open_journal(journal) as file:
        recorded = _read_rows(folder)
        rows = {task['key']: _finished_row(recorded.get(task['key']), task, folder)
                for task in tasks()}
        if shard is not None:  # Keys are digests: each share has missions of all kinds.
            number, count = shard
            rows = {key: rows[key] for key in sorted(rows)[number - 1::count]}
        finished = [row for row in rows.values() if row is not None]
        if len(finished) == len(rows):
            return finished
        queue = _take_missing(tasks(), {key for key, row in rows.items() if row is None})
        progress = _Progress(title, finished, len(rows))
        for row in run_on_cores(queue, jobs) if cluster is None else (
                run_on_cluster(queue, cluster)):
            plan = row.pop('plan', None)
            if plan is not None:
                plan_path(folder, row['key']).parent.mkdir(exist_ok=True)
                plan.save(plan_path(folder, row['key']))
            line = json.dumps(row, allow_nan=False).encode() + b'\n'
            with naming(journal):  # No buffer is left, which closing would write again.
                while line:
                    line = line[os.write(file.fileno(), line):]
            rows[row['key']] = row
            progress.add(row)
        progress.report()
    return [row for row in rows.values() if row is not None]


class _Progress:
    """Reports of progress on stderr: a line that changes on a terminal, otherwise new lines."""

    def __init__(self, title: str, finished: Sequence[Row], total: int) -> None:
        """Begin with the rows finished before this run, of `total` missions."""
        self._title, self._total = title, total
        # Missions done so far, and missions done before this run.
        self._done = self._first = len(finished)
        self._failed = sum(row['outcome'] != 'ok' for row in finished)
        self._started = self._reported = time.monotonic()
        self._is_terminal = sys.stderr.isatty()

    def add(self, row: Row) -> None:
        """Count a finished mission, and report if the last report is _PERIODS [s] old."""
        self._done += 1
        self._failed += row['outcome'] != 'ok'
        if time.monotonic() - self._reported >= _PERIODS[self._is_terminal]:
            self.report('\r' if self._is_terminal else '\n')

    def report(self, end: str = '\n') -> None:
        """Print missions done and failed, the rate of this run, and the time left at this rate."""
        self._reported = time.monotonic()
        rate = (self._done - self._first) / max(self._reported - self._started, 1e-9)
        per_second = f'{rate:.0f}' if rate >= 100 else f'{rate:.3g}'
        text = (f'{self._title}: {self._done} of {self._total} missions done, {self._failed} '
                f'failed, {per_second}/s')
        if rate > 0:
            text += f', {timedelta(seconds=round((self._total - self._done) / rate))} left'
        if self._is_terminal:
            text = f'\033[K{text}'
        print(text, end=end, file=sys.stderr, flush=True)


def journal_name(shard: tuple[int, int] | None = None) -> str:
    """Return the name of the journal of a campaign or of one of its shards (k, n)."""
    return JOURNAL if shard is None else 'results-{}-of-{}.jsonl'.format(*shard)


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
        yield file


def _read_rows(folder: Path) -> dict[str, Row]:
    """Return the last row of each key in a folder's journals; print numbers of damaged lines."""
    rows: dict[str, Row] = {}
    for path in sorted([*folder.glob(JOURNAL), *folder.glob('results-*-of-*.jsonl')]):
        damaged = []
        with open(path, 'rb') as file:
            for number, line in enumerate(file, start=1):
                row = _read_row(line)
                if row is None and line.endswith(b'\n'):  # A shard may be writing the last line.
                    damaged.append(str(number))
                # A later row replaces an earlier one, unless it is an infrastructure failure.
                elif row is not None and (row['key'] not in rows or not _is_lost(row)):
                    rows[row['key']] = row
        if damaged:
            print(f'{path}: no result in line {brief(", ".join(damaged), 60)}; a mission without '
                  'another line is planned again', file=sys.stderr)
    return rows


def _read_row(line: bytes) -> Row | None:
    """Return the Row in a journal's line, None for no JSON, a missing column or a wrong type."""
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(row, dict) or not row.keys() >= {*COLUMNS, 'fields'} - _NEWER_COLUMNS:
        return None
    rate = (int, float) if row['outcome'] == 'ok' else (int, float, type(None))
    kinds = {'key': str, 'fields': dict, 'rate': rate, 'guaranteed_rate': rate,
             'worst_case_rate': rate}
    return row if all(isinstance(row[name], kind) for name, kind in kinds.items()) else None


def _is_lost(row: Row) -> bool:
    """Return True for an infrastructure failure, which says nothing about the mission."""
    return row['outcome'] in (ERROR, WORKER_LOST)


def _finished_row(row: Row | None, task: Task, folder: Path) -> Row | None:
    """Return a task's recorded row; None if missing, lost (see _is_lost) or its plan is gone."""
    if row is None or _is_lost(row):
        return None
    lacks_plan = task.get('plans') and row['outcome'] == 'ok' and not plan_path(
        folder, row['key']).exists()
    # An earlier campaign in the folder may have varied other fields, or drawn other samples.
    return None if lacks_plan else {**row, 'sample': task['sample'], 'fields': task['fields']}


def _take_missing(tasks: Iterable[Task], missing: set[str]) -> Iterator[Task]:
    """Yield the first task with each key in `missing`, and remove the key from the set."""
    for task in tasks:
        if task['key'] in missing:  # Equal missions of a grid share a key.
            missing.remove(task['key'])
            yield task


def run_sweep(options: argparse.Namespace) -> None:
    """
    Plan the missions of a campaign; without --shard, write tables and a figure of all results.

    :raises PlanningError: at the end, if missions were lost or met a fault of the program.
    """
    campaign = load_input(options.mission, load_campaign)
    out = make_folder(Path(options.out))
    logging.getLogger('distributed').setLevel(logging.CRITICAL)  # Errors are reported below.
    try:
        rows = run_tasks(campaign.tasks, out, options.jobs, options.scheduler, options.shard)
    except KeyboardInterrupt:
        file = out / journal_name(options.shard)
        count = len(file.read_bytes().splitlines()) if file.exists() else 0
        raise StoppedError(f'stopped; {file} keeps {count} missions, and the same command goes on '
                           'from there') from None
    outcomes = Counter(row['outcome'] for row in rows)
    print(', '.join(f'{outcomes[outcome]} {outcome}'
                    for outcome in sorted(outcomes, key=lambda name: (name != 'ok', name))))
    if options.shard is None:
        written = save_tables(rows, out)
        with drawing_if_possible(out / 'summary.png'):
            save_figure(rows, out / 'summary.png')
            written.append(out / 'summary.png')
        print(f'written: {", ".join(map(str, written))}')
    else:
        print(f'written: {out / journal_name(options.shard)}; when all shards are, the same '
              'command without --shard makes the tables')
    if lost := [row for row in rows if _is_lost(row)]:
        raise PlanningError(f'{len(lost)} missions failed for reasons outside of them, and the '
                            f'same command plans them again: {lost[0]["reason"]}')
    if faults := [row for row in rows if row['outcome'] == FAULT]:
        raise PlanningError(f'{len(faults)} missions met a fault of the program, and stay so with '
                            f'this --out; please report it: {faults[0]["reason"]}')
