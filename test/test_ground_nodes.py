"""Several ground nodes are served fairly, by shares of the slots."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import oracle
import pytest
from scipy.optimize import brentq
from secure_uav_planner import (
    assess, Channel, Eavesdropper, fly_hover_fly, GroundNode, Plan, Scenario, shortest_duration,
    solve, Uav, upper_bound)
from secure_uav_planner.assessment.world import World
from secure_uav_planner.model.channel import guaranteed_node_rates, worst_case_node_rates
from secure_uav_planner.model.channel.rates import find_least_rate
from secure_uav_planner.model.channel.shares import find_shares
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.joint import visit_search
from secure_uav_planner.optimize.joint.exchange import WorstPlaces
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver
from secure_uav_planner.optimize.joint.settings import VISIT_SEARCH
from secure_uav_planner.optimize.joint.starts import limit_powers, refine
from secure_uav_planner.optimize.joint.visits import draw_visits, fly_visits
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from strategies import with_eavesdroppers, with_uavs

LAYOUTS = {'A': [(0, 150), (0, -150)], 'B': [(0, 0), (400, 0)],
           'C': [(0, 200), (-100, 0), (0, -200)], 'D': [(0, 0), (130, 60)]}
BEST = {('A', 120): 1.4249, ('A', 200): 1.9514, ('B', 120): 0.4255, ('C', 120): 1.1516,
        ('D', 120): 0.6566}
"""The best known guaranteed rates, found by IPOPT from many starts by plain formulas."""

BEST_OF_RANDOM = {1: (0.09314, 0.09314), 2: (0.40014, 0.40014), 3: (0.2387, 0.2419),
                  4: (0.0799, 0.0799), 5: (0.16, 0.16181), 6: (0.3129, 0.31772)}
"""The best rates that many searches found for (P2) and (P1) of missions in data/nodes."""


def make_mission(places, duration=120.0, **fields):
    """Return the paper's mission with ground nodes at places, or with given ones."""
    nodes = [place if isinstance(place, GroundNode) else GroundNode(place) for place in places]
    return replace(Scenario.paper(duration, **fields), ground_node=None,
                   ground_nodes=tuple(nodes))


def distrust(scenario, *numbers):
    """Return a mission in which ground nodes with some numbers, or all, are not trusted."""
    return replace(scenario, ground_nodes=tuple(
        replace(node, trusted=bool(numbers) and number not in numbers)
        for number, node in enumerate(scenario.ground_nodes)))


def compute_secrecy_rates(plan):
    """Return r_k - leak of the guarantee in each slot, (G, N), by the plain formulas."""
    return oracle.secrecy_rates(
        plan.scenario, plan.times[1:-1], plan.positions[:, 1:-1], plan.powers)


def compute_node_rates(plan):
    """Return the means of a_k [r_k - leak]^+ of the guarantee, (G,), by the plain formulas."""
    return (plan.shares * np.maximum(compute_secrecy_rates(plan), 0.0)).mean(axis=1)


@pytest.mark.parametrize('untrusted', [(), (1,), (0, 1, 2)])
@pytest.mark.parametrize('channel, colluding', [
    (Channel(), False), (Channel(), True), (Channel(2.4, 'urban'), True),
    (Channel(los='suburban', rician_k_db=10.0, outage=0.1), False)])
