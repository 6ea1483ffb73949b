"""Assessments: draws have the laws that they should, and rates are those of every world drawn."""

from dataclasses import replace
import itertools
import math
import re
import tracemalloc

from hypothesis import given, settings, strategies as st
from matplotlib.image import imread
from matplotlib.text import Text
import numpy as np
import pytest
from scipy import stats
from secure_uav_planner import (
    assess, Channel, Eavesdropper, fly_hover_fly, Plan, Scenario, solve, Uav, World)
from secure_uav_planner.assessment import world as worlds
from secure_uav_planner.assessment.monte_carlo import promised_rates
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial import fly_hover_fly_positions
from secure_uav_planner.output.figures import draw_assessment
from secure_uav_planner.output.tables import assessment_table
from strategies import random_powers, scenarios

URBAN = (9.61, 0.16, 20.0)  # Al-Hourani, Kandeepan and Lardner (2014).
MANY = 20000


def planned(scenario, seed=0):
    """Return a plan with random powers."""
    return Plan(scenario, fly_hover_fly_positions(Problem(scenario)),
                random_powers(scenario, np.random.default_rng(seed)))


def team(error_radius=30.0, **fields):
    """Return a scenario of three UAVs and two eavesdroppers."""
    uavs = tuple(Uav(name, (x, 300.0), (x, -300.0), altitude, 12.0) for name, x, altitude in (
        ('one', -50.0, 80.0), ('two', 100.0, 100.0), ('three', 150.0, 120.0)))
    eavesdroppers = (Eavesdropper((200.0, 50.0), error_radius, 'near', 3.0),
                     Eavesdropper((-100.0, -150.0), 2 * error_radius, 'far'))
    return Scenario((10.0, 20.0), eavesdroppers, uavs, 60.0, 12, **fields)


@pytest.fixture(scope='module')
def plan():
    return planned(team())


def agrees(samples, law):
    """Return whether samples may be of a law, by the test of Kolmogorov and Smirnov."""
    return stats.kstest(samples, law).pvalue > 1e-4


# Rates


@pytest.mark.parametrize('until, gaps', [(90.0, ((20.0, 40.0),)), (0.0, ())])
def test_rates_are_over_the_slots_that_the_plan_promises(until, gaps):
    whole = solve(Scenario.paper(120.0, slots=24))
    plan = replace(whole, promised_until=until, gaps=gaps)
    found = assess(plan, draws=50)
    assert (found.outages[plan.promised_slots] == 0.0).all()
    if until:
        assert 0 < plan.promised_slots.sum() < 24
        assert found.rates.min() >= plan.promise.rate
    else:  # Without a promise, over all slots.
        assert found.mean == assess(whole, draws=50).mean
    figure = draw_assessment(found)
    figure.draw_without_rendering()
    (title,) = (text for text in figure.axes[0].findobj(Text) if 'draws:' in text.get_text())
    assert title.get_window_extent().x1 <= figure.bbox.x1


def gain_of(one, heights, squared, sight=None):
    """Return the gain of links over the noise power, from the sources' equations."""
    a, b, loss = URBAN if one.channel.los == 'urban' else (0.0, 0.0, 0.0)
    line = 10 ** (one.reference_snr_db / 10) / math.hypot(heights, math.sqrt(squared)) ** (
        one.channel.exponent)
    if a == 0.0:
        return line
    elevation = math.degrees(math.atan2(heights, math.sqrt(squared)))
    probability = 1 / (1 + a * math.exp(-b * (elevation - a)))
    if sight is None:
        return line * (probability + (1 - probability) * 10 ** (-loss / 10))
    return line if sight < probability else line * 10 ** (-loss / 10)


