"""
The study: the paper's figures, what it does not show, and whether its claims hold.

Every finished point is kept in the output folder; a study that was stopped goes on from there.
"""

import argparse
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
import hashlib
import inspect
import json
import os
import pathlib
import signal
import sys

import joblib
from tqdm import tqdm

from . import fly_hover_fly, METHODS, Plan, Scenario, solve, Uav

PROPOSED = inspect.signature(solve).parameters['method'].default
"""What stands for the paper's proposed design."""

BASELINES = ('fly_hover_fly_constant', 'fly_hover_fly_optimised')

_DURATIONS = (102, 104, 106, 108, 110, 115, 120, 130, 140, 150, 160, 170, 180, 190, 200)
_RADII = (0, 5, 10, 15, 20, 30, 40, 50, 60)
_SNRS = (60, 65, 70, 75, 80, 85, 90, 95, 100)
_THREAD_COUNTS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS',
                  'RAYON_NUM_THREADS')


@dataclass(frozen=True)
class Point:
    """
    One plan of the study.

    :param experiment: the figure it belongs to.
    :param x: its place on the figure's horizontal axis.
    :param scheme: a method of solve or one of BASELINES.
    :param scenario: what is planned.
    """

    experiment: str
    x: float
    scheme: str
    scenario: Scenario

    @property
    def file(self):
        """Name of the file it is kept in: the same for the same problem, scheme and code."""
        text = json.dumps([self.scenario.to_dict(), self.scheme, code_version()])
        return f'{self.scheme}-{hashlib.sha256(text.encode()).hexdigest()[:20]}.json'


def points(quick=False):
    """Return the Points of the study; quick takes a few of every experiment."""
    paper = Scenario.paper()
    found = []

    def add(experiment, x, scenario, schemes=(*BASELINES, PROPOSED)):
        found.extend(Point(experiment, float(x), scheme, scenario) for scheme in schemes)

    for duration in (102, 104, 200) if quick else _DURATIONS:
        add('duration', duration, Scenario.paper(duration))
        add('duration, radius 0', duration, Scenario.paper(duration, error_radius=0.0),
            (PROPOSED,))
    for radius in (0, 10, 60) if quick else _RADII:
        add('radius', radius, Scenario.paper(error_radius=radius))
    for snr in (70, 80, 90) if quick else _SNRS:
        add('snr', snr, replace(paper, reference_snr_db=float(snr)))
    for jammers in (0, 1, 2) if quick else (0, 1, 2, 3):
        add('jammers', jammers, _with_jammers(paper, jammers))
    for duration in (102,) if quick else (102, 200):
        add('convergence', duration, Scenario.paper(duration), tuple(METHODS))
    return found


def _with_jammers(scenario, count):
    """Return the scenario with a number of jammers like its own, 10 m above one another."""
    transmitter, jammer = scenario.uavs
    return replace(scenario, uavs=(transmitter, *(
        Uav(f'uav{index + 2}', jammer.start, jammer.goal, jammer.altitude + 10.0 * index,
            jammer.max_speed, jammer.average_power, jammer.peak_power)
        for index in range(count))))


_version = None


def code_version():
    """Return a digest of the code that plans: other code, other plans."""
    global _version
    if _version is None:
        package = pathlib.Path(__file__).parent
        digest = hashlib.sha256()
        for path in sorted([package / 'channel.py', package / 'scenario.py', package / 'plan.py',
                            *(package / 'optimize').glob('*.py')]):
            digest.update(path.read_bytes())
        _version = digest.hexdigest()[:16]
    return _version


def compute(point):
    """Return the Plan of a point, its rates computed."""
    if point.scheme in METHODS:
        plan = solve(point.scenario, method=point.scheme)
    else:
        plan = fly_hover_fly(point.scenario, point.scheme.rpartition('_')[2])
    # Kept in the plan: the worst case takes time of its own.
    plan.worst_case_rates, plan.guaranteed_rates
    return plan


