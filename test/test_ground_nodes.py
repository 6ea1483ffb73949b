"""Several ground nodes are served fairly, by shares of the slots."""

from dataclasses import replace
import json

import numpy as np
import oracle
import pytest
from secure_uav_planner import (
    assess, Eavesdropper, fly_hover_fly, GroundNode, Plan, Scenario, solve, Uav, upper_bound)
from secure_uav_planner.errors import OptionError, PlanError
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver
from secure_uav_planner.plan.splice import continue_plan, cut_tail

LAYOUTS = {'A': [(0, 150), (0, -150)], 'B': [(0, 0), (400, 0)],
           'C': [(0, 200), (-100, 0), (0, -200)], 'D': [(0, 0), (130, 60)]}
BEST = {('A', 120): 1.4249, ('A', 200): 1.9514, ('B', 120): 0.4255, ('C', 120): 1.1516,
        ('D', 120): 0.6566}
"""The best known guaranteed rates, found by IPOPT from many starts by plain formulas."""


def make_mission(places, duration=120.0, **fields):
    """Return the paper's mission with ground nodes at places, or with given ones."""
    nodes = [place if isinstance(place, GroundNode) else GroundNode(place) for place in places]
    return replace(Scenario.paper(duration, **fields), ground_node=None,
                   ground_nodes=tuple(nodes))


def compute_node_rates(plan):
    """Return the means of a_k [r_k - r_e]^+ of the guarantee, (G,), stated anew for free space."""
    scenario, sums = plan.scenario, []
    snr = 10**(scenario.reference_snr_db / 10)
    for node, shares in zip(scenario.ground_nodes, plan.shares):
        total = 0.0
        for n in range(scenario.slots):
            time = (n + 1) * scenario.duration / scenario.slots

            def find_rate(place, radius=0.0, advantage=1.0, at=n):
                received = []
                for u, uav in enumerate(scenario.uavs):
                    distance = np.hypot(*(plan.positions[u, at + 1] - place))
                    distance = distance + radius if u else max(distance - radius, 0.0)
                    received.append(advantage * snr * plan.powers[u, at] / (
                        distance**2 + uav.altitude**2))
                return np.log2(1 + received[0] / (1 + sum(received[1:])))

            place = node.position
            if node.track is not None:
                t, *axes = np.transpose(node.track)
                place = [np.interp(time, t, axis) for axis in axes]
            leaks = [find_rate(
                eve.position, eve.error_radius, 10**(eve.receiver_advantage_db / 10))
                for eve in scenario.eavesdroppers]
            leak = np.log2(1 + sum(2**leak - 1 for leak in leaks)) if (
                scenario.colluding) else max(leaks)
            total += shares[n] * max(find_rate(place) - leak, 0.0)
        sums.append(total / scenario.slots)
    return np.array(sums)


@pytest.mark.parametrize('colluding', [False, True])
def test_rates_are_those_of_the_plain_formulas(colluding):
    rng = np.random.default_rng(4)
    scenario = replace(
        make_mission([GroundNode((0, 80), 'barn', 2.0), GroundNode(
            name='cart', track=((0, -50, 0), (60, 90, -30))), GroundNode((120, -60), 'well', 0.5)],
            slots=12),
        eavesdroppers=(Eavesdropper((200, 0), 10.0), Eavesdropper((-150, 90), 30.0, 'drone', 3.0)),
        colluding=colluding)
    flight = fly_hover_fly(scenario)
    shares = rng.dirichlet(np.ones(3), scenario.slots).T
    plan = Plan(scenario, flight.positions, rng.uniform(0, 1, (2, 12)) * [[1.0], [0.01]],
                shares=shares)
    rates = compute_node_rates(plan)
    np.testing.assert_allclose(plan.node_rates, rates, rtol=1e-9)
    assert plan.guaranteed_rate == pytest.approx((rates / [2.0, 1.0, 0.5]).min(), rel=1e-9)
    assert plan.guaranteed_rates.sum() == pytest.approx(12 * rates.sum(), rel=1e-9)
    assert plan.worst_case_rate >= plan.guaranteed_rate


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


@pytest.mark.parametrize('fields', [
    {'max_acceleration': 2.0}, {}], ids=['acceleration', 'none'])
def test_a_plan_is_improved_further_and_its_rest_planned_again(fields):
    scenario = make_mission(LAYOUTS['A'])
    scenario = replace(scenario, uavs=tuple(replace(uav, **fields) for uav in scenario.uavs))
    plan = solve(scenario, objective='guaranteed')
    again = solve(scenario, initial=plan)
    assert again.guaranteed_rate >= plan.guaranteed_rate
    tail = cut_tail(plan, 40)
    np.testing.assert_array_equal(tail.shares, plan.shares[:, 40:])
    whole = continue_plan(plan, 40, solve(tail.scenario, initial=tail))
    np.testing.assert_array_equal(whole.shares[:, :40], plan.shares[:, :40])
    assert whole.rate > plan.rate - 1e-6


