"""The worst case is a bound: no place of a disc leaks more, and one leaks all but 1e-6 of it."""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import oracle
import pytest
from secure_uav_planner import Channel, Eavesdropper, Scenario, Uav
from secure_uav_planner.model import channel
from secure_uav_planner.model.channel import rates, worst_case
from secure_uav_planner.model.channel.links import make_link
from secure_uav_planner.model.kernel import core
from strategies import (
    channels, missions, random_powers, random_sectors, SEEDS, with_eavesdroppers, with_tracks)


def random_plan(scenario, rng):
    """Return positions, some at the same place or above an eavesdropper, and powers."""
    uavs, slots = len(scenario.uavs), scenario.slots
    positions = rng.uniform(-400, 400, (uavs, slots + 2, 2))
    together = rng.random(slots + 2) < 0.3
    spread = rng.choice([0.0, 1e-6, 1.0], slots + 2)[:, None]
    positions[:, together] = (positions[:1] + spread * rng.standard_normal(
        positions.shape))[:, together]
    above = rng.random((uavs, slots + 2)) < 0.2
    positions[above] = rng.choice(
        [eve.position for eve in scenario.eavesdroppers], np.count_nonzero(above))
    return positions, random_powers(scenario, rng)


def proven_leaks(scenario, positions, powers):
    """Return what the worst-case rates subtract from the ground node's, (N,)."""
    return (channel.ground_rates(scenario, positions, powers)
            - channel.worst_case_rates(scenario, positions, powers))


def leaks_at(scenario, positions, powers, places):
    """Return the largest leak at places (N, 2) to an eavesdropper that may be there, (N,)."""
    leaks = rates.leakage_rates(
        scenario, positions[:, 1:-1], powers,
        np.repeat(places[:, None], len(scenario.eavesdroppers), axis=1),
        scenario.receiver_advantages)
    _, centres, radii = scenario.receivers_at(
        np.arange(1, len(places) + 1) * scenario.slot_duration)
    away = np.linalg.norm(places[:, None] - centres.swapaxes(0, 1), axis=-1)
    return np.where(away <= radii.T * (1 + 1e-12) + 1e-9, leaks, 0.0).max(axis=1)


def check_bounds(scenario, positions, powers, rng, margin=1e-11):
    """Check that proven leaks bound sampled ones and are tight."""
    proven = proven_leaks(scenario, positions, powers)
    places = channel.worst_case_places(scenario, positions, powers)
    there = leaks_at(scenario, positions, powers, places)
    sampled = oracle.sampled_leaks(scenario, positions, powers, places, rng)
    assert (sampled <= proven + margin).all()
    assert (there <= proven + margin).all()
    assert scenario.colluding or (there >= proven - 1e-6).all()
    assert (channel.guaranteed_rates(scenario, positions, powers)
            <= channel.worst_case_rates(scenario, positions, powers)).all()


@settings(max_examples=140)
@given(missions(max_eavesdroppers=4), st.booleans(), SEEDS)
def test_no_place_leaks_more_than_proven_and_the_worst_within_1e_6(scenario, moves, seed):
    rng = np.random.default_rng(seed)
    scenario = with_tracks(scenario, rng) if moves else scenario
    check_bounds(scenario, *random_plan(scenario, rng), rng)


@given(missions(), SEEDS)
def test_without_an_error_radius_or_a_jammer_it_is_the_guarantee(scenario, seed):
    rng = np.random.default_rng(seed)
    positions, powers = random_plan(scenario, rng)
    points = with_eavesdroppers(scenario, error_radius=0.0)
    alone = replace(scenario, uavs=scenario.uavs[:1])
    for variant, count in ((points, len(positions)), (alone, 1)):
        arguments = variant, positions[:count], powers[:count]
        assert channel.worst_case_rates(*arguments) == pytest.approx(
            channel.guaranteed_rates(*arguments), abs=1e-12)


@given(missions(max_eavesdroppers=4), SEEDS)
def test_several_eavesdroppers_leak_the_largest_or_colluding_the_sum(scenario, seed):
    positions, powers = random_plan(scenario, np.random.default_rng(seed))
    model = scenario.channel
    if model.outage is not None:  # Which is divided by the number of links.
        model = replace(model, outage=model.outage * 2 / (1 + len(scenario.eavesdroppers)))
    each = np.array([proven_leaks(replace(
        scenario, eavesdroppers=(eve,), channel=model, colluding=False), positions, powers)
        for eve in scenario.eavesdroppers])
    together = np.log1p(np.expm1(each * np.log(2)).sum(axis=0)) / np.log(2)
    assert proven_leaks(scenario, positions, powers) == pytest.approx(
        together if scenario.colluding else each.max(axis=0),
        abs=1e-6 * (len(each) if scenario.colluding else 1))