def run(wanted, folder, jobs=None, backend=None):
    """
    Return the Plan of every Point, computing only what the folder does not hold.

    What is computed comes back to this process and is written at once, so that the workers may
    be on other machines: choose them by `backend`, or around the call by joblib.parallel_config.
    Convergence is timed, so its points come last and one by one.

    :param wanted: Points.
    :param folder: where finished plans are kept.
    :param jobs: of joblib, by default as it is configured.
    :param backend: of joblib, by default as it is configured.
    :return: a dict of Plans by Point.
    """
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    plans, missing = {}, {}
    for point in wanted:
        plan = _kept(folder / point.file)
        if plan is None:
            missing.setdefault(point.file, []).append(point)
        else:
            plans[point] = plan
    timed = [same for same in missing.values()
             if any(point.experiment == 'convergence' for point in same)]
    untimed = [same for same in missing.values() if same not in timed]
    with tqdm(total=len(wanted), initial=len(plans), unit='plan', desc='study',
              disable=None) as bar:
        for group, options in ((untimed, {'n_jobs': jobs}), (timed, {'n_jobs': 1})):
            with _computed([same[0] for same in group], backend, options) as results:
                for number, plan in results:
                    same = group[number]
                    plan.save(folder / same[0].file)
                    plans.update({point: plan for point in same})
                    bar.update(len(same))
    return plans


def _kept(path):
    try:
        return Plan.load(path)
    except (OSError, ValueError):
        return None


def _numbered(number, point):
    return number, compute(point)


@contextmanager
def _computed(wanted, backend, options):
    """Give the (number, Plan) of Points as they come; leave no worker behind on an error."""
    threads = {name: os.environ.get(name) for name in _THREAD_COUNTS}
    os.environ.update(dict.fromkeys(_THREAD_COUNTS, '1'))
    chosen = (nullcontext() if backend is None or options['n_jobs'] == 1
              else joblib.parallel_config(backend))
    # Workers inherit it: Ctrl-C reaches all of a terminal's processes, and only this one may act.
    handler = _ignore_interrupts()
    try:
        with chosen:
            results = joblib.Parallel(return_as='generator_unordered', batch_size=1, **options)(
                joblib.delayed(_numbered)(number, point) for number, point in enumerate(wanted))
    finally:
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
        for name, value in threads.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    try:
        yield results
    finally:
        results.close()


def _ignore_interrupts():
    try:
        return signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not in the main thread, where signals do not come
        return None


def main(argv=None):
    """Run the study; return the exit status."""
    # Here and not above: a worker needs neither.
    from .study_claims import write_claims
    from .study_figures import write_figures

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=pathlib.Path, default=pathlib.Path('out/study'),
                        help='folder for figures, tables and finished plans')
    parser.add_argument('--jobs', type=int, default=-1, help='processes at once, -1 for all cores')
    parser.add_argument('--backend', help="joblib's, such as loky, threading, dask or ray")
    parser.add_argument('--quick', action='store_true', help='a few points of every figure')
    options = parser.parse_args(_without_ros_arguments(sys.argv[1:] if argv is None else argv))
    wanted = points(options.quick)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        plans = run(wanted, options.out / 'plans', options.jobs, options.backend)
        written = write_figures(plans, options.out)
        written.append(write_claims(plans, options.out / 'claims.md'))
    except KeyboardInterrupt:
        kept = sum((options.out / 'plans' / point.file).exists() for point in wanted)
        print(f'\nstopped: {kept} of {len(wanted)} points are kept, the same command goes on '
              'from there', file=sys.stderr)
        return 130
    print('\n'.join(map(str, written)))
    return 0


def _without_ros_arguments(arguments):
    try:
        from rclpy.utilities import remove_ros_args
    except ImportError:
        return arguments
    return remove_ros_args(['study', *arguments])[1:]


if __name__ == '__main__':
    sys.exit(main())
