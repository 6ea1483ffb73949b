"""The planner's plan_file: the last plan is restored, and a wrong file is one warning."""

from dataclasses import replace
import json
from threading import Event
import time

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
import pytest
from ros_nodes import has_said, node_here, node_process, wait_for, wait_for_line
from secure_uav_planner import Eavesdropper, fly_hover_fly, Plan, Scenario
from secure_uav_planner.ros.messages import plan_time
from secure_uav_planner.ros.planner.solver import SolverThread
from sensor_msgs.msg import TimeReference

PLAN = replace(fly_hover_fly(Scenario.paper(104, slots=8)), start_ns=10**18)


@pytest.fixture
def file(tmp_path):
    return tmp_path / 'plan.json'


@pytest.mark.parametrize('change', [
    {'status': 'cancelled'}, {'status': 'given'}, {'method': 'x' * 10**5}],
    ids=['cancelled', 'given', 'long name'])
def test_a_valid_plan_is_restored_whatever_its_status_and_method(client, file, change):
    replace(PLAN, **change).save(file)
    with node_here('planner', plan_file=file) as process:
        paths = client.listen(Path, 'uav2/path')
        wait_for(lambda: paths and client.statuses, what='the restored plan')
        assert client.status.plan.status == change.get('status', PLAN.status)
        wait_for_line(process, 'ready')
        assert not has_said(process, 'plan_file')
        assert max(map(len, process.lines)) < 1000 and (
            len(client.statuses[-1].text) < 1000)


def test_a_plan_is_restored_in_its_own_frame_only(client, file):
    with node_here('planner', plan_file=file, frame_id='odom', duration=120.0, slots=20):
        client.send_paper(frame_id='odom')
        assert client.call('planner/plan').success
        assert not client.set_parameters('planner', frame_id='map')[0].successful
        wait_for(file.exists)
    assert Plan.load(file).scenario.slots == 20
    for frame_id, line in (('odom', 'restored: '), (
            'map', "is in frame 'odom' and the parameter frame_id is 'map'; it is not published")):
        with node_here('planner', plan_file=file, frame_id=frame_id) as process:
            wait_for_line(process, line)


@pytest.mark.parametrize('delay, slots', [(0.0, 0), (1000.0, 8)])
def test_a_restored_plan_that_begins_too_late_to_be_of_this_clock_promises_nothing(
        client, file, delay, slots):
    """The clock was set back meanwhile, and its moving receivers were predicted before."""
    eavesdropper = Eavesdropper(track=((0.0, 200.0, 0.0, 10.0), (200.0, 250.0, 0.0, 10.0)))
    scenario = replace(PLAN.scenario, eavesdroppers=(eavesdropper,))
    replace(PLAN, scenario=scenario, promised_until=200.0,
            start_ns=time.time_ns() + 900 * 10**9).save(file)
    checks = client.listen(DiagnosticArray, '/diagnostics', 10)  # There are ten checks a second.
    with node_here('planner', plan_file=file, start_delay=delay):
        wait_for(lambda: checks and client.status.plan.identity
                 and client.status.plan.promised_slots == slots)


def test_an_eavesdropper_that_moved_meanwhile_has_left_the_disc_of_the_restored_plan(client, file):
    PLAN.save(file)
    with node_here('planner', plan_file=file):
        wait_for(lambda: client.send_estimate('eavesdropper/pose', 20, 0, until_known=False)
                 or 'eavesdropper has left its disc: it is 180 m from' in client.status.text)


def test_a_request_just_after_a_restart_in_flight_waits_for_the_follower(client, file):
    scenario = Scenario.paper(400.0, slots=40)
    plan = replace(fly_hover_fly(scenario), start_ns=time.time_ns() - 60 * 10**9)
    plan.save(file)
    with node_here('planner', plan_file=file, duration=400.0, slots=40, start_delay=10.0):
        client.send_paper()
        answer = client.ask('planner/plan')
        reports = client.publisher(TimeReference, 'plan_time')

        def is_answered():
            now = client.node.get_clock().now()
            time_of_plan = (now.nanoseconds - plan.start_ns) * 1e-9
            reports.publish(plan_time(plan, time_of_plan, now.to_msg()))
            return answer.done()
        wait_for(is_answered)
    assert answer.result().success
    assert f'goes on from plan {plan.identity}, which is flying' in answer.result().message


def test_a_request_that_waits_for_the_follower_can_be_cancelled(client, file, monkeypatch):
    """Before, the planner knew of no solve, and planned later."""
    monkeypatch.setattr('secure_uav_planner.ros.planner.node._DISCOVERY', 1e6)
    PLAN.save(file)
    with node_here('planner', plan_file=file):
        answer = client.ask('planner/plan')
        wait_for(lambda: client.call('planner/cancel').success, what='a request')
        wait_for(answer.done)
        assert not answer.result().success
        assert answer.result().message == 'cancelled; the last plan stands'
        wait_for(lambda: client.status.outcome.code == 'cancelled')
        assert client.call('planner/cancel').message == 'no solve is under way'


def set_field(field, value):
    """Return a function that sets a field in the text of a file."""
    return lambda text: json.dumps({**json.loads(text), field: value})


@pytest.mark.parametrize('change, other', [
    (lambda text: text.replace('"uav2"', '"other"'), None),
    (lambda text: text.replace('"eavesdropper"', '"other"'), None),
    (set_field('start_ns', 10**30), None), (set_field('start_ns', None), None),
    (set_field('positions', 'x' * 10**5), None), (str, '/dev/zero'), (str, 'x' * 5000)],
    ids=['foreign', 'other eavesdropper', 'too late', 'none', 'text', 'device', 'long name'])
def test_a_plan_that_cannot_be_restored_is_one_short_warning_and_is_replaced(
        client, file, change, other):
    """A file that is no regular file stays as it is."""
    PLAN.save(file)
    file.write_text(change(file.read_text()))
    paths = client.listen(Path, 'uav1/path')
    with node_here('planner', plan_file=other or file, duration=120.0, slots=20) as process:
        warnings = [line for line in process.lines if 'plan_file' in line]
        assert len(warnings) == 1 and '[WARN]' in warnings[0], process.lines
        client.plan_paper()
        wait_for(lambda: paths)
        assert [len(path.poses) for path in paths] == [22]
    assert max(map(len, process.lines)) < 1000
    assert not has_said(process, 'Traceback')
    assert other or Plan.load(file).scenario.slots == 20


def test_a_file_is_saved_while_a_solve_goes_on():
    solver, may_end, saved = SolverThread(lambda work: work(), lambda: None), Event(), Event()
    solver.start(lambda job: may_end.wait(60.0), lambda result: None)
    solver.save(saved.set)
    assert saved.wait(10.0) and solver.is_solving
    may_end.set()
    assert solver.close(10.0)


def test_a_plan_file_belongs_to_one_planner_at_a_time(client, file):
    PLAN.save(file)
    content = file.read_bytes()
    with node_process('planner', namespace='/first', plan_file=file) as first:
        wait_for_line(first, 'restored: ')
        with node_here('planner', plan_file=file, duration=120.0, slots=20) as second:
            wait_for_line(second, f'plan_file: another planner keeps its plan in {file}; this')
            client.plan_paper()
            assert not has_said(second, 'restored')
            assert file.read_bytes() == content
        first.kill()
        first.wait()
    with node_here('planner', plan_file=file) as again:
        wait_for_line(again, 'restored: ')
