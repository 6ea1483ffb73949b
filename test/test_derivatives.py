"""The derivatives in the kernel are those of the plain formulas."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import oracle
from secure_uav_planner import Scenario
from secure_uav_planner.model.channel import guaranteed_rates
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver
from strategies import missions, random_powers, SEEDS, with_tracks

MUS = st.sampled_from([1.0, 1e-2, 1e-4])


def random_positions(scenario, rng):
    """Return positions (U, N+2, 2) in m, half of them in or near the first disc."""
    positions = rng.normal(0, 300, (len(scenario.uavs), scenario.slots + 2, 2))
    eve = scenario.eavesdroppers[0]
    near = rng.random(positions.shape[:2]) < 0.5
    offset = rng.normal(0, max(eve.error_radius, 10.0), positions.shape)
    return np.where(near[..., None], np.array(eve.position) + offset, positions)


def interior_variables(grid, rng):
    """Return x with positive powers, as an interior-point method has it."""
    scenario = grid.scenario
    x = grid.variables(random_positions(scenario, rng)[:, 1:-1], random_powers(scenario, rng))
    x[..., 0] += 0.05
    return x


def is_smooth(grid, x, step):
    """Return True for slots in which the transmitter is not near the edge of a disc, (N,)."""
    offset = (x[:, 0, 1:] * grid.length + grid.origin)[:, None] - (
        [eve.position for eve in grid.scenario.eavesdroppers])
    gap = np.linalg.norm(offset, axis=-1) - [
        eve.error_radius for eve in grid.scenario.eavesdroppers]
    return (np.abs(gap) > 10 * step * grid.length).all(axis=-1)


@settings(max_examples=80)
@given(missions(), st.booleans(), SEEDS)
def test_rates_are_those_of_the_channel_and_variables_are_positions_and_powers(
        scenario, moves, seed):
    rng = np.random.default_rng(seed)
    scenario = with_tracks(scenario, rng) if moves else scenario
    positions, powers = random_positions(scenario, rng), random_powers(scenario, rng)
    grid = Problem(scenario).grid
    x = grid.variables(positions[:, 1:-1], powers)
    rates = guaranteed_rates(scenario, positions, powers)
    np.testing.assert_allclose(
        InteriorPointSolver(grid, x[None], 1.0).rates() * grid.rate / np.log(2),
        np.maximum(rates, 0).mean(),
        rtol=1e-9, atol=1e-9)
    ground, leaks = oracle.rates(grid, x)
    np.testing.assert_allclose(
        (ground - oracle.combine(scenario, leaks)) / np.log(2), rates, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(grid.positions(x)[:, 1:-1], positions[:, 1:-1], atol=1e-9)
    np.testing.assert_allclose(grid.powers(x), powers, atol=1e-12)


@settings(max_examples=30)
@given(missions(max_eavesdroppers=3, max_slots=6), SEEDS, MUS)
def test_the_gradient_is_that_of_the_barrier_function(scenario, seed, mu):
    grid = Problem(scenario).grid
    x = interior_variables(grid, np.random.default_rng(seed))
    _, [gradient], _ = oracle.model(InteriorPointSolver(grid, x[None], mu))
    exact = oracle.gradient(
        lambda at: oracle.barrier(grid, at, mu, oracle.SOFTENING), x)
    np.testing.assert_allclose(gradient, exact, rtol=1e-7, atol=1e-7 * (1 + np.abs(exact).max()))


@settings(max_examples=30)
@given(missions(max_eavesdroppers=3), SEEDS, MUS)
def test_hessians_are_those_of_the_objective(scenario, seed, mu):
    grid, step = Problem(scenario).grid, 1e-5
    x = interior_variables(grid, np.random.default_rng(seed))
    _, _, [hessians] = oracle.model(InteriorPointSolver(grid, x[None], mu))
    exact = oracle.hessians(
        lambda at: oracle.objective(grid, at, mu, oracle.SOFTENING), x, step)
    scale = 1 + np.abs(exact).max(axis=(-2, -1), keepdims=True)
    lower = np.tril(np.abs(hessians - exact)) / scale
    assert lower[is_smooth(grid, x, step)].max(initial=0) < 1e-4


def test_derivatives_are_finite_at_the_kink():
    scenario = Scenario.paper(102.0, slots=3)
    grid = Problem(scenario).grid
    above = np.broadcast_to(scenario.eavesdroppers[0].position, (2, 3, 2))
    x = grid.variables(above, 0.5 * np.ones((2, 3)))
    _, gradient, hessian = oracle.model(InteriorPointSolver(grid, x[None], 1e-2))
    assert np.isfinite(gradient).all() and np.isfinite(hessian).all()
