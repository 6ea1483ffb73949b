"""Several ground nodes are served fairly, by shares of the slots."""

from dataclasses import replace
from functools import partial
import json
from types import SimpleNamespace

import numpy as np
import oracle
import pytest
from scipy.optimize import brentq
from secure_uav_planner import (
    assess, Channel, Eavesdropper, fly_hover_fly, GroundNode, Plan, Scenario, solve, Uav,
    upper_bound)
from secure_uav_planner.errors import OptionError, PlanError
from secure_uav_planner.model.channel import (
    guaranteed_node_rates, guaranteed_rates, worst_case_node_rates, worst_case_rates)
from secure_uav_planner.model.channel.rates import find_least_rate
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.joint.exchange import WorstPlaces
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver
from secure_uav_planner.plan.playback import Playback
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


def distrust(scenario, *numbers):
    """Return a mission in which ground nodes with some numbers, or all, are not trusted."""
    return replace(scenario, ground_nodes=tuple(
        replace(node, trusted=bool(numbers) and number not in numbers)
        for number, node in enumerate(scenario.ground_nodes)))


def isolate(scenario, number):
    """Return the mission of one node only, with eavesdroppers at the others that listen."""
    node, hearers = scenario.ground_nodes[number], [
        Eavesdropper(other.position) if other.track is None else
        Eavesdropper(track=tuple((*knot, 0.0) for knot in other.track))
        for index, other in enumerate(scenario.ground_nodes)
        if index != number and not other.trusted]
    alone = replace(scenario, ground_nodes=(GroundNode(node.position, track=node.track),),
                    head_starts=(), eavesdroppers=(*scenario.eavesdroppers, *hearers))
    if scenario.channel.outage is None:
        return alone
    # Each link and each side of it has its share of the outage.
    links = len(scenario.eavesdroppers) + sum(2 - node.trusted for node in scenario.ground_nodes)
    return replace(alone, channel=replace(scenario.channel, outage=scenario.channel.outage * (
        1 + len(alone.eavesdroppers)) / links))


def compute_node_rates(plan):
    """Return the means of a_k [r_k - leak]^+ of the guarantee, (G,), anew for free space."""
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

            def find_place(node, at=time):
                if node.track is None:
                    return node.position
                t, *axes = np.transpose(node.track)
                return [np.interp(at, t, axis) for axis in axes]

            leaks = [find_rate(
                eve.position, eve.error_radius, 10**(eve.receiver_advantage_db / 10))
                for eve in scenario.eavesdroppers] + [
                find_rate(find_place(listener)) for listener in scenario.ground_nodes
                if listener is not node and not listener.trusted]
            leak = np.log2(1 + sum(2**leak - 1 for leak in leaks)) if (
                scenario.colluding) else max(leaks)
            total += shares[n] * max(find_rate(find_place(node)) - leak, 0.0)
        sums.append(total / scenario.slots)
    return np.array(sums)


@pytest.mark.parametrize('untrusted', [(), (1,), (0, 1, 2)])
@pytest.mark.parametrize('colluding', [False, True])
def test_rates_are_those_of_the_plain_formulas(colluding, untrusted):
    rng = np.random.default_rng(4)
    scenario = replace(
        make_mission([GroundNode((0, 80), 'barn', 2.0), GroundNode(
            name='cart', track=((0, -50, 0), (60, 90, -30))), GroundNode((120, -60), 'well', 0.5)],
            slots=12),
        eavesdroppers=(Eavesdropper((200, 0), 10.0), Eavesdropper((-150, 90), 30.0, 'drone', 3.0)),
        colluding=colluding)
    if untrusted:
        scenario = distrust(scenario, *untrusted)
    flight = fly_hover_fly(scenario)
    shares = rng.dirichlet(np.ones(3), scenario.slots).T
    plan = Plan(scenario, flight.positions, rng.uniform(0, 1, (2, 12)) * [[1.0], [0.01]],
                shares=shares)
    rates = compute_node_rates(plan)
    np.testing.assert_allclose(plan.node_rates, rates, rtol=1e-9)
    assert plan.guaranteed_rate == pytest.approx((rates / [2.0, 1.0, 0.5]).min(), rel=1e-9)
    assert plan.guaranteed_rates.sum() == pytest.approx(12 * rates.sum(), rel=1e-9)
    assert plan.worst_case_rate >= plan.guaranteed_rate
    # With eavesdroppers at known places the guarantee is exact.
    exact = replace(plan, scenario=replace(scenario, eavesdroppers=tuple(
        replace(eve, error_radius=0.0) for eve in scenario.eavesdroppers)), objective='worst_case')
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


def make_farm(eves, colluding=False, untrusted=()):
    """Return a mission of five slots with three ground nodes."""
    scenario = make_mission(
        [GroundNode((0, 80), weight=2.0), (90, -30), (-40, 10)], 300.0, slots=5)
    scenario = replace(scenario, head_starts=(0.0, 700.0, 200.0), eavesdroppers=tuple(
        Eavesdropper((200 - 500 * index, 50), 10.0) for index in range(eves)), colluding=colluding)
    return distrust(scenario, *untrusted) if untrusted else scenario


