"""A campaign from its file to its results; a campaign that was stopped goes on."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from . import workers
from .journal import Journal
from .specification import Campaign

JOURNAL = 'results.jsonl'


def run(campaign: Campaign, folder: Path, jobs: int = -1,
        scheduler: str | None = None) -> list[dict[str, Any]]:
    """
    Return the rows of all missions of a campaign; only those are planned that have none.

    Every finished mission is written to the journal in the folder at once.

    :param folder: where the journal is, or will be.
    :param jobs: processes on this computer; -1 for as many as there are cores.
    :param scheduler: address of a Dask scheduler, whose workers are used instead.
    :raises OSError: when a row cannot be written; what is finished is kept.
    :raises PlanningError: when the scheduler cannot be reached, or workers are lost.
    """
    from tqdm import tqdm
    with Journal(folder / JOURNAL) as journal:
        kept = {row['key']: row for row in journal.rows()}
        # Two places of a grid may be the same mission, which is then planned once.
        rows = {task['key']: kept.get(task['key']) for task in campaign.tasks()}
        missing = sum(row is None for row in rows.values())
        with tqdm(total=len(rows), initial=len(rows) - missing, unit='mission',
                  desc='sweep', disable=None) as bar:
            for row in _new(_missing(campaign.tasks(), rows), missing, jobs, scheduler):
                journal.add(row)
                rows[row['key']] = row
                bar.update()
    return [row for row in rows.values() if row is not None]


def _missing(tasks: Iterable[dict[str, Any]],
             rows: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the tasks without a row, each once."""
    seen = set()
    for task in tasks:
        if rows[task['key']] is None and task['key'] not in seen:
            seen.add(task['key'])
            yield task


def _new(tasks: Iterator[dict[str, Any]], count: int, jobs: int,
         scheduler: str | None) -> Iterator[dict[str, Any]]:
    if not count:
        return iter(())
    return workers.on_cores(tasks, jobs) if scheduler is None else workers.on_cluster(
        tasks, scheduler)
