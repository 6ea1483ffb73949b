"""Plans against the true worst case, problem (P1), beside those by the formula, (P2)."""

from dataclasses import replace

from benchmarks.missions import random_mission
import numpy as np
import oracle
import pytest
from secure_uav_planner import fly_hover_fly, Scenario, solve
from secure_uav_planner.model import channel
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.incumbent import Incumbent
from secure_uav_planner.optimize.initial import constant_powers, fly_hover_fly_positions
from secure_uav_planner.optimize.joint import exchange
from secure_uav_planner.optimize.joint.exchange import WorstPlaces
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver
from secure_uav_planner.optimize.joint.method import improve
from secure_uav_planner.optimize.joint.settings import DESCENT
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from strategies import with_uavs


@pytest.mark.parametrize('duration, radius, best_known', [
    (102, 10, 1.4658), (102, 60, 1.1080), (120, 30, 1.8586), (120, 60, 1.5578),
    (200, 10, 3.0577), (200, 60, 2.3456)])
def test_the_papers_scenario_reaches_the_best_known_worst_case(duration, radius, best_known):
    scenario = Scenario.paper(float(duration), float(radius))
    plan = solve(scenario, objective='worst_case')
    assert (plan.status, plan.objective) == ('converged', 'worst_case')
    assert plan.worst_case_rate >= best_known - 5e-5
    assert plan.worst_case_rate > solve(scenario, objective='guaranteed').worst_case_rate + 1e-3


def test_the_history_ends_with_the_rate_of_the_plan_where_steps_run_out(monkeypatch):
    monkeypatch.setattr(exchange, 'DESCENT', replace(DESCENT, most_steps=6))
    scenario = Scenario.paper(120.0, 30.0, 40)
    problem = Problem(scenario)
    incumbent = Incumbent(problem, fly_hover_fly_positions(problem), constant_powers(scenario),
                          objective='worst_case')
    plan = incumbent.to_plan('joint', improve(incumbent))
    assert plan.status == 'iteration_limit'
    assert plan.history[-1].rate == pytest.approx(plan.worst_case_rate, abs=1e-9)


def test_with_known_places_both_objectives_are_one():
    scenario = Scenario.paper(120.0, error_radius=0.0)
    plans = [solve(scenario, objective=objective) for objective in ('guaranteed', 'worst_case')]
    assert plans[1].worst_case_rate == pytest.approx(plans[0].guaranteed_rate, abs=1e-5)


def test_it_keeps_a_limit_of_acceleration_and_never_loses_a_warm_start():
    scenario = with_uavs(Scenario.paper(120.0, 30.0), max_acceleration=2.0)
    plan = solve(scenario, objective='worst_case')
    assert plan.worst_case_rate > solve(scenario, objective='guaranteed').worst_case_rate + 1e-3
    again = solve(scenario, objective='worst_case', initial=plan)
    assert again.worst_case_rate >= plan.worst_case_rate - 1e-9
    assert len(again.history) < 0.8 * len(plan.history)


def test_the_default_objective_is_the_methods_own_or_that_of_the_initial_plan():
    scenario = Scenario.paper(102.0, 30.0, slots=10)
    plan = solve(scenario)
    assert plan.objective == 'worst_case'
    alternating = {'method': 'alternating', 'on_iteration': lambda _: True}
    assert solve(scenario, **alternating).objective == 'guaranteed'
    guaranteed = solve(scenario, objective='guaranteed')
    assert guaranteed.guaranteed_rate >= plan.guaranteed_rate
    for before in (plan, guaranteed):
        tail = cut_tail(before, 3)
        assert tail.objective == before.objective
        again = solve(tail.scenario, initial=tail)
        assert again.objective == before.objective
        assert continue_plan(before, 3, again).objective == before.objective
    assert solve(scenario, initial=plan, **alternating).objective == 'guaranteed'
    assert solve(scenario, initial=fly_hover_fly(scenario)).objective == 'worst_case'


@pytest.mark.parametrize('radius', [20.0, 150.0], ids=['on the edge', 'inside'])
def test_the_curvature_of_the_largest_leak_is_that_of_places_that_follow_the_uavs(radius):
    scenario = replace(Scenario.paper(120.0, radius, slots=6), reference_snr_db=90.0)
    grid, rng = Problem(scenario).grid, np.random.default_rng(2)
    x = np.empty((6, 2, 3))
    x[..., 0] = [0.8, 0.02]
    x[..., 1:] = rng.uniform([-0.5, -1.0], [2.0, 1.0], (6, 2, 2))

    def largest(x):
        leaks = channel.leak_maximisers(scenario, grid.positions(x)[:, 1:-1], grid.powers(x))[1]
        return leaks[0] * np.log(2)

    # With so small a barrier parameter only the largest leak counts.
    places, fixed = WorstPlaces(grid, x), WorstPlaces(grid, x)
    fixed._largest[:] = False  # So that no place follows.
    ground = oracle.hessians(lambda at: oracle.rates(grid, at)[0], x)
    bends = [
        mirror(oracle.model(InteriorPointSolver(grid, x[None], 1e-7, receivers=variant.receivers,
                                                discs=variant.discs))[2][0]) + ground
        for variant in (places, fixed)]
    measured, fixed_bends = [], []
    for move in rng.normal(0, 1, (20, 2, 3)):
        step = 2e-3 * move
        measured.append((largest(x + step) - 2 * largest(x) + largest(x - step)) / 2e-3**2)
        followed, unmoved = (np.einsum('i,nij,j->n', move.ravel(), matrix, move.ravel())
                             for matrix in bends)
        fixed_bends.append(unmoved)
        assert np.allclose(followed, measured[-1], rtol=0.05, atol=0.02)
    assert not np.allclose(fixed_bends, measured, rtol=0.2, atol=0.1)


def mirror(lower):
    """Return symmetric matrices (N, V, V) of their lower triangles."""
    lower = np.tril(lower)
    return lower + np.swapaxes(np.tril(lower, -1), -1, -2)


@pytest.mark.soak
@pytest.mark.parametrize('first', range(0, 100, 20))
def test_in_random_missions_it_is_never_below_the_plan_of_the_formula(first):
    for seed in range(first, first + 20):
        scenario = random_mission(seed, slots=60 + 7 * seed % 41)
        rates = [solve(scenario, objective=objective).worst_case_rate
                 for objective in ('worst_case', 'guaranteed')]
        assert rates[0] >= rates[1], seed
