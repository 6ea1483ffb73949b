"""
Poses at 200 Hz on every topic, for as long as it takes.

Times depend on the machine: the long forms (marker `soak`) print them, none is asserted.
"""

from contextlib import contextmanager
import os
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
import numpy as np
import pytest
from ros_client import (
    Client, memory_settles, node_process, values_of, wait_for, wait_for_line)

RATE = 200.0  # Hz
# Far from solved when the tests stop it.
LONG = {'duration': 400.0, 'slots': 3000, 'method': 'alternating', 'time_limit': 0.0}
TOPICS = {
    'ground_node/pose': (PoseStamped, (0.0, 0.0)),
    'eavesdropper/pose': (PoseWithCovarianceStamped, (200.0, 0.0)),
    'uav1/pose': (PoseStamped, (100.0, 500.0)),
    'uav2/pose': (PoseStamped, (100.0, 500.0)),
}


@contextmanager
def poses(client, rate=RATE):
    """Send poses on every topic at a rate in the background; yield how many rounds so far."""
    publishers = {topic: client.publisher(kind, topic) for topic, (kind, _) in TOPICS.items()}
    sent, stop = [0], threading.Event()

    def run():
        began = time.monotonic()
        while not stop.is_set():
            stamp = client.node.get_clock().now().to_msg()
            for topic, (kind, (x, y)) in TOPICS.items():
                message = kind()
                message.header.frame_id, message.header.stamp = 'map', stamp
                pose = getattr(message.pose, 'pose', message.pose)
                pose.position.x, pose.position.y, pose.orientation.w = x, y, 1.0
                publishers[topic].publish(message)
            sent[0] += 1
            time.sleep(max(0.0, began + sent[0] / rate - time.monotonic()))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield sent
    finally:
        stop.set()
        thread.join()


def cpu_seconds(process):
    """Return the processor time that a process has used."""
    with open(f'/proc/{process.pid}/stat', encoding='ascii') as file:
        fields = file.read().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def solving(client, status):
    """Ask for a plan; return the future of its answer once iterations are reported."""
    status.clear()
    answer = client.ask('planner/plan')
    wait_for(lambda: answer.done() or (status and 'progress.iteration' in values_of(status[-1])),
             what='progress')
    return answer


def test_under_load_a_solve_is_cancelled_and_the_next_one_plans():
    with Client() as client, node_process('planner', **LONG) as process:
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.send_paper()
        with poses(client) as sent:
            answer = solving(client, status)
            before = sent[0]
            wait_for(lambda: sent[0] > before + 100, what='100 rounds of poses')
            assert not answer.done()
            assert client.call('planner/cancel').success
            wait_for(answer.done)
            assert answer.result().message == 'cancelled'
            assert client.set_parameters('planner', slots=30)[0].successful
            wait_for(lambda: client.call('planner/plan').success)
        assert process.poll() is None


@pytest.mark.soak
@pytest.mark.parametrize('method, slots', [('joint', 2000), ('alternating', 50)])
def test_how_much_longer_a_solve_takes_under_load(method, slots):
    with Client() as client, node_process(
            'planner', duration=200.0, slots=slots, method=method, time_limit=0.0,
            pose_timeout=0.0):
        client.send_paper()

        def solve_time():
            # Another duration keeps the last plan from being the start of this one.
            for duration in (200.0, 300.0):
                client.set_parameters('planner', duration=duration)
                client.send_paper()
                answer = client.call('planner/plan', patience=600)
                assert answer.success
            return float(answer.message.split('bit/s/Hz, ')[1].split(' s,')[0])

        # One after the other, so that what else the machine does meets both alike.
        alone, loaded = [], []
        for _ in range(7):
            alone.append(solve_time())
            with poses(client):
                time.sleep(0.2)
                loaded.append(solve_time())
    ratio = np.median(loaded) / np.median(alone)
    print(f'\n{method}, {slots} slots: {np.median(alone):.3f} s alone, '
          f'{np.median(loaded):.3f} s under load, ratio {ratio:.2f} (medians of 7)')


@pytest.mark.soak
def test_how_soon_a_cancel_answers_under_load():
    with Client() as client, node_process('planner', **LONG):
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.send_paper()
        times = []
        with poses(client):
            for _ in range(12):
                answer = solving(client, status)
                time.sleep(0.3)
                assert not answer.done()
                answered, asked = [], time.monotonic()
                future = client.ask('planner/cancel')
                future.add_done_callback(lambda _: answered.append(time.monotonic()))
                wait_for(lambda: answered, what='the answer of ~/cancel')
                times.append(answered[0] - asked)
                assert future.result().success
                wait_for(answer.done)
                assert answer.result().message == 'cancelled'
    print(f'\n~/cancel under load: {1e3 * np.median(times):.1f} ms in the median of 12, '
          f'{1e3 * max(times):.1f} ms at most')


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
@pytest.mark.parametrize('node', ['planner', 'replay'])
def test_how_much_an_idle_node_uses(node):
    with node_process(node) as process:
        wait_for_line(process, 'ready')
        time.sleep(2.0)
        before, began = cpu_seconds(process), time.monotonic()
        time.sleep(20.0)
        used = (cpu_seconds(process) - before) / (time.monotonic() - began)
        assert process.poll() is None
    print(f'\n{node}, idle: {100 * used:.2f}% of a core')
