"""The relay node: setpoints in the messages of an autopilot's stack, and odometry back from it."""

from collections.abc import Mapping
from functools import partial
import math
from operator import add
from pathlib import Path
import sys
from typing import Any

from nav_msgs.msg import Odometry
import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from trajectory_msgs.msg import MultiDOFJointTrajectory

from .guard import Guard, Limits
from .messages import class_of, filled, setpoint_of
from .node_parameters import Parameters
from .parameters import RELAY, relay_parameters
from .process import run_node
from .spec import Spec
from .topics import OVERRIDABLE, publishers, SENSOR, STREAM, subscribe, timer_clock, TOPICS
from ..errors import brief, ParameterError, PlanningError, PoseError, quote
from ..output.autopilots import rotation, Stack, STACKS, Vector

_HOLD_PERIOD = 0.1  # s
_WARN_AGAIN = 5.0  # s


class Relay(Node):
    """Passes on setpoints and odometry; see docs/relay.md."""

    def __init__(self, **options: Any) -> None:
        super().__init__('relay', **options)
        self._settings = Parameters(self, RELAY, _check, _parameters_of_uavs)
        uavs = self._settings['uavs']
        self._stack = STACKS[self._settings['stack']]
        self._kinds = _kinds_of(self._settings['stack'], self._stack)
        rotation((0.0, 0.0, 0.0, 1.0))  # SciPy is imported now and not when a setpoint comes.
        self._guard_of = {name: Guard() for name in uavs}
        # A logger for each UAV, as what one of them repeats must not hide what another one says.
        self._logger_of = {name: self.get_logger().get_child(name) for name in uavs}
        self._outputs: dict[str, dict[str, Publisher]] = {}
        self._reports: dict[str, dict[str, Any]] = {name: {} for name in uavs}
        self._odometry = publishers(self, TOPICS['relay', 'pub'], uavs) if (
            self._settings['publish_odometry']) else {}
        subscribe(self, TOPICS['relay', 'sub'], self._on_setpoint, self.default_callback_group,
                  uavs)
        for name, vehicle in zip(uavs, self._settings['vehicles'] or uavs, strict=True):
            self._connect(name, vehicle)
        self.create_timer(_HOLD_PERIOD, self._on_timer, clock=timer_clock(self))
        self._settings.warn_of_unknown()
        self.get_logger().info(brief(
            f'ready: relays the setpoints of {", ".join(uavs)} to {self._settings["stack"]}'))

    def close(self) -> bool:
        """Return whether nothing is left running."""
        return True

    def _connect(self, name: str, vehicle: str) -> None:
        self._outputs[name] = {kind: self.create_publisher(
            self._kinds[kind], f'{vehicle}/{topic}', STREAM, qos_overriding_options=OVERRIDABLE)
            for kind, topic in self._stack.topics.items()}
        for kind, topic in self._stack.reports.items():
            self.create_subscription(
                self._kinds[kind], f'{vehicle}/{topic}', partial(self._on_report, name, kind),
                SENSOR, qos_overriding_options=OVERRIDABLE)

    @property
    def _now(self) -> int:
        return self.get_clock().now().nanoseconds

    def _limits_of(self, name: str) -> Limits:
        return Limits(self._settings[f'{name}.max_speed'], self._settings['max_jump'],
                      self._settings['start_tolerance'], self._settings['setpoint_timeout'])

    def _on_setpoint(self, topic: str, message: MultiDOFJointTrajectory) -> None:
        name, now = topic.partition('/')[0], self._now
        try:
            # Guarded as it is sent, so that a change of the origin counts as a jump, too.
            setpoint = setpoint_of(message).seen_from(self._settings[f'{name}.origin'])
            fields = self._stack.fields(setpoint, now)
            self._guard_of[name].take(setpoint, now, self._limits_of(name))
        except PlanningError as error:
            self._logger_of[name].warning(
                f'a setpoint of {name} is not relayed: {brief(error)}',
                throttle_duration_sec=_WARN_AGAIN)
        else:
            self._publish(name, fields)

    def _on_timer(self) -> None:
        now = self._now
        for name, guard in self._guard_of.items():
            if guard.has_ended(now, self._limits_of(name)):
                self._logger_of[name].warning(
                    f'no setpoint of {name} has come for {self._settings["setpoint_timeout"]:g} '
                    's; nothing more is sent, so that its autopilot notices')
            elif (held := guard.hold(now)) is not None:
                self._logger_of[name].warning(
                    f'no setpoint of {name} can be relayed now; its last place is held',
                    throttle_duration_sec=_WARN_AGAIN)
                self._publish(name, self._stack.fields(held, now))

    def _publish(self, name: str, fields: Mapping[str, Mapping[str, Any]]) -> None:
        for kind, values in fields.items():
            self._outputs[name][kind].publish(filled(self._kinds[kind](), values))

    def _on_report(self, name: str, kind: str, message: Any) -> None:
        """Take where a vehicle is from each of the first kind of its reports."""
        reports = self._reports[name]
        reports[kind] = message
        kinds = list(self._stack.reports)
        if kind != kinds[0] or len(reports) < len(kinds):
            return
        try:
            odometry = filled(Odometry(), self._stack.odometry(*map(reports.get, kinds)))
            pose = odometry.pose.pose
            place = _finite('position', pose.position, 'xyz')
            self._guard_of[name].see(place, self._now)
            _finite('orientation', pose.orientation, 'xyzw')
            _finite('velocity', odometry.twist.twist.linear, 'xyz')
        except PlanningError as error:
            self._logger_of[name].warning(
                f'what {name} reports of itself is not used: {brief(error)}',
                throttle_duration_sec=_WARN_AGAIN)
            return
        if self._odometry:
            self._publish_odometry(name, odometry, place)

    def _publish_odometry(self, name: str, odometry: Odometry, place: Vector) -> None:
        header, position = odometry.header, odometry.pose.pose.position
        position.x, position.y, position.z = map(add, place, self._settings[f'{name}.origin'])
        header.frame_id = self._settings['frame_id']
        odometry.child_frame_id = f'{name}/base_link'
        if not (header.stamp.sec or header.stamp.nanosec):
            header.stamp = self.get_clock().now().to_msg()
        publisher = self._odometry[f'{name}/odom']
        publisher.publish(odometry)
        if self.count_publishers(publisher.topic_name) > 1:
            self._logger_of[name].warning(
                f'another node publishes {publisher.topic_name}, too; set vehicle_odometry of '
                'the replay, or unset publish_odometry of the relay',
                throttle_duration_sec=_WARN_AGAIN)


