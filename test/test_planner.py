"""The planner node over DDS, asked as another program would."""

import signal
import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_client import (
    Client, node_here, node_process, PATIENCE, places_of, refusal, seconds, values_of, wait_for)
from secure_uav_planner import Plan, Scenario, solve, upper_bound
from simulation import plan_of, received
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray


def test_a_plan_arrives_whole_on_every_topic_with_one_stamp_and_the_rates_that_are_told(
        client, planner):
    paths, powers = received(client)
    trajectories = [client.listen(MultiDOFJointTrajectory, f'{name}/trajectory')
                    for name in ('uav1', 'uav2')]
    markers = client.listen(MarkerArray, 'planner/markers')
    answer = client.plan_paper()
    wait_for(lambda: all(paths + powers + trajectories) and markers, what='the plan')
    plan = plan_of(Scenario.paper(120.0, slots=40), paths, powers, -1)
    assert f'guaranteed rate {plan.guaranteed_rate:.4f}, worst-case rate ' \
           f'{plan.worst_case_rate:.4f} bit/s/Hz' in answer.message
    assert plan.guaranteed_rate > 1.9
    stamp, = {seconds(message.header.stamp) for message in (
        *(got[-1] for got in paths + trajectories), *markers[-1].markers)}
    wait_for(lambda: 'plan.guaranteed_rate' in client.status)
    assert float(client.status['plan.guaranteed_rate']) == pytest.approx(
        plan.guaranteed_rate, rel=1e-5)
    assert float(client.status['plan.stamp']) == pytest.approx(stamp)
    assert client.statuses[-1].level == DiagnosticStatus.OK


def test_without_poses_the_answer_and_diagnostics_each_second_name_every_missing_topic(
        client, planner):
    answer = client.call('planner/plan')
    assert not answer.success
    assert 'no pose has come on ground_node/pose' in answer.message
    assert 'no pose has come on eavesdropper/pose' in answer.message
    assert 'uav1/pose' not in answer.message
    diagnostics = client.listen(DiagnosticArray, '/diagnostics', 10)

    def are_regular():
        times = [seconds(message.header.stamp) for message in diagnostics]
        # On a busy machine one comes late at times, and the next one sooner after it.
        return any(after - before == pytest.approx(2.0, abs=0.7)
                   for before, after in zip(times, times[2:]))
    wait_for(are_regular, what='three messages in about two seconds')
    status, = diagnostics[-1].status
    assert (status.name, status.level) == ('planner: plan', DiagnosticStatus.WARN)
    assert 'no pose has come on ground_node/pose' in status.message


