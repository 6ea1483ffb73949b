"""Nodes that die, come back, join late, and clocks that misbehave."""

import random
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
import numpy as np
import pytest
from relay_client import rests
from ros_client import Client, seconds, stamp_at
from ros_nodes import node_here, node_process, stopped, wait_for
from secure_uav_planner import fly_hover_fly, Plan, Scenario
from simulation import SimulatedTime
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

SHORT = {'duration': 120.0, 'slots': 30}
LONG = {'duration': 400.0, 'slots': 3000, 'method': 'alternating', 'time_limit': 0.0}
KINDS = {'path': Path, 'power': Float64MultiArray, 'trajectory': MultiDOFJointTrajectory}


@pytest.fixture
def file(tmp_path):
    return tmp_path / 'plan.json'


def whole():
    """Return the last message of every topic of a plan, as somebody gets them who comes now."""
    with Client() as late:
        got = {f'{name}/{topic}': late.listen(kind, f'{name}/{topic}')
               for name in ('uav1', 'uav2') for topic, kind in KINDS.items()}
        got['planner/markers'] = late.listen(MarkerArray, 'planner/markers')
        wait_for(lambda: all(got.values()) and late.status.plan.identity, what='a whole plan')
        return {topic: received[-1] for topic, received in got.items()}, late.status


# The planner is killed


def test_a_planner_killed_in_a_solve_publishes_its_last_plan_again(client, file):
    with node_process('planner', plan_file=file, **SHORT) as process:
        client.plan_paper()
        first, status = whole()
        client.set_parameters('planner', **LONG)
        answer = client.ask('planner/plan')
        wait_for(lambda: client.status.progress.step, what='progress')
        assert not answer.done()
        # Also who comes in the middle of a solve receives the whole last plan.
        assert whole()[0] == first
        assert stopped(process, signal.SIGKILL) == -signal.SIGKILL
    with node_process('planner', plan_file=file, **SHORT):
        again, status_again = whole()
        assert again == first and status_again.plan.stamp == status.plan.stamp
        # It is a planner as before.
        client.forget_status()
        client.plan_paper()


def test_a_plan_file_that_cannot_be_written_does_not_keep_the_plan_back(client, tmp_path):
    folder = tmp_path / 'out'
    folder.mkdir()
    with node_here('planner', plan_file=folder / 'plan.json', **SHORT) as process:
        folder.rmdir()
        client.plan_paper()
        assert len(whole()[0]['uav1/path'].poses) == 32
        [line] = [line for line in process.lines if '[ERROR]' in line]
        assert f"No such file or directory: '{folder}/plan.json'; the plan is published" in line


@pytest.mark.soak
def test_twenty_kills_at_any_time_leave_a_whole_plan_file(file):
    rng, loaded = random.Random(1), 0
    for _ in range(20):
        with Client() as client, node_process('planner', plan_file=file, **SHORT) as process:
            client.plan_paper()
            until = time.monotonic() + rng.uniform(0, 0.3)
            while time.monotonic() < until:
                client.call('planner/plan')
            client.ask('planner/plan')
            time.sleep(rng.uniform(0, 0.05))
            process.kill()
        Plan.load(file)
        loaded += 1
    left = len(list(file.parent.glob('*.part')))
    print(f'\n{loaded} kills, {loaded} whole plan files, {left} unfinished ones beside them')


# Clocks


def test_the_planner_plans_before_the_first_clock_while_it_stands_still_and_after_a_jump_back(
        client):
    paths = client.listen(Path, 'uav1/path')
    with node_here('planner', use_sim_time='true', pose_timeout=0.0, replan_lead=100.0, **SHORT):
        client.send_paper(stamp=stamp_at(0))
        assert client.call('planner/plan').success
        wait_for(lambda: paths)
        assert seconds(paths[-1].header.stamp) == 0.0
        with SimulatedTime(client, start=1000.0, speedup=1.0) as clock:
            def plans_between(low, high):
                client.send_paper(stamp=clock.stamp(), until_known=False)
                return client.call('planner/plan').success and any(
                    low <= seconds(path.header.stamp) <= high for path in paths)
            wait_for(lambda: plans_between(1000.0, 2000.0), what='a plan on simulated time')
            clock.running = False
            received = client.listen(DiagnosticArray, '/diagnostics', 10)
            wait_for(lambda: len(received) >= 2, what='diagnostics while the clock stands')
            del paths[:]
            clock.running = True
            clock.jump(10.0)
            wait_for(lambda: 'no pose has come on ground_node/pose since the clock was set back' in
                     client.call('planner/plan').message, what='a refusal')
            wait_for(lambda: plans_between(10.0, 900.0), what='a plan after the jump')
            wait_for(lambda: 0.0 <= client.status.plan.age < 900.0, what='a new age')


def test_replay_waits_for_a_clock_holds_while_it_stands_and_no_jump_of_it_moves_a_uav(
        client, file):
    """The UAVs neither leap nor turn back, whatever the clock does; they arrive."""
    fly_hover_fly(Scenario.paper(104, slots=104), 'constant').save(file)
    setpoints = client.listen(PoseStamped, 'uav1/setpoint/pose', 5000)

    def has_flown(distance, since=500.0):
        return setpoints and setpoints[-1].pose.position.y < since - distance

    with node_here('replay', use_sim_time='true', plan_file=file):
        # Without any clock it answers.
        for service in ('start', 'pause', 'start'):
            assert client.call(f'replay/{service}').success
        assert not setpoints
        # No leap to the end of the plan when the time of day comes.
        with SimulatedTime(client, start=1.7e9) as clock:
            wait_for(lambda: has_flown(50.0), what='flight')
            clock.running = False
            wait_for(lambda: rests(setpoints), what='a halt')
            held = setpoints[-1].pose.position.y
            clock.running = True
            wait_for(lambda: has_flown(50.0, held), what='flight again')
            for earlier in (500.0, 0.0):
                at = setpoints[-1].pose.position.y
                clock.jump(earlier)
                wait_for(lambda: has_flown(50.0, at), what='flight on')
            # It has begun, although its time is to come once more.
            assert client.call('replay/pause').success
            assert client.call('replay/start').message.partition(': playing')[1]
            wait_for(lambda: setpoints[-1].pose.position.y == -500.0, what='the goal')
    place = np.array([(at.pose.position.x, at.pose.position.y) for at in setpoints])
    assert 500.0 - place[0, 1] <= 10.0 * (seconds(setpoints[0].header.stamp) - 1.7e9) + 1e-3
    # What the clock went on from one setpoint to the next; a busy machine drops a few of them.
    elapsed = np.diff([seconds(at.header.stamp) for at in setpoints])
    back = np.flatnonzero(elapsed < 0)
    assert len(back) == len(clock.jumps)
    elapsed[back] += [before - after for before, after in clock.jumps]
    assert (np.hypot(*np.diff(place, axis=0).T) <= 10.0 * elapsed + 1e-3).all()
    assert (np.diff(place[:, 1]) <= 1e-9).all()  # never back
