"""Every lemma of the bound against brute force, and against a deliberate error in it."""

from bound_attack import certified, climb, lagrangian
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from secure_uav_planner import Eavesdropper, Scenario, solve, Uav
from secure_uav_planner.bound import (
    boxes, certificate, chords, curvature, potential as potentials, team as teams)
from secure_uav_planner.bound.boxes import Terms
from secure_uav_planner.bound.conjugate import entropy, sigmoid, softplus, transmit_power
from secure_uav_planner.bound.lens import Lens
from secure_uav_planner.bound.potential import Potential
from secure_uav_planner.bound.stages import Stages
from secure_uav_planner.bound.witnesses import Witnesses

NUMBER = st.floats(-40, 40)


@given(NUMBER, st.lists(NUMBER, min_size=1, max_size=4), st.integers(0, 2**32 - 1))
def test_lemma_1_bounds_every_rate_for_every_choice_of_shares(z0, ze, seed):
    rng = np.random.default_rng(seed)
    weight = np.linspace(0, 1, 2001)
    share = rng.dirichlet(np.ones(len(ze)))
    total = weight * rng.random()
    rate = softplus(np.array(z0)) - softplus(np.array(ze)).max()
    bracket = (weight * z0 + entropy(weight) - total * (share @ ze) - entropy(total))
    at = sigmoid(np.array(z0))
    exact = at * z0 + entropy(at) - np.interp(at, weight, total) * (share @ ze) - entropy(
        np.interp(at, weight, total))
    assert rate <= max(bracket.max(), exact) + 1e-9


@given(st.floats(0, 1), st.floats(1e-6, 10), st.floats(1e-3, 10))
def test_lemma_3_gives_the_largest_value_of_any_power(weight, price, peak):
    power = np.geomspace(1e-9, 1, 500) * peak
    most, _ = transmit_power(np.array(weight), price, peak)
    assert most >= (weight * np.log(power) - price * power).max() - 1e-12


def mission(seed, slots=6, jammers=1, eavesdroppers=1):
    """Return a small random mission in which everything happens."""
    rng = np.random.default_rng(seed)
    duration = float(rng.uniform(30, 120))
    uavs = []
    for i in range(1 + jammers):
        start, goal = rng.uniform(-400, 400, (2, 2))
        speed = float(np.hypot(*(goal - start)) / duration * rng.choice([1.0, 1.2, 2.5]) + 0.1)
        uavs.append(Uav(f'uav{i + 1}', tuple(start), tuple(goal), float(rng.uniform(40, 150)),
                        speed, 1.0, float(rng.uniform(1, 5))))
    return Scenario(tuple(rng.uniform(-100, 100, 2)), tuple(
        Eavesdropper(tuple(rng.uniform(-300, 300, 2)), float(rng.choice([0.0, 15.0, 80.0])))
        for _ in range(eavesdroppers)), tuple(uavs), duration, slots, float(rng.uniform(65, 90)))


def lens_of(seed, uav=0, **options):
    """Return the lens of a UAV of a random mission."""
    scenario = mission(seed, **options)
    return Lens.of(scenario, uav, Stages.of(scenario.slots), Witnesses.of(scenario, 'guaranteed'))


def places_in(lens, stage, rng, count=400):
    """Return random places in a lens and on its rim."""
    low, high = (corner[stage] for corner in lens.sides)
    tried = rng.uniform(low, high, (20 * count, 2))
    tried = tried[lens.inside(tried, np.full(len(tried), stage))][:count]
    rim = lens.farthest(rng.normal(size=(1, count, 2)))[stage]
    return np.concatenate([tried, rim[lens.inside(rim, np.full(count, stage))]])


@given(st.integers(0, 10**6), st.integers(0, 5))
@settings(max_examples=60)
def test_the_rectangle_and_the_support_hold_the_lens(seed, stage):
    lens, rng = lens_of(seed), np.random.default_rng(seed)
    places = places_in(lens, stage, rng)
    low, high = (corner[stage] for corner in lens.sides)
    assert (places >= low).all() and (places <= high).all()
    directions = rng.normal(size=(50, 2))
    support = lens.support(directions, np.full(50, stage))
    if len(places):
        largest = (directions @ places.T).max(1)
        assert (support >= largest - 1e-12).all()
    farthest = lens.farthest(directions[None])[stage]
    exact = (farthest * directions).sum(-1)
    np.testing.assert_allclose(support, exact, rtol=1e-6, atol=1e-6)