@pytest.mark.parametrize('layout, point', [('A', 20), ('B', 60), ('C', 60), ('D', 90)])
def test_the_rest_of_a_mission_makes_up_for_what_was_delivered_before(layout, point):
    duration = 150.0 if layout == 'B' else 120.0
    plan = solve(make_mission(LAYOUTS[layout], duration), objective='guaranteed')
    tail = cut_tail(plan, point)
    delivered = plan.node_shares[:, :point].sum(axis=1)
    assert tail.scenario.head_starts == pytest.approx(delivered - delivered.min())
    left = plan.rate * duration - delivered.min()
    assert tail.rate == pytest.approx(left / tail.scenario.duration)
    # From scratch, too, in the rest there is the flight that is the best for the whole.
    for initial in (tail, None):
        rest = solve(tail.scenario, objective='guaranteed', initial=initial)
        whole = continue_plan(plan, point, rest)
        assert whole.scenario.head_starts == ()
        assert plan.rate - 2e-4 < whole.rate < plan.rate + 1e-3
    unfair = solve(replace(tail.scenario, head_starts=()), objective='guaranteed')
    assert continue_plan(plan, point, unfair).rate < 0.99 * plan.rate


@pytest.mark.parametrize('mu', [1e-1, 1e-3])
@pytest.mark.parametrize('eves', [1, 2])
def test_the_gradient_is_that_of_the_barrier_function(mu, eves):
    scenario = make_mission(
        [GroundNode((0, 80), weight=2.0), (90, -30), (-40, 10)], 300.0, slots=5)
    scenario = replace(scenario, head_starts=(0.0, 700.0, 200.0), eavesdroppers=tuple(
        Eavesdropper((200 - 300 * index, 50), 10.0) for index in range(eves)))
    grid = Problem(scenario).grid
    flight = fly_hover_fly(scenario)
    x = grid.variables(0.98 * flight.positions[:, 1:-1] + 1.0, 0.3 * flight.powers)

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


def test_a_single_node_is_the_ground_node():
    paper = Scenario.paper(102.0)
    single = replace(paper, ground_node=None, ground_nodes=(GroundNode((0.0, 0.0)),))
    assert single == paper and hash(single) == hash(paper)
    assert single.ground_node == (0.0, 0.0) and paper.ground_nodes == single.ground_nodes
    assert replace(paper, ground_node=(5.0, 0.0)).ground_nodes == (GroundNode((5.0, 0.0)),)
    assert paper.to_dict() == single.to_dict() and 'ground_nodes' not in paper.to_dict()


def test_missions_and_plans_keep_their_nodes_in_files(tmp_path):
    scenario = make_mission([GroundNode((0, 150), 'barn', 2.0),
                             GroundNode(name='cart', track=((0, 0, 0), (10, 5, 5)))], 102.0)
    for name in ('mission.yaml', 'mission.json'):
        scenario.save(tmp_path / name)
        assert Scenario.load(tmp_path / name) == scenario
    plan = fly_hover_fly(scenario)
    plan.save(tmp_path / 'plan.json')
    assert Plan.load(tmp_path / 'plan.json') == plan
    single = fly_hover_fly(Scenario.paper(102.0))
    single.save(tmp_path / 'plan.json')
    assert 'shares' not in json.loads((tmp_path / 'plan.json').read_text())


def test_wrong_shares_are_refused():
    plan = fly_hover_fly(make_mission(LAYOUTS['A'], 102.0))
    for shares in (np.ones((2, 102)), -plan.shares, plan.shares[:, 1:]):
        with pytest.raises(PlanError, match='shares'):
            replace(plan, shares=shares)


def test_what_holds_for_one_node_only_is_refused_with_the_reason():
    scenario = make_mission(LAYOUTS['A'])
    with pytest.raises(OptionError, match='2 ground_nodes'):
        solve(scenario, method='alternating')
    with pytest.raises(OptionError, match='2 ground_nodes'):
        upper_bound(scenario)


def test_an_assessment_counts_the_least_of_the_nodes():
    plan = solve(make_mission(LAYOUTS['C']), objective='guaranteed')
    assessment = assess(plan, 50)
    assert assessment.promised_rate == plan.guaranteed_rate
    assert (assessment.rates >= plan.guaranteed_rate - 1e-9).all() and assessment.outage == 0


def test_a_table_has_the_shares_of_each_node():
    plan = solve(make_mission([GroundNode((0, 150), 'barn'), GroundNode((0, -150), 'well')]),
                 objective='guaranteed')
    table = plan.to_dataframe()
    of_one = table[table['uav'] == 'uav1']
    np.testing.assert_array_equal(of_one[['barn.share', 'well.share']].to_numpy().T[:, 1:-1],
                                  plan.shares)
    assert 'ground_node.share' not in fly_hover_fly(Scenario.paper(102.0)).to_dataframe()


def test_a_lone_transmitter_serves_two_nodes():
    uav = Uav('solo', (0, 0), (300, 0), 100.0, 10.0)
    scenario = Scenario(ground_nodes=(GroundNode((0, 80)), GroundNode((300, 80))), uavs=(uav,),
                        eavesdroppers=(Eavesdropper((150, -300), 20.0),), duration=60.0, slots=60)
    plan = solve(scenario)
    assert scenario.ground_node_names == ('ground_node1', 'ground_node2')
    assert plan.worst_case_rate > fly_hover_fly(scenario, power='optimised').worst_case_rate


def test_a_lone_transmitter_serves_nodes_without_the_time_to_visit_them():
    places = [(-184.0, -331.0), (-138.0, -35.0), (-291.0, 32.0), (-247.0, -57.0), (10.0, 266.0)]
    plan = solve(Scenario(
        ground_nodes=tuple(GroundNode(place, f'node{number}')
                           for number, place in enumerate(places)),
        eavesdroppers=(Eavesdropper((-157.0, 175.0), 20.0),),
        uavs=(Uav('uav1', (31.0, -466.0), (-262.0, 126.0), 63.0, 11.8, max_acceleration=1.9),),
        duration=136.0, slots=70), objective='guaranteed')
    assert plan.guaranteed_rate > 0.1
