from itertools import count
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
import oracle
import pytest
from secure_uav_planner import fly_hover_fly, METHODS, Plan, Scenario, solve
from secure_uav_planner.optimize.initial import is_similar
from strategies import make_crowd, scenarios, with_eavesdroppers, with_uavs


@pytest.mark.parametrize('duration, at_least', [
    (102, 1.360), pytest.param(200, 3.007, marks=pytest.mark.slow)])
def test_the_papers_scenario_reaches_the_reference(duration, at_least):
    plan = solve(Scenario.paper(duration), method='alternating')
    assert plan.status == 'converged'
    assert plan.guaranteed_rate >= at_least
    assert plan.worst_case_rate >= plan.guaranteed_rate


@settings(max_examples=8)
@given(scenarios(max_slots=8))
def test_the_objective_never_falls_and_no_slot_leaks_more_than_arrives(scenario):
    scenario = with_uavs(scenario, max_acceleration=None)
    plan = solve(scenario, method='alternating')
    oracle.check_rates(plan)
    assert plan.guaranteed_rate >= fly_hover_fly(scenario).guaranteed_rate - 1e-9


@pytest.mark.parametrize('method', METHODS)
def test_at_the_deadline_there_is_a_feasible_plan(monkeypatch, method):
    # A second goes by whenever the time is asked for.
    monkeypatch.setattr('secure_uav_planner.optimize.deadline.time',
                        SimpleNamespace(monotonic=count().__next__))
    scenario = Scenario.paper(200, slots=200)
    plan = solve(scenario, method=method, time_limit=30.0)
    assert isinstance(plan, Plan)
    assert plan.status == 'time_limit'
    assert plan.guaranteed_rate >= fly_hover_fly(scenario).guaranteed_rate


@pytest.mark.parametrize('method, uavs, eavesdroppers, slots, limit', [
    ('alternating', 16, 16, 190, 0.1), ('alternating', 2, 12, 2000, 0.1),
    ('joint', 32, 32, 1085, 1.0), ('joint', 7, 32, 20000, 1.0)])
def test_the_largest_scenarios_end_at_their_deadline(method, uavs, eavesdroppers, slots, limit):
    plan = solve(make_crowd(uavs, eavesdroppers, slots), method, time_limit=limit,
                 objective='guaranteed')
    assert plan.status == 'time_limit'


def test_a_warm_start_begins_at_its_plan():
    scenario = Scenario.paper(102, slots=51)
    cold = solve(scenario, method='alternating')
    moved = with_eavesdroppers(scenario, position=(205.0, 0.0))
    warm = solve(moved, method='alternating', initial=cold)
    assert warm.history[0].guaranteed_rate > fly_hover_fly(moved, 'optimised').guaranteed_rate
    assert len(warm.history) < len(cold.history)


@given(st.floats(0, 300))
def test_missions_are_similar_while_the_eavesdropper_is_within_a_height(distance):
    scenario = Scenario.paper()
    changed = with_eavesdroppers(scenario, position=(200.0, distance))
    assert is_similar(changed, scenario) == (distance <= 100.0)
