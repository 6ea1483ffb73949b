"""
A client of the nodes, which uses them like any other program, and the nodes' processes.

No wait here depends on the speed of the machine: each one is for a condition, and its patience
only ends a test that would otherwise wait forever. The report of a failed test contains the output
of its nodes; see conftest.py.
"""

from contextlib import contextmanager
import gc
from importlib import import_module
import os
import signal
import subprocess
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
import numpy as np
from processes import environment, ROOT
import pytest
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.time import Time
from secure_uav_planner.ros.client import make_clients
from secure_uav_planner.ros.parameters import eavesdropper_parameters, PLANNER, uav_parameters
from secure_uav_planner.ros.process import run_node, spin
from secure_uav_planner.ros.topics import LATCHED
from sensor_msgs.msg import TimeReference
from std_srvs.srv import Trigger

DEFAULTS = {name: spec.default for specs in (
    PLANNER, uav_parameters('uav1', 0), uav_parameters('uav2', 1),
    eavesdropper_parameters('eavesdropper')) for name, spec in specs.items()} | {
        'tracks': {}}
PATIENCE = 120.0
ASK_AGAIN = 5.0  # s without an answer
IDLE = 60  # s without a solve; the planner is idle while it still evaluates a plan, too
RESEND = 3.0  # s, well below the planner's default pose_timeout
_SHOWN = 60  # Lines of a node's output in the report of a failed test.

_started = []  # (test, Popen) of every node process, until another test begins.
_clients = []


def wait_for(condition, patience=PATIENCE, what='the condition'):
    """Return the value of a condition once it is true; fail after the patience in s."""
    until = time.monotonic() + patience
    while not (value := condition()):
        assert time.monotonic() < until, f'{what} did not come true in {patience} s'
        time.sleep(0.01)
    return value


# Processes


@contextmanager
def node_process(name, *arguments, namespace=None, program=None, **parameters):
    """Run a node, or a program, in its own process; yield that, with its output in .lines."""
    script = ['-c', program] if program else [str(ROOT / 'scripts' / name)]
    command = [sys.executable, *script, *_ros_args(parameters)]
    if namespace:
        command += ['-r', f'__ns:={namespace}']
    process = subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=environment(PYTHONUNBUFFERED='1'))
    process.name, process.lines = name, []
    _note(process)
    reader = threading.Thread(target=lambda: process.lines.extend(process.stdout), daemon=True)
    reader.start()
    process.reader = reader
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
        process.wait()
        reader.join(timeout=PATIENCE)


def _ros_args(parameters):
    return ['--ros-args'] + [word for key, value in parameters.items()
                             for word in ('-p', f'{key.replace("__", ".")}:={value}')]


def refusal(capfd, name, **parameters):
    """Start a node in this process; return the line with the reason why it cannot start."""
    kind = getattr(import_module(f'secure_uav_planner.ros.{name}'), name.title())
    capfd.readouterr()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with pytest.raises(SystemExit) as ended:
        run_node(kind, _ros_args(parameters))
    for number, handler in handlers.items():
        signal.signal(number, handler)
    assert ended.value.code == 1
    del ended  # Its traceback holds the node, and with that its place in DDS.
    gc.collect()
    # Others in this process may write as well, such as what is left of the node before.
    lines = ''.join(capfd.readouterr()).splitlines()
    reasons = [line for line in lines if line.startswith('cannot start: ')]
    assert len(reasons) == 1, lines
    return reasons[0]


class _LocalProcess:
    """The process attributes of a node in this process."""

    def __init__(self, name):
        self.name, self.pid, self.lines, self.ended = name, os.getpid(), [], None

    def poll(self):
        return self.ended


@contextmanager
def _logged_in(lines):
    """Keep what is logged in this process. With capfd, lines get lost while it is read."""
    write = rclpy_implementation.rclpy_logging_rcutils_log

    def log(severity, name, message, *place):
        lines.append(f'[{severity.name}] [{name}]: {message}\n')
        write(severity, name, message, *place)

    rclpy_implementation.rclpy_logging_rcutils_log = log
    try:
        yield
    finally:
        rclpy_implementation.rclpy_logging_rcutils_log = write