def test_rates_are_those_of_the_plain_formulas(channel, colluding, untrusted):
    rng = np.random.default_rng(4)
    scenario = replace(
        make_mission([GroundNode((0, 80), 'barn', 2.0), GroundNode(
            name='cart', track=((0, -50, 0), (60, 90, -30))), GroundNode((120, -60), 'well', 0.5)],
            slots=12),
        eavesdroppers=(Eavesdropper((200, 0), 10.0), Eavesdropper((-150, 90), 30.0, 'drone', 3.0)),
        channel=channel, colluding=colluding)
    if untrusted:
        scenario = distrust(scenario, *untrusted)
    flight = fly_hover_fly(scenario)
    shares = rng.dirichlet(np.ones(3), scenario.slots).T
    plan = Plan(scenario, flight.positions, rng.uniform(0, 1, (2, 12)) * [[1.0], [0.01]],
                shares=shares)
    np.testing.assert_allclose(
        guaranteed_node_rates(scenario, plan.positions, plan.powers), compute_secrecy_rates(plan),
        rtol=1e-9, atol=1e-12)
    rates = compute_node_rates(plan)
    np.testing.assert_allclose(plan.node_rates, rates, rtol=1e-9)
    assert plan.guaranteed_rate == pytest.approx((rates / [2.0, 1.0, 0.5]).min(), rel=1e-9)
    assert plan.guaranteed_rates.sum() == pytest.approx(12 * rates.sum(), rel=1e-9)
    assert plan.worst_case_rate >= plan.guaranteed_rate
    # With eavesdroppers at known places the guarantee is exact.
    exact = replace(plan, scenario=with_eavesdroppers(scenario, error_radius=0.0),
                    objective='worst_case')
    np.testing.assert_allclose(
        worst_case_node_rates(exact.scenario, plan.positions, plan.powers),
        compute_secrecy_rates(exact), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(exact.node_rates, compute_node_rates(exact), rtol=1e-9)


@pytest.mark.parametrize('layout, duration', BEST)
def test_plans_are_as_good_as_the_best_known(layout, duration):
    plan = solve(make_mission(LAYOUTS[layout], duration), objective='guaranteed')
    assert plan.guaranteed_rate >= 0.995 * BEST[layout, duration]
    np.testing.assert_allclose(plan.node_rates, compute_node_rates(plan), rtol=1e-9)
    # All nodes have the same, of which at most one slot fewer is divided than there are nodes.
    assert np.ptp(plan.node_rates) < 1e-6
    divided = ((plan.shares > 0) & (plan.shares < 1)).any(axis=0)
    assert divided.sum() < len(plan.shares)
    oracle.check_rates(plan)


@pytest.mark.parametrize('factor', [1 / 256, 256])
def test_a_common_factor_of_the_weights_changes_no_plan(factor):
    nodes = [GroundNode(place, weight=weight) for place, weight in (
        ((0.0, 0.0), 1.0), ((-200.0, 100.0), 2.0), ((150.0, -250.0), 3.0))]
    plan, scaled = (solve(make_mission([
        replace(node, weight=node.weight * scale) for node in nodes], slots=24))
        for scale in (1, factor))
    assert plan.rate > 0.1 and scaled.rate * factor == pytest.approx(plan.rate, rel=1e-9)


def test_a_head_start_that_all_nodes_have_changes_no_plan_and_one_of_a_node_is_used():
    mission = make_mission([GroundNode((0.0, 0.0)), GroundNode((-200.0, 100.0), weight=2.0),
                            GroundNode((150.0, -250.0))], slots=24)
    iterations = []
    plan = solve(mission)
    ahead = solve(replace(mission, head_starts=64 * mission.duration * mission.node_weights),
                  on_iteration=iterations.append)
    assert plan.rate > 0.1 and ahead.rate - 64.0 == pytest.approx(plan.rate, rel=1e-9)
    assert iterations[-1].rate == ahead.history[-1].rate == pytest.approx(ahead.rate)
    # A node with all that it can get leaves the time to the others.
    helped = solve(replace(mission, head_starts=(0.0, 0.0, 1e6)))
    others = solve(replace(mission, ground_nodes=mission.ground_nodes[:2]))
    assert helped.rate > 0.99 * others.rate > 1.05 * plan.rate


@pytest.mark.parametrize('objective', ['guaranteed', 'worst_case'])
def test_the_order_of_the_nodes_changes_nothing(objective):
    nodes = [GroundNode((40, 160), 'a', 2.0), GroundNode((-90, -20), 'b', trusted=False),
             GroundNode(name='c', track=((0, 60, -170), (100, 10, -120)))]
    first = solve(make_mission(nodes, slots=24), objective=objective)
    for order in ([2, 1, 0], [1, 0, 2]):
        plan = solve(make_mission([nodes[number] for number in order], slots=24),
                     objective=objective)
        np.testing.assert_array_equal(plan.positions, first.positions)
        np.testing.assert_array_equal(plan.shares, first.shares[order])
        assert plan.guaranteed_rate == pytest.approx(first.guaranteed_rate, rel=1e-9)
        assert plan.worst_case_rate == pytest.approx(first.worst_case_rate, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize('number', BEST_OF_RANDOM)
def test_plans_for_random_missions_are_nearly_as_good_as_the_best_known(number):
    scenario = Scenario.load(Path(__file__).parent / f'data/nodes/mission_{number}.yaml')
    guaranteed, worst_case = BEST_OF_RANDOM[number]
    first = solve(scenario, objective='guaranteed')
    assert first.guaranteed_rate >= 0.95 * guaranteed
    plan = solve(scenario)
    assert plan.worst_case_rate >= max(0.95 * worst_case, (1 - 1e-6) * first.worst_case_rate)


def test_estimates_of_visits_are_close_bounds_of_what_shares_can_give():
    rng, ratios = np.random.default_rng(0), []
    for nodes in (2, 3, 4, 5, 6) * 8:
        rates = np.maximum(rng.normal(size=(nodes, 24)), 1e-3)
        rates *= 10.0**rng.uniform(-2, 0, (nodes, 1))
        mission = make_mission([(50 * node, 0) for node in range(nodes)])
        offsets = rng.choice([0.0, 0.3]) * rng.random(nodes)
        shares = find_shares(
            replace(mission, head_starts=tuple(offsets * mission.duration)), rates)
        best = (offsets + (shares * rates).mean(axis=1)).min()
        ratios.append(visit_search._bound_least_rates(rates[None], offsets)[0] / best)
    assert min(ratios) > 1 - 1e-6
    assert np.median(ratios) < 1.1


def test_changes_of_visits_keep_every_node_and_raise_the_estimates(monkeypatch):
    scenario = make_mission(LAYOUTS['C'], slots=24)
    grid, rng = Problem(scenario).grid, np.random.default_rng(0)
    powers = limit_powers(scenario)
    visits = draw_visits(scenario, [2, 0, 1], 6, powers[:, 0], rng)
    for _ in range(50):
        visits = visit_search._change(scenario, visits, visits, rng)
    np.testing.assert_array_equal(np.sort(visits.nodes, axis=1), [[0, 1, 2]] * 6)
    np.testing.assert_allclose(visits.ends[:, -1], 1.0)
    monkeypatch.setattr(
        visit_search, 'VISIT_SEARCH', replace(VISIT_SEARCH, changes=0, most_changes=0))
    drawn = visit_search.generate_visits(grid, 6, powers, lambda: None)[2]
    monkeypatch.undo()
    changed = visit_search.generate_visits(grid, 6, powers, lambda: None)[2]
    assert (changed > 1.02 * drawn).all()


@pytest.mark.parametrize('duration', [98.0, 120.0, 180.0])
def test_flights_through_visits_keep_the_largest_speed_and_reach_the_goal(duration):
    scenario = make_mission(LAYOUTS['C'], duration, slots=24)
    grid, rng = Problem(scenario).grid, np.random.default_rng(0)
    visits = draw_visits(scenario, [2, 0, 1], 200, limit_powers(scenario)[:, 0], rng)
    visits = visits._replace(places=visits.places + 100 * rng.normal(size=visits.places.shape))
    flights = fly_visits(grid, visits)
    np.testing.assert_allclose(flights[:, :, -1], np.tile(scenario.goals, (200, 1, 1)))
    moves = np.linalg.norm(np.diff(flights, axis=2), axis=-1) / grid.slot_duration
    assert (moves < scenario.max_speeds[:, None] * (1 + 1e-9)).all()
    assert np.median(moves / scenario.max_speeds[:, None]) > 0.9


def test_weights_divide_the_rates_also_against_the_worst_case():
    scenario = make_mission([GroundNode((0, 150), 'a', 1.0), GroundNode((0, -150), 'b', 3.0)])
    plan = solve(scenario)
    first, second = plan.node_rates
    assert second == pytest.approx(3 * first, rel=1e-4)
    assert plan.worst_case_rate == pytest.approx(first, rel=1e-4)
    assert plan.worst_case_rate >= solve(scenario, objective='guaranteed').guaranteed_rate


def test_shares_given_by_nobody_are_the_best_for_the_flight():
    scenario = make_mission(LAYOUTS['C'])
    flight = fly_hover_fly(scenario)
    rng = np.random.default_rng(0)
    others = [Plan(scenario, flight.positions, flight.powers, shares=rng.dirichlet(
        np.ones(3), scenario.slots).T) for _ in range(20)]
    assert flight.guaranteed_rate > max(plan.guaranteed_rate for plan in others) > 0
    # The baseline flies over all of them.
    distances = np.linalg.norm(
        flight.positions[0][None] - np.array(LAYOUTS['C'])[:, None], axis=-1)
    assert distances.min(axis=1).max() < 6.0


def test_a_node_that_cannot_be_served_leaves_nothing_for_the_least():
    scenario = make_mission([(0, 0), (200, 0)])
    plan = solve(scenario, objective='guaranteed')
    assert plan.guaranteed_rate == 0.0
    assert 'eavesdropper covers the ground node ground_node2' in plan.message


@pytest.mark.parametrize('layout, point', [('A', 20), ('B', 60), ('C', 60), ('D', 90)])
def test_the_rest_of_a_mission_makes_up_for_what_was_delivered_before(layout, point):
    duration = 150.0 if layout == 'B' else 120.0
    plan = solve(make_mission(LAYOUTS[layout], duration), objective='guaranteed')
    tail = cut_tail(plan, point)
    delivered = plan.node_shares[:, :point].sum(axis=1)
    assert tail.scenario.head_starts == pytest.approx(delivered - delivered.min())
    np.testing.assert_array_equal(tail.shares, plan.shares[:, point:])
    left = plan.rate * duration - delivered.min()
    assert tail.rate == pytest.approx(left / tail.scenario.duration)
    # From scratch, too, in the rest there is the flight that is the best for the whole.
    for initial in (tail, None):
        rest = solve(tail.scenario, objective='guaranteed', initial=initial)
        whole = continue_plan(plan, point, rest)
        assert whole.scenario.head_starts == ()
        assert plan.rate - 2e-4 < whole.rate < plan.rate + 1e-3
        assert initial is None or rest.rate >= tail.rate
        np.testing.assert_array_equal(whole.shares[:, :point], plan.shares[:, :point])
    unfair = solve(replace(tail.scenario, head_starts=()), objective='guaranteed')
    assert continue_plan(plan, point, unfair).rate < 0.99 * plan.rate


def start_in_farm(eves, colluding=False, untrusted=()):
    """Return the grid of a mission of five slots with three ground nodes, and a start's x."""
    scenario = make_mission(
        [GroundNode((0, 80), weight=2.0), (90, -30), (-40, 10)], 300.0, slots=5)
    scenario = replace(scenario, head_starts=(0.0, 700.0, 200.0), eavesdroppers=tuple(
        Eavesdropper((200 - 500 * index, 50), 10.0) for index in range(eves)), colluding=colluding)
    scenario = distrust(scenario, *untrusted) if untrusted else scenario
    grid, flight = Problem(scenario).grid, fly_hover_fly(scenario)
    return grid, grid.variables(0.98 * flight.positions[:, 1:-1] + 1.0, 0.3 * flight.powers)


FARMS = pytest.mark.parametrize('farm', [
    (1,), (2,), (1, False, (2,)), (1, True, (0, 1)), (2, False, (0, 1, 2)), (2, True, (1,))])


@pytest.mark.parametrize('mu', [1e-1, 1e-3])
@FARMS
def test_the_gradient_is_that_of_the_barrier_function(mu, farm):
    grid, x = start_in_farm(*farm)

    def evaluate(x, shares):
        barrier = InteriorPointSolver(grid, x[None], mu)
        barrier.shares[0] = shares
        size = x.size + 2 * len(x)
        parts = np.empty(1), np.empty((1, size)), np.empty((1, len(x), size // 5, size // 5))
        barrier._core.evaluate(*parts)
        return parts[0][0], parts[1][0]

    shares = np.random.default_rng(1).dirichlet(np.ones(3), len(x))
    _, gradient = evaluate(x, shares)
    step = 1e-6
    for index in range(gradient.size):
        values = []
        for sign in (step, -step):
            moved, others = x.copy(), shares.copy()
            if index < x.size:
                moved.flat[index] += sign
            else:
                slot, node = divmod(index - x.size, 2)
                others[slot, [0, 1 + node]] += -sign, sign
            values.append(evaluate(moved, others)[0])
        exact = (values[0] - values[1]) / (2 * step)
        assert gradient[index] == pytest.approx(exact, rel=1e-5, abs=1e-5)


@FARMS
def test_the_kernel_has_the_rates_of_the_plain_formulas_in_discs_and_at_places(farm):
    grid, x = start_in_farm(*farm)
    positions, powers, places = grid.positions(x), grid.powers(x), WorstPlaces(grid, x)
    for barrier, find_rates in (
            (InteriorPointSolver(grid, x[None], 0.1), guaranteed_node_rates),
            (InteriorPointSolver(grid, x[None], 0.1, receivers=places.receivers,
                                 discs=places.discs), worst_case_node_rates)):
        shares = barrier.shares[0].T
        rates = np.maximum(find_rates(grid.scenario, positions, powers), 0.0)
        least = find_least_rate(grid.scenario, (shares * rates).mean(axis=1)) * np.log(2)
        assert least > 0 and barrier.rates()[0] * grid.rate == pytest.approx(least, abs=2e-6)
    places.exchange(x, shares, 1e-9)
    assert places.rate == pytest.approx(least, abs=2e-6)


@pytest.mark.parametrize('mu', [1e-1, 1e-3])
@FARMS
def test_the_hessian_is_that_of_each_node_with_the_others_that_listen_as_eavesdroppers(mu, farm):
    grid, x = start_in_farm(*farm)
    scenario, barrier = grid.scenario, InteriorPointSolver(grid, x[None], mu)
    width = 6 + len(scenario.ground_nodes) - 1
    hessians = np.empty((1, len(x), width, width))
    barrier._core.evaluate(np.empty(1), np.empty((1, len(x) * width)), hessians)
    weights, shares = scenario.node_weights, barrier.shares[0]
    objectives = [partial(oracle.objective, grid, mu=mu, softening=oracle.SOFTENING, node=number)
                  for number in range(len(weights))]
    values = np.stack([objective(x) for objective in objectives], axis=-1)
    if scenario.colluding or farm == (1,):
        values -= mu * grid.rate  # A smooth leak has no t = mu.
    losses = ((shares * values).mean(axis=0) - np.log(2) * scenario.node_offsets) / weights
    unit = mu * grid.rate
    top = brentq(lambda t: (unit / (t - losses)).sum() - 1, losses.max() + 0.1 * unit,
                 losses.max() + 4 * unit, xtol=1e-15)
    factors = shares * unit / (top - losses) / weights
    exact = sum(factors[:, node, None, None] * oracle.hessians(objective, x)
                for node, objective in enumerate(objectives))
    np.testing.assert_allclose(
        np.tril(hessians[0, :, :6, :6]), np.tril(exact), atol=1e-4 * np.abs(exact).max())


def test_a_single_node_is_the_ground_node():
    paper = Scenario.paper(102.0)
    single = replace(paper, ground_node=None, ground_nodes=(GroundNode((0.0, 0.0)),))
    assert single == paper and hash(single) == hash(paper)
    assert single.ground_node == (0.0, 0.0) and paper.ground_nodes == single.ground_nodes
    assert replace(paper, ground_node=(5.0, 0.0)).ground_nodes == (GroundNode((5.0, 0.0)),)
    assert paper.to_dict() == single.to_dict() and 'ground_nodes' not in paper.to_dict()
    base = GroundNode((5.0, 0.0), 'base', 2.0)
    assert replace(paper, ground_nodes=(base,)).ground_node == (5.0, 0.0)
    assert replace(paper, ground_nodes=(base,), duration=103.0).ground_nodes == (base,)
    other = Scenario(ground_nodes=single.ground_nodes, eavesdroppers=paper.eavesdroppers,
                     uavs=paper.uavs, duration=102.0, slots=102)
    assert other == paper
    moved = replace(other, ground_nodes=(base,), ground_node=(7.0, 0.0))
    assert moved.ground_nodes == (replace(base, position=(7.0, 0.0)),)


SINGLE = replace(Scenario.paper(104.0, slots=8), eavesdroppers=(Eavesdropper((200.0, 0.0)),))
TRACK = ((0.0, 0.0, 0.0), (104.0, 0.0, 0.0))


@pytest.mark.parametrize('change', [{'name': 'base'}, {'weight': 2.0}, {'trusted': False}])
def test_what_a_single_node_is_called_and_weighs_changes_nothing_elsewhere(change):
    node = replace(SINGLE.ground_nodes[0], **change)
    scenario = replace(SINGLE, ground_nodes=(node,))
    for objective in ('guaranteed', 'worst_case'):
        plan, usual = (solve(mission, objective=objective) for mission in (scenario, SINGLE))
        assert plan.rate == usual.rate and (plan.positions == usual.positions).all()
    bounds = [upper_bound(mission, objective=objective) for mission in (scenario, SINGLE)]
    assert bounds[0].rate == bounds[1].rate
    assert solve(scenario, 'alternating').rate == solve(SINGLE, 'alternating').rate
    shortest = [shortest_duration(mission, 40.0) for mission in (scenario, SINGLE)]
    assert shortest[0].scenario.duration == shortest[1].scenario.duration
    assert shortest[0].too_short == shortest[1].too_short
    tails = [cut_tail(whole, 3) for whole in (plan, usual)]
    assert tails[0].rate == tails[1].rate


def test_a_single_node_on_a_track_that_stands_is_planned_like_one_that_stands():
    moving = replace(SINGLE, ground_node_track=TRACK)
    assert moving.ground_nodes == (GroundNode(track=TRACK),) and moving.ground_node == (0.0, 0.0)
    for objective in ('guaranteed', 'worst_case'):
        plans = [solve(mission, objective=objective) for mission in (moving, SINGLE)]
        assert plans[0].rate == pytest.approx(plans[1].rate, rel=1e-6)
    assert replace(moving, ground_node=(0.0, 0.0)) == SINGLE


@pytest.mark.parametrize('fields', [
    {}, {'channel': Channel(los='suburban', outage=0.3)}, {'colluding': True}],
    ids=['free_space', 'outage', 'colluding'])
@pytest.mark.parametrize('objective', ['guaranteed', 'worst_case'])
def test_a_plan_that_knows_who_listens_beats_the_plan_that_trusts_all(objective, fields):
    trusting = replace(make_mission(LAYOUTS['A'], slots=40), **fields)
    scenario = distrust(trusting)
    naive, plan = (solve(mission, objective=objective) for mission in (trusting, scenario))
    naive = Plan(scenario, naive.positions, naive.powers, objective=objective)
    assert plan.rate > 1.1 * naive.rate
    if not fields:
        assert assess(plan, 20).rates.min() >= plan.guaranteed_rate - 1e-9


def test_without_any_eavesdropper_playback_counts_the_nodes_that_listen_and_nobody_else():
    scenario = distrust(make_mission([(0, 0), (0, 200)], slots=10))
    flight = fly_hover_fly(scenario)
    plan = Plan(scenario, flight.positions, flight.powers, shares=[[1.0] * 10, [0.0] * 10])
    rates = Playback(plan).secrecy_rates(plan.times[1:-1])
    alone = replace(plan, scenario=replace(scenario, eavesdroppers=(Eavesdropper((0, 200)),)))
    np.testing.assert_allclose(rates, alone.guaranteed_rates, atol=1e-12)
    assert (rates > 0).any() and (rates == 0).any()
    trusting = Playback(replace(plan, scenario=distrust(scenario, 9)))
    assert trusting.secrecy_rates(plan.times[1:-1]) == pytest.approx(  # As from very far away.
        trusting.secrecy_rates(plan.times[1:-1], (9e6, 0.0)), abs=1e-5)


@pytest.mark.parametrize('change', [lambda scenario: scenario, distrust])
def test_an_assessment_counts_the_least_of_the_nodes(change):
    plan = solve(change(make_mission(LAYOUTS['C'])), objective='guaranteed')
    assessment = assess(plan, 50)
    assert assessment.promised_rate == plan.guaranteed_rate
    assert (assessment.rates >= plan.guaranteed_rate - 1e-9).all() and assessment.outage == 0


@pytest.mark.parametrize('channel', [
    Channel(los='urban'), Channel(los='urban', rician_k_db=5.0, outage=0.2)])
def test_an_assessment_draws_for_the_links_of_all_nodes(channel):
    eve, places = Eavesdropper((200.0, 0.0)), [(0, 0), (0, 200)]
    for node in range(2):
        alone, both = (replace(make_mission(nodes, slots=30), channel=channel,
                               eavesdroppers=(eve,)) for nodes in (places[node:node + 1], places))
        # Of the other node, nothing is asked any more.
        both = replace(both, head_starts=1e9 * (np.arange(2) != node))
        flight = fly_hover_fly(alone)
        plans = flight, Plan(both, flight.positions, flight.powers,
                             shares=np.eye(2)[[node] * 30].T)
        usual, found = (assess(plan, 2000, world=World('fixed', los_distance=0.0)).mean
                        for plan in plans)
        assert found == pytest.approx(usual, rel=0.02) and usual > 0.2


@pytest.mark.parametrize('layout', 'BC')
def test_flights_past_several_nodes_are_hardly_moved_on_the_way_to_the_full_grid(layout):
    """Before, they were blended with the reference flight, and one mission lost all its rate."""
    problem = Problem(with_uavs(
        make_mission(LAYOUTS[layout], slots=109), max_acceleration=2.0,
        start_velocity=(0.0, 0.0), goal_velocity=(0.0, 0.0)))
    fine, coarse = problem.grid, problem.grid.with_slots(40)
    plan = solve(coarse.scenario, objective='guaranteed')
    x = coarse.variables(plan.positions[:, 1:-1], np.maximum(plan.powers, 1e-6))
    refined = refine(coarse, x, fine, lambda: None)
    positions, expected = fine.positions(refined), fine.positions(coarse.refine(x, fine.slots))
    problem.validate(positions, fine.powers(refined))
    assert np.abs(positions - expected).max() < 2.0


def test_a_lone_transmitter_serves_nodes_without_the_time_to_visit_them():
    places = [(-184.0, -331.0), (-138.0, -35.0), (-291.0, 32.0), (-247.0, -57.0), (10.0, 266.0)]
    plan = solve(Scenario(
        ground_nodes=tuple(GroundNode(place, f'node{number}')
                           for number, place in enumerate(places)),
        eavesdroppers=(Eavesdropper((-157.0, 175.0), 20.0),),
        uavs=(Uav('uav1', (31.0, -466.0), (-262.0, 126.0), 63.0, 11.8, max_acceleration=1.9),),
        duration=136.0, slots=70), objective='guaranteed')
    assert plan.guaranteed_rate > 0.1
