"""Every channel model falls with the distance, is planned for and proven for, or is refused."""

from dataclasses import replace

from benchmarks.missions import random_mission
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import oracle
import pytest
from secure_uav_planner import (
    assess, Channel, fly_hover_fly, Plan, Scenario, solve, upper_bound, World)
from secure_uav_planner.errors import OptionError
from secure_uav_planner.model.channel import links
from secure_uav_planner.model.channel.links import FreeSpace, make_link, sight_radii
from strategies import channels, SEEDS, with_uavs

# design: duration, environment, P2 rate of a plan for free space in it, and of one made for it
REFERENCE = [
    (120, 'suburban', 2.0206, 2.0235), (120, 'urban', 3.2051, 3.3723),
    (120, 'dense_urban', 3.6599, 3.7168), (200, 'suburban', 3.0397, 3.0415),
    (200, 'urban', 4.4565, 4.7711), (200, 'dense_urban', 5.4694, 5.5634)]
# prototype: duration, outage, and the rate that a plan for lines of sight promises
PROMISED = [(120, 0.1, 1.300), (120, 0.02, 1.124), (200, 0.1, 2.605)]
MODELS = {
    'exponent': Channel(2.8), 'suburban': Channel(los='suburban'), 'urban': Channel(los='urban'),
    'cautious': Channel(los='urban', cautious=True), 'dense_urban': Channel(los='dense_urban'),
    'highrise': Channel(los='highrise'), 'numbers': Channel(2.2, (5.0, 0.3, 10.0), True),
    'sights': Channel(los='urban', outage=0.1),
    'fading': Channel(rician_k_db=15.0, outage=0.1),
    'all': Channel(2.2, 'urban', True, 15.0, 0.1)}


def adapted(scenario, model):
    """Return a scenario with a channel, as strong at 100 m as before."""
    return replace(scenario, channel=model, reference_snr_db=scenario.reference_snr_db
                   + 20 * (model.exponent - scenario.channel.exponent))


@pytest.mark.parametrize('duration, los, of_free_space, planned', REFERENCE)
def test_plans_have_the_reference_rates(duration, los, of_free_space, planned):
    scenario = Scenario.paper(duration, 10.0)
    known = solve(scenario, objective='guaranteed')
    scenario = replace(scenario, channel=Channel(los=los))
    assert Plan(scenario, known.positions, known.powers).guaranteed_rate == pytest.approx(
        of_free_space, abs=2e-4)
    assert solve(scenario, objective='guaranteed').guaranteed_rate >= planned - 2e-4


@given(channels(), st.floats(1, 1e4), st.sampled_from(['ground_node', 'eavesdropper']))
def test_gains_fall_with_the_distance_and_have_the_derivatives_that_are_said(
        model, altitude, receiver):
    scenario = replace(with_uavs(Scenario.paper(), altitude=altitude), channel=model)
    squared = (altitude * np.concatenate([[0.0], np.geomspace(1e-2, 1e3, 40)]))**2
    link = make_link(scenario, receiver)
    gains = link.gain(np.array([squared, squared]))
    assert (np.diff(gains) < 0).all() and (gains > 0).all()
    assert gains == pytest.approx(oracle.snr(
        scenario, np.stack([squared] * 2, axis=-1), receiver == 'ground_node').T, rel=1e-9)
    kernel = make_link(scenario, receiver, axes=0).compiled(1, 2)
    for uav in range(2):
        for place, gain in zip(squared[1:], gains[uav, 1:], strict=True):
            value, same, first, second = kernel.gain(uav, place)
            assert [value, same] == pytest.approx([gain, gain], rel=1e-9)
            step = 1e-5 * place
            above, below = (kernel.gain(uav, place + move) for move in (step, -step))
            assert (above[0] - below[0]) / (2 * step) == pytest.approx(
                first, rel=1e-3)
            assert (above[2] - below[2]) / (2 * step) == pytest.approx(
                second, rel=1e-3, abs=1e-4 * abs(first) / place)
        assert np.isfinite(kernel.gain(uav, 0.0)).all()


@given(channels().filter(lambda model: not model.is_inverse_square), SEEDS)
def test_the_derivatives_of_a_gain_along_any_line_are_within_their_bounds(model, seed):
    rng = np.random.default_rng(seed)
    scenario = replace(Scenario.paper(), channel=model)
    kernel = make_link(scenario, 'eavesdropper', axes=0).compiled(1, 2)
    uav, near = int(rng.integers(2)), 10**rng.uniform(-1, 4)
    far = near * 10**rng.uniform(0, 1)
    bounds = np.array(kernel.bound_log_gain(uav, near, far))
    step = 1e-2 * near
    for _ in range(20):
        angle, start = rng.uniform(0, 2 * np.pi), rng.uniform(near, far)
        line = start + step * np.linspace(0, 3, 31) * np.exp(1j * angle)
        if np.abs(line).min() < near or np.abs(line).max() > far:
            continue
        values = np.log([kernel.gain(uav, float(abs(place)**2))[0] for place in line[::10]])
        # Each divided difference is a derivative somewhere between its points.
        for order, bound in enumerate(bounds, 1):
            rounding = 1e-13 * (1 + np.abs(values).max())
            assert (np.abs(np.diff(values, order)) <= bound * step**order + rounding).all()


