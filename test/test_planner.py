"""The planner node over DDS: requests, refusals, its solver, its bound, and its names."""

from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle
import random
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Path
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_client import Client, seconds
from ros_nodes import has_said, node_here, node_process, wait_for
from secure_uav_planner import fly_hover_fly, Iteration, Plan, Scenario, solve, upper_bound
from secure_uav_planner.errors import OptionError
from secure_uav_planner.ros.planner_status import PlannerStatus
from simulation import DEEP, plan_of, received
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

# Beside every path of the paper's mission.
TOWER = [900.0, 0.0, 950.0, 0.0, 950.0, 50.0]
FENCE = [-900.0, -900.0, 990.0, -900.0, 990.0, 900.0, -900.0, 900.0]


@pytest.fixture(scope='module')
def shared():
    """Return a client of a planner with poses, a zone and a fence, for tests that only ask it."""
    with Client('/shared') as client, node_here(
            'planner', namespace='/shared', duration=120.0, slots=20, pose_timeout=0.0,
            separation=8.0, no_fly_zones='[tower]', tower__vertices=TOWER,
            geofence=FENCE) as client.process:
        client.send_paper()
        yield client


@contextmanager
def changed(client, **values):
    """Set parameters of the planner for a while."""
    before = dict(zip(values, client.get_parameters('planner', *values), strict=True))
    assert all(result.successful for result in client.set_parameters('planner', **values))
    yield
    client.set_parameters('planner', **before)


@pytest.fixture
def set_solver(monkeypatch):
    """Return a function that sets what the planners of this process solve with."""
    return lambda function: monkeypatch.setattr(
        'secure_uav_planner.ros.planner.solver.solve', function)


def fly_baseline(scenario, status='converged', **options):
    return replace(fly_hover_fly(scenario), status=status)