@contextmanager
def node_here(name, **parameters):
    """
    Run a node in this process, which takes a tenth of the time; its log is in .lines.

    For tests that ask a node of their own; tests of processes and warnings use node_process.
    """
    kind = getattr(import_module(f'secure_uav_planner.ros.{name}'), name.title())
    context, local = Context(), _LocalProcess(name)
    _note(local)
    rclpy.init(context=context, args=_ros_args(parameters))
    with _logged_in(local.lines):
        node, stop = kind(context=context), threading.Event()
        full_name = node.get_fully_qualified_name()
        thread = threading.Thread(target=spin, args=(node, stop), daemon=True)
        thread.start()
        try:
            yield local
        finally:
            local.ended = 0
            stop.set()
            thread.join(PATIENCE)
            node.destroy_node()
            rclpy.shutdown(context=context)
            # The next node of this process is the same participant in DDS, which clients would not
            # discover before the end of this one.
            wait_for(lambda: not any(
                full_name in client.node.get_fully_qualified_node_names()
                for client in _clients), what=f'the end of {full_name}')


def stopped(process, number=signal.SIGINT):
    """Send a signal to a process and return its exit status, however long it takes to end."""
    process.send_signal(number)
    return process.wait(timeout=PATIENCE)


def output_of(process):
    """Return all output of a process that has ended."""
    process.reader.join(timeout=PATIENCE)
    return ''.join(process.lines)


def wait_for_line(process, text):
    """Return the first line of a process's output that contains a text, once there is one."""
    def line():
        return next((line for line in list(process.lines) if text in line), None)
    return wait_for(line, what=f'{text!r} in the output of {process.name}')


def outputs():
    """Return the last output of the node processes of this test, and their states."""
    lines = []
    for _, process in _started:
        status = process.poll()
        state = 'running' if status is None else f'ended with status {status}'
        lines += [f'--- {process.name} ({process.pid}), {state}\n', *process.lines[-_SHOWN:]]
    return ''.join(lines)


def _note(process):
    """Keep a process for the report of its test, and forget the ones of tests before."""
    test = os.environ.get('PYTEST_CURRENT_TEST', '').rpartition(' ')[0]
    _started[:] = [(name, earlier) for name, earlier in _started
                   if name == test or earlier.poll() is None]
    _started.append((test, process))


def _running():
    return [process for _, process in _started if process.poll() is None]


def memory_settles(process, work, quiet=5, least=0.5, most=60):
    """
    Repeat a piece of work until a process's memory has settled; return it after each, in MB.

    Settled is when the last rounds, `quiet` of them, have added less than `least` MB together.
    What a process needs once, such as caches and the pools of its allocator, comes to an end; a
    leak does not, however fast the machine is.

    :param most: rounds after which memory that still rises fails the test.
    """
    sizes = [memory(process)]
    while len(sizes) <= quiet or sizes[-1] - sizes[-1 - quiet] >= least:
        assert len(sizes) <= most, f'memory still rises after {most} rounds: {sizes} MB'
        work()
        sizes.append(memory(process))
    return sizes


def memory(process):
    """Return the resident memory of a process in MB."""
    with open(f'/proc/{process.pid}/statm', encoding='ascii') as file:
        return int(file.read().split()[1]) * os.sysconf('SC_PAGE_SIZE') / 1e6


