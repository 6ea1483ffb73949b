"""Computation of the plans of the study; every finished plan is kept in a file."""

from contextlib import contextmanager, nullcontext
import os
import pathlib
import signal

import joblib
from tqdm import tqdm

from .. import fly_hover_fly, METHODS, Plan, solve, upper_bound
from ..campaign.workers import THREAD_COUNTS


def compute(point):
    """Return the Plan of a point with its rates evaluated."""
    if point.scheme in METHODS:
        plan = solve(point.scenario, method=point.scheme, objective=point.objective)
    else:
        plan = fly_hover_fly(point.scenario, point.scheme.rpartition('_')[2])
    if point.bounded:
        plan = plan.with_bound(upper_bound(
            point.scenario, objective=point.objective, plan=plan))
    return plan.evaluated()  # In the worker process, not later when the plan is saved.


def run(wanted, folder, jobs=None, backend=None):
    """
    Return the Plan of every Point; only plans that are not in the folder are computed.

    Computed plans are returned to this process, which writes each of them at once. The workers may
    therefore be on other machines: choose them with `backend`, or with joblib.parallel_config
    around the call. Convergence is timed, so its points are computed last and one at a time.

    :param wanted: the Points.
    :param folder: where finished plans are kept.
    :param jobs: number of jobs for joblib; by default joblib's own setting.
    :param backend: backend of joblib; by default joblib's own setting.
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
    """Yield (number, Plan) for Points in the order of completion; stop the workers on an error."""
    threads = {name: os.environ.get(name) for name in THREAD_COUNTS}
    os.environ.update(dict.fromkeys(THREAD_COUNTS, '1'))
    chosen = (nullcontext() if backend is None or options['n_jobs'] == 1
              else joblib.parallel_config(backend))
    # Workers inherit this setting. Ctrl-C reaches all processes of a terminal, and only this one
    # may handle it.
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
    except ValueError:  # Handlers can be set in the main thread only.
        return None
