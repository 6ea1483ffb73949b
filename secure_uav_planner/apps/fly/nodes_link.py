"""The link of a flight to a planner and a replay node."""

from collections import Counter

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from rclpy.time import Time
from sensor_msgs.msg import TimeReference
from std_srvs.srv import Trigger

from .link import FlightError, Link
from ...ros import messages
from ...ros.topics import LATCHED, STREAM

_COUNTS = ('plans', 'replans', 'refusals')


class NodesLink(Link):
    """
    What the two nodes publish, and what a user and the vehicles send.

    :param scenario: the mission; of its one eavesdropper the node knows the error radius.
    :ivar paths: all nav_msgs/Path of each UAV.
    :ivar plan_time: the last sensor_msgs/TimeReference of the replay, or None.
    :ivar status: the values of the planner's status, by key.
    :ivar warnings: how many times that was not OK, by its text.
    :ivar is_solving: whether the planner solves, or has not said yet what has come of it.
    """

    def __init__(self, scenario):
        super().__init__([uav.name for uav in scenario.uavs])
        self.paths = [[] for _ in self._names]
        self.plan_time, self.status, self.warnings = None, {}, Counter()
        self.is_solving, self._settled = False, None
        self._scenario = scenario

    def _connect(self):
        super()._connect()
        make = self._node.create_publisher
        self._odometry = [make(Odometry, f'{name}/odom', STREAM) for name in self._names]
        self._ground_node = make(PoseStamped, 'ground_node/pose', STREAM)
        self._estimate = make(PoseWithCovarianceStamped, 'eavesdropper/pose', STREAM)
        self._services = {name: self._node.create_client(Trigger, name) for name in (
            'planner/plan', 'replay/start', 'replay/pause')}
        receive = self._node.create_subscription
        for name, paths in zip(self._names, self.paths, strict=True):
            receive(Path, f'{name}/path', paths.append, LATCHED)
        receive(DiagnosticStatus, 'planner/status', self._take_status, LATCHED)
        receive(TimeReference, 'plan_time',
                lambda message: setattr(self, 'plan_time', message), STREAM)

    def _is_connected(self):
        return super()._is_connected() and self._clock.get_subscription_count() > 1 and all(
            service.service_is_ready() for service in self._services.values())

    def _take_status(self, message):
        self.status = {entry.key: entry.value for entry in message.values}
        if message.level != DiagnosticStatus.OK:
            self.warnings[message.message] += 1
        counts = [self.status[key] for key in _COUNTS]
        if self.status['state'] == 'solving':
            self.is_solving = True
        elif not self.is_solving or counts != self._settled:
            self.is_solving, self._settled = False, counts

    def knows_poses(self):
        """Return whether the planner knows where everybody is."""
        return all(self.status.get(f'pose_age.{topic}', 'none') != 'none' for topic in (
            'ground_node/pose', 'eavesdropper/pose', *(f'{name}/odom' for name in self._names)))

    def has_come_to(self, now_ns):
        """Return whether the replay has come to a time in ns with all that it sends."""
        return nanoseconds(self.plan_time.header.stamp) == now_ns and (not self.received or all(
            name in self.received and self.received[name].time_ns == now_ns
            for name in self._names))

    def call(self, service):
        """
        Call a service.

        :raises FlightError: if it fails, with its message.
        """
        future = self._services[service].call_async(Trigger.Request())
        self.wait(future.done, f'the answer of {service}')
        if not future.result().success:
            raise FlightError(f'{service}: {future.result().message}')

    def report(self, now_ns, vehicles):
        """Publish where everybody is at a time in ns."""
        stamp = Time(nanoseconds=now_ns).to_msg()
        self._ground_node.publish(
            messages.pose_stamped('map', stamp, *self._scenario.ground_node, 0.0, 0.0))
        estimate = PoseWithCovarianceStamped()
        estimate.header.frame_id, estimate.header.stamp = 'map', stamp
        eavesdropper, = self._scenario.eavesdroppers
        estimate.pose.pose = messages.pose(*eavesdropper.position, 0.0, 0.0)
        self._estimate.publish(estimate)
        for name, publisher, vehicle in zip(self._names, self._odometry, vehicles, strict=True):
            publisher.publish(messages.odometry(
                'map', f'{name}/base_link', stamp, vehicle.place, 0.0, vehicle.velocity[:2]))


def nanoseconds(stamp):
    """Return the ns of a builtin_interfaces/Time."""
    return stamp.sec * 10**9 + stamp.nanosec