class Client:
    """
    A node of its own context, spun in the background.

    Poses that it has sent with the time of now are sent again every few seconds, as a real
    localisation would, so that they are not too old when a busy machine processes them. That ends
    when a node ends that was running when they were sent.
    """

    def __init__(self, name='tester', namespace='', **options):
        self.context = Context()
        rclpy.init(context=self.context, args=[])
        self.node = Node(name, context=self.context, namespace=namespace, **options)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._publishers = {}
        self._services = {}
        self._parameters = {}
        self._statuses = {}
        self._states = {}
        self._poses = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        _clients.append(self)

    def _spin(self):
        sent = time.monotonic()
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)
            if time.monotonic() - sent > RESEND:
                sent = time.monotonic()
                for publish, receivers in list(self._poses.values()):
                    if all(process.poll() is None for process in receivers):
                        publish()

    def close(self):
        _clients.remove(self)
        self._stop.set()
        self._thread.join()
        self._executor.shutdown(timeout_sec=0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    # Topics

    def listen(self, kind, topic, qos=LATCHED):
        """Return a list that grows with the messages of a topic."""
        messages = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def follow(self, now=time.time, late=0.0):
        """
        Report on plan_time, as a follower does that flies each plan by its stamps.

        :param now: returns the time in s.
        :param late: s by which it flies later than the stamps.
        """
        statuses = self.listen(DiagnosticStatus, 'planner/status')
        reports = self.node.create_publisher(TimeReference, 'plan_time', 10)
        flown = []  # The plan in flight, or the first: its stamp and its identity.

        def report():
            clock = now()
            for values in map(values_of, statuses[-1:]):
                if 'plan.identity' in values:
                    newest = float(values['plan.stamp']), values['plan.identity']
                    if not flown or newest[0] <= clock:
                        flown[:] = newest
            if flown:
                message = TimeReference(source=f'{flown[1]} /tester',
                                        time_ref=stamp_at(max(clock - late, flown[0])))
                message.header.stamp = stamp_at(clock)
                reports.publish(message)
        self.node.create_timer(0.05, report)

    def publisher(self, kind, topic, qos=None):
        """Return the publisher of a topic, once it has a subscriber."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(
                kind, topic, qos or QoSProfile(depth=10))
        publisher = self._publishers[topic]
        wait_for(publisher.get_subscription_count, what=f'a subscriber of {topic}')
        return publisher

    def send_pose(self, topic, x, y, frame_id='map', stamp=None, qos=None, until_known=True):
        """Send a pose; if until_known, repeat until the planner has received one on this topic."""
        def message():
            return pose_message(PoseStamped, x, y, 0, frame_id, stamp or self.now())
        self._send(self.publisher(PoseStamped, topic, qos), topic, message, stamp, until_known)

    def send_estimate(self, topic, x, y, frame_id='map', stamp=None, variance=0.0,
                      until_known=True):
        """Send an estimate as send_pose does."""
        def message():
            estimate = pose_message(
                PoseWithCovarianceStamped, x, y, 0, frame_id, stamp or self.now())
            estimate.pose.covariance[0] = estimate.pose.covariance[7] = float(variance)
            return estimate
        self._send(
            self.publisher(PoseWithCovarianceStamped, topic), topic, message, stamp, until_known)

    def _send(self, publisher, topic, message, stamp, until_known):
        status = self.status_of('planner')

        def publish():
            publisher.publish(message())

        def is_known():
            publish()
            time.sleep(0.1)
            return not until_known or (status and values_of(status[-1]).get(
                f'pose_age.{topic}', 'none') != 'none')

        # Not while this pose is on its way, and never again if it has a stamp of its own.
        self._poses.pop(topic, None)
        wait_for(is_known, what=f'the pose of {topic}')
        if until_known and stamp is None:
            self._poses[topic] = publish, _running()

    def now(self):
        return self.node.get_clock().now().to_msg()

    def send_paper(self, **options):
        """Send the paper's poses."""
        self.send_pose('ground_node/pose', 0, 0, **options)
        self.send_estimate('eavesdropper/pose', 200, 0, **options)

    def plan_paper(self):
        """Send the paper's poses and have them planned with; return the answer."""
        self.send_paper()
        answer = self.call('planner/plan')
        assert answer.success, answer.message
        return answer

    def status_of(self, node):
        """Return the list of a planner's status messages, which grows."""
        if node not in self._statuses:
            self._statuses[node] = self.listen(DiagnosticStatus, f'{node}/status')
        return self._statuses[node]

    # Services

    def ask(self, service, kind=Trigger, request=None):
        """Return the future of a service's answer."""
        client = self._service(service, kind)
        return client.call_async(request or kind.Request())

    def call(self, service, kind=Trigger, request=None, patience=PATIENCE, lost=None):
        """
        Return the answer of a service, asked again when none comes for some seconds.

        `~/plan` is asked again only when the planner has reported for a long time that it solves
        nothing, so that the answer must have been lost. Asked earlier, the planner would refuse,
        or plan twice.

        :param lost: returns whether there is no hope of an answer; then None is returned.
        """
        node, _, name = service.rpartition('/')
        states = self._states_of(node) if name == 'plan' else None
        futures, asked, since = [], [], 0

        def is_due():
            nonlocal since
            if asked and time.monotonic() - asked[-1] < ASK_AGAIN:
                since = len(states or ())
                return False
            return not asked or states is None or states[since:][-IDLE:] == IDLE * ['idle']

        def answered():
            if is_due():
                futures.append(self.ask(service, kind, request))
                asked.append(time.monotonic())
            done = next((future for future in futures if future.done()), None)
            return done or (lost is not None and lost())

        answer = wait_for(answered, patience, f'the answer of {service}')
        return None if answer is True else answer.result()

    def _states_of(self, node):
        """Return a list that grows each second with the state of a planner."""
        if node not in self._states:
            self._states[node] = []

            def take(message):
                # A name such as 'fleet/planner', or 'planner: plan'.
                self._states[node] += [
                    values_of(status)['state'] for status in message.status
                    if status.name.partition(':')[0].endswith(node.strip('/'))]
            self.node.create_subscription(DiagnosticArray, '/diagnostics', take, 10)
        return self._states[node]

    def _service(self, service, kind):
        if service not in self._services:
            client, later = make_clients(self.node, kind, service)
            self._answer(lambda: later.call_async(GetParameters.Request()),
                         f'the service {service}', again=0.2)
            self._services[service] = client
        client = self._services[service]
        wait_for(client.service_is_ready, what=f'the service {service}')
        return client

    def forget_services(self, node):
        """Discover the services of a node anew, which has been started again."""
        for service in [name for name in self._services if name.startswith(f'{node}/')]:
            del self._services[service]

    def _answer(self, ask, what, again=ASK_AGAIN):
        """Return the first answer to a request that is repeated after some s."""
        futures, asked = [], []

        def answer():
            if not asked or time.monotonic() - asked[-1] > again:
                futures.append(ask())
                asked.append(time.monotonic())
            return next((future for future in futures if future.done()), None)

        return wait_for(answer, what=f'the answer of {what}').result()

    # Parameters

    def _parameter_client(self, node):
        client = self._parameters.get(node)
        if client is None:
            client = self._parameters[node] = AsyncParameterClient(self.node, node)
        wait_for(client.services_are_ready, what=f'the parameters of {node}')
        return client

    def set_parameters(self, node, **values):
        """Return the results of setting parameters of a node."""
        client = self._parameter_client(node)
        parameters = [rclpy.Parameter(name.replace('__', '.'), value=value)
                      for name, value in values.items()]
        return self._answer(lambda: client.set_parameters(parameters),
                            f'{node}/set_parameters').results

    def get_parameters(self, node, *names):
        """Return the values of parameters of a node."""
        client = self._parameter_client(node)
        answer = self._answer(lambda: client.get_parameters(list(names)),
                              f'{node}/get_parameters')
        return [rclpy.parameter.parameter_value_to_python(value) for value in answer.values]

    def all_parameters(self, node):
        """Return the values of all parameters of a node by name."""
        client = self._parameter_client(node)
        names = self._answer(lambda: client.list_parameters([], 0),
                             f'{node}/list_parameters').result.names
        return dict(zip(names, self.get_parameters(node, *names)))


def values_of(status):
    """Return the values of a DiagnosticStatus by key."""
    return {entry.key: entry.value for entry in status.values}


def seconds(stamp):
    return stamp.sec + stamp.nanosec * 1e-9


def stamp_at(time):
    """Return the stamp of a time in s."""
    return Time(nanoseconds=round(time * 1e9)).to_msg()


def pose_message(kind, x, y, z=0, frame_id='map', stamp=None):
    """Return an upright pose, as a message of any kind that has one, at the time 0 by default."""
    message = kind()
    message.header.frame_id = frame_id
    message.header.stamp = stamp or message.header.stamp
    pose = getattr(message.pose, 'pose', message.pose)
    pose.position.x, pose.position.y, pose.position.z = float(x), float(y), float(z)
    pose.orientation.w = 1.0
    return message


def places_of(path):
    """Return the points of a path, (N + 2, 2) in m."""
    return np.array([(at.pose.position.x, at.pose.position.y) for at in path.poses])


def flat(tree, prefix=''):
    """Yield the parameters of a parameter file's tree, their names joined by dots."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f'{prefix}{key}.')
        else:
            yield prefix + key, value
