import copy
from dataclasses import replace
import json
import math
import os
import pathlib
import pickle

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import (
    Channel, Eavesdropper, fly_hover_fly, GroundNode, Iteration, Plan, Scenario, solve)
from secure_uav_planner.errors import OptionError, PlanError, PlanFileError
from secure_uav_planner.model import channel
from secure_uav_planner.output.picture import draw_plan
from secure_uav_planner.output.tables import rate_table
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from strategies import PLACED, scenarios, with_eavesdroppers, with_uavs
from test_mission_file import change_values

OLD = pathlib.Path(__file__).parent / 'data' / 'plan_0.1.0.json'
BOUND = {'rate': 9.0, 'objective': 'worst_case', 'ignored': [], 'solve_time': 0.5,
         'status': 'converged'}


@pytest.fixture
def plan():
    return fly_hover_fly(Scenario.paper(102))


def test_a_plan_its_rates_and_its_copies_are_read_only(plan):
    with pytest.raises(AttributeError):
        plan.powers = np.ones((2, 102))
    for same in (plan, copy.deepcopy(plan), pickle.loads(pickle.dumps(plan.evaluate()))):
        for array in (same.positions, same.powers, same.guaranteed_rates, same.worst_case_rates):
            with pytest.raises(ValueError):
                array[...] = 9.0
        assert same.guaranteed_rate == plan.guaranteed_rate


def test_a_power_below_zero_by_at_most_the_tolerance_is_zero(plan):
    powers = plan.powers.copy()
    powers[:, :3] = [-9e-10, -0.0, 0.0]
    kept = replace(plan, powers=powers).powers
    assert not kept[:, :3].any() and not np.signbit(kept).any()


def test_a_plan_begins_when_ros_can_stamp_all_of_it(plan):
    last = (2**31 - 1 - math.ceil(plan.times[-1])) * 10**9
    for start in (0, last):
        assert replace(plan, start_ns=start).start_ns == start
    with pytest.raises(PlanError, match=f'from 0 to {last}'):
        replace(plan, start_ns=last + 1)


@pytest.mark.parametrize('times', [1 - 1e-12, 1.0, 1 + 1e-12])
def test_a_promise_ends_before_the_slot_of_a_time_whatever_the_rounding(plan, times):
    step = plan.scenario.slot_duration
    for slot in range(1, 9):
        assert plan.end_promise(times * slot * step).promised_until == (slot - 1) * step


def test_only_slots_with_a_positive_rate_count():
    scenario = Scenario.paper(104.0, 60.0, slots=26)
    optimised, baseline = solve(scenario), fly_hover_fly(scenario)
    unhelped = replace(baseline, powers=baseline.powers * [[1.0], [0.0]])
    for plan in (optimised, baseline, unhelped):
        before = channel.guaranteed_rates(scenario, plan.positions, plan.powers)
        worst = channel.worst_case_rates(scenario, plan.positions, plan.powers)
        assert before.min() < -0.01
        assert plan.guaranteed_rates == pytest.approx(np.where(before > 0, before, 0.0))
        assert plan.guaranteed_rate == plan.guaranteed_rates.mean() > before.mean()
        assert plan.worst_case_rates == pytest.approx(np.where(worst > 0, worst, 0.0))
        assert plan.curve_rates.min() == 0.0
        assert (worst.min() < -0.01) == (plan is unhelped)


@pytest.mark.parametrize('changes, reason', [
    ({'reference_snr_db': -60.0}, 'the SNR is -94 dB; is reference_snr_db, -60, right? '
     '`secure_uav_planner link-budget`'),
    ({'eavesdroppers': (Eavesdropper((99.0, 0.0), 10.0), Eavesdropper((5.0, 0.0), 6.0, 'car'))},
     'the disc of car covers the ground node'),
    ({'eavesdroppers': (Eavesdropper((5.0, 0.0), 6.0, receiver_advantage_db=-1.0),)},
     'more time or power may help'),
    ({'reference_snr_db': 50.0, 'channel': Channel(exponent=5.0)},
     'the SNR is -44 dB; is reference_snr_db, 50, right?'),
    ({'ground_nodes': (GroundNode((0.0, 0.0), 'a', trusted=False), GroundNode((0.0, 0.0), 'b'))},
     'a is not trusted and is where b is, where it receives the same: no plan can')])