def rates_of(plan, places, fades=None, sights=None, better=0.0, errors=None):
    """Return the secrecy rates of a plan in one world, (N,), in plain loops."""
    one, found = plan.scenario, []
    for n in range(one.slots):
        sinr = []
        receivers = [(one.ground_node, 0.0), *(
            (place, eve.receiver_advantage_db + better)
            for place, eve in zip(places, one.eavesdroppers))]
        for r, ((x, y), advantage) in enumerate(receivers):
            got = []
            for u, uav in enumerate(one.uavs):
                at = plan.positions[u, n + 1] + (0.0 if errors is None else errors[n][u])
                squared = (at[0] - x)**2 + (at[1] - y)**2
                sight = None if sights is None else sights[n][u, r]
                fade = 1.0 if fades is None else fades[n][u, r]
                got.append(gain_of(one, uav.altitude, squared, sight) * fade
                           * 10 ** (advantage / 10) * plan.powers[u, n])
            sinr.append(got[0] / (1 + sum(got[1:])))
        leak = sum(sinr[1:]) if one.colluding else max(sinr[1:])
        found.append(max(0.0, math.log2(1 + sinr[0]) - math.log2(1 + leak)))
    return np.array(found)


@settings(max_examples=40, deadline=None)
@given(scenarios(), st.integers(0, 2**32 - 1), st.sampled_from(['guaranteed', 'worst_case']))
def test_in_the_disc_no_promise_is_broken(scenario, seed, objective):
    plan = replace(planned(scenario, seed), objective=objective)
    found = assess(plan, 200, seed)
    assert found.outage == 0.0 == found.promised_outage
    assert (found.rates >= found.promised_rate - 1e-9).all()
    assert found.delivered == pytest.approx(np.full(200, found.promised_delivery))


@pytest.mark.parametrize('colluding', [False, True])
@pytest.mark.parametrize('of, world', [
    (Channel(), World()), (Channel(2.7), World(receiver_db=4.0)),
    (Channel(los='urban'), World(los_distance=None)), (Channel(2.4, 'urban'), World()),
    (Channel(rician_k_db=5.0, outage=0.1), World('beyond', beyond=50.0)),
    (Channel(), World('fixed')), (Channel(), World('fixed', positions=((150, 20), (-80, -90)))),
    (Channel(2.2, 'urban', False, 0.0, 0.1), World(los_distance=0.0, tracking_std=4.0))])
