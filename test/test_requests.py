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


def test_a_request_stops_a_replan_and_no_replan_of_an_older_plan_is_published_after_it():
    rng, answers = random.Random(3), []
    with Client() as client, node_process(
            'planner', duration=120.0, slots=200, replan_period=0.2, replan_lead=10.0):
        paths = client.listen(Path, 'uav1/path', DEEP)
        client.follow()
        for _ in range(20):
            client.send_paper()
            answers.append(client.call('planner/plan'))
            time.sleep(rng.uniform(0.2, 0.5))
        # On a busy machine the requests may have left none of them the time to finish.
        wait_for(lambda: int(client.status['replans']) > 0, what='a replan')
        client.set_parameters('planner', replan_period=0.0)

        def quiet():
            received = len(paths)
            time.sleep(1.0)
            return received == len(paths) and client.status['state'] == 'idle'
        wait_for(quiet, what='the end of the last replan')
        values = client.status
    assert [answer.message for answer in answers if not answer.success] == []
    assert int(values['plans']) == 20
    stamps = [seconds(path.header.stamp) for path in paths]
    assert len(stamps) > 20 and stamps == sorted(stamps)
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
        client.send_paper()
        answer = client.call('planner/plan')
        assert not answer.success
        assert answer.message.startswith('the solve failed: ValueError: operands')
        wait_for(lambda: client.status['outcome.code'] == 'failed')
        assert client.statuses[-1].level == DiagnosticStatus.ERROR
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
                    if values['state'] == 'solving' and values['plans'] == '1']
        wait_for(lambda: len(solving()) > 2, what='a solve that is reported')
        assert not answer.done()
        (tmp_path / 'go').touch()
        wait_for(answer.done)
        assert not any('progress.iteration' in values for values in solving())


@pytest.mark.parametrize('change, code, text', [
    ({'duration': 20.0}, 'infeasible', 'uav1 needs at least'),
    ({'pose_timeout': 1e-3}, 'pose_stale', 'pose_timeout is 0.001 s'),
    ({'frame_id': 'odom'}, 'wrong_frame', "the parameter frame_id is 'odom'"),
    ({'start_delay': 1e-3}, 'late', 'a longer start_delay gives it more time'),
    ({'height_tolerance': 0.0}, 'ok', 'joint plan of 20 slots')])
def test_the_code_of_an_outcome_is_that_of_its_error(client, change, code, text):
    with node_here('planner', duration=120.0, slots=20):
        client.call('planner/plan')
        wait_for(lambda: client.status.get('outcome.code') == 'pose_missing')
        client.send_paper()
        client.set_parameters('planner', **change)

        def is_told():
            # Again, if a pose has come just before.
            answer = client.call('planner/plan')
            return text in answer.message and client.status['outcome.code'] == code
        wait_for(is_told, what=code)


def test_a_replan_that_comes_too_late_leaves_the_old_plan_and_gives_the_reason(client):
    slow = """
def solve(scenario, initial=None, **options):
    if initial is not None:
        time.sleep(0.5)
    return replace(initial or fly_hover_fly(scenario), status='converged')
"""
    with planner_with(slow, replan_distance=5.0, replan_lead=0.1, duration=120.0, slots=1200):
        paths = client.listen(Path, 'uav1/path')
        client.plan_paper()
        client.follow()
        wait_for(lambda: paths)
        client.send_estimate('eavesdropper/pose', 260, 0)
        wait_for(lambda: client.status['outcome.code'] == 'late', what='the reason')
        status = client.statuses[-1]
        assert 'replan_lead' in status.message and 'the last plan stands' in status.message
        assert status.level == DiagnosticStatus.WARN and len(paths) == 1


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
        client.send_paper()
        assert client.status['state'] == 'idle'
        future = client.ask('planner/plan')
        wait_for(future.done)
        wait_for(lambda: client.status['state'] == 'idle', what='an idle planner')
    assert future.result().success
    assert 'solving' in [values_of(status)['state'] for status in client.statuses]


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
        client.plan_paper()
        client.follow()
        wait_for(lambda: (tmp_path / 'solves').read_text().count('solve') > 4, what='replans')
        assert client.status['replans'] == '0'
        wait_for(lambda: len(paths) > 1)


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
        client.plan_paper()
        assert not client.call('planner/plan').success
        wait_for(lambda: 'plan.bound' in client.status, what='the bound')


def test_a_mission_that_cannot_be_flown_is_a_warning_when_the_node_starts():
    with node_process('planner', duration=20.0) as process:
        wait_for(lambda: any('ready' in line for line in process.lines))
    warning, = [line for line in process.lines if '[WARN]' in line]
    assert 'cannot be flown' in warning and 'uav1 needs at least' in warning
