from dataclasses import replace
import json

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import fly_hover_fly, Plan, Scenario
from strategies import scenarios


@pytest.fixture
def plan():
    return fly_hover_fly(Scenario.paper(102))


def test_a_plan_cannot_be_changed(plan):
    with pytest.raises(ValueError):
        plan.positions[0, 0, 0] = 1.0
    with pytest.raises(ValueError):
        plan.powers[0, 0] = 1.0
    with pytest.raises(AttributeError):
        plan.powers = np.ones((2, 102))


def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize('field, index, value, message', [
    ('positions', (0, 0, 0), 101.0, 'the start of uav1'),
    ('positions', (1, -1, 1), -499.0, 'the goal of uav2'),
    ('positions', (0, 50, 0), 50.0, 'uav1 moves'),
    ('powers', (0, 3), -0.1, r'the power of uav1 is -0.1 W in slot 4'),
    ('powers', (1, 7), 5.0, r'the power of uav2 is 5 W in slot 8; at most 4 W'),
    ('powers', (1, slice(0, 9)), 2.0, 'the average power of uav2'),
    ('powers', (0, 0), np.nan, 'powers has the shape'),
])
def test_a_plan_that_breaks_a_limit_is_refused_with_the_place(plan, field, index, value, message):
    with pytest.raises(ValueError, match=message):
        replace(plan, **{field: changed(getattr(plan, field), index, value)})


def test_arrays_of_another_shape_are_refused(plan):
    with pytest.raises(ValueError, match='positions has the shape'):
        replace(plan, positions=plan.positions[:, :-1])
    with pytest.raises(ValueError, match='powers must be an array of numbers'):
        replace(plan, powers='loud')


@given(scenario=scenarios())
def test_a_plan_survives_its_file(tmp_path_factory, scenario):
    path = tmp_path_factory.mktemp('plans') / 'plan.json'
    plan = replace(fly_hover_fly(scenario), start_ns=1795246192039494728)
    plan.save(path)
    again = Plan.load(path)
    assert again.scenario == scenario
    assert again.start_ns == plan.start_ns
    assert (again.positions == plan.positions).all()
    assert (again.powers == plan.powers).all()
    assert again.guaranteed_rate == plan.guaranteed_rate
    assert json.loads(path.read_text())['worst_case_rate'] == plan.worst_case_rate


@pytest.mark.parametrize('text', [
    '', '{', '[]', '{"format": "other"}', 'null', '{"format": "secure_uav_planner/plan"}',
    '{"format": "secure_uav_planner/plan", "version": 2}', '[' * 100000, '\x00'])
def test_a_foreign_file_is_refused_by_name(tmp_path, text):
    path = tmp_path / 'foreign.json'
    path.write_text(text)
    with pytest.raises(ValueError, match=r'foreign\.json is not a plan'):
        Plan.load(path)


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_file_is_refused_or_still_a_feasible_plan(tmp_path_factory, data):
    path = tmp_path_factory.mktemp('plans') / 'plan.json'
    replace(fly_hover_fly(Scenario.paper(102, slots=4)), solve_time=1.0).save(path)
    raw = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw[:data.draw(st.integers(1, len(raw)))])
    try:
        assert isinstance(Plan.load(path), Plan)
    except ValueError as error:
        assert 'is not a plan' in str(error)


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path, plan, monkeypatch):
    path = tmp_path / 'plan.json'
    plan.save(path)
    before = path.read_bytes()
    unwritable = replace(plan, method=object())
    with pytest.raises(TypeError):
        unwritable.save(path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ['plan.json']


@given(scenarios(), st.data())
def test_the_tail_of_a_plan_is_feasible_for_what_is_left(scenario, data):
    plan = replace(fly_hover_fly(scenario), start_ns=10**18)
    point = data.draw(st.integers(0, scenario.slots - 1))
    tail = plan.tail(point)
    assert (tail.positions == plan.positions[:, point:]).all()
    assert tail.times[-1] == pytest.approx(plan.times[-1] - plan.times[point])
    assert tail.start_ns - plan.start_ns == pytest.approx(plan.times[point] * 1e9, abs=1)
    assert tail.guaranteed_rates == pytest.approx(plan.guaranteed_rates[point:])
    for uav, before, power in zip(tail.scenario.uavs, scenario.uavs, plan.powers):
        spent = power[:point].sum() + uav.average_power * tail.scenario.slots
        assert spent <= before.average_power * scenario.slots * (1 + 1e-9)


def test_there_is_no_tail_beyond_the_last_slot(plan):
    with pytest.raises(ValueError, match='point is 102'):
        plan.tail(102)