def test_poses_of_both_reliabilities_are_received(client, planner):
    client.send_pose('ground_node/pose', 0, 0, qos=QoSProfile(
        depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    client.send_estimate('eavesdropper/pose', 200, 0)
    wait_for(lambda: client.call('planner/plan').success, what='a plan')


def test_while_solving_everything_else_answers_and_a_second_plan_is_refused(client):
    with node_process('planner', duration=120.0, slots=40, method='alternating',
                      pose_timeout=0.0, time_limit=0.0):
        path = client.listen(Path, 'uav1/path')
        client.plan_paper()
        wait_for(lambda: path and 'plan.stamp' in client.status)
        first = client.status['plan.stamp']
        client.set_parameters('planner', slots=2000, duration=400.0)
        client.call('planner/cancel')
        solving = client.ask('planner/plan')
        wait_for(lambda: 'progress.iteration' in client.status)
        for _ in range(5):
            assert client.get_parameters('planner', 'slots') == [2000]
        second = client.call('planner/plan')
        assert not second.success and second.message.startswith('a solve is under way')
        assert not solving.done()
        count = len(client.statuses)
        wait_for(lambda: len(client.statuses) > count + 1, what='more progress')
        assert client.call('planner/cancel').success
        wait_for(solving.done)
        assert not solving.result().success
        assert solving.result().message == 'cancelled; the last plan stands'
        wait_for(lambda: client.status['state'] == 'idle')
        assert client.status['plan.stamp'] == first and len(path) == 1
        again = client.call('planner/cancel')
        assert not again.success and again.message == 'no solve is under way'


def test_at_the_deadline_the_best_plan_so_far_is_published(client):
    with node_process('planner', duration=400.0, slots=3000, method='alternating',
                      time_limit=2.0):
        path = client.listen(Path, 'uav1/path')
        answer = client.plan_paper()
        assert 'stopped at time_limit with the best feasible plan so far' in answer.message
        wait_for(lambda: path)
        assert len(path[-1].poses) == 3002


def test_names_follow_the_namespace_and_the_lists_of_names():
    with Client('/fleet') as member, node_process(
            'planner', namespace='/fleet', uavs='[tx, left, right]', pose_timeout=1.0,
            eavesdroppers='[eve, mallory]', duration=120.0, slots=30):
        paths = [member.listen(Path, f'{name}/path') for name in ('tx', 'left', 'right')]
        markers = member.listen(MarkerArray, 'planner/markers')
        diagnostics = member.listen(DiagnosticArray, '/diagnostics', 10)
        member.send_pose('ground_node/pose', 0, 0)
        member.send_estimate('eve/pose', 200, 0)
        answer = member.call('planner/plan')
        assert not answer.success and 'mallory/pose' in answer.message
        member.send_estimate('mallory/pose', 150, 100)
        # A pose that is too old is a warning, and not the level of a node that has stopped.
        status = wait_for(lambda: next((status for message in diagnostics for status in (
            message.status) if 'pose_timeout' in status.message), None))
        assert (status.name, status.level) == ('fleet/planner: plan', DiagnosticStatus.WARN)
        assert member.set_parameters('planner', pose_timeout=0.0)[0].successful
        assert member.call('planner/plan').success
        wait_for(lambda: all(paths) and markers)
        assert {one.text for one in markers[-1].markers if one.ns == 'label'} == {
            'tx', 'left', 'right', 'eve', 'mallory', 'ground node'}


def test_misspelt_parameters_are_named_with_the_nearest(tmp_path):
    file = tmp_path / 'mission.yaml'
    file.write_text("""
/**:
  ros__parameters:
    use_sim_time: false
    durration: 150.0
    uav1: {max_sped: 12.0}
    qos_overrides: {/parameter_events: {publisher: {depth: 10}}}
/**/replay:
  ros__parameters: {loup: true}
""")
    expected = {'planner': {'durration': 'duration', 'uav1.max_sped': 'uav1.max_speed'},
                'replay': {'loup': 'loop', 'durration': None, 'uav1.max_sped': None}}
    for node, nearest in expected.items():
        with node_process(node, '--params-file', str(file)) as process:
            wait_for(lambda: any('ready' in line for line in process.lines))
            warnings = [line for line in process.lines if 'there is no parameter' in line]
        assert len(warnings) == len(nearest), warnings
        for name, near in nearest.items():
            line = next(line for line in warnings if f'no parameter {name}, ' in line)
            assert '[WARN]' in line
            assert near is None or line.endswith(f'did you mean {near}?\n')


@pytest.mark.parametrize('parameter, part', [
    ({'slots': 'many'}, 'slots'), ({'uavs': '[a, a]'}, 'uavs'),
    ({'uav2.peak_power': 0.1}, 'uav2.peak_power')])
def test_a_wrong_parameter_at_start_ends_the_node_with_one_line(capfd, parameter, part):
    assert part in refusal(capfd, 'planner', **parameter)


def test_the_same_request_again_starts_from_the_last_plan(client, planner):
    client.plan_paper()
    wait_for(lambda: 'plan.iterations' in client.status)
    cold = client.status
    assert client.call('planner/plan').success
    wait_for(lambda: client.status['plan.stamp'] != cold['plan.stamp'])
    assert int(client.status['plan.iterations']) < int(cold['plan.iterations'])


def test_a_limit_of_acceleration_is_kept_by_the_plan_and_what_contradicts_it_is_refused(client):
    with node_here('planner', duration=120.0, slots=60, uav1__max_acceleration=2.0,
                   uav2__max_acceleration=2.0):
        path = client.listen(Path, 'uav1/path')
        client.plan_paper()
        wait_for(lambda: path)
        points = places_of(path[-1])
        # At rest at both ends, so that the points before and behind are the ends.
        points = np.concatenate([points[:1], points, points[-1:]])
        accelerations = np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1) / 2.0**2
        assert 1.5 < accelerations.max() <= 2.0 + 1e-5
        result, = client.set_parameters('planner', uav1__start_velocity=[20.0, 0.0])
        assert not result.successful and 'start_velocity' in result.reason
        assert not client.set_parameters('planner', uav1__goal_velocity=[3.0])[0].successful
        for limit, reason in (
                (0.0, 'all uavs have a max_acceleration or none: uav1 has none, uav2 has 2 m/s^2'),
                (0.1, 'uav1 needs at least')):
            assert client.set_parameters('planner', uav1__max_acceleration=limit)[0].successful
            answer = client.call('planner/plan')
            assert not answer.success and reason in answer.message


def test_the_bound_follows_the_plan_and_is_part_of_the_status_and_the_file(client, tmp_path):
    file = tmp_path / 'plan.json'
    with node_here('planner', duration=104.0, slots=12, bound='after', pose_timeout=0.0,
                   plan_file=str(file)):
        client.send_paper()
        answer = client.call('planner/plan')
        assert answer.success and 'below the best possible' not in answer.message
        wait_for(lambda: 'plan.bound' in client.status, what='the bound')
        values = client.status
        assert float(values['plan.bound']) >= float(values['plan.worst_case_rate'])
        assert values['plan.claim'] in client.statuses[-1].message
        assert 'below the best possible' in values['plan.claim']
        wait_for(lambda: Plan.load(file).bound is not None, what='the bound in the file')
        # The next plan has none at first, and then its own.
        first = values['plan.stamp']
        assert client.call('planner/plan').success
        wait_for(lambda: client.status['plan.stamp'] != first and 'plan.bound' in client.status,
                 what='the next bound')
        assert any(values.get('plan.stamp', first) != first and 'plan.bound' not in values
                   for values in map(values_of, client.statuses))


def test_a_request_stops_the_bound_of_the_last_plan_before_it_is_solved(client, monkeypatch):
    under_way, ended, solved = threading.Event(), [], []

    def held(scenario, on_progress, **options):
        """Go on until it is stopped, however fast this machine is."""
        def told(progress):
            under_way.set()
            return wait_for(lambda: on_progress(progress))
        bound = upper_bound(scenario, on_progress=told, **options)
        ended.append(bound.status)
        return bound

    def watched(scenario, **options):
        if under_way.is_set():
            wait_for(lambda: ended, what='the end of the bound')
        solved.append(list(ended))
        return solve(scenario, **options)

    for name, function in (('upper_bound', held), ('solve', watched)):
        monkeypatch.setattr(f'secure_uav_planner.ros.solver.{name}', function)
    with node_here('planner', bound='after', pose_timeout=0.0, duration=104.0, slots=52):
        client.plan_paper()
        wait_for(under_way.is_set, what='the bound to be under way')
        assert client.call('planner/plan').success
    assert solved == [[], ['cancelled']]


def test_a_request_is_answered_and_the_node_ends_while_a_bound_is_under_way(client):
    with node_process('planner', bound='after', pose_timeout=0.0) as process:
        client.plan_paper()
        assert client.call('planner/plan').success
        wait_for(lambda: client.status.get('plans') == '2')
        assert client.call('planner/cancel').message == 'no solve is under way'
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
