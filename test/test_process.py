"""How the nodes stop."""

from collections import Counter
import random
import signal
import subprocess
import sys
import time

import pytest
from ros_client import Client
from ros_nodes import node_process, output_of, PATIENCE, stopped, wait_for
from secure_uav_planner.ros.topics import serve
from service_msgs.msg import ServiceEventInfo
from std_srvs.srv import Trigger


@pytest.mark.parametrize('number, method, slots', [
    (signal.SIGINT, 'joint', 20000), (signal.SIGTERM, 'alternating', 3000)])
def test_a_signal_in_the_middle_of_a_solve_ends_the_node_and_the_solve(number, method, slots):
    with Client() as client, node_process('planner', duration=900.0, slots=slots, method=method,
                                          time_limit=0.0) as process:
        client.send_paper()
        answer = client.ask('planner/plan')
        wait_for(lambda: client.status.state == 'solving')
        process.send_signal(number)
        process.send_signal(number)  # an impatient user's second one changes nothing
        assert process.wait(timeout=PATIENCE) == 0
        assert 'Traceback' not in output_of(process) and 'exception' not in output_of(process)
        wait_for(answer.done)
        assert not answer.result().success


def test_a_signal_ends_an_idle_node_that_said_no_more_than_ready_and_a_planner_in_a_bound():
    with node_process('replay') as process:
        wait_for(lambda: process.lines, what='the first line')
        assert stopped(process) == 0
        assert 'ready' in output_of(process) and len(process.lines) == 1
    with Client() as client, node_process('planner', bound='after', pose_timeout=0.0) as process:
        wait_for(lambda: process.lines, what='the first line')
        assert 'ready' in process.lines[0] and len(process.lines) == 1
        client.plan_paper()
        assert stopped(process) == 0


def test_a_node_starts_without_the_parts_of_scipy_that_few_missions_need():
    subprocess.run([sys.executable, '-c', 'import secure_uav_planner.ros.planner.node, sys; '
                    'assert not {"scipy.sparse", "scipy.linalg"} & {*sys.modules}'], check=True)


BLOCKED = """
import ctypes, os, signal, sys, threading
from rclpy.node import Node
from secure_uav_planner.ros.process import run_node

class Blocked(Node):
    def __init__(self):
        super().__init__('blocked')
        if sys.argv[1] == 'callback':
            self.create_timer(0.01, self.block)
        threading.Timer(0.5, os.kill, [os.getpid(), signal.SIGINT]).start()

    def block(self):
        threading.Event().wait()

    def close(self):
        return True

    def destroy_node(self):
        if sys.argv[1] == 'destructor':  # With the interpreter's lock.
            ctypes.PyDLL(None).pause()

run_node(Blocked, args=[])
"""


@pytest.mark.parametrize('place, status', [('callback', 0), ('destructor', -signal.SIGALRM)])
def test_a_node_ends_after_a_signal_whatever_hangs(place, status):
    ended = subprocess.run([sys.executable, '-c', BLOCKED, place], timeout=PATIENCE)
    assert ended.returncode == status


BUSY = """
import os, signal, time
from rclpy.executors import Executor
from rclpy.node import Node
from secure_uav_planner.ros.process import run_node

class Busy(Node):
    def __init__(self):
        super().__init__('busy')
        self.calls = self.polls = 0
        for _ in range(2):
            self.create_timer(0.01, self.work)
        poll = Executor.wait_for_ready_callbacks
        def count(*args, **options):
            self.polls += 1
            return poll(*args, **options)
        Executor.wait_for_ready_callbacks = count

    def work(self):
        time.sleep(0.02)
        self.calls += 1
        if self.calls == 100:
            print(self.polls, flush=True)
            os.kill(os.getpid(), signal.SIGTERM)

    def close(self):
        return True

run_node(Busy, args=[])
"""


def test_an_executor_polls_no_more_often_than_callbacks_run_however_long_they_take():
    ended = subprocess.run(
        [sys.executable, '-c', BUSY], stdout=subprocess.PIPE, text=True, timeout=PATIENCE)
    assert ended.returncode == 0 and int(ended.stdout) < 200


def test_a_signal_as_soon_as_a_node_says_that_it_is_ready_ends_it_cleanly():
    program = BUSY.replace('self.calls = self.polls = 0', 'os.kill(os.getpid(), signal.SIGTERM)')
    assert subprocess.run([sys.executable, '-c', program], timeout=PATIENCE).returncode == 0


def test_a_service_that_fails_answers_with_the_reason():
    with Client() as client:
        def fail():
            raise ValueError('too bad')

        async def fail_later():
            fail()

        client.node.declare_parameter('service_introspection', 'off')
        for name, action in (('start', fail), ('plan', fail_later)):
            serve(client.node, {f'~/{name}': action}, client.node.default_callback_group)
            answer = client.call(f'client/{name}')
            assert (answer.success, answer.message) == (False, 'ValueError: too bad')


def test_with_service_introspection_the_graph_shows_what_was_asked_and_answered():
    with Client() as client, node_process('replay', service_introspection='contents'):
        events = []
        client.node.create_subscription(
            Trigger.Event, 'replay/pause/_service_event', events.append, 10)
        answers = []
        # Each time, since nobody can tell when the node has discovered the subscription.
        wait_for(lambda: answers.append(client.call('replay/pause')) or {
            event.info.event_type for event in events} >= {
                ServiceEventInfo.REQUEST_RECEIVED, ServiceEventInfo.RESPONSE_SENT})
        assert answers[0] in [response for event in events for response in event.response]


def test_a_wrong_command_line_is_named():
    with node_process('planner', '--params-file', 'no/such/file.yaml') as process:
        assert process.wait(timeout=PATIENCE) == 1
    assert '/such/file.yaml' in output_of(process)  # rcl shortens long texts
    assert process.lines[-1].startswith('cannot start: ') and len(process.lines) <= 2


@pytest.mark.soak
@pytest.mark.parametrize('node', ['planner', 'replay'])
def test_fifty_stops_at_any_time_of_two_seconds_from_the_start_or_the_first_line(node):
    """Before its own code runs, Python itself answers a signal, as in any node of rclpy."""
    rng, early, statuses = random.Random(5), 0, Counter()
    for number in range(50):
        with node_process(node) as process:
            if number % 2:  # On a busy machine, all others may come before its own code.
                wait_for(lambda: process.lines, what='the first line')
            time.sleep(rng.uniform(0, 2.0))
            process.send_signal(signal.SIGINT)
            try:
                status = process.wait(timeout=30.0)
            except subprocess.TimeoutExpired:  # An import may lose the exception of the first.
                status = stopped(process)
        text = output_of(process)
        if 'run_node' not in text and 'Traceback' in text or status == -signal.SIGINT:
            early += 1
            continue
        statuses[status] += 1
        assert 'Traceback' not in text, text
        # On a busy machine, a stop may come while the node is loaded.
        assert status == 0 or status == 130 and 'ready' not in text, text
    print(f'\n{node}: 50 stops, {early} of them before its own code, the others {statuses}')
