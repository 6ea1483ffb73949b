"""The kernel computes what the plain formulas say, takes only what fits, and is always there."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import os
from pathlib import Path
import shutil
import subprocess
import sys
import threading

from benchmarks.missions import random_mission
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import oracle
from processes import ROOT, run_python
import pytest
from random_cities import random_city_mission
from secure_uav_planner import Eavesdropper, Scenario
from secure_uav_planner.errors import NumericalError, StoppedError
from secure_uav_planner.model import kernel
from secure_uav_planner.model.grid import Receivers
from secure_uav_planner.model.kernel import core
from secure_uav_planner.model.limits import build_limits
from secure_uav_planner.model.limits.lines import LineLimit
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial import constant_powers, fly_hover_fly_positions
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver
from secure_uav_planner.optimize.joint.starts import generate_starts, make_strictly_feasible
from strategies import find_interior, make_crowd, scenarios, with_uavs

COARSE_MU = 1e-3


def first_starts(scenario, slots):
    """Return a grid and its first batch of starts, (S, N, U, 3), with barrier parameters."""
    problem = Problem(scenario)
    grid = problem.grid.with_slots(slots)
    return grid, next(generate_starts(grid, problem, fly_hover_fly_positions(problem)))


def smallest_slack(grid, x):
    return min(slacks.min() for slacks, _ in oracle.slacks_at(grid, x))


def city_mission(*uavs, pieces=1):
    """Return the mission in the city for some of its UAVs, with each zone in several sizes."""
    city = Scenario.load(ROOT / 'config' / 'city.yaml')
    zones = tuple(
        replace(zone, vertices=tuple(zone.vertices[0] + share * (
            np.array(zone.vertices) - zone.vertices[0])), name=f'{zone.name} {number}')
        for zone in city.no_fly_zones for number, share in enumerate(
            np.linspace(1.0, 0.5, pieces).tolist()))
    return replace(city, uavs=tuple(city.uavs[uav] for uav in uavs), no_fly_zones=zones)


LINES = {
    'city': city_mission(0, 1, 2), 'alone': city_mission(0),
    'many pieces': city_mission(0, 1, pieces=4),
    'straight': with_uavs(city_mission(0, 1), max_acceleration=None),
    'side by side': replace(Scenario.paper(120.0), separation=18.0, uavs=tuple(
        replace(uav, start=(uav.start[0] + 20.0 * number, uav.start[1]),
                goal=(uav.goal[0] + 20.0 * number, uav.goal[1]), altitude=100.0)
        for number, uav in enumerate(Scenario.paper().uavs))),
    'free ends': with_uavs(city_mission(0, 1), start_velocity=None, goal_velocity=None)}


def check_model(grid, x, mu, rng, receivers=None):
    """Compare the barrier function and its gradient, along three directions, with the oracle."""
    [value], [gradient], _ = oracle.model(
        InteriorPointSolver(grid, x[None], mu, receivers=receivers))
    assert value == pytest.approx(
        oracle.barrier(grid, x, mu, oracle.SOFTENING), rel=1e-9, abs=1e-9)
    for direction in rng.normal(size=(3, *x.shape)):
        slope = oracle.barrier(grid, x + oracle.STEP * 1j * direction, mu, oracle.SOFTENING,
                               at=x).imag / oracle.STEP
        assert (gradient * direction).sum() == pytest.approx(
            slope, rel=1e-7, abs=1e-9 * np.abs(gradient * direction).sum())


@pytest.mark.parametrize('name', LINES)
def test_the_barrier_function_with_lines_is_that_of_the_formulas(name):
    grid, x = find_interior(LINES[name], 30)
    check_model(grid, x, 1e-2, np.random.default_rng(0))
    # The lines are not far away.
    path = np.ascontiguousarray(oracle.path_of(grid, x))
    least = min(oracle.slacks(limit, path, limit.choose_lines(path)).min()
                for limit in build_limits(grid) if isinstance(limit, LineLimit))
    assert 0 < least < 0.5


def test_the_largest_scenario_follows_the_formulas_too():
    grid, x = find_interior(make_crowd(32, 32, 6), 6)
    check_model(grid, x, 1e-2, np.random.default_rng(0))
    barrier = InteriorPointSolver(grid, x[None], 1e-2)
    barrier.advance(1, 1e-3)
    assert smallest_slack(grid, barrier.x[0]) > 0 and not np.array_equal(barrier.x[0], x)


@pytest.mark.parametrize('copies', [1, 3])
@pytest.mark.parametrize('spread', [0.0, 0.3, 300.0])
def test_the_largest_of_many_leaks_is_exact_however_near_they_are(monkeypatch, spread, copies):
    rng, paper = np.random.default_rng(0), Scenario.paper(120.0)
    places = paper.eavesdroppers[0].position + spread * rng.normal(size=(32, 2))
    grid, x = find_interior(replace(paper, eavesdroppers=tuple(
        Eavesdropper(tuple(place), 0.0) for place in places)), 6)
    # Three places for each eavesdropper, as problem (P1) has them: 96 leaks at once.
    receivers = Receivers.of(grid).at_places(np.repeat(
        [(places - grid.origin) / grid.length], copies, axis=1).repeat(6, axis=0))
    rates = oracle.rates

    def repeat_leaks(*arguments):
        ground, leaks = rates(*arguments)
        return ground, np.repeat(leaks, copies, axis=-1)

    monkeypatch.setattr(oracle, 'rates', repeat_leaks)
    for mu in (1e-1, 1e-3, 1e-5):
        check_model(grid, x, mu, rng, receivers)


@settings(max_examples=10)
@given(st.one_of(
    scenarios(max_eavesdroppers=3), st.integers(0, 5).map(lambda seed: random_city_mission(
        seed, 12))))
def test_steps_stay_inside_and_lower_the_function_until_it_is_stationary(scenario):
    grid, x = find_interior(scenario)
    mu = 1e-2
    barrier = InteriorPointSolver(grid, x[None], mu)
    lines = any(isinstance(limit, LineLimit) for limit in build_limits(grid))
    first, last = slope_of(barrier), np.inf
    for _ in range(80):
        [value] = oracle.model(barrier)[0]
        assert lines or value <= last + 1e-9 * abs(last)  # lines are chosen anew
        last = value
        barrier.advance(1, mu)
        assert smallest_slack(grid, barrier.x[0]) > 0
    assert barrier.finished.all() and barrier.mu[0] == mu
    assert slope_of(barrier) < (0.05 if lines else 1e-8) * first


def slope_of(barrier):
    """Return the length of the gradient of what varies, each power in units of itself."""
    _, [gradient], _ = oracle.model(barrier)
    gradient[..., 0] *= barrier.x[0, ..., 0]
    gradient[..., 1:] *= ~barrier.grid.fixed[:, None]
    return np.linalg.norm(gradient)


def test_several_steps_in_a_call_are_the_same_as_single_ones():
    grid, (x, mu) = first_starts(random_mission(2), 30)
    together, singly = (InteriorPointSolver(grid, x, mu) for _ in range(2))
    left = 12
    while left:
        left -= together.advance(left, COARSE_MU)
    for _ in range(12):
        assert singly.advance(1, COARSE_MU) == 1
    assert not np.array_equal(together.x, x)
    for name in ('x', 'mu', 'finished'):
        assert np.array_equal(getattr(together, name), getattr(singly, name)), name


def test_a_call_takes_fewer_steps_if_they_are_long():
    taken = []
    for slots in (50, 5000):
        problem = Problem(Scenario.paper(slots=slots))
        grid = problem.grid
        x = make_strictly_feasible(grid, fly_hover_fly_positions(problem),
                                   constant_powers(grid.scenario), share=0.05)
        taken.append(InteriorPointSolver(grid, x[None], 0.02).advance(60, 1e-3))
    assert 1 <= taken[1] < taken[0] == 60


def test_arrays_of_discs_of_a_wrong_shape_or_layout_are_refused():
    discs = dict.fromkeys(('x', 'y'), np.zeros((2, 3))) | {
        'squared_altitudes': np.ones((2, 1)), 'noise': np.ones(3), 'radius': np.ones(3),
        'jamming': np.ones((1, 3))}
    core.find_local_minima(discs, np.empty((3, 3)))
    for name, wrong in (('x', np.zeros((2, 2))), ('jamming', np.ones((2, 3))),
                        ('radius', np.ones(4)), ('y', np.zeros((3, 2))[:, ::2])):
        with pytest.raises(ValueError):
            core.find_local_minima(discs | {name: wrong}, np.empty((3, 3)))
    answers = np.zeros(2), np.zeros(2, np.int64), np.zeros((2, 2))
    for slots in ([0, 1, 2], [1, 0, 0], [-1, 0, 0]):
        with pytest.raises(ValueError):
            core.prove_leaks(discs, np.array(slots), np.ones(3), 100, 1e-6, *answers)


def test_threads_run_during_a_long_step_and_check_can_stop_it():
    grid, (x, _) = first_starts(Scenario.paper(slots=20000), 20000)
    begun, stop = threading.Event(), threading.Event()

    def check():
        begun.set()
        if stop.is_set():
            raise StoppedError

    barrier = InteriorPointSolver(grid, np.concatenate([x[:2]] * 8), 0.02, check)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1000.0)  # Python itself lets no other thread run.
    try:
        with ThreadPoolExecutor(1) as pool, pytest.raises(StoppedError):
            running = pool.submit(barrier.advance, 50, 1e-3)
            begun.wait()
            stop.set()
            running.result()
    finally:
        sys.setswitchinterval(interval)
    assert np.isfinite(barrier.rates()).all()
    stop.clear()
    barrier.advance(1, 1e-3)  # It can go on.


def test_variables_of_a_wrong_shape_are_refused():
    grid, (x, mu) = first_starts(Scenario.paper(slots=5), 5)
    for wrong in (x[:, :4], x[:, :, :1], x[..., :2], x[0], x[:0]):
        with pytest.raises((ValueError, IndexError)):
            InteriorPointSolver(grid, wrong, 0.1)


def test_a_start_with_nan_fails_alone():
    grid, (x, mu) = first_starts(Scenario.paper(slots=5), 5)
    x = x[:3].copy()
    x[1, 2] = np.nan
    barrier = InteriorPointSolver(grid, x, mu[:3])
    barrier.advance(1, 1e-3)
    assert (barrier.x[[0, 2]] != x[[0, 2]]).any(axis=(1, 2, 3)).all()
    assert np.array_equal(barrier.x[1], x[1], equal_nan=True)
    with pytest.raises(NumericalError):
        InteriorPointSolver(grid, x[1:2], mu[1:2]).advance(1, 1e-3)


# Where the kernel is not there or does not fit


def test_the_error_without_a_kernel_says_what_to_do(tmp_path):
    (tmp_path / '_secure_uav_planner_kernel.py').write_text('raise ImportError("no such file")')
    done = run_python('-c', 'from secure_uav_planner import solve', status=1,
                      env={**os.environ, 'PYTHONPATH': str(tmp_path)})
    [said] = done.stderr.splitlines()[-1:]
    assert said.startswith('ImportError: ')
    assert 'no such file' in said and "'pip install .'" in said


def test_a_kernel_of_other_sources_is_not_used(monkeypatch):
    assert kernel.sources.load_kernel() is core
    monkeypatch.setattr(kernel.sources, 'find_digest', lambda: 'another')
    with pytest.raises(ImportError, match='another version of secure_uav_planner'):
        kernel.sources.load_kernel()


# Building it on a machine without a compiler


def without_compiler(folder):
    """Return an environment in which no compiler is found."""
    return {name: value for name, value in os.environ.items()
            if name not in ('CC', 'CXX')} | {'PATH': str(folder)}


@pytest.fixture
def source(tmp_path):
    """Return a copy of all that is built."""
    folder = tmp_path / 'source'
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(
        '.*', 'build', 'docs', 'install', 'log', 'out', 'test', '__pycache__', '*.egg-info'))
    return folder


def test_the_build_asks_for_a_compiler_where_there_is_none(source, tmp_path):
    script = 'import build_backend; print(build_backend.get_requires_for_build_wheel())'
    bare = without_compiler(tmp_path)
    for environment, asked in ((bare, True),
                               (bare | dict.fromkeys(('CC', 'CXX'), '/bin/sh'), False)):
        done = subprocess.run([sys.executable, '-c', script], cwd=source, env=environment,
                              capture_output=True, text=True, check=True)
        assert ('ziglang' in done.stdout.splitlines()[-1]) == asked


def test_setup_py_says_what_to_install_where_there_is_no_compiler(source, tmp_path):
    done = subprocess.run([sys.executable, 'setup.py', 'build'], cwd=source,
                          env=without_compiler(tmp_path), capture_output=True, text=True)
    assert done.returncode and 'to build it, install build-essential' in done.stderr
    assert not list(source.rglob('*.so'))


@pytest.mark.soak
def test_pip_builds_the_kernel_without_a_compiler(source, tmp_path):
    target = tmp_path / 'target'
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--target',
                    target, source], env=without_compiler(tmp_path), check=True)
    script = ('from secure_uav_planner import Scenario, solve; '
              'from secure_uav_planner.model import kernel; '
              'print(kernel.core.__file__, solve(Scenario.paper(120.0)).worst_case_rate)')
    done = subprocess.run(
        [sys.executable, '-c', script], cwd=tmp_path, check=True, text=True, capture_output=True,
        env={**os.environ, 'PYTHONPATH': str(target)})
    file, rate = done.stdout.split()
    assert Path(file).parent == target and float(rate) == pytest.approx(2.0531817, abs=1e-5)
