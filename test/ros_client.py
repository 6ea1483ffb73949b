"""A program that talks to the nodes as any other would, and the nodes' processes."""

from contextlib import contextmanager
import os
import signal
import subprocess
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from secure_uav_planner.ros.qos import LATCHED
from std_srvs.srv import Trigger

PATIENCE = 30.0


def wait_for(condition, patience=PATIENCE, what='the condition'):
    """Return what the condition returns once that is true; fail after the patience in s."""
    until = time.monotonic() + patience
    while not (found := condition()):
        assert time.monotonic() < until, f'{what} did not come true in {patience} s'
        time.sleep(0.01)
    return found


@contextmanager
def node_process(name, *arguments, namespace=None, **parameters):
    """Run a node in a process of its own; yield the process, with its output in .lines."""
    command = [sys.executable, '-m', f'secure_uav_planner.ros.{name}', '--ros-args']
    if namespace:
        command += ['-r', f'__ns:={namespace}']
    for key, value in parameters.items():
        command += ['-p', f'{key.replace("__", ".")}:={value}']
    process = subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, 'PYTHONUNBUFFERED': '1'})
    process.lines = []
    reader = threading.Thread(target=lambda: process.lines.extend(process.stdout), daemon=True)
    reader.start()
    process.reader = reader
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
        process.wait()
        reader.join(timeout=5)


def output_of(process):
    """Return all output of a process that has ended."""
    process.reader.join(timeout=5)
    return ''.join(process.lines)


class Client:
    """A node of its own context, spun in the background."""

    def __init__(self, name='tester', namespace='', **options):
        self.context = Context()
        rclpy.init(context=self.context, args=[])
        self.node = Node(name, context=self.context, namespace=namespace, **options)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        self._publishers = {}
        self._services = {}

    def _spin(self):
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def close(self):
        self._stop.set()
        self._thread.join()
        self._executor.shutdown(timeout_sec=0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def listen(self, kind, topic, qos=LATCHED):
        """Return a list that grows with the messages of a topic."""
        found = []
        self.node.create_subscription(kind, topic, found.append, qos)
        return found

    def publisher(self, kind, topic, qos=None):
        """Return the publisher of a topic, once somebody listens."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(
                kind, topic, qos or QoSProfile(depth=10))
        publisher = self._publishers[topic]
        wait_for(publisher.get_subscription_count, what=f'a subscriber of {topic}')
        return publisher

    def send_pose(self, topic, x, y, frame_id='map', stamp=None, qos=None, heard=True):
        """Send a pose; if heard, again and again until the planner knows one of this topic."""
        def message():
            found = PoseStamped()
            self._fill(found.header, found.pose, x, y, frame_id, stamp)
            return found
        self._send(self.publisher(PoseStamped, topic, qos), topic, message, heard)

    def send_estimate(self, topic, x, y, frame_id='map', stamp=None, variance=0.0, heard=True):
        """Send an estimate as send_pose does."""
        def message():
            found = PoseWithCovarianceStamped()
            self._fill(found.header, found.pose.pose, x, y, frame_id, stamp)
            found.pose.covariance[0] = found.pose.covariance[7] = float(variance)
            return found
        self._send(self.publisher(PoseWithCovarianceStamped, topic), topic, message, heard)

    def _send(self, publisher, topic, message, heard):
        if 'status' not in self._services:
            self._services['status'] = self.listen(DiagnosticStatus, 'planner/status')
        status = self._services['status']

        def known():
            publisher.publish(message())
            time.sleep(0.1)
            return not heard or (status and values_of(status[-1]).get(
                f'pose_age.{topic}', 'none') != 'none')
        wait_for(known, what=f'the pose of {topic}')

    def _fill(self, header, pose, x, y, frame_id, stamp):
        header.frame_id = frame_id
        header.stamp = self.node.get_clock().now().to_msg() if stamp is None else stamp
        pose.position.x, pose.position.y = float(x), float(y)
        pose.orientation.w = 1.0

    def send_paper(self, **options):
        """Send the paper's poses."""
        self.send_pose('ground_node/pose', 0, 0, **options)
        self.send_estimate('eavesdropper/pose', 200, 0, **options)

    def ask(self, service, kind=Trigger, request=None):
        """Return the future of a service's answer."""
        if service not in self._services:
            self._services[service] = self.node.create_client(kind, service)
        client = self._services[service]
        wait_for(client.service_is_ready, what=f'the service {service}')
        return client.call_async(request or kind.Request())

    def call(self, service, patience=PATIENCE):
        """Return the answer of a Trigger service."""
        future = self.ask(service)
        wait_for(future.done, patience, f'the answer of {service}')
        return future.result()

    def set_parameters(self, node, **values):
        """Return the results of setting parameters of a node."""
        client = self._services.setdefault(node, AsyncParameterClient(self.node, node))
        wait_for(client.services_are_ready, what=f'the parameters of {node}')
        future = client.set_parameters([
            rclpy.Parameter(name.replace('__', '.'), value=value)
            for name, value in values.items()])
        wait_for(future.done)
        return future.result().results

    def get_parameters(self, node, *names):
        """Return the values of parameters of a node."""
        client = self._services.setdefault(node, AsyncParameterClient(self.node, node))
        wait_for(client.services_are_ready, what=f'the parameters of {node}')
        future = client.get_parameters(list(names))
        wait_for(future.done)
        return [rclpy.parameter.parameter_value_to_python(value)
                for value in future.result().values]


def values_of(status):
    """Return the values of a DiagnosticStatus by key."""
    return {entry.key: entry.value for entry in status.values}


def flat(tree, prefix=''):
    """Yield the parameters of a parameter file's tree, their names joined by dots."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f'{prefix}{key}.')
        else:
            yield prefix + key, value
