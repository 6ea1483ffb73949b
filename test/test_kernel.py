"""The compiled kernel does what the NumPy form of the barrier method does, or is not used."""

from dataclasses import replace
import logging
import os
from pathlib import Path
import shutil
import subprocess
import sys
import threading

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import Scenario, solve
from secure_uav_planner.bench.missions import random_mission
from secure_uav_planner.channel import kernel_search, leak_maximisers, worst_case_rates
from secure_uav_planner.channel.derivatives import Receivers
from secure_uav_planner.errors import NumericalError
from secure_uav_planner.grid import Grid
from secure_uav_planner.kernel import loading
from secure_uav_planner.limits import limits_of, SpeedLimit
from secure_uav_planner.limits.base import Iterate
from secure_uav_planner.limits.lines import LineLimit
from secure_uav_planner.optimize.baselines import constant_powers, fly_hover_fly_positions
from secure_uav_planner.optimize.joint import kernel_barrier as kernel
from secure_uav_planner.optimize.joint.barrier import Barrier
from secure_uav_planner.optimize.joint.kernel_barrier import KernelBarrier, make_barrier
from secure_uav_planner.optimize.joint.schedule import SCHEDULE
from secure_uav_planner.optimize.joint.starts import several_starts, strictly_feasible
from secure_uav_planner.optimize.joint.worst_places import WorstPlaces
from strategies import random_powers, scenarios

ROOT = Path(__file__).resolve().parents[1]

needs_kernel = pytest.mark.skipif(
    kernel.compiled() is None, reason='the package was installed without its compiled kernel')


def relative(found, expected):
    """Return the largest difference of every start, (S,)."""
    axes = tuple(range(1, expected.ndim))
    return np.abs(found - expected).max(axis=axes) if axes else np.abs(found - expected)


class Noisy(Barrier):
    """The NumPy form with Hessians that are wrong in their last bits, and other starts."""

    def __init__(self, grid, x, mu, schedule, check, places):
        self._random = np.random.default_rng(len(x) * grid.slots)
        beside = x * (1 + 1e-13 * self._random.choice([-1.0, 1.0], x.shape))
        super().__init__(grid, beside, mu, schedule, check, places)

    def _model_of_slots(self, here):
        gradient, hessian, leaks = super()._model_of_slots(here)
        noise = self._random.uniform(-1e-15, 1e-15, hessian.shape) * np.abs(hessian).max(
            axis=(-1, -2), keepdims=True)
        return gradient, hessian + noise + np.swapaxes(noise, -1, -2), leaks


class Both:
    """
    The two forms from the same starts, and noisy ones.

    Near a kink or a boundary the last bits of a Hessian decide about a step. How far noisy
    barriers have gone from the first shows how much that matters.

    :param places: for problem (P1); all have the same, the worst where the first one is.
    """

    def __init__(self, grid, x, mu, places=None):
        self.numpy, self.kernel, *self.noisy = self.all = [
            form(grid, x, mu, SCHEDULE, lambda: None, places)
            for form in (Barrier, KernelBarrier, Noisy, Noisy)]
        self.places = places
        self.spread = np.zeros(len(x))

    @classmethod
    def against_places(cls, grid, x):
        """Return the forms for problem (P1) from one start."""
        return cls(grid, x[None], SCHEDULE.places_mu, WorstPlaces(grid, x))

    def iterate(self, final):
        """Take a step with each; all can, or none."""
        errors = []
        for barrier in self.all:
            try:
                barrier.iterate(final)
            except NumericalError as error:
                errors.append(error)
        assert len(errors) in (0, len(self.all))
        for other in self.noisy:
            self.spread = np.maximum(self.spread, relative(other.x, self.numpy.x))
        if self.places is not None:
            worse = self.places.exchange(self.numpy.x[0], SCHEDULE.worse)
            for barrier in self.all:
                barrier.exchange(self.places, worse)
        return not errors

    def steady(self):
        """Check that the forms agree where noise does not matter; return where, (S,)."""
        apart, steady = relative(self.kernel.x, self.numpy.x), self.spread <= 1e-8
        assert (apart <= 1e-9 + 1000 * self.spread)[steady].all(), (apart, self.spread)
        assert self.kernel.mu[steady] == pytest.approx(self.numpy.mu[steady], rel=1e-12, abs=0)
        assert np.array_equal(self.kernel.finished[steady], self.numpy.finished[steady])
        assert self.kernel.rates()[steady] == pytest.approx(
            self.numpy.rates()[steady], rel=1e-7, abs=1e-9)
        return steady

    def same(self):
        """Return the starts where the forms agree by 1e-9, (S,)."""
        return relative(self.kernel.x, self.numpy.x) <= 1e-9