def test_what_is_missing_is_named_and_then_a_plan_comes_whole_with_the_rates_that_are_told(
        client, planner):
    paths, powers = received(client)
    trajectories = [client.listen(MultiDOFJointTrajectory, f'{name}/trajectory')
                    for name in ('uav1', 'uav2')]
    markers = client.listen(MarkerArray, 'planner/markers')
    diagnostics = client.listen(DiagnosticArray, '/diagnostics', 10)
    answer = client.call('planner/plan')
    assert not answer.success and 'uav1/pose' not in answer.message
    assert 'no pose has come on ground_node/pose' in answer.message
    assert 'no pose has come on eavesdropper/pose' in answer.message
    wait_for(lambda: client.status.outcome.code == 'pose_missing')

    def are_regular():
        times = [seconds(message.header.stamp) for message in diagnostics]
        # On a busy machine one comes late at times, and the next one sooner after it.
        return any(after - before == pytest.approx(2.0, abs=0.7)
                   for before, after in zip(times, times[2:]))
    wait_for(are_regular, what='three messages in about two seconds')
    status, = diagnostics[-1].status
    assert (status.name, status.level) == ('planner: plan', DiagnosticStatus.WARN)
    assert 'no pose has come on ground_node/pose' in status.message

    # Publishers of both reliabilities match.
    client.send_pose('ground_node/pose', 0, 0, qos=QoSProfile(
        depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    client.send_estimate('eavesdropper/pose', 200, 0)
    answer = client.call('planner/plan')
    assert answer.success
    wait_for(lambda: all(paths + powers + trajectories) and markers, what='the plan')
    plan = plan_of(Scenario.paper(120.0, slots=40), paths, powers, -1)
    assert f'guaranteed rate {plan.guaranteed_rate:.4f}, worst-case rate ' \
           f'{plan.worst_case_rate:.4f} bit/s/Hz' in answer.message
    assert plan.guaranteed_rate > 1.9
    stamp, = {seconds(message.header.stamp) for message in (
        *(got[-1] for got in paths + trajectories), *markers[-1].markers)}
    cold = wait_for(lambda: client.status.plan.identity and client.status.plan)
    assert cold.guaranteed_rate == pytest.approx(plan.guaranteed_rate, rel=1e-5)
    assert cold.stamp == pytest.approx(stamp)
    assert client.statuses[-1].level == DiagnosticStatus.OK

    # The same request again starts from the last plan.
    assert client.call('planner/plan').success
    wait_for(lambda: client.status.plan.stamp != cold.stamp)
    assert client.status.plan.iterations < cold.iterations


def test_the_latched_status_tells_of_poses_that_get_old_also_without_a_flight(client):
    """Before, only /diagnostics did, until the next request."""
    with node_here('planner', duration=120.0, slots=20, pose_timeout=6.0):
        client.send_paper(stamp=client.now())
        wait_for(lambda: 'pose_timeout is 6 s' in client.statuses[-1].text, what='old poses')
        client.send_paper()
        wait_for(lambda: client.statuses[-1].level == DiagnosticStatus.OK, what='fresh poses')


def test_teams_in_two_namespaces_plan_at_once_each_its_own_mission_with_its_own_names():
    teams = {'/north': ('uav1', 'uav2'), '/south': ('tx', 'left', 'right')}
    slots = {'/north': 20, '/south': 30}

    def planner(team, **parameters):
        return node_process('planner', namespace=team, duration=120.0, slots=slots[team],
                            pose_timeout=0.0, **parameters)

    with Client('/north') as north, Client('/south') as south, planner('/north'), planner(
            '/south', uavs='[tx, left, right]', eavesdroppers='[eve, mallory]'):
        clients = {'/north': north, '/south': south}
        diagnostics = north.listen(DiagnosticArray, '/diagnostics', 10)
        markers = south.listen(MarkerArray, 'planner/markers')
        paths = {team: [clients[team].listen(Path, f'{name}/path') for name in names]
                 for team, names in teams.items()}
        north.send_paper()
        # What one team has heard, the other has not.
        south.send_estimate('eve/pose', 200, 0)
        answer = south.call('planner/plan')
        assert not answer.success and 'no pose has come on ground_node/pose' in answer.message
        assert 'no pose has come on mallory/pose' in answer.message
        south.send_pose('ground_node/pose', 0, 0)
        south.send_estimate('mallory/pose', 150, 100)
        futures = {team: client.ask('planner/plan') for team, client in clients.items()}
        for team, future in futures.items():
            wait_for(future.done, what=f'the answer of {team}')
            assert future.result().success, future.result().message
            assert f'plan of {slots[team]} slots' in future.result().message
            wait_for(lambda expected=paths[team]: all(expected), what=f'the paths of {team}')
            assert {len(path[-1].poses) for path in paths[team]} == {slots[team] + 2}
        wait_for(lambda: markers)
        assert {marker.text for marker in markers[-1].markers if marker.ns == 'label'} == {
            'tx', 'left', 'right', 'eve', 'mallory', 'ground node'}
        # A second plan of one team is none of the other.
        assert north.call('planner/plan').success

        def plans(team):
            return [PlannerStatus.from_message(status).plans for message in list(diagnostics)
                    for status in message.status if status.name == f'{team[1:]}/planner: plan']
        wait_for(lambda: [max(plans(team), default=0) for team in teams] == [2, 1])


# Refusals, and how close UAVs come


@pytest.mark.parametrize('change, code, text', [
    ({'duration': 20.0}, 'infeasible', 'uav1 needs at least'),
    ({'pose_timeout': 1e-3}, 'pose_stale', 'pose_timeout is 0.001 s'),
    ({'start_delay': 1e-3}, 'late', 'a longer start_delay gives it more time'),
    ({'height_tolerance': 0.0}, 'ok', 'joint plan of 20 slots')])
def test_the_code_of_an_outcome_is_that_of_its_error(shared, change, code, text):
    with changed(shared, **change):
        # Again, if a pose has come just before.
        wait_for(lambda: text in shared.call('planner/plan').message
                 and shared.status.outcome.code == code, what=code)


def test_a_plan_shows_zone_and_fence_and_tells_how_close_it_comes(shared):
    markers = shared.listen(MarkerArray, 'planner/markers')
    answer = shared.call('planner/plan')
    assert 'uav1 and uav2 come within 10.0 m of each other' in answer.message
    assert ' m of tower' in answer.message and '; along the curve ' in answer.message
    plan = wait_for(lambda: markers and shared.status.plan.zone_distance.between
                    and shared.status.plan)
    names = {marker.ns for marker in markers[-1].markers}
    assert {'no_fly_zone', 'no_fly_zone_edges', 'geofence'} <= names
    assert plan.uav_distance.distance == pytest.approx(10.0, abs=1e-3)
    assert plan.uav_distance.between == 'uav1, uav2'
    assert plan.zone_distance.between.endswith(', tower')
    assert plan.zone_distance.distance > 500
    assert plan.curve_rate == pytest.approx(plan.guaranteed_rate, abs=0.05)
    wait_for(lambda: shared.statuses[-1].level == DiagnosticStatus.OK)
    with changed(shared, **{'uav2.altitude': 101.0, 'separation': 0.0}):
        answer = shared.call('planner/plan')
        assert 'come within 1.0 m of each other at ' in answer.message
        assert 'less than 5 m; set separation to keep them apart' in answer.message
        wait_for(lambda: shared.statuses[-1].level == DiagnosticStatus.WARN)
    for change, reason in (
            ({'tower.vertices': [50.0, 450.0, 150.0, 450.0, 150.0, 550.0, 50.0, 550.0]},
             'inside tower; it must be outside'),
            ({'tracking_margin': 5000.0}, 'tracking_margin is 5000 m, which leaves nothing')):
        with changed(shared, **change):
            answer = shared.call('planner/plan')
            assert not answer.success and answer.message.endswith('; the last plan stands')
            assert reason in answer.message
    assert shared.call('planner/plan').success
    assert not has_said(shared.process, 'there is no parameter')


# The solver


def test_an_error_of_the_program_is_told_as_one_and_no_answer_depends_on_what_was_logged_before(
        shared, set_solver):
    # rclpy refuses two severities at one line of code.
    turns = cycle(['converged', 'time_limit', OptionError('no'),
                   ValueError('operands could not be broadcast')])

    def solve(scenario, **options):
        turn = next(turns)
        if isinstance(turn, Exception):
            raise turn
        return fly_baseline(scenario, turn)

    set_solver(solve)
    answers = [shared.call('planner/plan') for _ in range(8)]
    assert [answer.success for answer in answers] == [True, True, False, False] * 2
    assert 'no;' in answers[2].message
    assert answers[3].message.startswith('the solve failed: ValueError: operands')
    wait_for(lambda: shared.status.outcome.code == 'failed')
    assert shared.statuses[-1].level == DiagnosticStatus.ERROR
    assert any('[ERROR]' in line and 'operands' in line for line in shared.process.lines)


def test_a_solve_does_not_begin_with_the_progress_of_the_one_before(shared, set_solver):
    go, diagnostics = threading.Event(), shared.listen(DiagnosticArray, '/diagnostics', 100)

    def report(scenario, on_iteration, **options):
        on_iteration(Iteration(77, 'joint', 1.0, 0.0, 0.0))
        return fly_baseline(scenario)

    set_solver(report)
    assert shared.call('planner/plan').success
    set_solver(lambda scenario, **options: go.wait() and fly_baseline(scenario))
    diagnostics.clear()
    answer = shared.ask('planner/plan')

    def solving():
        return [status for status in (
            PlannerStatus.from_message(message.status[0]) for message in diagnostics)
                if status.state == 'solving']
    wait_for(lambda: len(solving()) > 2, what='a solve that is reported')
    assert not answer.done()
    go.set()
    wait_for(answer.done)
    assert not any(status.progress.step for status in solving())


def test_the_state_is_solving_until_the_answer_and_a_cancel_after_the_solve_is_kept(
        shared, set_solver, monkeypatch):
    go, solved = threading.Event(), threading.Event()

    def evaluate(plan):
        solved.set()
        go.wait()
        return plan

    monkeypatch.setattr(Plan, 'evaluate', evaluate)
    set_solver(fly_baseline)
    paths = shared.listen(Path, 'uav1/path', 10)
    shared.statuses.clear()
    answer = shared.ask('planner/plan')
    wait_for(solved.is_set)
    wait_for(lambda: shared.statuses and shared.status.state == 'solving')
    assert shared.call('planner/cancel').success
    go.set()
    wait_for(answer.done)
    assert not answer.result().success
    assert answer.result().message == 'cancelled; the last plan stands'
    wait_for(lambda: shared.status.state == 'idle', what='an idle planner')
    assert shared.call('planner/plan').success
    wait_for(lambda: paths)
    assert len(paths) == 1


# Replans


def test_a_request_stops_a_replan_and_no_replan_of_an_older_plan_is_published_after_it(client):
    rng, answers = random.Random(3), []
    paths = client.listen(Path, 'uav1/path', DEEP)
    with node_here('planner', duration=120.0, slots=200, replan_period=0.2, replan_lead=10.0):
        client.follow()
        for _ in range(20):
            client.send_paper()
            answers.append(client.call('planner/plan'))
            time.sleep(rng.uniform(0.2, 0.5))
        # On a busy machine the requests may have left none of them the time to finish.
        wait_for(lambda: client.status.replans > 0, what='a replan')
        client.set_parameters('planner', replan_period=0.0)

        def is_quiet():
            count = len(paths)
            time.sleep(1.0)
            return count == len(paths) and client.status.state == 'idle'
        wait_for(is_quiet, what='the end of the last replan')
        status = client.status
    assert [answer.message for answer in answers if not answer.success] == []
    assert status.plans == 20
    stamps = [seconds(path.header.stamp) for path in paths]
    assert len(stamps) > 20 and stamps == sorted(stamps)
    assert status.plan.stamp == pytest.approx(max(stamps), abs=1e-6)


def test_a_replan_that_changes_nothing_is_not_counted_and_of_a_late_one_the_reason_is_told(
        client, set_solver):
    delay, solves = [0.0], []

    def solve(scenario, initial=None, **options):
        solves.append(initial)
        if initial is not None:
            time.sleep(delay[0])
        return fly_baseline(scenario) if initial is None else replace(initial, status='converged')

    set_solver(solve)
    paths = client.listen(Path, 'uav1/path')
    with node_here('planner', replan_period=0.3, replan_lead=5.0, duration=120.0, slots=1200):
        client.plan_paper()
        client.follow()
        wait_for(lambda: len(solves) > 4 and len(paths) > 1, what='replans')
        assert client.status.replans == 0
        delay[0] = 0.5
        client.set_parameters('planner', replan_period=0.0, replan_distance=5.0, replan_lead=0.1)
        client.send_estimate('eavesdropper/pose', 260, 0)
        wait_for(lambda: client.status.outcome.code == 'late', what='the reason')
        status = client.statuses[-1]
        assert 'replan_lead' in status.text and 'the last plan stands' in status.text
        assert status.level == DiagnosticStatus.WARN


# The bound


def test_the_bound_follows_the_plan_and_a_request_stops_it_first_and_if_it_fails_it_comes_again(
        client, set_solver, monkeypatch, tmp_path):
    file, answered, ended, solved = tmp_path / 'plan.json', threading.Event(), [], []
    under_way = threading.Event()

    def hold_bound(scenario, on_progress, **options):
        """Go on until it is stopped or all is answered, however fast this machine is."""
        def report(progress):
            under_way.set()
            wait_for(lambda: on_progress(progress) or answered.is_set())
            return on_progress(progress)
        bound = upper_bound(scenario, on_progress=report, **options)
        ended.append(bound.status)
        return bound

    def fail(scenario, **options):
        wait_for(lambda: ended, what='the end of the bound')
        solved.append(list(ended))
        raise ValueError('no')

    monkeypatch.setattr('secure_uav_planner.ros.planner.solver.upper_bound', hold_bound)
    with node_here('planner', duration=104.0, slots=12, bound='after', pose_timeout=0.0,
                   plan_file=file):
        assert 'below the best possible' not in client.plan_paper().message
        wait_for(under_way.is_set, what='the bound to be under way')
        assert client.call('planner/cancel').message == 'no solve is under way'
        set_solver(fail)
        assert not client.call('planner/plan').success
        assert solved == [['cancelled']]
        answered.set()
        told = wait_for(lambda: client.status.plan.bound and client.status.plan)
        assert told.bound >= told.worst_case_rate
        assert 'below the best possible' in told.claim
        wait_for(lambda: Plan.load(file).bound is not None, what='the bound in the file')
        # The next plan has none at first, and then its own.
        set_solver(solve)
        first = told.stamp
        assert client.call('planner/plan').success
        wait_for(lambda: client.status.plan.stamp != first and client.status.plan.bound,
                 what='the next bound')
        assert client.status.plan.claim in client.statuses[-1].text
        assert any(status.plan.identity and status.plan.stamp != first
                   and status.plan.bound is None for status in client.statuses)