def random_potential(lens, stages, rng, curved):
    count = len(stages.count) + 1
    return Potential(np.cumsum(rng.normal(0, 1, (count, 2)), 0),
                     np.cumsum(rng.normal(0, 0.5, (count, 3)), 0) * curved, stages, lens)


@given(st.integers(0, 10**6), st.sampled_from([(False, 6), (False, 4), (True, 6)]))
@settings(max_examples=60)
def test_lemma_2_costs_no_path_that_can_be_flown(seed, kind):
    curved, most = kind
    rng = np.random.default_rng(seed)
    scenario = mission(seed, slots=6)
    stages = Stages.of(6, most)
    lens = Lens.of(scenario, 0, stages, Witnesses.of(scenario, 'guaranteed'))
    potential = random_potential(lens, stages, rng, curved)
    # Paths that use all of their speed, by walking at random as far as the goal allows.
    for _ in range(20):
        path = [np.zeros(2)]
        for n in range(1, 7):
            stage = stages.of_slots()[n - 1]
            angle = rng.uniform(0, 2 * np.pi)
            trial = path[-1] + lens.step * rng.choice([1.0, 0.5]) * np.array(
                [np.cos(angle), np.sin(angle)])
            goal = np.array([lens.distance, 0.0])
            room = (7 - n) * lens.step
            away = trial - goal
            distance = max(np.hypot(*away), 1e-300)
            trial = goal + away * min(1.0, room / distance)
            if np.hypot(*(trial - path[-1])) > lens.step:
                move = goal - path[-1]
                trial = path[-1] + move * min(1.0, lens.step / max(np.hypot(*move), 1e-300))
            path.append(trial)
        total = potential.ends()
        for n in range(1, 7):
            stage = stages.of_slots()[n - 1]
            slope, bend = (part[stage] for part in potential.change)
            x, y = path[n]
            total += slope @ path[n] + bend @ [x * x / 2, x * y, y * y / 2]
            total += potential.constant()[stage]
            for factor, u, s in potential.tilts():
                u, s = u[stage], s[stage]
                total += factor[stage] * np.hypot(u[0] + s[0] * x + s[1] * y,
                                                  u[1] + s[1] * x + s[2] * y)
        assert total >= -1e-9


def test_quadratic_potentials_in_stages_of_several_slots_are_refused():
    scenario = mission(1)
    stages = Stages.of(6, 4)
    lens = Lens.of(scenario, 0, stages, Witnesses.of(scenario, 'guaranteed'))
    with pytest.raises(AssertionError, match='one slot'):
        random_potential(lens, stages, np.random.default_rng(1), True)


def random_terms(lens, stages, rng, curved, jams, count=12):
    potential = random_potential(lens, stages, rng, curved)
    stage = rng.integers(0, len(stages.count), count)
    slope, bend = potential.change
    weight = rng.random(count)
    shares = weight[:, None] * rng.random((count, 1)) * rng.dirichlet(
        np.ones(len(lens.radii)), count)
    tilts = [tuple(part[stage] for part in term) for term in potential.tilts()]
    powers = (np.log(lens.peak) - 12, np.log(lens.peak)) if jams else None
    return Terms(lens, stage, weight, shares, slope[stage], bend[stage], tilts,
                 np.full(count, 1e-10), 0.3, lens.log_gain, powers)


def values(terms, k, places, powers):
    """Return the values of term k at places and powers, by the plain formulas."""
    lens = terms.lens
    ground, leaks = lens.log_squares(places)
    x, y = places.T
    value = places @ terms.slope[k] + terms.bend[k] @ np.array([x * x / 2, x * y, y * y / 2])
    for factor, u, s in terms.tilts:
        value += factor[k] * np.hypot(u[k, 0] + s[k, 0] * x + s[k, 1] * y,
                                      u[k, 1] + s[k, 1] * x + s[k, 2] * y)
    if terms.powers is None:
        return value + terms.weight[k] * (terms.log_gain - ground) + (
            leaks - terms.log_gain) @ terms.shares[k]
    z = np.log(powers) + terms.log_gain
    return (value - terms.weight[k] * softplus(z - ground)
            + softplus(z[:, None] - leaks) @ terms.shares[k] - terms.price * powers)