def extreme_scenario(rng):
    """Return a scenario with values over the whole of the allowed ranges, and its size in m."""
    uavs, eves = rng.choice([1, 2, 3, 8, 32]), rng.choice([1, 2, 32])
    size = 10**rng.uniform(0, 7)
    radii = 10**rng.uniform(-9, 7, eves) * (rng.random(eves) > 0.1)
    return Scenario(
        (0.0, 0.0), tuple(Eavesdropper(tuple(rng.uniform(-size, size, 2)), radius)
                          for radius in radii.tolist()),
        tuple(Uav(f'uav{index}', (0.0, 0.0), (0.0, 0.0), altitude, 1.0, 1e6, 1e6)
              for index, altitude in enumerate((10**rng.uniform(-3, 6, uavs)).tolist())),
        100.0, 10, rng.uniform(-200, 300)), size


@pytest.mark.parametrize('seed', range(40))
def test_bounds_hold_without_a_warning_for_extreme_scenarios(seed):
    rng = np.random.default_rng(seed)
    scenario, size = extreme_scenario(rng)
    positions = rng.uniform(-size, size, (len(scenario.uavs), scenario.slots + 2, 2))
    powers = np.minimum(10**rng.uniform(-15, 7, (len(positions), scenario.slots)), 1e6)
    powers *= rng.random(powers.shape) > 0.1
    powers[0, 0] = 5e-324
    with np.errstate(over='raise', divide='raise', invalid='raise'):
        channel.leak_maximisers(scenario, positions[:, 1:-1], powers)
        # Places are exact to 1e-9 m where coordinates are 1e7 m.
        check_bounds(scenario, positions, powers, rng, margin=1e-11 + 1e-15 * (
            size + scenario.receivers.radii.max()) / scenario.altitudes.min())


@pytest.mark.parametrize('altitudes', [(100, 100), (100, 110), (100, 100, 110), (100, 30, 1000)])
@pytest.mark.parametrize('radius', [1e-9, 10.0, 1e3, 1e7])
@pytest.mark.parametrize('spread', [0.0, 1e-6, 1.0])
def test_uavs_at_the_same_place_take_few_sectors(altitudes, radius, spread, monkeypatch):
    # Where the leak is flat, or largest all along a circle, little can be dropped.
    monkeypatch.setattr(worst_case, 'MOST_SECTORS', 5000)
    rng = np.random.default_rng(0)
    scenario = Scenario(
        (0.0, 0.0), (Eavesdropper((0.0, 0.0), radius),),
        tuple(Uav(f'uav{index}', (0.0, 0.0), (0.0, 0.0), altitude, 1.0)
              for index, altitude in enumerate(altitudes)), 100.0, 12)
    positions = np.zeros((len(altitudes), 14, 2)) + [300.0, 0.0] * rng.random((14, 1))
    positions += spread * rng.standard_normal(positions.shape)
    check_bounds(scenario, positions, rng.uniform(0.1, 2, (len(altitudes), 12)), rng)


def bound_sectors(discs, **sectors):
    """Return lower bounds of the inverse SINR in a sector of each disc, and at a place, (P,)."""
    bound, value = np.empty((2, len(discs['noise'])))
    core.bound_sectors(discs, sectors, bound, value)
    return bound, value


@given(st.one_of(st.just(Channel()), channels()), SEEDS, st.integers(1, 4), st.floats(-2, 3),
       st.sampled_from([0.0, 1e-3, 100.0]))
def test_no_place_of_a_sector_is_below_its_bound(model, seed, uavs, decades, spread):
    rng = np.random.default_rng(seed)
    count, altitudes = 50, rng.choice([50.0, 100.0, 120.0], uavs)
    radius = np.full(count, 10**decades)
    x, y = rng.normal(0, spread, (2, uavs, count)) + radius * rng.normal(0, 1, (2, 1, count))
    discs = {'x': x, 'y': y, 'squared_altitudes': altitudes[:, None]**2,
             'noise': 10**rng.uniform(-20, 3, count), 'radius': radius,
             'jamming': 10**rng.uniform(-3, 3, (uavs - 1, count))}
    model = Channel() if model.is_inverse_square else model
    scenario = replace(Scenario.paper(), reference_snr_db=0.0, channel=model, uavs=tuple(
        Uav(f'uav{number}', (0.0, 0.0), (0.0, 0.0), altitude, 10.0)
        for number, altitude in enumerate(altitudes.tolist())))
    if not model.is_inverse_square:
        discs['channel'] = make_link(scenario, 'eavesdropper', axes=0).compiled(1, uavs)
    inner, outer, middle, half = random_sectors(rng, radius)
    zero, whole = np.zeros(count), np.full(count, np.pi)
    accuracy = 1e-11 if model.rician_k_db is None else 1e-8  # SciPy 1.11's quantiles have 2e-9.
    for begin, centre, angles in ((zero, zero, whole), (inner, middle, half)):
        bound, value = bound_sectors(discs, inner=begin, outer=outer, middle=centre, half=angles)
        assert (bound <= value).all()
        for _ in range(20):
            distance = begin + (outer - begin) * rng.choice([0.0, 1.0, rng.random()], count)
            angle = centre + angles * np.clip(rng.uniform(-1.5, 1.5, count), -1, 1)
            squared = (distance * np.cos(angle) - x)**2 + (distance * np.sin(angle) - y)**2
            gains = oracle.snr(scenario, squared.T, False).T
            inverse_sinr = (discs['noise'] + (discs['jamming'] * gains[1:]).sum(axis=0)) / gains[0]
            assert (inverse_sinr >= bound * (1 - accuracy)).all()


