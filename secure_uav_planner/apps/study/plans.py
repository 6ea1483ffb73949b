"""The study as a campaign: its rows of results, and the plan of every point."""

from dataclasses import dataclass

from .experiments import Point
from ..campaign.run import run_campaign
from ..campaign.tasks import plan_file
from ...plan.plan import Plan


@dataclass(frozen=True)
class _Part:
    """Some of the Points, as a campaign."""

    points: list[Point]

    def tasks(self):
        """Yield the task of every point."""
        return (point.task for point in self.points)


def run(wanted, folder, jobs=-1, backend=None, scheduler=None):
    """
    Return the rows of all Points; only those are planned that have none, or no readable plan.

    Convergence is timed, so its points are planned last and one at a time, in this process.

    :param wanted: the Points.
    :param folder: where rows and plans are kept, a pathlib.Path.
    :param jobs, backend, scheduler: as for run_campaign.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for point in wanted:
        file = plan_file(folder, point.task['key'])
        if file.exists() and _loaded(file) is None:
            file.unlink()
    timed = {point.task['key'] for point in wanted if point.experiment == 'convergence'}
    together, alone = [_Part([point for point in wanted if (point.task['key'] in timed) == so])
                       for so in (False, True)]
    return [*run_campaign(together, folder, jobs, scheduler, backend, 'study'),
            *run_campaign(alone, folder, 1, title='study, convergence')]


def plans_of(wanted, folder):
    """
    Return the Plans of Points by Point, without those that are not planned.

    :param folder: as for run.
    """
    found = {point: _loaded(plan_file(folder, point.task['key'])) for point in wanted}
    return {point: plan for point, plan in found.items() if plan is not None}


def _loaded(path):
    try:
        return Plan.load(path)
    except (OSError, ValueError):
        return None
