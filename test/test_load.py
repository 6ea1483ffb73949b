"""Poses at 200 Hz on each topic: the planner answers, and its memory does not grow."""

from contextlib import contextmanager
import threading
import time

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Path
import pytest
from ros_client import Client, memory_settles, node_process, pose_message, wait_for

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