def test_a_plan_that_carries_nothing_says_why(changes, reason):
    scenario = replace(Scenario.paper(120.0, slots=10), **changes)
    made = fly_hover_fly(scenario)
    plan = Plan(scenario, made.positions, np.zeros_like(made.powers))
    assert f'no slot carries anything in secret; {reason}' in plan.message.replace(
        'straight below uav1 at peak power ', '')
    assert 'secret' not in fly_hover_fly(Scenario.paper(120.0, slots=10)).message


def test_a_small_head_start_hides_no_reason_for_a_rate_of_0():
    scenario = replace(Scenario.paper(120.0, slots=8), ground_nodes=(
        GroundNode((0.0, 0.0), 'a'), GroundNode((-300.0, 0.0), 'b')),
        eavesdroppers=(Eavesdropper((0.0, 0.0), 30.0),), head_starts=(1e-6, 0.0))
    assert 'covers the ground node a' in fly_hover_fly(scenario).message


def test_a_plan_of_rate_0_names_the_ground_nodes_that_nothing_is_carried_to():
    nodes = tuple(GroundNode(place, name) for place, name in (
        ((0.0, 0.0), 'barn'), ((200.0, 5.0), 'mill'), ((0.0, 200.0), 'farm')))
    plan = fly_hover_fly(replace(Scenario.paper(120.0, slots=10), ground_nodes=nodes))
    assert plan.rate == 0 < plan.node_rates[0]
    assert ('no slot carries anything in secret to mill; the disc of eavesdropper covers the '
            'ground node mill, where') in plan.message


@pytest.mark.parametrize('text', [
    '', '[]', '{"format": "other"}', '{"format": "secure_uav_planner/plan", "version": 2}',
    '[' * 100000, '\x00'])
def test_a_foreign_file_is_refused_by_name(tmp_path, text):
    path = tmp_path / 'foreign.json'
    path.write_text(text)
    with pytest.raises(ValueError, match=r'foreign\.json is not a plan'):
        Plan.load(path)


def test_a_missing_field_of_an_older_file_takes_its_default(tmp_path):
    document, old = json.loads(OLD.read_text()), Plan.load(OLD)
    assert (old.status, old.start_ns) == ('converged', 1795246192039494728)
    assert old.history[-1].rate == old.history[-1].guaranteed_rate
    for field in ('history', 'status', 'method', 'solve_time', 'start_ns'):
        del document[field]
    del document['scenario']['reference_snr_db'], document['scenario']['uavs'][0]['peak_power']
    path = tmp_path / 'less.json'
    path.write_text(json.dumps(document))
    plan = Plan.load(path)
    assert (plan.status, plan.history, plan.scenario.uavs[0].peak_power) == ('given', (), 4.0)


@pytest.mark.parametrize('change, field, message', [
    ({'powers/1/7': '0.5'}, 'powers[1][7]', "powers[1][7] is '0.5'; it must be a number"),
    ({'powers/1/7': True}, 'powers[1][7]', 'powers[1][7] is true; it must be a number'),
    ({'positions/1/7': {}}, 'positions[1][7]', 'positions[1][7] is {}; it must be a number'),
    ({'status': 'finished'}, 'status', "status is 'finished'"),
    ({'start_ns': 10**400}, 'start_ns', 'start_ns is'),
    ({'powrs': 1}, 'powrs', 'did you mean powers'), ({'history': 5}, 'history', 'history is 5'),
    ({'history': [{'number': 'one'}]}, 'history[0]', 'history[0] lacks'),
    ({'history/0/number': 'one'}, 'history[0].number', "number is 'one'"),
    ({'history/0/elapsed': math.nan}, 'history[0].elapsed', 'elapsed is nan'),
    ({'scenario': None}, 'scenario', 'mission is null'),
    ({'positions': None}, 'positions', 'positions'),
    ({'version': True}, '', 'its version is true'),
    ({'bound': []}, '', 'bound'), *(
        ({'bound': {**BOUND, name: value}}, field, name) for name, value, field in (
            ('more', 1, 'more'), ('status', None, 'status'), ('rate', math.nan, 'rate'),
            ('ignored', [5], 'ignored[0]'), ('solve_time', -1, 'solve_time'))),
    ({'version': 99, 'wind': 'west'}, '', 'version 99, which a newer secure_uav_planner wrote')])
