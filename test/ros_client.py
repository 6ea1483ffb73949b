"""
A client of the nodes, which uses them like any other program, and its messages.

No wait here depends on the speed of the machine; see ros_nodes.py.
"""

import time

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
import rclpy
from rclpy.time import Time
from ros_nodes import clients, PATIENCE, running, wait_for
from secure_uav_planner.ros.client import make_clients, SecurePlanner
from secure_uav_planner.ros.parameters import PLANNER, PLANNER_MEMBERS, read_member_specs
from secure_uav_planner.ros.planner.settings import PlannerSettings
from secure_uav_planner.ros.planner_status import PlannerStatus
from secure_uav_planner.ros.topics import LATCHED
from sensor_msgs.msg import TimeReference
from std_srvs.srv import Trigger

DEFAULTS = {name: spec.default for name, spec in PLANNER.items()} | {'tracks': {}}
DEFAULTS |= {name: spec.default
             for name, spec in read_member_specs(DEFAULTS, PLANNER_MEMBERS).items()}
SETTINGS = PlannerSettings.from_values(DEFAULTS)
RESEND = 3.0  # s, well below the planner's default pose_timeout


def settings_with(**values):
    """Return the settings of the planner with the defaults, but for some parameters."""
    return PlannerSettings.from_values({**DEFAULTS, **values})


