"""The relay node: setpoints in the messages of an autopilot's stack."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from trajectory_msgs.msg import MultiDOFJointTrajectory

from .messages import filled, setpoint_of
from .node_parameters import Parameters
from .parameters import RELAY, relay_parameters
from .qos import OVERRIDABLE, STREAM
from .text import brief
from ..autopilots import Stack, STACKS
from ..errors import ParameterError, PlanningError, shown

_HEARTBEAT = 0.1  # s; PX4 asks for more than 2 Hz.
_WARN_AGAIN = 5.0  # s


class Relay(Node):
    """
    Publishes setpoints as the messages of a stack; docs/reference.md describes its interface.

    :raises PlanningError: for a wrong parameter, or when the stack's message package is missing.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__('relay', **options)
        self._settings = Parameters(self, RELAY, _check)
        uavs = self._settings['uavs']
        for name in uavs:
            self._settings.declare(relay_parameters(name))
        self._stack = STACKS[self._settings['stack']]
        self._kinds = _kinds_of(self._settings['stack'], self._stack)
        vehicles = self._settings['vehicles'] or uavs
        self._outputs = {name: self._outputs_of(vehicle)
                         for name, vehicle in zip(uavs, vehicles, strict=True)}
        # Of each UAV the fields of its last messages, and when they were sent, in ns.
        self._last: dict[str, tuple[dict[str, dict[str, Any]], int]] = {}
        for name in uavs:
            self.create_subscription(
                MultiDOFJointTrajectory, f'{name}/setpoint/trajectory',
                lambda message, name=name: self._on_setpoint(name, message), STREAM,
                qos_overriding_options=OVERRIDABLE)
        if self._stack.heartbeat:
            self.create_timer(_HEARTBEAT, self._on_heartbeat)
        self._settings.warn_of_unknown()
        self.get_logger().info(brief(
            f'ready: relays the setpoints of {", ".join(uavs)} to {self._settings["stack"]}'))

    def close(self) -> bool:
        """Return whether nothing is left running."""
        return True

    def _outputs_of(self, vehicle: str) -> dict[str, Publisher]:
        return {kind: self.create_publisher(
            self._kinds[kind], f'{vehicle}/{topic}', STREAM, qos_overriding_options=OVERRIDABLE)
            for kind, topic in self._stack.topics.items()}

    def _on_setpoint(self, name: str, message: MultiDOFJointTrajectory) -> None:
        now = self.get_clock().now().nanoseconds
        try:
            setpoint = setpoint_of(message).seen_from(self._settings[f'{name}.origin'])
            fields = self._stack.fields(setpoint, now)
        except PlanningError as error:
            self.get_logger().warning(
                f'a setpoint of {name} is not relayed: {brief(error)}',
                throttle_duration_sec=_WARN_AGAIN)
            return
        self._last[name] = fields, now
        self._publish(name, fields)

    def _on_heartbeat(self) -> None:
        now = self.get_clock().now().nanoseconds
        for name, (fields, sent) in list(self._last.items()):
            # An autopilot must notice that setpoints have stopped.
            if not 0 <= now - sent < self._settings['setpoint_timeout'] * 1e9:
                del self._last[name]
                self.get_logger().warning(
                    f'no setpoint of {name} has come for {(now - sent) * 1e-9:.1f} s; the '
                    'heartbeat ends')
                continue
            self._publish(name, {kind: {**fields[kind], 'timestamp': now // 1000}
                                 for kind in self._stack.heartbeat})

    def _publish(self, name: str, fields: Mapping[str, Mapping[str, Any]]) -> None:
        for kind, values in fields.items():
            self._outputs[name][kind].publish(filled(self._kinds[kind](), values))


def _kinds_of(name: str, stack: Stack) -> dict[str, type]:
    """Return the message classes of a stack by their names."""
    try:
        package = import_module(f'{stack.package}.msg')
        return {kind: getattr(package, kind) for kind in stack.topics}
    except (ImportError, AttributeError) as error:
        raise ParameterError(
            f'parameter stack is {name}: its message package {stack.package} is missing '
            f'({brief(error, 100)}); {stack.source}') from None


def _check(values: Mapping[str, Any]) -> None:
    vehicles, uavs = values['vehicles'], values['uavs']
    for name in ('uavs', 'vehicles'):
        if len(set(values[name])) < len(values[name]):
            raise ParameterError(f'{name} is {shown(values[name])}; the names must be unique')
    if vehicles and len(vehicles) != len(uavs):
        raise ParameterError(f'vehicles is {shown(vehicles)}; it must be empty or have a name for '
                             f'each of uavs, which is {shown(uavs)}')