@needs_kernel
@pytest.mark.parametrize('scenario', [
    Scenario.paper(102.0), Scenario.paper(), random_mission(1), random_mission(2),
    replace(Scenario.paper(), uavs=Scenario.paper().uavs[:1])],
    ids=['T = 102', 'T = 200', 'seed 1', 'seed 2', 'alone'])
def test_starts_take_the_same_ten_steps(scenario):
    grid = Grid.of(scenario, 30)
    both = Both(grid, *several_starts(grid, SCHEDULE)[:2])
    for _ in range(10):
        assert both.iterate(SCHEDULE.coarse_mu)
        steady = both.steady()
    assert steady.mean() > 0.2 and both.same().mean() > 0.2
    chosen = np.flatnonzero(steady)[::-2]
    both.spread = both.spread[chosen]
    for barrier in both.all:
        barrier.keep(chosen)
    assert both.iterate(SCHEDULE.coarse_mu)
    assert both.steady().any()


@needs_kernel
def test_several_steps_at_once_are_the_same_as_one_after_the_other():
    grid = Grid.of(random_mission(2), 30)
    x, mu = several_starts(grid, SCHEDULE)[:2]
    once, one_by_one = (KernelBarrier(grid, x, mu, SCHEDULE) for _ in range(2))
    left = 12
    while left:
        left -= once.advance(left, SCHEDULE.coarse_mu)
    for _ in range(12):
        one_by_one.iterate(SCHEDULE.coarse_mu)
    assert not np.array_equal(once.x, x)
    for name in ('x', 'mu', 'finished'):
        assert np.array_equal(getattr(once, name), getattr(one_by_one, name)), name


@needs_kernel
def test_only_steps_that_are_short_are_taken_at_once():
    taken = []
    for slots in (50, 5000):
        grid = Grid.of(Scenario.paper(slots=slots))
        x = strictly_feasible(grid, fly_hover_fly_positions(grid.scenario),
                              constant_powers(grid.scenario))
        taken.append(KernelBarrier(grid, x[None], 0.02, SCHEDULE).advance(60, 1e-3))
    assert 1 <= taken[1] < taken[0] == 60


def of_city(*uavs, pieces=1):
    """Return the mission in the city with some of its UAVs, whose zones are divided."""
    city = Scenario.load(ROOT / 'config' / 'city.yaml')
    zones = tuple(
        replace(zone, vertices=tuple(zone.vertices[0] + share * (
            np.array(zone.vertices) - zone.vertices[0])), name=f'{zone.name} {number}')
        for zone in city.no_fly_zones for number, share in enumerate(
            np.linspace(1.0, 0.5, pieces).tolist()))
    return replace(city, uavs=tuple(city.uavs[uav] for uav in uavs), no_fly_zones=zones)


def without_acceleration_limit(scenario, *uavs):
    return replace(scenario, uavs=tuple(
        replace(uav, max_acceleration=None) if number in uavs else uav
        for number, uav in enumerate(scenario.uavs)))


