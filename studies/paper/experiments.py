"""The points of the study: what is planned for each figure, and as a campaign."""

from dataclasses import dataclass, replace
from functools import cache, cached_property
import hashlib
import math
import pathlib

import secure_uav_planner
from secure_uav_planner import Channel, METHODS, Plan, Scenario, Uav
from secure_uav_planner.apps.campaigns import run_campaign
from secure_uav_planner.apps.specification import BASELINES
from secure_uav_planner.apps.tasks import plan_file, task_of
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
    """One point of the study, for which one plan is made."""

    experiment: str  # The figure to which it belongs.
    x: float  # Its coordinate on the figure's horizontal axis.
    scheme: str  # A method of solve, or one of BASELINES.
    scenario: Scenario
    objective: str = 'guaranteed'  # The paper's.
    bounded: bool = False  # Whether the plan gets its upper bound.

    @cached_property
    def task(self):
        """Task of the campaign, whose key is the same for the same scenario, scheme and code."""
        scenario = self.scenario
        return task_of(scenario.to_dict(), self.scheme, self.objective, {
            'time_limit': None, 'bound_time_limit': math.inf if self.bounded else None,
            'plans': True, 'code': code_version()}, {
                'duration': scenario.duration,
                'error_radius': scenario.eavesdroppers[0].error_radius,
                'reference_snr_db': scenario.reference_snr_db,
                'jammers': len(scenario.uavs) - 1, 'los': scenario.channel.los})


def points(quick=False):
    """Return the Points of the study, or a few if quick; those of an experiment ascend in x."""
    paper = Scenario.paper()
    found = []

    def add(experiment, x, scenario, schemes=(*BASELINES, PROPOSED)):
        found.extend(Point(experiment, float(x), scheme, scenario) for scheme in schemes)

    for duration in (102, 104, 200) if quick else _DURATIONS:
        add('duration', duration, Scenario.paper(duration))
        add('duration, radius 0', duration, Scenario.paper(duration, error_radius=0.0),
            (PROPOSED,))
        # A bound takes a hundred times as long as a plan.
        found.append(Point('duration, worst case', float(duration), PROPOSED,
                           Scenario.paper(duration), 'worst_case', not quick or duration == 200))
    for radius in (0, 10, 60) if quick else _RADII:
        add('radius', radius, Scenario.paper(error_radius=radius))
    for snr in (70, 80, 90) if quick else _SNRS:
        add('snr', snr, replace(paper, reference_snr_db=float(snr)))
    for jammers in (0, 1, 2) if quick else (0, 1, 2, 3):
        add('jammers', jammers, _with_jammers(paper, jammers))
    for place, los in enumerate((None, *ENVIRONMENTS)):
        if not quick or los in (None, 'urban'):
            add('environment', place, replace(paper, channel=Channel(los=los)), (PROPOSED,))
    return found


def _with_jammers(scenario, count):
    """Return the scenario with a number of jammers like its own, each 10 m above the last."""
    transmitter, jammer = scenario.uavs
    return replace(scenario, uavs=(transmitter, *(
        Uav(f'uav{index + 2}', jammer.start, jammer.goal, jammer.altitude + 10.0 * index,
            jammer.max_speed, jammer.average_power, jammer.peak_power)
        for index in range(count))))


@cache
def code_version():
    """Return a digest of the package's code, so that plans of other code are not reused."""
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def sources():
    """Return the files whose code makes a plan or its bound."""
    package = pathlib.Path(secure_uav_planner.__file__).parent
    return sorted(path for path in package.rglob('*') if path.suffix in _SOURCES
                  and path.relative_to(package).parts[0] not in _NOT_PLANNING)


def run(wanted, folder, jobs=-1, scheduler=None):
    """Return the rows of all Points after those without one, or a readable plan, are planned."""
    folder.mkdir(parents=True, exist_ok=True)
    for point in wanted:
        file = plan_file(folder, point.task['key'])
        if file.exists() and _loaded(file) is None:
            file.unlink()
    return run_campaign(lambda: [point.task for point in wanted], folder, jobs, scheduler,
                        'study')


def plans_of(wanted, folder):
    """Return the Plans of Points that are in a folder, by Point, in the order of these."""
    found = {point: _loaded(plan_file(folder, point.task['key'])) for point in wanted}
    return {point: plan for point, plan in found.items() if plan is not None}


def _loaded(path):
    try:
        return Plan.load(path)
    except (OSError, ValueError):
        return None
