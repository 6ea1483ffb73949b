"""The status of the planner: what it tells, and how it comes over DDS."""

from dataclasses import fields, is_dataclass, replace
import math
import time
from types import SimpleNamespace
from typing import get_args, get_origin, get_type_hints

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from ros_client import values_of
from secure_uav_planner import fly_hover_fly, Iteration, Scenario
from secure_uav_planner.errors import LateError, OptionError
from secure_uav_planner.ros.planner.status import (
    level_and_text, plan_status, RequestOutcome, State, WarningLog)
from secure_uav_planner.ros.planner_status import list_keys, PlannerStatus, TrackStatus
from test_plan import gap_plan

PLAN = fly_hover_fly(Scenario.paper(120.0, slots=10))
NAMES = st.from_regex('[a-z][a-z0-9_]{0,9}(/(pose|odom))?', fullmatch=True)
# Six digits are sent.
NUMBERS = st.floats(allow_infinity=False).map(lambda number: float(f'{number:.6g}'))


def statuses_of(kind):
    """Return a strategy of the values of a type."""
    if is_dataclass(kind):
        # A group is as it is by default, or has begun: then each of its values is sent.
        hints = get_type_hints(kind)
        return st.one_of(st.builds(kind), st.builds(kind, **{
            entry.name: statuses_of(hints[entry.name]) for entry in fields(kind)}))
    if get_origin(kind) is dict:
        return st.dictionaries(NAMES, statuses_of(get_args(kind)[1]), max_size=3)
    options = [option for option in get_args(kind) or [kind] if option is not type(None)]
    values = {bytes: st.sampled_from([DiagnosticStatus.OK, DiagnosticStatus.ERROR]),
              str: st.text(st.characters(exclude_categories=['Cs'], min_codepoint=1)),
              int: st.integers(0, 10**6), float: NUMBERS}[options[0]]
    return values if len(get_args(kind)) == 0 else st.one_of(st.none(), values)


@given(statuses_of(PlannerStatus))
def test_what_is_read_is_the_status_that_was_sent(status):
    message = status.to_message('planner: plan')
    sent = deserialize_message(serialize_message(message), DiagnosticStatus)
    read = PlannerStatus.from_message(sent)
    assert repr(read.to_message('planner: plan')) == repr(message)
    if math.isfinite(status.plan.age):
        assert read.plan.age == status.plan.age
    assert (read.level, read.text, read.pose_age.keys(), read.relay, read.track.state) == (
        status.level, status.text, status.pose_age.keys(), status.relay, status.track.state)


def test_groups_that_have_not_begun_are_left_out_and_nan_is_none():
    assert values_of(PlannerStatus(state='idle', pose_age={'eve/pose': math.nan}).to_message(
        'planner: plan')) == {'state': 'idle', 'plans': '0', 'replans': '0', 'refusals': '0',
                              'pose_age.eve/pose': 'none'}
    track = values_of(PlannerStatus(track=TrackStatus('12345678', 3.0, 'flying')).to_message(''))
    assert track['track.time'] == '3' and track['track.rate'] == 'none'
    assert not any(key.startswith(('plan.', 'progress.')) for key in track)


def test_each_key_has_a_meaning_of_its_own():
    keys = [key for key, meaning in list_keys() if meaning]
    assert len(keys) == len(set(keys)) > 40
    assert {'plan.uav_distance', 'plan.zone_distance.beyond_margin', 'plan.energy.<uav>.flying',
            'track.distance.<uav>', 'outcome.code'} <= {*keys}


@pytest.mark.parametrize('values', [
    {'plans': 'many'}, {'track.time': ''}, {'track.time.x': '1'}, {'plan.age..': '1'}])
def test_what_is_no_status_is_refused_with_its_key_and_more_keys_are_not_used(values):
    with pytest.raises(OptionError, match=r'(plans|track.time|plan.age) of the status is '):
        PlannerStatus.from_message(DiagnosticStatus(
            values=[KeyValue(key=key, value=value) for key, value in values.items()]))
    more = DiagnosticStatus(values=[KeyValue(key='plan.new.value', value='5')])
    assert PlannerStatus.from_message(more) == PlannerStatus(more.level, plan=PlannerStatus().plan)


def test_a_problem_with_a_uav_is_in_the_status_during_a_solve():
    outcome, problems = RequestOutcome(DiagnosticStatus.OK, 'ok', 'a plan'), ['uav1 is 9 m off']
    failed = outcome._replace(level=DiagnosticStatus.ERROR, text='it failed')
    solving = 'solving: iteration 3, 1.5000 bit/s/Hz'
    progress = Iteration(3, 'joint', 1.5, 0.1, 0.1)
    for last, wrong, iteration, level, text in (
            (outcome, problems, progress, DiagnosticStatus.WARN, f'uav1 is 9 m off; {solving}'),
            (outcome, [], progress, DiagnosticStatus.OK, solving),
            (outcome, problems, None, DiagnosticStatus.WARN, 'uav1 is 9 m off; a plan'),
            (outcome, [], None, DiagnosticStatus.OK, 'a plan'),
            (failed, problems, None, DiagnosticStatus.ERROR, 'uav1 is 9 m off; it failed')):
        assert level_and_text(last, wrong, iteration) == (level, text)


def test_the_end_of_the_flight_clears_the_refusal_of_a_replan_only():
    state = State(plan=PLAN)
    for is_replan in (False, True):
        state.refuse(LateError('it comes too late'), is_replan)
        state.forget_replan()
        assert (state.outcome.code == 'ok') is is_replan


def test_a_refusal_of_a_replan_ends_when_it_is_due_no_more_and_a_short_replan_is_no_warning():
    state = State()
    for keep, status, level in (
            (state.keep_requested, 'converged', DiagnosticStatus.OK),
            (state.keep_requested, 'time_limit', DiagnosticStatus.WARN),
            (state.keep_replan, 'time_limit', DiagnosticStatus.OK),
            (state.keep_replan, 'numerical_trouble', DiagnosticStatus.WARN)):
        keep(replace(PLAN, status=status))
        assert state.outcome.level == level, status
    assert (state.plans, state.replans) == (2, 0)  # The replans changed nothing.
    assert state.keep_replan(replace(PLAN, start_ns=5)) and state.replans == 1


def test_a_plan_without_a_promised_slot_is_told_with_warn():
    first, _ = gap_plan()
    outcome = State(plan=replace(first, promised_until=-2.2)).outcome
    assert outcome.level == DiagnosticStatus.WARN
    assert 'guaranteed rate none, worst-case rate none bit/s/Hz; no slot is promised: receivers ' \
        'are predicted until -2.2 s and slot 1 begins at 10.0 s' in outcome.text
    assert plan_status(first, None, 0.0).promised_slots == 2


def test_a_warning_that_comes_and_goes_is_logged_once_in_five_seconds(monkeypatch):
    logged, clock = [], [100.0]
    monkeypatch.setattr(time, 'monotonic', lambda: clock[0])
    log = WarningLog(SimpleNamespace(warning=logged.append))
    for _ in range(120):  # 12 s, with a good message after each refused one.
        log.warn('uav1/pose', 'it is in another frame')
        clock[0] += 0.1
        log.clear('uav1/pose', 5.0)
    assert len(logged) == 3
    log.clear('uav1/pose')
    for number in range(9):
        log.warn('uav1/pose', f'it is {number} s old')
    assert len(logged) == 8