LINES = {
    'city': of_city(0, 1, 2), 'alone': of_city(0), 'many pieces': of_city(0, 1, pieces=4),
    'straight': without_acceleration_limit(of_city(0, 1), 0, 1),
    'one straight': without_acceleration_limit(of_city(0, 1, 2), 1),
    'side by side': replace(Scenario.paper(120.0), separation=18.0, uavs=tuple(
        replace(uav, start=(uav.start[0] + 20.0 * number, uav.start[1]),
                goal=(uav.goal[0] + 20.0 * number, uav.goal[1]), altitude=100.0)
        for number, uav in enumerate(Scenario.paper().uavs))),
    'free ends': replace(of_city(0, 1), uavs=tuple(
        replace(uav, start_velocity=None, goal_velocity=None) for uav in of_city(0, 1).uavs))}


@needs_kernel
@pytest.mark.parametrize('objective', ['guaranteed', 'worst_case'])
@pytest.mark.parametrize('name', LINES)
def test_beyond_lines_four_steps_are_the_same(name, objective):
    grid = Grid.of(LINES[name], 30)
    lines = [limit for limit in limits_of(grid.scenario, grid) if isinstance(limit, LineLimit)]
    assert lines
    x, mu = several_starts(grid, SCHEDULE)[:2]
    both = Both(grid, x[:3], mu[:3]) if objective == 'guaranteed' else (
        Both.against_places(grid, x[0]))
    for _ in range(4):
        assert both.iterate(SCHEDULE.coarse_mu)
        both.steady()
        assert both.same().any()
    # The lines have not been far away all the time.
    least = min(limit.margin(Iterate(grid, both.numpy.x)).min() for limit in lines)
    assert 0 < least < 0.5


@needs_kernel
@pytest.mark.parametrize('scenario', [
    Scenario.paper(102.0), Scenario.paper(200.0, 60.0), random_mission(1), random_mission(2),
    replace(Scenario.paper(), uavs=Scenario.paper().uavs[:1])],
    ids=['T = 102', 'T = 200', '1 jammer, 2 eavesdroppers', '3 and 3', 'alone'])
def test_against_the_worst_places_ten_steps_are_the_same(scenario):
    assert scenario.error_radii.all()
    grid = Grid.of(scenario, 30)
    plan = solve(scenario, objective='guaranteed')
    both = Both.against_places(grid, strictly_feasible(grid, plan.positions, plan.powers))
    places = both.places.offsets
    for _ in range(10):
        assert both.iterate(SCHEDULE.places_final_mu)
        both.steady()
        # Where noise in the last bits has grown a thousandfold, steady() is the judge.
        assert (both.same() | (both.spread > 1e-12)).all()
    assert not np.array_equal(both.places.offsets, places)


@needs_kernel
@settings(max_examples=15)
@given(scenarios(max_uavs=6, max_eavesdroppers=3), st.integers(1, 14), st.booleans())
def test_the_forms_agree_on_missions_of_every_kind(scenario, slots, fixed):
    grid = Grid.of(scenario, slots)
    assume(kernel.is_known(limits_of(scenario, grid), Receivers.of(grid)))
    if fixed:
        grid = grid.with_fixed_positions()
    x, mu = several_starts(grid, SCHEDULE)[:2]
    # On another grid than the scenario's a limit of acceleration may be too hard.
    inside = np.all([limit.margin(Iterate(grid, x)).reshape(len(x), -1).min(axis=1) > 0
                     for limit in limits_of(scenario, grid)], axis=0)
    assume(inside.any())
    for both in (Both(grid, x[inside], mu[inside]), Both.against_places(grid, x[inside][0])):
        same = []
        for _ in range(5):
            with np.errstate(all='ignore'):
                if not both.iterate(SCHEDULE.final_mu):
                    break
            both.steady()
            same.append(both.same().any())
        assert not same or same[0]


