"""The certificate of the bound against points that climb, and against deliberate errors in it."""

from dataclasses import replace
from fractions import Fraction
import math

import bound_attack
from bound_attack import (
    certify_plan, lagrangian, largest_excess, random_plans, slot_groups, slot_rates)
from bound_parts import mission, places_in, random_potential, values
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from secure_uav_planner import Channel, Eavesdropper, solve
from secure_uav_planner.bound.proof import certificate
from secure_uav_planner.bound.proof.reachable_set import Cells, Team
from secure_uav_planner.bound.proof.relaxation import EavesdropperSubset
from secure_uav_planner.bound.proof.terms import Potential, Terms
from secure_uav_planner.mission import OBJECTIVES
from secure_uav_planner.model.channel import guaranteed_rates, worst_case_rates

MISSIONS = [{'seed': 1}, {'seed': 2, 'eavesdroppers': 2}, {'seed': 3, 'jammers': 0},
            {'seed': 7, 'eavesdroppers': 4}, {'seed': 5, 'slots': 1},
            {'seed': 10, 'jammers': 0, 'eavesdroppers': 3},
            {'seed': 2, 'eavesdroppers': 2, 'colluding': True},
            {'seed': 7, 'eavesdroppers': 4, 'colluding': True,
             'channel': Channel(rician_k_db=12.0, outage=0.3)}]


def excess(options, most=400, curved=False, count=60, objective='guaranteed'):
    """Return the largest excess of climbing points over a group's bound in a random mission."""
    return largest_excess(solve(mission(**options), objective=objective), most, curved, count)


def search_on_in_cut_cells(monkeypatch):
    """Make certificates of searches that go on with exact best columns and cut cells."""
    right = bound_attack.build_multipliers

    def build(search):
        search.thorough = True
        for _ in range(3):
            search.cut_cells(0.01)
            search.minimise(0.01, 2)
        return right(search)
    monkeypatch.setattr(bound_attack, 'build_multipliers', build)


@pytest.mark.parametrize('is_cut, arguments', [
    *((False, {'options': options}) for options in MISSIONS),
    *((False, {'options': options, 'curved': True}) for options in MISSIONS[:3]),
    (False, {'options': {'seed': 8, 'slots': 9}, 'most': 4}),
    # Discs of several places.
    (False, {'options': {'seed': 12, 'eavesdroppers': 2, 'colluding': True},
             'objective': 'worst_case'}),
    *((True, {'options': MISSIONS[number]}) for number in (0, 3, 5, 6))], ids=str)
def test_no_place_and_no_power_exceeds_the_bound_of_a_slot_or_a_group(
        is_cut, arguments, monkeypatch):
    if is_cut:
        search_on_in_cut_cells(monkeypatch)
    assert excess(**arguments) <= 0


def change_multipliers(monkeypatch, change):
    """Make certificates of multipliers of which some fields are changed."""
    right = bound_attack.build_multipliers

    def changed(search):
        given = right(search)
        return replace(given, **change(given))
    monkeypatch.setattr(bound_attack, 'build_multipliers', changed)


@pytest.mark.parametrize('change', [
    lambda given: {'v': given.v + 1.0}, lambda given: {'v': given.v - 0.2},
    lambda given: {'prices': given.prices - 1.0},
    lambda given: {'weights': np.maximum(given.weights, given.weights[2])},
    lambda given: {'incumbents': given.incumbents - 5.0}],
    ids=['too large v', 'negative v', 'negative prices', 'equal breakpoints', 'low incumbents'])
def test_any_multipliers_give_a_bound(change, monkeypatch):
    change_multipliers(monkeypatch, change)
    right = certificate.bound_pieces

    def checked(team, silent, joint, weights, v, price):
        assert (v >= 0).all() and (v.sum(-1) <= weights).all()
        return right(team, silent, joint, weights, v, price)
    monkeypatch.setattr(certificate, 'bound_pieces', checked)
    plan = solve(mission(3, jammers=0), objective='guaranteed')
    assert largest_excess(plan) <= 0
    proof = certify_plan(plan)[1]
    assert plan.rate <= proof.rate < math.inf and (proof.prices >= 0).all()


@pytest.mark.parametrize('point, cells, weight', [
    (-1, slice(None), 0.9), (-1, 0, 0.9), (1, slice(None), 0.0), (1, 0, 0.0)])