def test_rates_are_those_of_plain_loops_in_every_world_drawn(of, world, colluding):
    plan = planned(team(colluding=colluding))
    world = replace(world, channel=of)
    draws, seed = 6, 11
    found = assess(plan, draws, seed, world)
    one = replace(plan.scenario, channel=of)
    slots, links = one.slots, (3, 3)

    def first(states):
        return list(itertools.islice(states, slots))

    places = next(worlds.draw_places(one, world, draws, seed))
    if world.place == 'fixed':
        places = np.repeat([[place] for place in world.positions or [
            eve.position for eve in one.eavesdroppers]], draws, axis=1)
    sights = of.los and world.los_distance is not None and first(worlds.draw_sights(
        one, plan.positions[:, 1:-1], world.los_distance, draws, seed))
    fades = of.outage and first(worlds.draw_fading(of.rician_k_db, links, draws, seed))
    errors = world.tracking_std and first(worlds.draw_tracking_errors(one, world, draws, seed))
    wanted = np.array([rates_of(
        Plan(one, plan.positions, plan.powers), places[:, draw], *(
            [state[:, :, draw] for state in states] if states else None
            for states in (fades, sights)), world.receiver_db,
        [error[:, draw] for error in errors] if errors else None) for draw in range(draws)])
    np.testing.assert_allclose(found.rates, wanted.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(found.fan[2], np.median(wanted, axis=0), rtol=1e-11, atol=1e-13)
    kept = wanted >= promised_rates(plan) - 1e-9
    np.testing.assert_allclose(found.outages, 1 - kept.mean(axis=0), atol=1e-15)
    np.testing.assert_allclose(
        found.delivered, one.slot_duration * (kept * promised_rates(plan)).sum(axis=1))


@pytest.mark.parametrize('seed', range(20))
def test_the_outage_of_every_slot_is_at_most_the_promised_one(seed):
    rng = np.random.default_rng(seed)
    objective = ('guaranteed', 'worst_case')[seed % 2]
    scenario = replace(
        team(colluding=seed % 5 == 0),
        ground_node=tuple(rng.uniform(-50, 50, 2)), eavesdroppers=tuple(
            Eavesdropper(tuple(place), rng.uniform(0.0, 30.0)) for place in
            rng.uniform((250, -200), (500, 200), (1 + seed % 2, 2))),
        uavs=team().uavs[:1 + seed % 3], duration=rng.uniform(60, 150), slots=20,
        channel=Channel(
            rng.uniform(2.0, 2.8), (None, 'suburban', 'urban', 'dense_urban')[seed % 4], False,
            rng.uniform(8.0, 15.0) if seed % 4 in (0, 1) else None, rng.choice([0.02, 0.1, 0.3])))
    plan = solve(scenario, objective=objective)
    found = assess(plan, 10000, seed, World(los_distance=0.0))
    assert found.promised_outage == scenario.channel.outage
    assert (found.outages <= found.promised_outage).all()
    # Otherwise it would say nothing; with the 9 links of three UAVs it can be as rare as that.
    assert (plan.rate > 0 and found.outage > 0) or seed % 3 == 2


def test_outages_of_weak_links_are_found():
    for decibels in (-20.0, -60.0):
        plan = fly_hover_fly(replace(
            Scenario.paper(120.0, slots=12), reference_snr_db=decibels), 'optimised')
        found = assess(plan, 10, world=World(receiver_db=30.0))
        assert found.outage == 1.0 and found.delivered.max() == 0.0 < found.promised_delivery


def test_the_quantiles_are_those_of_the_missions_and_the_answer_is_short_and_true(plan):
    found = assess(plan, 200, world=World('normal'))
    assert found.quantile(0.05) == np.sort(found.rates)[[9, 10]] @ [0.05, 0.95]
    assert found.mean == found.rates.mean() and found.draws == len(found.rates) == 200
    text = repr(found)
    assert len(text) < 250
    for number in (f'{found.mean:.4f} bit/s/Hz in the mean', f'{found.quantile(0.5):.4f} at 50%',
                   f'{found.promised_rate:.4f} promised', f'{found.outage:.2%}'):
        assert number in text
    for values in (found.rates, found.fan, found.outages, found.delivered):
        assert not values.flags.writeable


# Draws


@pytest.mark.parametrize('world, squares', [
    (World(), (0.0, 40.0)), (World('beyond', beyond=25.0), (40.0, 65.0))])
def test_places_in_the_disc_or_the_ring_beyond_are_uniform_and_independent(world, squares):
    scenario = team(40.0)
    places = next(worlds.draw_places(scenario, world, MANY, 3))
    low, high = np.square(squares)
    x, y = (places[0] - scenario.eavesdroppers[0].position).T
    assert agrees(x**2 + y**2, stats.uniform(low, high - low).cdf)
    assert agrees(np.arctan2(y, x), stats.uniform(-np.pi, 2 * np.pi).cdf)
    assert abs(np.corrcoef(places[0, :, 0], places[1, :, 0])[0, 1]) < 0.05


def test_normal_places_have_their_covariance():
    scenario = team(40.0)
    offsets = next(worlds.draw_places(scenario, World('normal'), MANY, 3))[0] - (200.0, 50.0)
    # The disc has 95% of them: a squared distance is of the law chi-squared.
    assert agrees((offsets**2).sum(axis=1) / 40.0**2 * stats.chi2(2).ppf(0.95), stats.chi2(2).cdf)
    covariance = ((90.0, 40.0), (40.0, 30.0))
    offsets = next(worlds.draw_places(
        scenario, World('normal', covariance), MANY, 3))[1] - (-100.0, -150.0)
    assert agrees(np.einsum('ni,ij,nj->n', offsets, np.linalg.inv(covariance), offsets),
                  stats.chi2(2).cdf)
    np.testing.assert_allclose(np.cov(offsets.T), covariance, rtol=0.05)
    flat = next(worlds.draw_places(scenario, World('normal', ((4.0, 0.0), (0.0, 0.0))), 9, 3))[0]
    assert np.abs(flat[:, 1] - 50.0).max() < 1e-12 < np.ptp(flat[:, 0])


@pytest.mark.parametrize('rician_k_db', [-40.0, 0.0, 10.0, 30.0])
def test_fading_has_the_rician_law_and_is_independent(rician_k_db):
    first, second = itertools.islice(worlds.draw_fading(rician_k_db, (2, 2), MANY, 5), 2)
    factor = 10 ** (rician_k_db / 10)
    law = stats.ncx2(2, 2 * factor, scale=1 / (2 * (factor + 1)))
    assert law.mean() == pytest.approx(1.0)
    assert all(agrees(samples, law.cdf) for samples in first.reshape(4, -1))
    both = np.corrcoef(np.concatenate([first.reshape(4, -1), second.reshape(4, -1)]))
    assert np.abs(both - np.eye(8)).max() < 0.05


def test_lines_of_sight_are_held_over_the_distance_and_as_frequent_as_they_are_probable():
    scenario = team()
    steps = np.array([30.0, 30.0, 0.0, 45.0, 10.0, 100.0, 1.0])
    x = np.concatenate([[0.0], np.cumsum(steps)])  # 0, 30, 60, 60, 105, 115, 215, 216
    positions = np.stack([np.stack([x, 0 * x], axis=-1)] * 2 + [np.zeros((8, 2))])
    found = np.array(list(worlds.draw_sights(scenario, positions, 50.0, MANY, 7)))
    changed = (np.diff(found, axis=0) != 0)
    assert (changed[:, :2].any(axis=(2, 3)) == changed[:, :2].all(axis=(2, 3))).all()
    assert changed[:, 0, 0, 0].tolist() == [False, True, False, True, False, True, False]
    assert not changed[:, 2].any()
    assert agrees(found[0].ravel()[::5], stats.uniform.cdf)
    flat = found[0].reshape(9, -1)
    assert np.abs(np.corrcoef(flat) - np.eye(9)).max() < 0.05
    assert (np.diff(list(worlds.draw_sights(scenario, positions, 0.0, 9, 7)), axis=0) != 0).all()


def test_tracking_errors_have_their_deviation_and_correlation():
    scenario = team()
    world = World(tracking_std=3.0, tracking_time=8.0)
    found = np.array(list(itertools.islice(
        worlds.draw_tracking_errors(scenario, world, MANY, 9), 3)))[:, 0, :, 0]
    assert agrees(found[0], stats.norm(0, 3.0).cdf) and agrees(found[2], stats.norm(0, 3.0).cdf)
    kept = math.exp(-scenario.slot_duration / 8.0)
    np.testing.assert_allclose(np.corrcoef(found), [
        [1, kept, kept**2], [kept, 1, kept], [kept**2, kept, 1]], atol=0.03)


def test_a_seed_gives_the_same_draws_on_any_machine():
    # As numbers: they must not change from one version of NumPy to another.
    scenario = team()
    numbers = [
        next(worlds.draw_places(scenario, World(), 2, 42))[0, 1, 0],
        next(worlds.draw_places(scenario, World('normal'), 2, 42))[1, 1, 1],
        next(worlds.draw_sights(scenario, np.zeros((3, 1, 2)), 50.0, 2, 42))[2, 2, 1],
        next(worlds.draw_fading(3.0, (3, 3), 2, 42))[2, 2, 1],
        next(worlds.draw_tracking_errors(scenario, World(tracking_std=1.0), 2, 42))[2, 1, 1]]
    assert numbers == pytest.approx([
        213.2918245057113, -150.85115327553854, 0.092780403631184, 1.1606114855363339,
        -0.5078319544544213], rel=1e-12)
    plan = planned(scenario)
    world = World(tracking_std=2.0, channel=Channel(los='urban', rician_k_db=3.0, outage=0.1))
    first, again, other = (assess(plan, 20, seed, world) for seed in (1, 1, 2))
    assert (first.rates == again.rates).all() and (first.rates != other.rates).any()


def test_memory_does_not_grow_with_the_slots():
    scenario = Scenario.paper(400.0, slots=4000)
    plan = fly_hover_fly(scenario)
    promised_rates(plan)
    tracemalloc.start()
    try:
        assess(plan, 500, world=World(channel=Channel(los='urban')))
        assert tracemalloc.get_traced_memory()[1] < 500 * 4000 * 8 / 4
    finally:
        tracemalloc.stop()


# What is refused


def test_where_uavs_really_were_counts_instead_of_the_plan(plan):
    flown = plan.positions[:, 1:-1]
    np.testing.assert_allclose(assess(plan, 9, flown=flown).rates, assess(plan, 9).rates)
    aside = assess(plan, 9, flown=flown + (0.0, 40.0))
    assert aside.is_flown and (aside.rates != assess(plan, 9).rates).all()


# Command, picture and table


def test_the_command_prints_and_draws_what_is_found(plan, tmp_path, command):
    plan.save(tmp_path / 'plan.json')
    told, _ = command('assess', tmp_path / 'plan.json', '--draws', '50', '--seed', '4')
    found = assess(plan, 50, 4)
    assert told == f'{assessment_table(found)}\n\nwritten: {tmp_path / "plan.assess.png"}\n'
    assert imread(tmp_path / 'plan.assess.png').shape[1] == 1800
    told, _ = command('assess', tmp_path / 'plan.json', '-o', tmp_path / 'a.svg',
                      '--place', 'normal', '--covariance', '90', '40', '30', '--receiver-db', '3',
                      '--los', 'urban', '--exponent', '2.2', '--rician-k-db', '7', '--mean-gain',
                      '--draws', '50')
    world = World('normal', ((90, 40), (40, 30)), receiver_db=3.0, los_distance=None,
                  channel=Channel(2.2, 'urban', False, 7.0, 0.5))
    assert assessment_table(assess(plan, 50, 0, world)) in told


@pytest.mark.parametrize('options, named', [
    (['--place', 'beyond'], '--beyond: '), (['--beyond', '5'], '--beyond: '),
    (['--place', 'normal', '--covariance', '1', '2', '1'], '--covariance: '),
    (['--tracking-std', '-1'], '--tracking-std: '), (['--draws', '0'], ''),
    (['--positions', '1', '--place', 'fixed'], ''), (['--out', 'a.html'], ''),
    (['--speed-factor', '2'], '--speed-factor is 2; the plan must have an eavesdropper with a'),
    (['--exponent', '9'], '')])
def test_wrong_options_of_the_command_are_bad_input_and_named(
        plan, tmp_path, monkeypatch, command, options, named):
    monkeypatch.chdir(tmp_path)
    plan.save('plan.json')
    _, told = command('assess', 'plan.json', *options, status=2)
    assert told.count('\n') == 1 and told.startswith(f'secure_uav_planner: {named}')


def test_the_table_has_what_is_found_beside_what_was_promised(plan):
    plan = replace(plan, objective='worst_case')
    found = assess(plan, 100, world=World('normal', receiver_db=30.0))
    rows = {line.split('  ')[0]: line.split()[-4:] for line in assessment_table(
        found).splitlines() if line}
    assert rows['secrecy rate, bit/s/Hz'] == [f'{number:.4f}' for number in (
        found.promised_rate, found.mean, found.quantile(0.05), found.quantile(0.5))]
    assert rows['outage'][1:] == [f'{share:.4%}' for share in (
        0.0, found.outages.mean(), found.outage)]
    assert 0 < found.outage == found.outages.max() <= 1
    number, time = map(float, re.search(
        r'largest outage in .*?slot (\d+),? at ([\d.]+) s', assessment_table(found)).groups())
    assert found.outages[int(number) - 1] == found.outage and time == pytest.approx(
        plan.times[int(number)], rel=1e-5)


def test_the_picture_shows_what_is_promised_and_found(plan):
    found = assess(plan, 100, world=World('beyond', beyond=60.0))
    fan, outages, missions = draw_assessment(found).axes
    shown = {patch.get_label(): patch.get_data().values for patch in fan.patches}
    for label, values in (('5% to 95%', found.fan[4]), ('50%', found.fan[2]),
                          ('promised', found.promised_rates)):
        assert (shown[label] == values).all()
    assert (outages.patches[0].get_data().values == found.outages).all()
    assert sum(patch.get_height() for patch in missions.patches) == pytest.approx(1.0)
