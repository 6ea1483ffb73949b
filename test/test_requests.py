"""Requests to the planner that meet replans, failures of the solver and their own deadline."""

from contextlib import contextmanager
import random
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Path
import pytest
from ros_client import (
    Client, node_here, node_process, seconds, values_of, wait_for, wait_for_line)
from simulation import DEEP


@pytest.fixture(scope='module')
def busy():
    """Ask for twenty plans while replans are made all the time; return all that came."""
    rng, answers = random.Random(3), []
    with Client() as client, node_process(
            'planner', duration=120.0, slots=200, replan_period=0.2, replan_lead=10.0):
        paths = client.listen(Path, 'uav1/path', DEEP)
        status = client.listen(DiagnosticStatus, 'planner/status', DEEP)
        client.follow()
        for _ in range(20):
            client.send_paper()
            answers.append(client.call('planner/plan'))
            time.sleep(rng.uniform(0.2, 0.5))
        # On a busy machine the requests may have left none of them the time to finish.
        wait_for(lambda: int(values_of(status[-1])['replans']) > 0, what='a replan')
        client.set_parameters('planner', replan_period=0.0)

        def quiet():
            received = len(paths)
            time.sleep(1.0)
            return received == len(paths) and values_of(status[-1])['state'] == 'idle'
        wait_for(quiet, what='the end of the last replan')
        values = values_of(status[-1])
    return answers, [seconds(path.header.stamp) for path in paths], values


def test_a_request_stops_a_replan_and_is_not_refused(busy):
    answers, _, values = busy
    assert int(values['replans']) > 0
    assert [answer.message for answer in answers if not answer.success] == []
    assert int(values['plans']) == 20


def test_no_replan_of_an_older_plan_is_published_after_the_plan_of_a_request(busy):
    _, stamps, values = busy
    assert int(values['replans']) > 0 and len(stamps) > 20
    assert stamps == sorted(stamps)
    assert float(values['plan.stamp']) == pytest.approx(max(stamps), abs=1e-6)


@contextmanager
def planner_with(solve, **parameters):
    """Run a planner whose solver is the text of a function, in a process of its own."""
    program = ('from dataclasses import replace\n'
               'import os\n'
               'import time\n'
               'from secure_uav_planner import fly_hover_fly, Iteration, Plan\n'
               'from secure_uav_planner.ros import planner, solver\n'
               f'{solve}\n'
               'solver.solve = solve\n'
               'planner.main()\n')
    with node_process('planner', program=program, **parameters) as process:
        wait_for_line(process, 'ready')
        yield process


def test_an_error_of_the_program_is_reported_as_one_and_not_as_a_refusal(client):
    broken = """
def solve(scenario, **options):
    raise ValueError('operands could not be broadcast together')
"""
    with planner_with(broken) as process:
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.send_paper()
        answer = client.call('planner/plan')
        assert not answer.success
        assert answer.message.startswith('the solve failed: ValueError: operands')
        wait_for(lambda: status and status[-1].level == DiagnosticStatus.ERROR,
                 what='the level ERROR')
        assert values_of(status[-1])['outcome.code'] == 'failed'
        wait_for(lambda: any('[ERROR]' in line and 'operands' in line for line in process.lines),
                 what='the error in the output')


def test_a_solve_does_not_begin_with_the_progress_of_the_one_before(client, tmp_path):
    slow = f"""
calls = []
def solve(scenario, on_iteration, **options):
    calls.append(1)
    if len(calls) == 1:
        on_iteration(Iteration(77, 'joint', 1.0, 0.0, 0.0))
    else:
        while not os.path.exists({str(tmp_path / 'go')!r}):
            time.sleep(0.01)
    return replace(fly_hover_fly(scenario), status='converged')
"""
    with planner_with(slow):
        diagnostics = client.listen(DiagnosticArray, '/diagnostics', 100)
        client.plan_paper()
        diagnostics.clear()
        answer = client.ask('planner/plan')

        def solving():
            return [values for values in (values_of(message.status[0]) for message in diagnostics)
                    if values['state'] == 'solving']
        wait_for(lambda: len(solving()) > 2, what='a solve that is reported')
        assert not answer.done()
        (tmp_path / 'go').touch()
        wait_for(answer.done)
        assert not any('progress.iteration' in values for values in solving())


@pytest.mark.parametrize('change, code', [
    ({'duration': 20.0}, 'infeasible'), ({'pose_timeout': 1e-3}, 'pose_stale'),
    ({'frame_id': 'odom'}, 'wrong_frame'), ({'height_tolerance': 0.0}, 'ok')])
def test_the_code_of_an_outcome_is_that_of_its_error(client, change, code):
    with node_here('planner', duration=120.0, slots=20):
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.call('planner/plan')
        wait_for(lambda: status and values_of(status[-1])['outcome.code'] == 'pose_missing')
        client.send_paper()
        client.set_parameters('planner', **change)
        time.sleep(0.01)

        def outcome():
            client.call('planner/plan')  # again, if a pose has come just before
            return values_of(status[-1])['outcome.code']
        wait_for(lambda: outcome() == code, what=code)