def _finite(name: str, message: Any, fields: str) -> Any:
    """Return the numbers in fields of a message, or raise a PoseError with the name."""
    values = tuple(getattr(message, field) for field in fields)
    if not all(map(math.isfinite, values)):
        raise PoseError(f'its {name} is {quote(values)}; it must be finite')
    return values


def _kinds_of(name: str, stack: Stack) -> dict[str, type]:
    """Return the message classes of a stack by what it calls them."""
    try:
        return {**{kind: class_of(f'{stack.package}/{kind}') for kind in stack.topics},
                **{kind: class_of(kind) for kind in stack.reports}}
    except (ImportError, AttributeError) as error:
        raise ParameterError(
            f'parameter stack is {name}: its message package {stack.package} is missing '
            f'({brief(error, 100)}); {_advice(stack)}') from None


def _advice(stack: Stack) -> str:
    """Return how to get the message package of a stack beside the ROS that is installed."""
    way = (f'apt install {stack.debian}' if stack.debian else
           f'build {stack.source} in your workspace with colcon, and source that')
    if Path(rclpy.__file__).is_relative_to(sys.prefix):
        return f'ROS from wheels cannot have it; run the relay with ROS from apt: {way}'
    return way


def _parameters_of_uavs(values: Mapping[str, Any]) -> dict[str, Spec]:
    return {name: spec for index, uav in enumerate(values['uavs'])
            for name, spec in relay_parameters(uav, index).items()}


def _check(values: Mapping[str, Any]) -> None:
    vehicles, uavs = values['vehicles'], values['uavs']
    for name in ('uavs', 'vehicles'):
        if len(set(values[name])) < len(values[name]):
            raise ParameterError(f'{name} is {quote(values[name])}; the names must be unique')
    if vehicles and len(vehicles) != len(uavs):
        raise ParameterError(f'vehicles is {quote(vehicles)}; it must be empty or have a name for '
                             f'each of uavs, which is {quote(uavs)}')


main = partial(run_node, Relay)

if __name__ == '__main__':
    main()