@given(channels().filter(lambda model: model.los and model.outage and model.rician_k_db is None),
       st.sampled_from(['ground_node', 'eavesdropper']))
def test_a_link_counts_at_most_what_it_has_but_for_its_share_of_the_outage(model, receiver):
    scenario = replace(Scenario.paper(), channel=model)
    squared = np.concatenate([[0.0], np.geomspace(1.0, 1e8, 2000)])
    gains = make_link(scenario, receiver).gain(np.array([squared, squared]))
    line = make_link(replace(scenario, channel=Channel(model.exponent)), receiver).gain(
        np.array([squared, squared]))
    a, b, loss = model.los_numbers
    elevation = np.degrees(np.arctan2(scenario.altitudes[:, None], np.sqrt(squared)))
    chance = 1 / (1 + a * np.exp(-b * (elevation - a)))
    helps = np.array([[True], [False]]) == (receiver == 'ground_node')
    share, loss = model.outage / 4, 10**(-loss / 10)
    step = np.where(np.where(helps, 1 - chance <= share, chance > share), 1.0, loss)
    excess = gains / line - step
    assert (np.where(helps, excess, -excess) <= 1e-12).all()
    assert (gains <= line * (1 + 1e-12)).all() and (gains >= loss * line * (1 - 1e-12)).all()
    near = squared <= sight_radii(scenario)[:, None]**2
    assert (excess[helps & near & np.isfinite(sight_radii(scenario))[:, None]] >= -1e-9).all()


@pytest.mark.parametrize('duration, outage, promised', PROMISED)
def test_plans_promise_in_a_city_what_the_prototype_does_and_keep_it(duration, outage, promised):
    scenario = replace(Scenario.paper(duration, 10.0), channel=Channel(los='urban', outage=outage))
    plan = solve(scenario, objective='guaranteed')
    assert plan.guaranteed_rate >= 0.98 * promised
    assert assess(plan, 4000, world=World(los_distance=0.0)).outage <= outage


@pytest.mark.parametrize('colluding', [False, True])
@pytest.mark.parametrize('name', MODELS)
def test_a_plan_for_a_model_is_no_worse_in_it_than_one_for_free_space(name, colluding):
    for seed in (1, 9):
        check_planned_for(MODELS[name], replace(random_mission(seed, 40), colluding=colluding))


def check_planned_for(model, scenario, objective='worst_case', most=1e-3):
    """Check that it pays to know a channel, and return both rates."""
    known = solve(scenario, objective=objective)
    scenario = adapted(scenario, model)
    there = Plan(scenario, known.positions, known.powers)
    winning = (there.worst_case_rates if objective == 'worst_case'
               else there.guaranteed_rates) > 0
    there = Plan(scenario, known.positions, known.powers * winning, objective=objective)
    plan = solve(scenario, objective=objective)
    assert plan.rate >= there.rate * (1 - most) - 1e-9
    return there.rate, plan.rate


@pytest.mark.soak
@pytest.mark.parametrize('name', MODELS)
def test_of_100_missions_few_end_in_an_optimum_below_that_for_free_space(name):
    found = np.array([check_planned_for(MODELS[name], random_mission(seed, 40), most=0.1)
                      for seed in range(100)])
    assert (found[:, 1] < found[:, 0] * (1 - 1e-3)).sum() <= 6
    assert found[:, 1].mean() > found[:, 0].mean()


@pytest.mark.parametrize('name', MODELS)
def test_what_is_proven_for_free_space_only_refuses_other_channels(name):
    scenario = replace(Scenario.paper(120, slots=10), channel=MODELS[name])
    if scenario.channel.is_inverse_square:
        plan = solve(scenario, method='alternating')
        assert plan.status and upper_bound(scenario, plan=plan).gap(plan) >= 0
    else:
        with pytest.raises(OptionError, match='channel is .*free space'):
            upper_bound(scenario)
        with pytest.raises(OptionError, match="use 'joint'"):
            solve(scenario, method='alternating')


def test_what_is_proven_for_free_space_only_refuses_a_channel_of_ones_own(monkeypatch):
    class Absorbed(FreeSpace):

        def gain(self, squared):
            return super().gain(squared) * np.exp(-squared / 400.0**2)

    scenario = Scenario.paper(110.0, slots=10)
    plan = fly_hover_fly(scenario)
    make = links._link
    monkeypatch.setattr(links, '_link', lambda *args: Absorbed(*vars(make(*args)).values()))
    assert np.isfinite(replace(plan).guaranteed_rate)
    for call in (lambda: replace(plan).worst_case_rate, lambda: upper_bound(scenario, plan=plan),
                 lambda: solve(scenario, 'alternating')):
        with pytest.raises(OptionError):
            call()


@settings(max_examples=10)
@given(channels())
def test_the_baselines_fly_in_every_channel(model):
    scenario = adapted(Scenario.paper(120, slots=8), model)
    constant = fly_hover_fly(scenario)
    assert fly_hover_fly(scenario, 'optimised').guaranteed_rate >= constant.guaranteed_rate - 1e-9