def test_a_wrong_field_of_a_file_is_named(tmp_path, change, field, message):
    path = tmp_path / 'wrong.json'
    path.write_text(json.dumps(change_values(json.loads(OLD.read_text()), change)))
    with pytest.raises(PlanFileError) as error:
        Plan.load(path)
    assert message in str(error.value) and len(str(error.value)) < 300
    assert error.value.field == field


def test_a_history_in_numbers_of_numpy_survives_its_file(tmp_path, plan):
    counted = replace(plan, history=(
        Iteration(np.int64(3), 'own', np.float32(1.5), np.float64(0.1), np.float32(0.0)),))
    counted.save(tmp_path / 'plan.json')
    assert Plan.load(tmp_path / 'plan.json') == counted


def test_a_new_file_has_the_permissions_of_the_umask_and_a_replaced_one_keeps_its_own(
        tmp_path, plan):
    path, before = tmp_path / 'plan.json', os.umask(0o027)
    try:
        plan.save(path)
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640
    for mode in (0o600, 0o666):
        path.chmod(mode)
        plan.save(path)
        assert path.stat().st_mode & 0o777 == mode


def test_a_missing_file_and_a_device_are_neither_read_nor_replaced(plan, tmp_path):
    for file in (tmp_path / 'plan.json', '/dev/zero'):
        with pytest.raises(PlanFileError, match=f'{file} cannot be read'):
            Plan.load(file)
    with pytest.raises(OSError, match='not a regular file'):
        plan.save('/dev/full')
    assert not pathlib.Path('/dev/full').is_file()


