"""Every limit, checked against its own definition; each test covers all limits."""

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import PlanningError
from secure_uav_planner.bench.missions import random_city_mission
from secure_uav_planner.errors import InfeasibleMissionError
from secure_uav_planner.grid import Grid
from secure_uav_planner.limits import LIMITS, limits_of
from secure_uav_planner.limits.base import ALL_SLOTS, Iterate, Step
from secure_uav_planner.optimize.baselines import constant_powers, fly_hover_fly_positions
from secure_uav_planner.optimize.joint.newton import BandMatrix
from secure_uav_planner.optimize.joint.starts import strictly_feasible
from strategies import random_powers, scenarios

SEEDS = st.integers(0, 2**32 - 1)


@st.composite
def cities(draw):
    """Return missions with zones, fence and separation that can be flown."""
    try:
        scenario = random_city_mission(draw(st.integers(0, 10**6)), draw(st.integers(6, 14)))
        fly_hover_fly_positions(scenario)
    except InfeasibleMissionError:
        assume(False)
    return scenario


MISSIONS = st.one_of(scenarios(), cities())


def inside(scenario, rng):
    """Return a Grid and strictly feasible variables on it, (1, N, U, 3)."""
    grid = Grid.of(scenario)
    x = strictly_feasible(grid, fly_hover_fly_positions(scenario),
                          constant_powers(scenario, 0.9, 0.5), share=0.3)
    x[..., 0] *= rng.uniform(0.5, 1.0, x.shape[:-1])
    return grid, x[None]


def random_step(grid, x, rng, size):
    change = size * rng.normal(size=x.shape)
    change[..., 1:] *= ~grid.fixed[:, None]
    return change


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_margins_change_as_their_derivatives_say(scenario, seed):
    rng = np.random.default_rng(seed)
    grid, x = inside(scenario, rng)
    step = random_step(grid, x, rng, 1e-5)
    for limit in limits_of(scenario, grid):
        iterate = Iterate(grid, x)
        found = limit.change(iterate, Step(step))
        before, after = (limit.margin(iterate.moved(x + sign * step)) for sign in (-1, 1))
        scale = np.abs(found).max(initial=1e-9)
        np.testing.assert_allclose((after - before) / 2, found, atol=1e-6 * scale)


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_gradients_are_those_of_the_margins(scenario, seed):
    rng = np.random.default_rng(seed)
    grid, x = inside(scenario, rng)
    step = random_step(grid, x, rng, 1.0)
    for limit in limits_of(scenario, grid):
        iterate = Iterate(grid, x)
        force = rng.uniform(0, 1, limit.margin(iterate).shape)
        gradient = np.zeros_like(x)
        limit.add_gradient(iterate, force, gradient)
        change = limit.change(iterate, Step(step))
        assert (gradient * step).sum() == pytest.approx(-(force * change).sum(), rel=1e-9,
                                                        abs=1e-9 * np.abs(change).sum())


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_curvature_is_that_of_the_barrier_function(scenario, seed):
    # With central duals, the primal-dual Hessian is the barrier function's own.
    rng = np.random.default_rng(seed)
    grid, x = inside(scenario, rng)
    size = 3 * x.shape[2]
    for limit in limits_of(scenario, grid):
        if limit.reach == ALL_SLOTS:
            continue
        matrix = BandMatrix(np.zeros((1, x.shape[1], size, size)), max(size, limit.height(size)),
                            np.zeros(x.shape[2], bool))
        iterate = Iterate(grid, x)
        margin = limit.margin(iterate)
        limit.add_curvature(iterate, 1 / margin, margin, matrix)
        step = random_step(grid, x, rng, 1e-5 * margin.min())

        def gradient(at):
            found = np.zeros_like(at)
            moved = iterate.moved(at)
            limit.add_gradient(moved, 1 / limit.margin(moved), found)
            return found.ravel()

        expected = (gradient(x + step) - gradient(x - step)) / 2
        found = matrix.dense(0) @ step.ravel()
        np.testing.assert_allclose(
            found, expected, atol=1e-4 * np.abs(expected).max(initial=1e-12))


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_the_longest_step_stays_inside_and_is_not_needlessly_short(scenario, seed):
    rng = np.random.default_rng(seed)
    grid, x = inside(scenario, rng)
    step = random_step(grid, x, rng, 10.0)
    iterate = Iterate(grid, x)
    for limit in limits_of(scenario, grid):
        margin = limit.margin(iterate)
        reach = limit.longest_step(
            iterate, Step(step), margin, limit.change(iterate, Step(step)), 0.99)
        by = reach.min()
        there = limit.margin(iterate.moved(x + by * step))
        assert (there >= 0.0099 * margin - 1e-9).all()
        lines = iterate.lines.get(limit)
        if by < 1 and (lines is None or lines.room is None):  # what has no line stops it, too
            assert limit.margin(iterate.moved(x + 1.02 * by * step)).min() < 0.012 * margin.max()


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_what_is_repaired_passes_the_check_and_what_breaks_a_limit_does_not(scenario, seed):
    rng = np.random.default_rng(seed)
    positions = fly_hover_fly_positions(scenario)
    positions[:, 1:-1] += rng.normal(0, 100, positions[:, 1:-1].shape)
    powers = 3 * random_powers(scenario, rng)
    powers[0, 0] = -0.1
    broken = 0
    for limit in limits_of(scenario):
        try:
            limit.check(positions, powers)
        except PlanningError:
            broken += 1
        positions, powers = limit.repair(positions, powers)
    assert broken
    for limit in limits_of(scenario):
        limit.check(positions, powers)


def test_every_limit_is_listed_once():
    assert len(set(LIMITS)) == len(LIMITS)