def test_a_replan_that_comes_too_late_leaves_the_old_plan_and_gives_the_reason(client):
    slow = """
def solve(scenario, initial=None, **options):
    if initial is not None:
        time.sleep(0.5)
    return replace(initial or fly_hover_fly(scenario), status='converged')
"""
    with planner_with(slow, replan_distance=5.0, replan_lead=0.1, duration=120.0, slots=1200):
        paths = client.listen(Path, 'uav1/path')
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.plan_paper()
        client.follow()
        wait_for(lambda: paths)
        client.send_estimate('eavesdropper/pose', 260, 0)
        wait_for(lambda: status and 'replan' in status[-1].message, what='the reason')
        assert 'replan_lead' in status[-1].message
        assert 'the last plan stands' in status[-1].message
        assert status[-1].level == DiagnosticStatus.WARN
        assert values_of(status[-1])['outcome.code'] == 'late'
        assert len(paths) == 1


def test_answers_do_not_depend_on_what_was_logged_before(client):
    # rclpy refuses two severities at one line of code.
    turns = """
from itertools import cycle
from secure_uav_planner.errors import OptionError
turns = cycle(['converged', 'time_limit', OptionError('no'), ZeroDivisionError('oh')])
def solve(scenario, **options):
    turn = next(turns)
    if isinstance(turn, Exception):
        raise turn
    return replace(fly_hover_fly(scenario), status=turn)
"""
    with planner_with(turns, pose_timeout=0.0):
        client.send_paper()
        answers = [client.call('planner/plan') for _ in range(8)]
    assert [answer.success for answer in answers] == [True, True, False, False] * 2
    assert 'no;' in answers[2].message and 'ZeroDivisionError' in answers[3].message


def test_the_state_is_solving_until_the_request_has_been_answered(client):
    slow = """
Plan.evaluate = lambda plan: time.sleep(3.0) or plan
def solve(scenario, **options):
    return fly_hover_fly(scenario)
"""
    with planner_with(slow, pose_timeout=0.0):
        status = client.listen(DiagnosticStatus, 'planner/status', DEEP)
        diagnostics = client.listen(DiagnosticArray, '/diagnostics', 100)
        client.send_paper()
        states = [values_of(one.status[0])['state'] for one in diagnostics]
        assert set(states) <= {'idle'}
        future = client.ask('planner/plan')
        wait_for(lambda: status and values_of(status[-1])['state'] == 'solving'
                 or future.done())
        wait_for(future.done)
        wait_for(lambda: values_of(status[-1])['state'] == 'idle', what='an idle planner')
    assert future.result().success
    assert 'solving' in [values_of(one)['state'] for one in status]


def test_a_cancel_between_the_solve_and_the_publication_is_kept(client, tmp_path):
    slow = f"""
def evaluate(plan):
    open({str(tmp_path / 'solved')!r}, 'w').close()
    while not os.path.exists({str(tmp_path / 'go')!r}):
        time.sleep(0.01)
    return plan
Plan.evaluate = evaluate
def solve(scenario, **options):
    return replace(fly_hover_fly(scenario), status='converged')
"""
    with planner_with(slow, pose_timeout=0.0):
        paths = client.listen(Path, 'uav1/path')
        client.send_paper()
        answer = client.ask('planner/plan')
        wait_for((tmp_path / 'solved').exists)
        assert client.call('planner/cancel').success
        (tmp_path / 'go').touch()
        wait_for(answer.done)
        assert not answer.result().success and answer.result().message == 'cancelled'
        assert client.call('planner/plan').success
        wait_for(lambda: paths)
        assert len(paths) == 1


def test_a_replan_that_changes_nothing_is_published_and_not_counted(client, tmp_path):
    same = f"""
def solve(scenario, initial=None, **options):
    open({str(tmp_path / 'solves')!r}, 'a').write('solve ')
    return replace(initial or fly_hover_fly(scenario), status='converged')
"""
    with planner_with(same, replan_period=0.3, replan_lead=5.0, duration=120.0, slots=120):
        paths = client.listen(Path, 'uav1/path')
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.plan_paper()
        client.follow()
        wait_for(lambda: (tmp_path / 'solves').read_text().count('solve') > 4, what='replans')
        assert values_of(status[-1])['replans'] == '0' and len(paths) > 1


def test_a_request_that_fails_leaves_the_last_plan_its_bound(client):
    fails_later = """
calls = []
real = solver.solve
def solve(scenario, **options):
    calls.append(1)
    if len(calls) == 2:
        raise ValueError('no')
    return real(scenario, **options)
"""
    with planner_with(fails_later, bound='after', pose_timeout=0.0, duration=104.0, slots=52):
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.plan_paper()
        assert not client.call('planner/plan').success
        wait_for(lambda: status and 'plan.bound' in values_of(status[-1]), what='the bound')


def test_a_mission_that_cannot_be_flown_is_a_warning_when_the_node_starts():
    with node_process('planner', duration=20.0) as process:
        wait_for(lambda: any('ready' in line for line in process.lines))
    warning, = [line for line in process.lines if '[WARN]' in line]
    assert 'cannot be flown' in warning and 'uav1 needs at least' in warning