FARMS = pytest.mark.parametrize('farm', [
    (1,), (2,), (1, False, (2,)), (1, True, (0, 1)), (2, False, (0, 1, 2)), (2, True, (1,))])


@pytest.mark.parametrize('mu', [1e-1, 1e-3])
@FARMS
def test_the_gradient_is_that_of_the_barrier_function(mu, farm):
    scenario = make_farm(*farm)
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


@FARMS
def test_the_kernel_has_the_rates_of_the_plain_formulas_in_discs_and_at_places(farm):
    scenario = make_farm(*farm)
    grid, flight = Problem(scenario).grid, fly_hover_fly(scenario)
    x = grid.variables(0.98 * flight.positions[:, 1:-1] + 1.0, 0.3 * flight.powers)
    positions, powers, places = grid.positions(x), grid.powers(x), WorstPlaces(grid, x)
    for barrier, find_rates in (
            (InteriorPointSolver(grid, x[None], 0.1), guaranteed_node_rates),
            (InteriorPointSolver(grid, x[None], 0.1, receivers=places.receivers,
                                 discs=places.discs), worst_case_node_rates)):
        shares = barrier.shares[0].T
        rates = np.maximum(find_rates(scenario, positions, powers), 0.0)
        least = find_least_rate(scenario, (shares * rates).mean(axis=1)) * np.log(2)
        assert least > 0 and barrier.rates()[0] * grid.rate == pytest.approx(least, abs=2e-6)
    places.exchange(x, shares, 1e-9)
    assert places.rate == pytest.approx(least, abs=2e-6)


@pytest.mark.parametrize('mu', [1e-1, 1e-3])
@FARMS
def test_the_hessian_is_that_of_each_node_with_the_others_that_listen_as_eavesdroppers(mu, farm):
    scenario = make_farm(*farm)
    grid, flight = Problem(scenario).grid, fly_hover_fly(scenario)
    x = grid.variables(0.98 * flight.positions[:, 1:-1] + 1.0, 0.3 * flight.powers)
    barrier = InteriorPointSolver(grid, x[None], mu)
    width = 6 + len(scenario.ground_nodes) - 1
    hessians = np.empty((1, len(x), width, width))
    barrier._core.evaluate(np.empty(1), np.empty((1, len(x) * width)), hessians)
    weights, shares = scenario.node_weights, barrier.shares[0]
    units = {name: getattr(grid, name) for name in (
        'slots', 'slot_duration', 'power', 'length', 'origin', 'rate')}
    objectives = [partial(oracle.objective, SimpleNamespace(
        scenario=isolate(scenario, number), **units), mu=mu, softening=oracle.SOFTENING)
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


def test_missions_and_plans_keep_their_nodes_in_files(tmp_path):
    scenario = make_mission([GroundNode((0, 150), 'barn', 2.0, trusted=False),
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


@pytest.mark.parametrize('colluding', [False, True])
@pytest.mark.parametrize('channel', [Channel(), Channel(exponent=2.4, los='urban'), Channel(
    los='suburban', rician_k_db=10.0, outage=0.1)], ids=['free_space', 'los', 'outage'])
@pytest.mark.parametrize('untrusted', [(0, 1, 2), (2,)])
def test_what_leaks_is_what_eavesdroppers_at_the_nodes_that_listen_hear(
        untrusted, channel, colluding):
    scenario = distrust(replace(make_mission(
        [(0, 80), GroundNode(name='cart', track=((0, -50, 0), (60, 90, -30))), (120, -60)],
        slots=12), channel=channel, colluding=colluding), *untrusted)
    rng, flight = np.random.default_rng(5), fly_hover_fly(scenario)
    flight = flight.positions, rng.uniform(0, 1, (2, 12)) * [[1.0], [0.01]]
    for number in range(3):
        alone = isolate(scenario, number)
        np.testing.assert_allclose(guaranteed_node_rates(scenario, *flight)[number],
                                   guaranteed_rates(alone, *flight), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(worst_case_node_rates(scenario, *flight)[number],
                                   worst_case_rates(alone, *flight), atol=2e-6)


def test_playback_counts_nodes_that_listen_without_any_eavesdropper():
    scenario = distrust(make_mission([(0, 0), (0, 200)], slots=10))
    flight = fly_hover_fly(scenario)
    plan = Plan(scenario, flight.positions, flight.powers, shares=[[1.0] * 10, [0.0] * 10])
    rates = Playback(plan).secrecy_rates(plan.times[1:-1])
    alone = replace(plan, scenario=replace(scenario, eavesdroppers=(Eavesdropper((0, 200)),)))
    np.testing.assert_allclose(rates, alone.guaranteed_rates, atol=1e-12)
    assert (rates > 0).any() and (rates == 0).any()


@pytest.mark.parametrize('change', [lambda scenario: scenario, distrust])
def test_an_assessment_counts_the_least_of_the_nodes(change):
    plan = solve(change(make_mission(LAYOUTS['C'])), objective='guaranteed')
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