def test_breakpoints_that_do_not_rise_to_one_are_refused(point, cells, weight, monkeypatch):
    def change(given):
        weights = given.weights.copy()
        weights[:-1] = np.maximum(weights[:-1], 0.1)
        weights[point:point + 1 or None, cells] = weight
        if point < 0:
            weights = np.minimum(weights, weights[-1])
        return {'weights': weights}
    change_multipliers(monkeypatch, change)
    with pytest.raises(AssertionError, match='rise to 1'):
        certify_plan(solve(mission(1), objective='guaranteed'))


@pytest.mark.parametrize('seed', range(1, 6))
def test_the_rate_of_a_certificate_is_not_rounded_down(seed):
    team, proof = certify_plan(solve(mission(seed), objective='guaranteed'))
    exact = Fraction(proof.offset) + sum(
        int(count) * Fraction(group) for count, group in zip(team.groups.count, proof.groups))
    assert Fraction(proof.rate) * team.groups.slots * Fraction(math.log(2.0)) >= exact


def test_every_group_is_above_its_maximum_by_four_margins_of_each_uav(monkeypatch):
    plan = solve(mission(1), objective='guaranteed')
    groups = []
    for size in (0.0, 1.0):
        monkeypatch.setattr(certificate, 'margin', lambda _, terms: np.full(len(terms), size))
        groups.append(certify_plan(plan)[1].groups)
    np.testing.assert_allclose(groups[1] - groups[0], 8.0)


@given(st.integers(0, 10**6), st.floats(-30, 30))
def test_powers_that_count_as_silence_are_not_heard(seed, advantage):
    scenario = mission(seed, eavesdroppers=2)
    scenario = replace(scenario, eavesdroppers=(
        replace(scenario.eavesdroppers[0], receiver_advantage_db=advantage),
        scenario.eavesdroppers[1]))
    team = Team.of(scenario, EavesdropperSubset.of(scenario, 'guaranteed'), (None, None))
    region, (low, high) = team.regions[1], certificate.find_power_range(team, 1)
    assert high == math.log(region.peak) and low <= high
    for gain in (region.log_gain, *(region.log_gain + region.log_advantages)):
        assert math.exp(low + gain) / region.altitude**2 <= certificate.FLOOR * (1 + 1e-9)


@given(st.integers(0, 10**6), st.booleans(), st.sampled_from(OBJECTIVES),
       st.sampled_from([Channel(), Channel(rician_k_db=6.0, outage=0.2)]))
@settings(max_examples=20)
def test_a_team_hears_what_the_receivers_of_its_mission_hear(seed, colluding, objective, channel):
    scenario = mission(seed, eavesdroppers=3, colluding=colluding, channel=channel)
    rng = np.random.default_rng(seed)
    scenario = replace(scenario, eavesdroppers=tuple(
        replace(eve, receiver_advantage_db=rng.normal(0, 6)) for eve in scenario.eavesdroppers))
    plan = random_plans(scenario, rng, 1)[0]
    team = Team.of(scenario, EavesdropperSubset.of(scenario, objective), (None, None))
    places = [region.local(path[1:-1]) for region, path in zip(team.regions, plan.positions)]
    rates = slot_rates(team, places, plan.powers) / np.log(2.0)
    if objective == 'guaranteed':
        np.testing.assert_allclose(
            rates, guaranteed_rates(scenario, plan.positions, plan.powers), atol=1e-9)
    else:
        # Only some places of each disc listen, so the rates are no smaller.
        assert (rates >= worst_case_rates(scenario, plan.positions, plan.powers) - 1e-9).all()


@given(st.integers(0, 10**6))
def test_every_place_that_represents_an_eavesdropper_is_in_its_disc(seed):
    rng = np.random.default_rng(seed)
    eve = Eavesdropper(tuple(rng.uniform(-1, 1, 2) * 10**rng.uniform(0, 7)),
                       10**rng.uniform(-3, 3))
    places = EavesdropperSubset.of(
        replace(mission(seed), eavesdroppers=(eve,)), 'worst_case').places
    assert (np.hypot(*(places - eve.position).T) <= eve.error_radius).all()


