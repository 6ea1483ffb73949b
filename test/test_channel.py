from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import oracle
import pytest
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.model import channel
from strategies import missions, random_flight, rotate_map

# design: duration, error radius, fly-hover-fly with constant power, before the [x]^+ of each slot,
# and with optimised power
REFERENCE = [(102, 10, 0.616, 1.140), (104, 10, 0.649, 1.199), (120, 10, 0.868, 1.600),
             (150, 10, 1.154, 2.121), (200, 10, 1.439, 2.640), (200, 0, 1.488, 2.780)]


@pytest.mark.parametrize('duration, radius, constant, optimised', REFERENCE)
def test_baselines_have_the_reference_rates(duration, radius, constant, optimised):
    scenario = Scenario.paper(duration, radius)
    plan = fly_hover_fly(scenario)
    rates = channel.guaranteed_rates(scenario, plan.positions, plan.powers)
    assert round(rates.mean(), 3) == constant
    assert fly_hover_fly(scenario, 'optimised').guaranteed_rate == pytest.approx(
        optimised, abs=5.1e-4)


@given(missions(), st.integers(0, 2**32 - 1))
def test_rates_are_the_equations_of_the_paper(scenario, seed):
    rng = np.random.default_rng(seed)
    positions, powers = random_flight(scenario, rng)
    place = rng.uniform(-400, 400, 2)
    there = replace(scenario, colluding=False, eavesdroppers=tuple(
        replace(eve, position=place, error_radius=0.0) for eve in scenario.eavesdroppers))
    times = np.arange(1, scenario.slots + 1) * scenario.slot_duration
    [wanted] = oracle.secrecy_rates(there, times, positions[:, 1:-1], powers)
    assert channel.secrecy_rates(scenario, positions, powers, place) == pytest.approx(
        wanted, abs=1e-8)


@given(missions(), st.integers(0, 2**32 - 1), st.floats(-3, 3), st.floats(-300, 300))
def test_rotation_and_translation_change_no_rate(scenario, seed, angle, shift):
    positions, powers = random_flight(scenario, np.random.default_rng(seed))
    moved, move = rotate_map(scenario, angle, shift)
    for rates in (channel.guaranteed_rates, channel.worst_case_rates):
        assert rates(moved, move(positions), powers) == pytest.approx(
            rates(scenario, positions, powers), abs=1e-6)


@pytest.mark.parametrize('field, most', [('error_radius', 100), ('receiver_advantage_db', 30)])
@given(missions(), st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_a_larger_error_radius_or_a_better_receiver_never_helps(
        field, most, scenario, seed, share):
    positions, powers = random_flight(scenario, np.random.default_rng(seed))
    worse = replace(scenario, eavesdroppers=tuple(
        replace(eve, **{field: getattr(eve, field) + share * most})
        for eve in scenario.eavesdroppers))
    for rates in (channel.guaranteed_rates, channel.worst_case_rates):
        assert (rates(worse, positions, powers)
                <= rates(scenario, positions, powers) + 1e-6).all()
