"""Poses at 200 Hz on each topic, and plans that arrive in flight beside busy loops."""

from contextlib import contextmanager, ExitStack
from dataclasses import replace
import os
import subprocess
import sys
import threading
import time

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Path
import numpy as np
import pytest
from ros_client import Client, pose_message, seconds
from ros_nodes import has_said, memory_settles, node_process, wait_for, wait_for_line
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.topics import LATCHED
from std_msgs.msg import String
from strategies import with_uavs

RATE = 200.0  # Hz
POSES = {'ground_node/pose': (0.0, 0.0), 'eavesdropper/pose': (200.0, 0.0),
         'uav1/pose': (100.0, 500.0), 'uav2/pose': (100.0, 500.0)}


@contextmanager
def poses(client):
    """Send poses on each topic in the background; yield a list of the rounds so far."""
    kinds = {topic: PoseWithCovarianceStamped if topic.startswith('eavesdropper') else PoseStamped
             for topic in POSES}
    publishers = {topic: client.publisher(kind, topic) for topic, kind in kinds.items()}
    sent, stop = [0], threading.Event()

    def run():
        began = time.monotonic()
        while not stop.is_set():
            for topic, place in POSES.items():
                publishers[topic].publish(pose_message(kinds[topic], *place, stamp=client.now()))
            sent[0] += 1
            time.sleep(max(0.0, began + sent[0] / RATE - time.monotonic()))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield sent
    finally:
        stop.set()
        thread.join()


def test_under_load_a_solve_lets_everything_answer_can_be_cancelled_and_ends_at_its_deadline():
    with Client() as client, node_process('planner', duration=120.0, slots=40, time_limit=0.0,
                                          method='alternating') as process:
        paths = client.listen(Path, 'uav1/path')
        client.plan_paper()
        first = wait_for(lambda: paths and client.status.plan.identity)
        # Its solve takes far longer than the test.
        client.set_parameters('planner', duration=400.0, slots=3000)
        with poses(client) as sent:
            answer = client.ask('planner/plan')
            wait_for(lambda: client.status.progress.step, what='progress')
            before, count = sent[0], len(client.statuses)
            wait_for(lambda: sent[0] > before + 100, what='100 rounds of poses')
            assert client.get_parameters('planner', 'slots') == [3000]
            second = client.call('planner/plan')
            assert not second.success and second.message.startswith('a solve is under way')
            wait_for(lambda: len(client.statuses) > count + 1, what='more progress')
            assert not answer.done()
            assert client.call('planner/cancel').success
            wait_for(answer.done)
            assert answer.result().message == 'cancelled; the last plan stands'
            wait_for(lambda: client.status.state == 'idle')
            assert client.status.plan.identity == first and len(paths) == 1
            assert client.call('planner/cancel').message == 'no solve is under way'
            client.set_parameters('planner', time_limit=2.0)
            assert 'stopped at time_limit with the best feasible plan so far' in client.call(
                'planner/plan').message
            wait_for(lambda: len(paths[-1].poses) == 3002)
        assert process.poll() is None


@pytest.mark.soak
def test_memory_does_not_grow_under_load():
    plans, rounds = 100, 2000  # each time; rounds of poses
    with Client() as client, node_process(
            'planner', duration=200.0, slots=100) as process:
        client.send_paper()
        assert client.call('planner/plan').success
        with poses(client) as sent:
            def work():
                goal = sent[0] + rounds
                for _ in range(plans):
                    assert client.call('planner/plan').success
                wait_for(lambda: sent[0] >= goal, what='the poses')

            # A leak of 1 kB a plan, or of 100 bytes a pose, would never let it settle.
            sizes = memory_settles(process, work)
    times = len(sizes) - 1
    print(f'\n{plans * times} plans, {4 * sent[0]} poses: {sizes[0]:.1f} MB after the first '
          f'plan, {sizes[-1]:.1f} MB at the end')


@pytest.mark.soak
def test_plans_that_arrive_in_flight_beside_busy_loops_leave_no_gap_in_the_stream(client):
    """Set BUSY_LOOPS and PLANS to their numbers, and SLOTS to the length of each plan."""
    loops, count, slots = (int(os.environ.get(name, default)) for name, default in (
        ('BUSY_LOOPS', 4), ('PLANS', 20), ('SLOTS', 2000)))
    plan = fly_hover_fly(with_uavs(Scenario.paper(200.0, slots=slots), max_acceleration=2.0))
    with ExitStack() as stack, node_process('replay', rate=30.0) as replay:
        places = client.listen(PoseStamped, 'uav1/setpoint/pose', 10000)
        client.listen(PoseStamped, 'uav2/setpoint/pose', 10000)
        publisher = client.publisher(String, 'plan', LATCHED)
        for _ in range(loops):
            loop = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
            stack.callback(loop.wait)
            stack.callback(loop.kill)
        plan = replace(plan, start_ns=time.time_ns())
        publisher.publish(messages.plan_text(plan, 'map'))
        wait_for_line(replay, plan.identity)
        assert client.call('replay/start').success
        wait_for(lambda: places, what='the flight')
        for number in range(count):
            changed = replace(plan, powers=plan.powers * (1 - 0.01 * (number + 1)))
            publisher.publish(messages.plan_text(changed, 'map'))
            wait_for_line(replay, changed.identity)
            time.sleep(1.0)
    gaps = np.diff([seconds(place.header.stamp) for place in places])
    print(f'{count} plans of {slots} slots beside {loops} busy loops, {len(places)} setpoints: '
          f'largest gap {gaps.max():.3f} s, 99.9% {np.quantile(gaps, 0.999):.3f} s, median '
          f'{np.median(gaps):.3f} s')
    assert not has_said(replay, 'is not played')
    assert gaps.min() > 0.0