@given(st.integers(0, 10**6), st.booleans(), st.booleans(), st.integers(1, 3))
@settings(max_examples=40, deadline=None)
def test_lemma_5_bounds_every_box(seed, curved, jams, eavesdroppers):
    rng = np.random.default_rng(seed)
    lens = lens_of(seed, int(jams), eavesdroppers=eavesdroppers)
    terms = random_terms(lens, Stages.of(6), rng, curved, jams)
    for k in range(len(terms)):
        low, high = (corner[terms.stage[k]] for corner in lens.sides)
        centre = rng.uniform(low, high)
        half = (high - low) * np.exp(rng.uniform(-6, 0)) * rng.random(2) + 1e-9
        if jams:
            centre = np.append(centre, rng.uniform(*terms.powers))
            half = np.append(half, np.exp(rng.uniform(-5, 1)))
        value, bound, _ = terms.bounds(np.array([k]), centre[:, None], half[:, None])
        points = rng.uniform(centre - half, centre + half, (300, len(centre)))
        corners = centre + half * rng.choice([-1, 1], (30, len(centre)))
        points = np.concatenate([points, corners])
        points = points[lens.inside(points[:, :2], np.full(len(points), terms.stage[k]))]
        power = np.exp(points[:, 2]) if jams else None
        found = values(terms, k, points[:, :2], power)
        assert (found <= bound + 1e-9).all()
        if jams:
            exact = values(terms, k, centre[None, :2], np.exp(centre[2:]))[0]
        else:
            exact = values(terms, k, centre[None], None)[0]
        assert value[0] == pytest.approx(exact, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize('curved', [False, True])
@pytest.mark.parametrize('jams', [False, True])
def test_branch_and_bound_is_above_every_sample_and_not_far_above_the_best(curved, jams):
    rng = np.random.default_rng(5)
    lens = lens_of(3, int(jams))
    terms = random_terms(lens, Stages.of(6), rng, curved, jams)
    found = terms.maxima(np.full(len(terms), -np.inf), np.full(len(terms), 1e-3))
    for k in range(len(terms)):
        places = places_in(lens, terms.stage[k], rng, 3000)
        powers = np.exp(rng.uniform(*terms.powers, len(places))) if jams else None
        best = values(terms, k, places, powers).max()
        assert best <= found[k] <= best + 0.5


def test_a_search_that_is_cut_short_still_bounds():
    rng = np.random.default_rng(6)
    lens = lens_of(4, 1)
    terms = random_terms(lens, Stages.of(6), rng, False, True)
    nothing, slack = np.full(len(terms), -np.inf), np.full(len(terms), 1e-3)
    exact = terms.maxima(nothing, slack)
    assert (terms.maxima(nothing, slack, budget=100) >= exact - 2e-3).all()
    calls = iter([False] * 5 + [True] * 10**6)
    assert (terms.maxima(nothing, slack, stop=lambda: next(calls)) >= exact - 2e-3).all()


MISSIONS = [{'seed': 1}, {'seed': 2, 'eavesdroppers': 2}, {'seed': 3, 'jammers': 0},
            {'seed': 4, 'jammers': 2}, {'seed': 5, 'slots': 1}, {'seed': 6, 'jammers': 3}]


def worst(options, most=400, curved=False, count=60):
    """Return by how much climbing points exceed a stage's bound, at most."""
    scenario = mission(**options)
    plan = solve(scenario, objective='guaranteed')
    team, proof = certified(plan, most, curved)
    rng = np.random.default_rng(7)
    excess = []
    for stage in range(len(team.stages.count)):
        slot = team.stages.first[stage]
        starts = ([lens.local(plan.positions[i, slot]) for i, lens in enumerate(
            [*team.lenses, *team.helpers])], plan.powers[:, slot - 1])
        excess.append(climb(team, proof, stage, rng, count, starts=starts) - proof.stages[stage])
    return max(excess)


@pytest.mark.parametrize('options', MISSIONS, ids=str)
def test_no_place_and_no_power_exceeds_a_slots_bound(options):
    assert worst(options) <= 0


@pytest.mark.parametrize('options', MISSIONS[:3], ids=str)
def test_no_place_and_no_power_exceeds_a_slots_bound_with_quadratic_potentials(options):
    assert worst(options, curved=True) <= 0


def test_no_place_and_no_power_exceeds_a_stages_bound():
    assert worst({'seed': 8, 'slots': 9}, most=4) <= 0


@pytest.mark.parametrize('most, curved', [(400, False), (400, True), (4, False)])
def test_every_plan_satisfies_the_whole_of_the_proof(most, curved):
    scenario = mission(9, slots=9)
    plan = solve(scenario, objective='guaranteed')
    team, proof = certified(plan, most, curved)
    stage = team.stages.of_slots()
    total = proof.offset
    for n in range(scenario.slots):
        places = [lens.local(path[n + 1])[None]
                  for lens, path in zip(team.lenses, plan.positions)]
        value = lagrangian(team, proof, stage[n], places, plan.powers[:, n, None])[0]
        assert value <= proof.stages[stage[n]]
        total += value
    # Lemmas 2 and 3: the Lagrangian of a feasible plan is no less than its rate.
    assert total / scenario.slots >= plan.guaranteed_rate * np.log(2.0) - 1e-12


# A deliberate error in every lemma, and the attack that has to notice it.

def test_nodes_of_the_weight_without_a_chord_between_them_are_noticed(monkeypatch):
    right = certificate._over_weights

    def wrong(team, divisions, silent, jammed, weights, total, price):
        keep = [0, -1]
        return right(team, divisions, silent, jammed[:, keep] - 0.5 * (jammed[:, keep].max(
            1, keepdims=True) - jammed[:, keep]) - 0.05, weights[keep], total[keep], price)
    monkeypatch.setattr(certificate, '_over_weights', wrong)
    assert worst({'seed': 1}) > 0


def test_a_missing_cost_of_power_is_noticed(monkeypatch):
    right = chords.transmit_power
    monkeypatch.setattr(chords, 'transmit_power', lambda x, price, peak: (
        right(x, price, peak)[0] - 0.1, right(x, price, peak)[1]))
    assert worst({'seed': 1}) > 0


def test_a_search_that_drops_boxes_is_noticed(monkeypatch):
    right = boxes.Terms.bounds

    def wrong(self, function, centre, half):
        value, bound, score = right(self, function, centre, half)
        return value, value + 0.3 * (bound - value), score
    monkeypatch.setattr(boxes.Terms, 'bounds', wrong)
    lens, rng = lens_of(11, 1), np.random.default_rng(8)
    excess = []
    terms = random_terms(lens, Stages.of(6), rng, False, True)
    found = terms.maxima(np.full(len(terms), -np.inf), np.full(len(terms), 1e-6))
    monkeypatch.undo()
    right_found = terms.maxima(np.full(len(terms), -np.inf), np.full(len(terms), 1e-6))
    excess = right_found - found
    assert excess.max() > 1e-4


def boxes_fail():
    """Return whether the attack on boxes finds a bound that is too small."""
    for seed in range(40):
        try:
            test_lemma_5_bounds_every_box.hypothesis.inner_test(seed, False, seed % 2 == 0, 2)
        except AssertionError:
            return True
    return False


def test_a_second_derivative_that_is_too_small_is_noticed(monkeypatch):
    assert not boxes_fail()
    right = curvature._radial
    monkeypatch.setattr(curvature, '_radial', lambda low, high, altitude: (
        right(low, high, altitude) - 0.5 / altitude**2))
    assert boxes_fail()


def test_a_rim_that_gives_too_much_is_noticed(monkeypatch):
    right = Lens.pressed

    def wrong(self, *given):
        extra, slope, bend = right(self, *given)
        return extra - 0.1 * np.abs(extra), slope, bend
    monkeypatch.setattr(Lens, 'pressed', wrong)
    assert boxes_fail()


def test_a_node_left_out_that_is_put_too_low_is_noticed(monkeypatch):
    right = certificate.chords

    def wrong(values, first, weights, needed):
        moved = right(values, first, weights, needed)
        return np.where(needed, moved, moved - 0.5)
    assert worst({'seed': 1}) <= 0
    monkeypatch.setattr(certificate, 'chords', wrong)
    assert worst({'seed': 1}) > 0


def test_a_speed_that_costs_too_little_is_noticed(monkeypatch):
    right = potentials.Potential.ends
    monkeypatch.setattr(potentials.Potential, 'ends', lambda self: right(self) - 0.05 * abs(
        right(self)) - 0.1)
    with pytest.raises(AssertionError):
        test_every_plan_satisfies_the_whole_of_the_proof(400, False)


def test_two_jammers_without_gibbs_entropy_are_noticed(monkeypatch):
    right = chords._over_divisions

    def wrong(values, divisions, x, total):
        return right(values - 0.7 * (len(values) > 1), divisions, x, total)
    monkeypatch.setattr(chords, '_over_divisions', wrong)
    assert worst({'seed': 4, 'jammers': 2}) > 0


def test_helpers_that_do_not_help_are_noticed(monkeypatch):
    monkeypatch.setattr(certificate, '_help', lambda lens, total, price: 0 * total - 0.7)
    monkeypatch.setattr(teams, 'MOST_JAMMERS', 1)
    assert worst({'seed': 6, 'jammers': 3}) > 0
