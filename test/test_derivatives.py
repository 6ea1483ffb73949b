from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from secure_uav_planner import Scenario
from secure_uav_planner.channel import guaranteed_rates
from secure_uav_planner.channel.derivatives import Receivers, SlotRates
from secure_uav_planner.grid import Grid
from strategies import random_powers, scenarios

SEEDS = st.integers(0, 2**32 - 1)


def around_the_discs(scenario, rng):
    """Return positions (U, N+2, 2) in m inside the discs, on their edges and far away."""
    positions = rng.normal(0, 300, (len(scenario.uavs), scenario.slots + 2, 2))
    eve = scenario.eavesdroppers[0]
    near = rng.random(positions.shape[:2]) < 0.5
    offset = rng.normal(0, max(eve.error_radius, 10.0), positions.shape)
    return np.where(near[..., None], np.array(eve.position) + offset, positions)


def inner_variables(grid, rng):
    """Return x with every power above zero, as an interior-point method has it."""
    scenario = grid.scenario
    x = grid.variables(around_the_discs(scenario, rng)[:, 1:-1], random_powers(scenario, rng))
    x[..., 0] += 0.05
    return x


def rates_at(receivers, x):
    rates = SlotRates(receivers, x)
    return np.concatenate([rates.ground[..., None], rates.leaks], axis=-1)


def smooth(receivers, x, step):
    """Return which slots are farther from a kink of any distance than a step, (N,)."""
    offset = x[..., None, :, 1:] - receivers.positions[:, None]
    distance = np.linalg.norm(offset, axis=-1)
    kink = np.where(receivers.edge < 0, -receivers.edge, 0.0)
    apart = np.abs(distance - kink) > 4 * step
    apart |= receivers.edge == 0
    return (apart & (distance > 0.05)).all(axis=(-2, -1))


def changes(function, x, step):
    """Return the central differences of a function by every variable, last axes (U, 3)."""
    columns = []
    for variable in np.ndindex(x.shape[-2:]):
        move = np.zeros_like(x)
        move[(..., *variable)] = step
        columns.append((function(x + move) - function(x - move)) / (2 * step))
    return np.moveaxis(np.array(columns), 0, -1).reshape(*columns[0].shape, *x.shape[-2:])


@settings(max_examples=40)
@given(scenarios(), SEEDS)
def test_the_rates_are_those_of_the_channel(scenario, seed):
    rng = np.random.default_rng(seed)
    positions, powers = around_the_discs(scenario, rng), random_powers(scenario, rng)
    grid = Grid.of(scenario)
    receivers = Receivers.of(grid)
    slots = SlotRates(receivers, grid.variables(positions[:, 1:-1], powers))
    np.testing.assert_allclose(
        (slots.ground - slots.leaks.max(axis=-1)) / np.log(2),
        guaranteed_rates(scenario, positions, powers), rtol=1e-9, atol=1e-9)


@settings(max_examples=40)
@given(scenarios(), SEEDS)
def test_variables_are_positions_and_powers_in_other_units(scenario, seed):
    rng = np.random.default_rng(seed)
    positions, powers = around_the_discs(scenario, rng), random_powers(scenario, rng)
    grid = Grid.of(scenario)
    x = grid.variables(positions[:, 1:-1], powers)
    np.testing.assert_allclose(grid.positions(x)[:, 1:-1], positions[:, 1:-1], atol=1e-9)
    np.testing.assert_allclose(grid.powers(x), powers, atol=1e-12)


@settings(max_examples=40)
@given(scenarios(), SEEDS)
def test_gradients_are_the_limits_of_differences(scenario, seed):
    rng = np.random.default_rng(seed)
    grid = Grid.of(scenario)
    receivers = Receivers.of(grid)
    x = inner_variables(grid, rng)
    step = 1e-5
    kept = smooth(receivers, x, step)
    differences = changes(lambda at: rates_at(receivers, at), x, step)
    exact = SlotRates(receivers, x).derivatives().gradients
    scale = 1 + np.abs(exact).max(axis=(-3, -2, -1), keepdims=True)
    assert (np.abs(exact - differences) / scale)[kept].max(initial=0) < 1e-5


@settings(max_examples=40)
@given(scenarios(), SEEDS)
def test_hessians_are_the_differences_of_gradients_and_symmetric(scenario, seed):
    rng = np.random.default_rng(seed)
    grid = Grid.of(scenario)
    receivers = Receivers.of(grid)
    x = inner_variables(grid, rng)
    step = 1e-6
    kept = smooth(receivers, x, step)
    weights = rng.normal(size=(scenario.slots, len(scenario.eavesdroppers) + 1))
    size = x.shape[-2] * 3

    def gradient(at):
        gradients = SlotRates(receivers, at).derivatives().gradients
        return (weights[..., None, None] * gradients).sum(axis=-3)

    slots = SlotRates(receivers, x)
    exact = slots.derivatives().hessian(weights)
    differences = changes(gradient, x, step).reshape(scenario.slots, size, size)
    scale = 1 + np.abs(exact).max(axis=(-2, -1), keepdims=True)
    assert (np.abs(exact - differences) / scale)[kept].max(initial=0) < 1e-4
    np.testing.assert_allclose(exact, np.swapaxes(exact, -1, -2), rtol=1e-9,
                               atol=1e-12 * scale.max())


@settings(max_examples=40)
@given(scenarios(), SEEDS, st.floats(0, 1))
def test_rounding_the_kink_never_raises_the_guaranteed_rate(scenario, seed, softening):
    rng = np.random.default_rng(seed)
    grid = Grid.of(scenario)
    receivers = Receivers.of(grid)
    x = grid.variables(around_the_discs(scenario, rng)[:, 1:-1], random_powers(scenario, rng))
    sharp, soft = SlotRates(receivers, x), SlotRates(receivers, x, np.array([softening]))
    assert (soft.leaks >= sharp.leaks - 1e-12).all()
    np.testing.assert_array_equal(soft.ground, sharp.ground)


def test_the_gradient_at_the_very_kink_is_finite():
    scenario = Scenario.paper(102.0, slots=3)
    grid = Grid.of(scenario)
    receivers = Receivers.of(grid)
    above = np.broadcast_to(scenario.eavesdroppers[0].position, (2, 3, 2))
    slots = SlotRates(receivers, grid.variables(above, np.ones((2, 3))))
    assert np.isfinite(slots.derivatives().gradients).all()
    assert np.isfinite(slots.derivatives().hessian(np.ones((3, 2)))).all()


@settings(max_examples=20)
@given(scenarios(), SEEDS)
def test_the_gradients_change_with_the_places_as_derivatives_say(scenario, seed):
    rng = np.random.default_rng(seed)
    grid = Grid.of(scenario)
    x = inner_variables(grid, rng)
    places = rng.normal(0, 3, (scenario.slots, 2, 2))
    guarantee, step = Receivers.of(grid), 1e-5

    def gradients(axis, by):
        moved = places.copy()
        moved[..., axis] += by
        return SlotRates(guarantee.at_places(moved), x).derivatives().gradients[..., 1:, :, :]

    exact = SlotRates(guarantee.at_places(places), x).derivatives().by_places()[..., 1:, :, :]
    for axis in (0, 1):
        found = (gradients(axis, step) - gradients(axis, -step)) / (2 * step)
        assert np.allclose(exact[..., axis], found.reshape(exact.shape[:-1]),
                           rtol=1e-4, atol=1e-4 * np.abs(exact).max())
