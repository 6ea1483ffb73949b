"""The planner node over DDS, asked as another program would."""

from dataclasses import replace
import math
import signal
import threading
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_client import (
    Client, node_here, node_process, PATIENCE, places_of, pose_message, refusal, seconds,
    values_of, wait_for)
from secure_uav_planner import Eavesdropper, Plan, Scenario, solve, upper_bound
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray


def test_a_plan_arrives_whole_on_every_topic_with_one_stamp(client, planner):
    kinds = {'path': Path, 'power': Float64MultiArray, 'trajectory': MultiDOFJointTrajectory}
    got = {(uav, topic): client.listen(kind, f'{uav}/{topic}')
           for uav in ('uav1', 'uav2') for topic, kind in kinds.items()}
    markers, status = client.listen(MarkerArray, 'planner/markers'), client.listen(
        DiagnosticStatus, 'planner/status')
    answer = client.plan_paper()
    wait_for(lambda: all(got.values()) and markers, what='the plan')

    names = ['uav1', 'uav2']
    paths = [got[name, 'path'][-1] for name in names]
    plan = Plan(Scenario.paper(120.0, slots=40),
                [places_of(path) for path in paths],
                [got[name, 'power'][-1].data for name in names])
    # The rates that the node reports are those of the plan that arrived.
    assert f'guaranteed rate {plan.guaranteed_rate:.4f}, worst-case rate ' \
           f'{plan.worst_case_rate:.4f} bit/s/Hz' in answer.message
    assert plan.guaranteed_rate > 1.9
    stamps = {seconds(message.header.stamp) for message in paths + [
        got[name, 'trajectory'][-1] for name in names] + markers[-1].markers}
    assert len(stamps) == 1
    start = stamps.pop()
    for name, path, altitude in zip(names, paths, (100.0, 110.0)):
        assert path.header.frame_id == 'map'
        assert {at.pose.position.z for at in path.poses} == {altitude}
        assert [seconds(at.header.stamp) - start for at in path.poses] == pytest.approx(
            plan.times, abs=1e-6)
        layout = got[name, 'power'][-1].layout
        assert [(d.label, d.size, d.stride) for d in layout.dim[:1]] == [('slot', 40, 40)]
        trajectory = got[name, 'trajectory'][-1]
        assert trajectory.joint_names == [name]
        assert [seconds(point.time_from_start) for point in trajectory.points] == pytest.approx(
            plan.times)
        moves = np.diff([(point.transforms[0].translation.x, point.transforms[0].translation.y)
                         for point in trajectory.points], axis=0) / 3.0
        assert np.array([(point.velocities[0].linear.x, point.velocities[0].linear.y)
                         for point in trajectory.points[:-1]]) == pytest.approx(moves)
    wait_for(lambda: status and 'plan.guaranteed_rate' in values_of(status[-1]))
    values = values_of(status[-1])
    assert float(values['plan.guaranteed_rate']) == pytest.approx(plan.guaranteed_rate, rel=1e-5)
    assert float(values['plan.stamp']) == pytest.approx(start)
    assert status[-1].level == DiagnosticStatus.OK


def test_without_poses_every_missing_topic_is_named(client, planner):
    answer = client.call('planner/plan')
    assert not answer.success
    assert 'no pose has come on ground_node/pose' in answer.message
    assert 'no pose has come on eavesdropper/pose' in answer.message
    assert 'uav1/pose' not in answer.message