class Client:
    """
    A SecurePlanner, and what tests need besides: any topic, any service, poses of any kind.

    Poses that it has sent with the time of now are sent again every few seconds, as a real
    localisation would, so that they are not too old when a busy machine processes them. That ends
    when a node ends that was running when they were sent.

    :ivar statuses: each PlannerStatus that has come, the newest last.
    """

    def __init__(self, namespace=''):
        self.statuses = []
        self._planner = SecurePlanner(namespace=namespace, on_status=self.statuses.append)
        self._publishers, self._services, self._poses = {}, {}, {}

    def __enter__(self):
        self.node = self._planner.__enter__().node
        self.node.create_timer(RESEND, self._resend)
        clients.append(self)
        return self

    def __exit__(self, *_):
        clients.remove(self)
        self._planner.__exit__()

    @property
    def status(self):
        """Return the planner's last status."""
        return self._planner.status

    def forget_status(self):
        """Wait anew for what the status says."""
        self._planner.status = PlannerStatus()

    @property
    def last_plan(self):
        """Return the last plan of the planner, or None."""
        return self._planner.last_plan

    def _resend(self):
        for publish, receivers in list(self._poses.values()):
            if all(process.poll() is None for process in receivers):
                publish()

    # Topics

    def listen(self, kind, topic, qos=LATCHED):
        """Return a list that grows with the messages of a topic."""
        messages = []
        self._planner.receive(kind, topic, messages.append, qos)
        return messages

    def follow(self, now=time.time, late=0.0):
        """
        Report on plan_time, as a follower does that flies each plan by its stamps.

        :param now: returns the time in s.
        :param late: s by which it flies later than the stamps.
        """
        reports = self.node.create_publisher(TimeReference, 'plan_time', 10)
        flown = []  # The plan in flight, or the first: its stamp and its identity.

        def report():
            clock, plan = now(), self.status.plan
            if plan.identity:
                newest = plan.stamp, plan.identity
                if not flown or newest[0] <= clock:
                    flown[:] = newest
            if flown:
                message = TimeReference(source=f'{flown[1]} /tester',
                                        time_ref=stamp_at(max(clock - late, flown[0])))
                message.header.stamp = stamp_at(clock)
                reports.publish(message)
        self.node.create_timer(0.05, report)

    def publisher(self, kind, topic, qos=10):
        """Return the publisher of a topic, once it has a subscriber."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
        publisher = self._publishers[topic]
        wait_for(publisher.get_subscription_count, what=f'a subscriber of {topic}')
        return publisher

    def send_pose(self, topic, x, y, frame_id='map', stamp=None, qos=10, until_known=True):
        """Send a pose; if until_known, repeat until the planner has received one on this topic."""
        self._send(topic, lambda: pose_message(
            PoseStamped, x, y, 0, frame_id, stamp or self.now()), stamp, until_known, qos)

    def send_estimate(self, topic, x, y, frame_id='map', stamp=None, variance=0.0,
                      until_known=True):
        """Send an estimate as send_pose does."""
        def message():
            estimate = pose_message(
                PoseWithCovarianceStamped, x, y, 0, frame_id, stamp or self.now())
            set_variance(estimate.pose.covariance, variance)
            return estimate
        self._send(topic, message, stamp, until_known)

    def _send(self, topic, message, stamp, until_known, qos=10):
        made = message()
        publisher = self.publisher(type(made), topic, qos)
        # Not while this pose is on its way, and never again if it has a stamp of its own.
        self._poses.pop(topic, None)
        publisher.publish(made)
        if not until_known:
            return

        def publish():
            publisher.publish(message())

        def is_known():
            publish()
            time.sleep(0.1)
            return self.status.has_pose(topic)
        wait_for(is_known, what=f'the pose of {topic}')
        if stamp is None:
            self._poses[topic] = publish, running()

    def send_odometry(self, topic, x, y, velocity, **options):
        """Send odometry until the planner has received one on this topic."""
        publisher = self.publisher(Odometry, topic)

        def is_known():
            publisher.publish(odometry_message(x, y, velocity, stamp=self.now(), **options))
            time.sleep(0.1)
            return self.status.has_pose(topic)
        wait_for(is_known, what=f'the odometry of {topic}')

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

    # Services

    def ask(self, service, kind=Trigger, request=None):
        """Return the future of a service's answer, which is asked for once the node is there."""
        if service not in self._services:
            self._services[service] = make_clients(self.node, kind, service)
        client, later = self._services[service]
        answers = []
        # Each time, since the node may have been started again.
        self._planner.wait_until(
            lambda: any(answer.done() for answer in answers), f'the service {service}',
            lambda: answers.append(later.call_async(GetParameters.Request())), PATIENCE)
        return client.call_async(request or kind.Request())

    def call(self, service, kind=Trigger, request=None):
        """Return the answer of a service."""
        answer = self.ask(service, kind, request)
        wait_for(answer.done, what=f'the answer of {service}')
        return answer.result()

    # Parameters

    def set_parameters(self, node, **values):
        """Return the results of setting parameters of a node."""
        parameters = [rclpy.Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
                      for name, value in values.items()]
        return self.call(f'{node}/set_parameters', SetParameters,
                         SetParameters.Request(parameters=parameters)).results

    def get_parameters(self, node, *names):
        """Return the values of parameters of a node."""
        answer = self.call(f'{node}/get_parameters', GetParameters,
                           GetParameters.Request(names=names))
        return [rclpy.parameter.parameter_value_to_python(value) for value in answer.values]

    def all_parameters(self, node):
        """Return the values of all parameters of a node by name."""
        names = self.call(f'{node}/list_parameters', ListParameters).result.names
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


def set_variance(covariance, variance):
    """Set the variances of x and y in the 36 values of a covariance."""
    covariance[0] = covariance[7] = float(variance)


def odometry_message(x, y, velocity=(0.0, 0.0), frame_id='map', child_frame_id='map', stamp=None,
                     variance=0.0, velocity_variance=0.0):
    """Return odometry with round covariances; its velocity is in the frame of the child."""
    message = pose_message(Odometry, x, y, 0, frame_id, stamp)
    message.child_frame_id = child_frame_id
    message.twist.twist.linear.x, message.twist.twist.linear.y = map(float, velocity)
    set_variance(message.pose.covariance, variance)
    set_variance(message.twist.covariance, velocity_variance)
    return message


def numbers(message, names='xyz'):
    """Return the values of fields of a message."""
    return [getattr(message, name) for name in names]


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