def test_a_symbolic_link_is_followed_and_stays_a_link(plan, tmp_path):
    target, link = tmp_path / 'target.json', tmp_path / 'link.json'
    link.symlink_to(target)
    plan.save(link)
    assert link.is_symlink() and Plan.load(target).guaranteed_rate == plan.guaranteed_rate


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
    unwritable = replace(plan)
    unwritable.__dict__['method'] = object()
    with pytest.raises(TypeError):
        unwritable.save(path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ['plan.json']


@pytest.mark.parametrize('stem', [250 * 'a', 83 * 'é飛', 62 * '\U0001f681'])
def test_a_file_may_have_any_legal_name(tmp_path, plan, stem):
    stem = stem.encode()[:250].decode(errors='ignore')
    plan.save(tmp_path / f'{stem}.json')
    assert Plan.load(tmp_path / f'{stem}.json').scenario == plan.scenario
    assert len(list(tmp_path.iterdir())) == 1


def test_an_error_of_a_save_names_the_file_and_not_its_part(tmp_path, plan):
    file = tmp_path / 'none' / 'plan.json'
    with pytest.raises(FileNotFoundError) as error:
        plan.save(file)
    assert error.value.filename == str(file) and '.part' not in str(error.value)


@given(scenarios(), st.data())
def test_the_tail_of_a_plan_is_feasible_for_the_rest_of_the_mission(scenario, data):
    plan = replace(fly_hover_fly(scenario), start_ns=10**18)
    point = data.draw(st.integers(0, scenario.slots - 1))
    tail = cut_tail(plan, point)
    assert (tail.positions == plan.positions[:, point:]).all()
    assert tail.times[-1] == pytest.approx(plan.times[-1] - plan.times[point])
    assert tail.start_ns - plan.start_ns == pytest.approx(plan.times[point] * 1e9, abs=1)
    assert tail.guaranteed_rates == pytest.approx(plan.guaranteed_rates[point:])
    times = np.linspace(plan.times[point], plan.curve.end, 200)
    assert tail.curve.at(times - plan.times[point]).positions == pytest.approx(
        plan.curve.at(times).positions, abs=1e-6)
    for uav, before, power in zip(tail.scenario.uavs, scenario.uavs, plan.powers):
        spent = power[:point].sum() + uav.average_power * tail.scenario.slots
        assert spent <= before.average_power * scenario.slots * (1 + 1e-9)


def gap_plan():
    """Return a plan of 10 slots of 10 s that was promised until 20 s and planned again at 50 s."""
    scenario = with_eavesdroppers(
        with_uavs(Scenario.paper(100.0, slots=10), max_speed=15.0), **PLACED,
        track=((0.0, 400.0, 0.0, 10.0), (20.0, 400.0, 0.0, 10.0)))
    first = replace(solve(scenario), start_ns=10**18, promised_until=20.0)
    tail = cut_tail(first, 4)
    near = replace(tail.scenario, eavesdroppers=(Eavesdropper((60.0, 150.0), 10.0),))
    return first, continue_plan(first, 4, solve(near, initial=tail))


def test_a_promise_that_has_ended_does_not_come_back_with_a_replan(tmp_path):
    """
    Before, slot 4 counted 7.60 bit/s/Hz while the receiver got 8.67 of 10.77.

    The means then were 2.9507 and 2.9898 bit/s/Hz over 10 slots; over the 8 promised slots they
    are 2.0434 and 2.0846.
    """
    first, plan = gap_plan()
    assert plan.promised_slots.tolist() == [True, True, False, False, *[True] * 6]
    assert (plan.promise.text, plan.promise.gaps) == ('8 of 10 slots promised', [(30.0, 50.0)])
    assert plan.gaps == ((20.0, 50.0),)
    # In slot 4 the receiver gets more than the disc of the first plan allows.
    truth = channel.secrecy_rates(plan.scenario, plan.positions, plan.powers, (60.0, 150.0))
    assert truth[3] < plan.worst_case_rates[3] - 5.0
    assert plan.promise.guaranteed_rate < plan.guaranteed_rate - 0.5
    assert plan.promise.worst_case_rate < plan.worst_case_rate - 0.5
    for mean, rates in ((plan.promise.guaranteed_rate, plan.guaranteed_rates),
                        (plan.promise.worst_case_rate, plan.worst_case_rates),
                        (plan.promise.curve_rate, plan.curve_rates),
                        (plan.promise.node_rates[0], plan.worst_case_rates)):
        assert mean == pytest.approx(rates[[0, 1, *range(4, 10)]].mean())
    plan.save(tmp_path / 'plan.json')
    document = json.loads((tmp_path / 'plan.json').read_text())
    assert document['guaranteed_rate'] == plan.promise.guaranteed_rate != plan.guaranteed_rate
    assert Plan.load(tmp_path / 'plan.json') == plan
    assert '8 of 10 slots promised' in rate_table([plan])
    assert any('8 of 10 slots promised' in text.get_text() for text in draw_plan(plan).texts)
    assert f'{plan.promise.rate:.4f} bit/s/Hz by ' in repr(plan)
    assert '; 8 of 10 slots promised; ' in repr(plan)


def test_a_promise_that_ends_in_a_gap_leaves_the_slot_of_that_time_unpromised():
    """Before, slot 3 was promised after the next replan, though it had been flown in the gap."""
    _, plan = gap_plan()
    ended = replace(plan, promised_until=30.0)
    again = continue_plan(ended, 6, replace(cut_tail(ended, 6), promised_until=None))
    assert again.gaps == ((20.0, 70.0),)
    assert again.promised_slots.tolist() == [True, True, *[False] * 4, *[True] * 4]


@given(scenarios(), st.data())
def test_a_plan_that_is_cut_and_continued_keeps_its_promise(scenario, data):
    end, point = scenario.times[-1], data.draw(st.integers(0, scenario.slots - 1))
    times = sorted(data.draw(st.lists(st.floats(0, end), min_size=4, max_size=4)))
    plan = replace(
        fly_hover_fly(scenario), start_ns=10**18, gaps=(times[:2], times[2:]),
        promised_until=data.draw(st.one_of(st.none(), st.floats(0, end))),
        promise_delay=5.0, promise_speed=data.draw(st.floats(0.1, 10)))
    tail = cut_tail(plan, point)
    assert (tail.promised_slots == plan.promised_slots[point:]).all()
    assert all(begin >= 0 for begin, _ in tail.gaps)
    again = continue_plan(plan, point, tail)
    assert (again.promised_slots == plan.promised_slots).all()
    assert again.promise_delay == pytest.approx(plan.promise_delay)
    assert sum(end - begin for begin, end in plan.promise.gaps) == pytest.approx(
        (~plan.promised_slots).sum() * scenario.slot_duration)
    # The slot in which a flight leaves its receivers, and all later ones, are not promised.
    late = data.draw(st.floats(0, end))
    ended, slot = plan.end_promise(late), int(late / scenario.slot_duration + 1e-9)
    assert not ended.promised_slots[max(0, slot - 1):].any()
    assert (ended.promised_slots == plan.promised_slots)[:max(0, slot - 1)].all()


def test_a_plan_that_uses_the_tolerances_of_its_limits_can_be_cut():
    plan = fly_hover_fly(Scenario.paper(99.0001, slots=99))
    full = replace(plan, positions=plan.positions.round(6), powers=plan.powers * (1 + 0.9e-9))
    for point in range(99):
        tail = cut_tail(full, point)
        assert continue_plan(full, point, tail).identity == full.identity


def test_a_tail_of_another_team_is_refused(plan):
    tail = cut_tail(plan, 5)
    alone = tail.scenario.uavs[:1]
    with pytest.raises(OptionError, match='tail has 1 uavs; it must have 2'):
        continue_plan(plan, 5, replace(tail, scenario=replace(tail.scenario, uavs=alone),
                                       positions=tail.positions[:1], powers=tail.powers[:1]))


def test_a_plan_without_a_promised_slot_says_why_and_to_plan_again(plan):
    tail = cut_tail(replace(plan, promised_until=20.0), 50)
    assert 'until -30.0 s and slot 1 begins at 1.0 s; plan again or raise' in tail.promise.text
    for never in (replace(plan, promised_until=0.0), replace(plan, gaps=((0.0, 500.0),))):
        assert never.promise.text.endswith('ended before slot 1; plan again')


def test_the_text_of_a_promise_says_until_when_its_receivers_are_predicted(plan):
    assert replace(plan, promised_until=50.0).promise.text == (
        '50 of 102 slots promised, until 50.0 s')


def test_a_plan_whose_slots_are_all_promised_promises_its_rates_to_the_last_digit():
    nodes = tuple(GroundNode(place) for place in ((0.0, 0.0), (80.0, 0.0), (0.0, 90.0)))
    plan = fly_hover_fly(replace(Scenario.paper(102), ground_nodes=nodes))
    for seed in range(20):
        powers = plan.powers * np.random.default_rng(seed).uniform(0, 1, plan.powers.shape)
        drawn = replace(plan, powers=powers)
        for rate in ('guaranteed_rate', 'worst_case_rate', 'curve_rate', 'rate'):
            assert getattr(drawn.promise, rate) == getattr(drawn, rate)
        assert (drawn.promise.node_rates == drawn.node_rates).all()


def test_a_plan_without_a_promised_slot_has_no_mean_rate(plan, tmp_path):
    plan = replace(plan, promised_until=0.6)
    assert math.isnan(plan.promise.guaranteed_rate) and math.isnan(plan.promise.node_rates[0])
    assert plan.promise.text == ('no slot is promised: receivers are predicted until 0.6 s and '
                                 'slot 1 begins at 1.0 s; plan again or raise '
                                 'prediction_horizon')
    plan.save(tmp_path / 'plan.json')
    assert json.loads((tmp_path / 'plan.json').read_text())['worst_case_rate'] is None
    assert Plan.load(tmp_path / 'plan.json') == plan