@needs_kernel
@given(scenarios(max_uavs=4, max_eavesdroppers=3), st.integers(0, 2**32 - 1))
def test_worst_cases_are_the_same(scenario, seed):
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-400, 400, (len(scenario.uavs), scenario.slots + 2, 2))
    powers = random_powers(scenario, rng)
    found = []
    for form in (kernel.compiled, lambda: None):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(kernel_search, 'compiled', form)
            found.append((worst_case_rates(scenario, positions, powers),
                          leak_maximisers(scenario, positions[:, 1:-1], powers)[1]))
    (rates, leaks), (other_rates, other_leaks) = found
    # Proofs may end anywhere within their tolerance.
    assert rates == pytest.approx(other_rates, abs=1e-6)
    assert leaks == pytest.approx(other_leaks, rel=1e-9, abs=1e-9)


@needs_kernel
def test_places_that_are_no_arrays_of_pairs_are_refused():
    pairs = dict.fromkeys(('x', 'y'), np.zeros((2, 3))) | {
        'squared_altitudes': np.ones((2, 1)), 'noise': np.ones(3), 'radius': np.ones(3),
        'jamming': np.ones((1, 3))}
    kernel.compiled().likely_places(pairs, np.empty((3, 3)))
    for name, wrong in (('x', np.zeros((2, 2))), ('jamming', np.ones((2, 3))),
                        ('radius', np.ones(4)), ('y', np.zeros((3, 2))[:, ::2])):
        with pytest.raises(ValueError):
            kernel.compiled().likely_places(pairs | {name: wrong}, np.empty((3, 3)))
    answers = np.zeros(2), np.zeros(2, np.int64), np.zeros((2, 2))
    for slots in ([0, 1, 2], [1, 0, 0], [-1, 0, 0]):
        with pytest.raises(ValueError):
            kernel.compiled().prove(pairs, np.array(slots), np.ones(3), 100, *answers)


@needs_kernel
def test_plans_are_the_same(monkeypatch):
    missions = [Scenario.paper(102.0), Scenario.paper(120.0, 30.0), Scenario.paper(slots=60)]
    compiled = [solve(mission, objective=objective)
                for mission in missions for objective in ('guaranteed', 'worst_case')]
    monkeypatch.setattr(kernel, 'compiled', lambda: None)
    monkeypatch.setattr(kernel_search, 'compiled', lambda: None)
    for plan in compiled:
        other = solve(plan.scenario, objective=plan.objective)
        assert plan.rate == pytest.approx(other.rate, rel=1e-4)


@needs_kernel
def test_others_run_while_a_long_step_is_taken_and_can_stop_it():
    grid = Grid.of(Scenario.paper(slots=20000))
    x = several_starts(grid, replace(SCHEDULE, kinds=SCHEDULE.kinds[:1]))[0][:2]
    x = np.concatenate([x] * 8)
    seen, counted, done = [], [0], threading.Event()

    class Stop(Exception):
        pass

    def count():
        while not done.is_set():
            counted[0] += 1

    def check():
        seen.append(counted[0])
        if len(seen) > 3 and not done.is_set():
            raise Stop

    barrier = KernelBarrier(grid, x, 0.02, SCHEDULE, check)
    other = threading.Thread(target=count)
    other.start()
    try:
        with pytest.raises(Stop):
            for _ in range(50):
                barrier.iterate(1e-3)
    finally:
        done.set()
        other.join()
    # The other counted between looks, though a busy machine may let it wait from one to the next.
    assert len(seen) == 4 and seen[-1] > seen[0]
    assert np.isfinite(barrier.rates()).all()
    barrier.iterate(1e-3)  # It can go on.


@needs_kernel
def test_what_is_no_array_of_the_problem_is_refused():
    grid = Grid.of(Scenario.paper(slots=5))
    x, mu = several_starts(grid, SCHEDULE)[:2]
    for wrong in (x[:, :4], x[:, :, :1], x[..., :2], x[0], x[:0]):
        with pytest.raises((ValueError, IndexError)):
            KernelBarrier(grid, wrong, 0.1, SCHEDULE)
    barrier = KernelBarrier(grid, x, mu, SCHEDULE)
    with pytest.raises(IndexError):
        barrier.keep(np.array([len(x)]))