def test_poses_of_both_reliabilities_are_received(client, planner):
    client.send_pose('ground_node/pose', 0, 0, qos=QoSProfile(
        depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    client.send_estimate('eavesdropper/pose', 200, 0)
    wait_for(lambda: client.call('planner/plan').success, what='a plan')


def test_a_pose_in_another_frame_is_not_used_and_both_frames_are_named(client, planner):
    assert client.set_parameters('planner', pose_timeout=0.0)[0].successful
    client.send_paper()
    client.send_pose('ground_node/pose', 5, 5, frame_id='odom', until_known=False)
    client.send_pose('ground_node/pose', 6, 6, frame_id='odom', until_known=False)
    client.send_estimate('eavesdropper/pose', 200, 0)
    wait_for(lambda: any("'odom'" in line for line in planner.lines), what='the warning')
    assert client.call('planner/plan').success  # the last valid pose is kept
    assert sum("'odom'" in line for line in planner.lines) == 1
    assert client.set_parameters('planner', frame_id='odom')[0].successful
    answer = client.call('planner/plan')
    assert not answer.success
    assert "'map'" in answer.message and "'odom'" in answer.message


def bad_estimates():
    for change in (lambda m: setattr(m.pose.pose.position, 'x', math.nan),
                   lambda m: setattr(m.pose.pose.orientation, 'w', -math.inf),
                   lambda m: m.pose.covariance.__setitem__(0, -1.0),
                   lambda m: m.pose.covariance.__setitem__(1, 1.0),
                   lambda m: m.pose.covariance.__setitem__(7, math.nan)):
        message = pose_message(PoseWithCovarianceStamped, 77, 0)
        change(message)
        yield message


def test_nan_infinity_and_impossible_covariances_leave_the_last_valid_pose(client, planner):
    client.plan_paper()
    publisher = client.publisher(PoseWithCovarianceStamped, 'eavesdropper/pose')
    for message in bad_estimates():
        before = len(planner.lines)

        def warned():
            publisher.publish(message)  # again, if a good one has taken its place
            return any('eavesdropper/pose' in line and 'not used' in line
                       for line in planner.lines[before:])
        wait_for(warned, what='the warning')
        client.send_estimate('eavesdropper/pose', 200, 0)
    markers = client.listen(MarkerArray, 'planner/markers')
    assert client.call('planner/plan').success
    wait_for(lambda: markers)
    disc = next(m for m in markers[-1].markers if m.ns == 'eavesdropper')
    assert disc.pose.position.x == 200.0


def test_the_error_radius_is_that_of_the_covariance_at_the_confidence(client, planner):
    markers = client.listen(MarkerArray, 'planner/markers')
    client.send_pose('ground_node/pose', 0, 0)
    client.send_estimate('eavesdropper/pose', 200, 0, variance=16.0)
    assert client.call('planner/plan').success
    wait_for(lambda: markers)
    disc = next(m for m in markers[-1].markers if m.ns == 'eavesdropper')
    # 4 m of standard deviation; 95% of a round normal error is within sqrt(-2 ln 0.05) of it.
    assert disc.scale.x / 2 == pytest.approx(4.0 * math.sqrt(-2 * math.log(0.05)))


def test_while_solving_everything_else_answers_and_a_second_plan_is_refused(client):
    with node_process('planner', duration=120.0, slots=40, method='alternating',
                      pose_timeout=0.0, time_limit=0.0):
        path = client.listen(Path, 'uav1/path')
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.plan_paper()
        wait_for(lambda: path and status and 'plan.stamp' in values_of(status[-1]))
        first = values_of(status[-1])['plan.stamp']
        client.set_parameters('planner', slots=2000, duration=400.0)
        client.call('planner/cancel')
        solving = client.ask('planner/plan')
        wait_for(lambda: 'progress.iteration' in values_of(status[-1]))
        for _ in range(5):
            assert client.get_parameters('planner', 'slots') == [2000]
        second = client.call('planner/plan')
        assert not second.success and second.message.startswith('a solve is under way')
        assert not solving.done()
        received = len(status)
        wait_for(lambda: len(status) > received + 1, what='more progress')
        assert client.call('planner/cancel').success
        wait_for(solving.done)
        assert not solving.result().success
        assert solving.result().message == 'cancelled; the last plan stands'
        wait_for(lambda: values_of(status[-1])['state'] == 'idle')
        assert values_of(status[-1])['plan.stamp'] == first and len(path) == 1
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


def test_names_follow_the_namespace_and_the_lists_of_names(client):
    with node_process('planner', namespace='/fleet', uavs='[tx, left, right]',
                      eavesdroppers='[eve, mallory]', duration=120.0, slots=30):
        with Client(namespace='/fleet') as member:
            paths = [member.listen(Path, f'{name}/path') for name in ('tx', 'left', 'right')]
            markers = member.listen(MarkerArray, 'planner/markers')
            member.send_pose('ground_node/pose', 0, 0)
            member.send_estimate('eve/pose', 200, 0)
            answer = member.call('planner/plan')
            assert not answer.success and 'mallory/pose' in answer.message
            member.send_estimate('mallory/pose', 150, 100)
            wait_for(lambda: member.call('planner/plan').success)
            wait_for(lambda: all(paths) and markers)
            assert {one.text for one in markers[-1].markers if one.ns == 'label'} == {
                'tx', 'left', 'right', 'eve', 'mallory', 'ground node'}


def test_a_pose_that_is_too_old_is_a_warning_and_not_the_level_of_a_node_that_has_stopped(client):
    with node_process('planner', namespace='/fleet', pose_timeout=0.5):
        with Client(namespace='/fleet') as member:
            received = member.listen(DiagnosticArray, '/diagnostics', 10)
            member.send_paper(stamp=Time(sec=int(time.time()) - 60))
            wait_for(lambda: received and 'pose_timeout' in received[-1].status[0].message)
            assert received[-1].status[0].level == DiagnosticStatus.WARN
            assert received[-1].status[0].name == 'fleet/planner: plan'


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


def test_diagnostics_come_about_every_second(client, planner):
    received = client.listen(DiagnosticArray, '/diagnostics', 10)

    def regular():
        times = [seconds(message.header.stamp) for message in received]
        # On a busy machine one comes late at times, and the next one sooner after it.
        return any(after - before == pytest.approx(2.0, abs=0.7)
                   for before, after in zip(times, times[2:]))
    wait_for(regular, what='three messages in about two seconds')
    assert received[-1].status[0].name == 'planner: plan'
    assert received[-1].status[0].level == DiagnosticStatus.WARN
    assert 'no pose has come on ground_node/pose' in received[-1].status[0].message


WRONG = {
    'duration': [-5.0, math.nan, 'long'], 'slots': [1.5, 10**6], 'method': ['magic'],
    'confidence': [1.0], 'uav1.peak_power': [0.5], 'uav2.goal': [[1.0], [math.inf, 0.0]],
    'uavs': [['a']], 'frame_id': [7], 'time_limit': [True]}


def test_a_wrong_parameter_later_is_refused_with_its_reason(client, planner):
    for name, values in WRONG.items():
        before = client.get_parameters('planner', name)
        for value in values:
            result = client.set_parameters('planner', **{name.replace('.', '__'): value})[0]
            assert not result.successful
            assert name in result.reason
        assert client.get_parameters('planner', name) == before


@pytest.mark.parametrize('parameter, part', [
    ({'slots': 'many'}, 'slots'), ({'uavs': '[a, a]'}, 'uavs'),
    ({'uav2.peak_power': 0.1}, 'uav2.peak_power'), ({'uav1.start': '[1.0, .inf]'}, 'uav1.start')])
def test_a_wrong_parameter_at_start_ends_the_node_with_one_line(capfd, parameter, part):
    assert part in refusal(capfd, 'planner', **parameter)


def test_the_same_request_again_starts_from_the_last_plan(client, planner):
    status = client.listen(DiagnosticStatus, 'planner/status')
    client.plan_paper()
    wait_for(lambda: status and 'plan.iterations' in values_of(status[-1]))
    cold = values_of(status[-1])
    assert client.call('planner/plan').success
    wait_for(lambda: values_of(status[-1])['plan.stamp'] != cold['plan.stamp'])
    assert int(values_of(status[-1])['plan.iterations']) < int(cold['plan.iterations'])


def test_the_defaults_are_the_papers_scenario(client):
    with node_here('planner'):
        paper = Scenario.paper()
        read = client.get_parameters(
            'planner', 'duration', 'slots', 'reference_snr_db', 'uav2.altitude', 'uav1.start',
            'eavesdropper.error_radius')
        assert [list(v) if not np.isscalar(v) else v for v in read] == [
            paper.duration, paper.slots, 80.0, 110.0, [100.0, 500.0], 10.0]
        assert replace(paper, eavesdroppers=(Eavesdropper((200.0, 0.0), 10.0),)) == paper


def test_a_limit_of_acceleration_is_a_parameter_and_kept_by_the_plan(client):
    with node_here('planner', duration=120.0, slots=60, uav1__max_acceleration=2.0,
                   uav2__max_acceleration=2.0):
        path = client.listen(Path, 'uav1/path')
        client.plan_paper()
        wait_for(lambda: path)
        points = places_of(path[-1])
        # At rest at both ends, so that the points before and behind are the ends.
        points = np.concatenate([points[:1], points, points[-1:]])
        found = np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1) / 2.0**2
        assert 1.5 < found.max() <= 2.0 + 1e-5
        results = client.set_parameters('planner', uav1__start_velocity=[20.0, 0.0])
        assert not results[0].successful and 'start_velocity' in results[0].reason
        assert client.set_parameters('planner', uav1__max_acceleration=0.0)[0].successful
        refused = client.call('planner/plan')
        assert not refused.success and refused.message.startswith(
            'all uavs have a max_acceleration or none: uav1 has none, uav2 has 2 m/s^2')
        assert client.set_parameters('planner', uav1__goal_velocity=[3.0])[0].successful is False
        client.set_parameters('planner', uav1__max_acceleration=0.1)
        refused = client.call('planner/plan')
        assert not refused.success and 'uav1 needs at least' in refused.message
        assert '0.1 m/s^2' in refused.message


def test_the_bound_follows_the_plan_and_is_part_of_the_status_and_the_file(client, tmp_path):
    file = tmp_path / 'plan.json'
    with node_here('planner', duration=104.0, slots=12, bound='after', pose_timeout=0.0,
                   plan_file=str(file)):
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.send_paper()
        answer = client.call('planner/plan')
        assert answer.success and 'below the best possible' not in answer.message
        wait_for(lambda: status and 'plan.bound' in values_of(status[-1]), what='the bound')
        values = values_of(status[-1])
        assert float(values['plan.bound']) >= float(values['plan.worst_case_rate'])
        assert values['plan.claim'] in status[-1].message
        assert 'below the best possible' in values['plan.claim']
        wait_for(lambda: Plan.load(file).bound is not None, what='the bound in the file')
        # The next plan has none at first, and then its own.
        first = values['plan.stamp']
        assert client.call('planner/plan').success
        wait_for(lambda: values_of(status[-1])['plan.stamp'] != first
                 and 'plan.bound' in values_of(status[-1]), what='the next bound')
        news = [values_of(one) for one in status]
        assert any(one.get('plan.stamp', first) != first and 'plan.bound' not in one
                   for one in news)


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
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.plan_paper()
        assert client.call('planner/plan').success
        wait_for(lambda: status and values_of(status[-1]).get('plans') == '2')
        assert client.call('planner/cancel').message == 'no solve is under way'
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
