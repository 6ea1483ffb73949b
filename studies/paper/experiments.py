"""The points of the study: a plan each, made as a campaign."""

from dataclasses import dataclass, replace
from functools import cache, cached_property
import hashlib
import math
import pathlib

import secure_uav_planner
from secure_uav_planner import Channel, METHODS, Plan, Scenario, Uav
from secure_uav_planner.apps.campaign_file import BASELINES
from secure_uav_planner.apps.campaigns import run_tasks
from secure_uav_planner.apps.tasks import make_task, plan_path
from secure_uav_planner.mission.propagation import ENVIRONMENTS

PROPOSED = METHODS[0]
"""The method that represents the paper's proposed design."""

_DURATIONS = (102, 104, 106, 108, 110, 115, 120, 130, 140, 150, 160, 170, 180, 190, 200)
_RADII = (0, 5, 10, 15, 20, 30, 40, 50, 60)
_SNRS = (60, 65, 70, 75, 80, 85, 90, 95, 100)
_NOT_PLANNING = ('apps', 'assessment', 'output', 'ros')
_SOURCES = ('.py', '.cpp', '.hpp')


@dataclass(frozen=True)
class Point:
    """A point of a figure, for which a plan is made."""

    experiment: str  # The figure.
    x: float  # Its coordinate on the horizontal axis.
    scheme: str  # A method of solve, or one of BASELINES.
    scenario: Scenario
    objective: str = 'guaranteed'  # The paper's.
    bounded: bool = False  # True for a plan with an upper bound.

    @cached_property
    def task(self):
        """Task of the campaign; its key is a digest of scenario, scheme and code."""
        scenario = self.scenario
        return make_task(scenario.to_dict(), self.scheme, self.objective, {
            'time_limit': None, 'bound_time_limit': math.inf if self.bounded else None,
            'plans': True, 'code': code_version()}, {
                'duration': scenario.duration,
                'error_radius': scenario.eavesdroppers[0].error_radius,
                'reference_snr_db': scenario.reference_snr_db,
                'jammers': len(scenario.uavs) - 1, 'los': scenario.channel.los})


def make_points(quick=False):
    """Return the Points of the study, or a few if quick, by experiment with ascending x."""
    paper = Scenario.paper()
    points = []

    def add(experiment, x, scenario, schemes=(*BASELINES, PROPOSED)):
        points.extend(Point(experiment, float(x), scheme, scenario) for scheme in schemes)

    for duration in (102, 104, 200) if quick else _DURATIONS:
        add('duration', duration, Scenario.paper(duration))
        add('duration, radius 0', duration, Scenario.paper(duration, error_radius=0.0),
            (PROPOSED,))
        # A bound takes a hundred times as long as a plan.
        points.append(Point('duration, worst case', float(duration), PROPOSED,
                            Scenario.paper(duration), 'worst_case', not quick or duration == 200))
    for radius in (0, 10, 60) if quick else _RADII:
        add('radius', radius, Scenario.paper(error_radius=radius))
    for snr in (70, 80, 90) if quick else _SNRS:
        add('snr', snr, replace(paper, reference_snr_db=float(snr)))
    for jammers in (0, 1, 2) if quick else (0, 1, 2, 3):
        add('jammers', jammers, _with_jammers(paper, jammers))
    for index, los in enumerate((None, *ENVIRONMENTS)):
        if not quick or los in (None, 'urban'):
            add('environment', index, replace(paper, channel=Channel(los=los)), (PROPOSED,))
    return points


def _with_jammers(scenario, count):
    """Return the scenario with copies of its jammer, each 10 m above the last."""
    transmitter, jammer = scenario.uavs
    return replace(scenario, uavs=(transmitter, *(
        Uav(f'uav{index + 2}', jammer.start, jammer.goal, jammer.altitude + 10.0 * index,
            jammer.max_speed, jammer.average_power, jammer.peak_power)
        for index in range(count))))


@cache
def code_version():
    """Return a digest of the package's code, to reuse only plans of the same code."""
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def sources():
    """Return the source files that determine a plan or its bound."""
    package = pathlib.Path(secure_uav_planner.__file__).parent
    return sorted(path for path in package.rglob('*') if path.suffix in _SOURCES
                  and path.relative_to(package).parts[0] not in _NOT_PLANNING)


def plan_points(points, folder, jobs=-1, scheduler=None):
    """Plan the Points that lack a row or a readable plan in a folder; return the rows of all."""
    folder.mkdir(parents=True, exist_ok=True)
    for point in points:
        file = plan_path(folder, point.task['key'])
        if file.exists() and _load_plan(file) is None:
            file.unlink()
    return run_tasks(lambda: [point.task for point in points], folder, jobs, scheduler,
                     title='study')


def load_plans(points, folder):
    """Return the Plans in a folder by Point, in the order of the Points."""
    plans = {point: _load_plan(plan_path(folder, point.task['key'])) for point in points}
    return {point: plan for point, plan in plans.items() if plan is not None}


def _load_plan(path):
    try:
        return Plan.load(path)
    except (OSError, ValueError):
        return None