@needs_kernel
def test_numbers_that_are_none_fail_and_cost_nothing_but_their_own_start():
    grid = Grid.of(Scenario.paper(slots=5))
    x, mu = several_starts(grid, SCHEDULE)[:2]
    x = x[:3].copy()
    x[1, 2] = np.nan
    barrier = KernelBarrier(grid, x, mu[:3], SCHEDULE)
    barrier.iterate(1e-3)
    assert (barrier.x[[0, 2]] != x[[0, 2]]).any(axis=(1, 2, 3)).all()
    assert np.array_equal(barrier.x[1], x[1], equal_nan=True)
    barrier.keep(np.array([1]))
    with pytest.raises(NumericalError):
        barrier.iterate(1e-3)


# Without the kernel, or with one that does not fit


class NewLimit(SpeedLimit):
    """A limit that the kernel has never heard of."""


def test_a_limit_that_the_kernel_does_not_know_is_left_to_numpy(monkeypatch):
    grid = Grid.of(Scenario.paper(slots=5))
    start = several_starts(grid, SCHEDULE)[:2]
    if kernel.compiled() is not None:
        assert type(make_barrier(grid, *start, SCHEDULE)) is KernelBarrier
    limits = kernel.limits_of
    monkeypatch.setattr(kernel, 'limits_of', lambda *of: (NewLimit(*of), *limits(*of)[1:]))
    assert type(make_barrier(grid, *start, SCHEDULE)) is Barrier
    with pytest.raises(ValueError, match='does not know a limit'):
        KernelBarrier(grid, *start, SCHEDULE)


@pytest.fixture
def anew():
    """Let the kernel be looked for again, before and after a test."""
    kernel.compiled.cache_clear()
    yield
    kernel.compiled.cache_clear()


@pytest.mark.parametrize('module, line', [
    (type(sys)('_secure_uav_planner_kernel'), "has no attribute 'sources'"),
    (None, '_secure_uav_planner_kernel')])
def test_without_a_kernel_that_fits_one_line_says_so(module, line, anew, monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, '_secure_uav_planner_kernel', module)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert solve(Scenario.paper(102.0, slots=8)).guaranteed_rate > 0
    [record] = caplog.records
    assert 'without its compiled kernel' in record.message and line in record.message


@needs_kernel
def test_a_kernel_of_other_sources_is_not_used(anew, monkeypatch, caplog):
    monkeypatch.setattr(loading, 'digest', lambda: 'another')
    assert kernel.compiled() is None
    assert 'another version' in caplog.text


def test_the_switch_turns_the_kernel_off(anew, monkeypatch, caplog):
    monkeypatch.setenv(loading.SWITCH, '0')
    assert kernel.compiled() is None and not caplog.records


@pytest.mark.parametrize('lacking', ['compiler', 'pybind11'])
def test_the_package_is_built_without(lacking, tmp_path):
    source = tmp_path / 'source'
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(
        '.*', 'build', 'install', 'log', 'out', 'test', '__pycache__', '*.so', '*.egg-info'))
    hidden = tmp_path / 'hidden'
    hidden.mkdir()
    headers = '' if lacking == 'pybind11' else "def get_include():\n    return '.'\n"
    (hidden / 'pybind11.py').write_text(headers or 'raise ImportError\n')
    done = subprocess.run(
        [sys.executable, 'setup.py', 'build'], cwd=source, capture_output=True, text=True,
        env={**os.environ, 'CC': '/no/compiler', 'CXX': '/no/compiler',
             'PYTHONPATH': str(hidden)})
    assert done.returncode == 0, done.stdout + done.stderr
    built = list((source / 'build').rglob('*'))
    assert any(path.name == 'newton.hpp' for path in built)
    assert not any(path.suffix == '.so' for path in built)