@pytest.mark.parametrize('most, curved', [(400, False), (400, True), (4, False)])
def test_every_plan_satisfies_the_whole_of_the_proof(most, curved):
    scenario = mission(9, slots=9)
    plan = solve(scenario, objective='guaranteed')
    team, proof = certify_plan(plan, most, curved)
    group = slot_groups(team.groups)
    total = proof.offset
    for n in range(scenario.slots):
        places = [region.local(path[n + 1])[None]
                  for region, path in zip(team.regions, plan.positions)]
        value = lagrangian(team, proof, group[n], places, plan.powers[:, n, None])[0]
        assert value <= proof.groups[group[n]]
        total += value
    # Lemmas 2 and 3: the Lagrangian of a feasible plan is no less than its rate.
    assert total / scenario.slots >= plan.guaranteed_rate * np.log(2.0) - 1e-12


# A deliberate error in every lemma, and the attack that has to notice it.

def leave_out_a_part_of_the_reachable_set(cells, chosen, right=Cells.quarter):
    quarters = right(cells, chosen)
    return replace(quarters, low=quarters.low + 0.3 * (quarters.high - quarters.low))


def leave_out_half_of_what_is_cut_off(cells, chosen, axis, at, right=Cells.cut):
    parts, new = right(cells, chosen, axis, at), np.arange(-len(chosen), 0)
    low = parts.low.copy()
    low[new, axis] += 0.5 * (parts.high - low)[new, axis]
    return replace(parts, low=low)


def leave_out_the_chord_between_breakpoints(
        team, silent, joint, weights, total, price, right=certificate.bound_pieces):
    keep = [0, -1]
    return right(team, silent, joint[keep] - 0.05, weights[keep], total[keep], price)


def count_too_little_power(x, price, peak, right=certificate.maximise_power):
    most, power = right(x, price, peak)
    return most - 0.1, power


@pytest.mark.parametrize('owner, name, wrong, options', [
    (Cells, 'quarter', leave_out_a_part_of_the_reachable_set, MISSIONS[3]),
    (Cells, 'cut', leave_out_half_of_what_is_cut_off, MISSIONS[3]),
    (certificate, 'bound_pieces', leave_out_the_chord_between_breakpoints, MISSIONS[0]),
    (certificate, 'maximise_power', count_too_little_power, MISSIONS[0])])
def test_an_error_in_a_bound_of_slots_is_noticed(owner, name, wrong, options, monkeypatch):
    monkeypatch.setattr(owner, name, wrong)
    if name == 'cut':
        search_on_in_cut_cells(monkeypatch)
    assert excess(options) > 0


def test_a_speed_that_costs_too_little_is_noticed(monkeypatch):
    right = Potential.end_cost
    monkeypatch.setattr(
        Potential, 'end_cost', lambda self: right(self) - 0.05 * abs(right(self)) - 0.1)
    with pytest.raises(AssertionError):
        test_every_plan_satisfies_the_whole_of_the_proof(400, False)


def powers_above(seed, count=8):
    """Return the largest excess of random places and powers over a jammer's bound."""
    rng, scenario = np.random.default_rng(seed), mission(seed)
    team = Team.of(scenario, EavesdropperSubset.of(scenario, 'guaranteed'), (None, None))
    potential = random_potential(team.regions[1], team.groups, rng, False)
    group, weights = rng.integers(0, 6, count), rng.random(count)
    v = (weights * rng.random(count))[:, None]
    price = 0.3
    cells = Cells.whole(team.regions[1])
    silent = certificate.bound_silence(potential, cells, group, np.full(count, -np.inf), bool)
    bounds = certificate.bound_terms(team, potential, 1, cells, group, silent, weights, v, price,
                                     np.full(count, -np.inf), bool)
    terms = Terms(potential, cells, group, weights, v, price,
                  certificate.find_power_range(team, 1))
    differences = []
    for k in range(count):
        places = places_in(team.regions[1], group[k], rng)
        powers = team.regions[1].peak * np.exp(rng.uniform(-25, 0, len(places)))
        powers[rng.random(len(places)) < 0.3] = 0.0
        with np.errstate(divide='ignore'):
            differences.append((values(terms, k, places, powers) - bounds[k]).max())
    return max(differences)


@given(st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_no_power_of_a_jammer_exceeds_its_maximum(seed):
    assert powers_above(seed) <= 0


def test_powers_that_count_as_silence_too_early_are_noticed(monkeypatch):
    right = certificate.find_power_range
    monkeypatch.setattr(certificate, 'find_power_range', lambda team, uav: (
        right(team, uav)[1] - 1, right(team, uav)[1]))
    assert max(map(powers_above, range(20))) > 0