def test_bounds_approach_the_least_value_with_the_square_of_the_size():
    discs = {'x': np.array([[0.3], [-1.0]]), 'y': np.array([[0.2], [0.4]]),
             'squared_altitudes': np.array([[1.0], [1.2]]), 'noise': np.array([0.1]),
             'jamming': np.array([[2.0]]), 'radius': np.array([10.0])}
    minima = np.empty((3, 1))
    core.find_local_minima(discs, minima)
    least, x, y = minima
    assert least == pytest.approx(oracle.inverse_sinr(discs, x, y), rel=1e-12)
    for size in (0.1, 0.01, 1e-3):
        distance = np.hypot(x, y)
        bound, _ = bound_sectors(discs, inner=distance - size, outer=distance + size,
                                 middle=np.arctan2(y, x), half=size / distance)
        assert 0 <= least - bound <= 20 * size**3


def difficult_plan():
    """Return scenario, positions and powers with maxima of every kind."""
    rng = np.random.default_rng(0)
    scenario = Scenario(
        (0.0, 0.0), (Eavesdropper((0.0, 0.0), 300.0), Eavesdropper((100.0, 0.0), 200.0)),
        tuple(Uav(f'uav{index}', (0.0, 0.0), (0.0, 0.0), altitude, 1.0)
              for index, altitude in enumerate((100.0, 60.0, 130.0))), 100.0, 60)
    return scenario, rng.uniform(-300, 300, (3, 62, 2)), rng.uniform(0, 2, (3, 60)), rng


@pytest.mark.parametrize('most', [1, 50])
def test_bounds_hold_where_the_search_ends_early(most, monkeypatch):
    scenario, positions, powers, rng = difficult_plan()
    whole = proven_leaks(scenario, positions, powers)
    worst = channel.worst_case_places(scenario, positions, powers)
    monkeypatch.setattr(worst_case, 'MOST_SECTORS', most)
    proven = proven_leaks(scenario, positions, powers)
    sampled = oracle.sampled_leaks(scenario, positions, powers, worst, rng)
    assert (sampled <= proven + 1e-11).all()
    assert (proven >= whole - 1e-6).all() and (proven > whole + 1e-3).any()


@given(missions(max_eavesdroppers=3), SEEDS)
def test_maximisers_are_in_their_discs_and_have_the_leaks_returned(scenario, seed):
    positions, powers = random_plan(scenario, np.random.default_rng(seed))
    places, leaks = channel.leak_maximisers(scenario, positions[:, 1:-1], powers)
    eves = len(scenario.eavesdroppers)
    assert places.shape == (eves, scenario.slots, 2) and leaks.shape == (eves, scenario.slots)
    offsets = places - scenario.receivers.centres
    assert (np.linalg.norm(offsets, axis=-1) <= scenario.receivers.radii + 1e-9).all()
    there = rates.leakage_rates(scenario, positions[:, 1:-1], powers, places.swapaxes(0, 1),
                                scenario.receiver_advantages)
    assert leaks.T == pytest.approx(there, abs=1e-9)
    assert (leaks <= proven_leaks(scenario, positions, powers) + 1e-11).all()


def test_maximisers_are_almost_always_the_worst():
    scenario, positions, powers, _ = difficult_plan()
    _, leaks = channel.leak_maximisers(scenario, positions[:, 1:-1], powers)
    missed = proven_leaks(scenario, positions, powers) - leaks.max(axis=0) > 2e-6
    assert missed.mean() < 0.05


def test_a_power_rounded_below_zero_counts_as_zero():
    scenario, positions, powers, _ = difficult_plan()
    powers[:, ::2] = 0.0
    below = np.where(powers > 0, powers, -1e-9)
    assert (channel.worst_case_rates(scenario, positions, below)
            == channel.worst_case_rates(scenario, positions, powers)).all()
