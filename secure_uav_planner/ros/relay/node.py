"""The relay node: setpoints in the messages of an autopilot's stack, and odometry back from it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.publisher import Publisher
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory

from .guard import Guard, Limits, Stream
from ..messages import (
    check_versions, diagnostic_status, fill_message, import_messages, nanoseconds, read_setpoint)
from ..parameters import RELAY, RELAY_MEMBERS
from ..process import run_node, WorkingNode
from ..references import LocalFrames
from ..relay_reports import RelayState, REPORT_PERIOD
from ..settings import (
    check_references, origin_from, read_settings, Settings, VehicleSettings)
from ..topics import (
    Answer, overridable, publishers, SENSOR, serve, STREAM, subscribe, timer_clock, TOPICS)
from ...errors import brief, OptionError, ParameterError, PlanningError, PoseError, quote
from ...mission.geography import Origin
from ...output.autopilots import rotation, STACKS, Vector

_HOLD_PERIOD = 0.1  # Time [s] between setpoints of a held position.
_WARN_AGAIN = 5.0  # Least time [s] between two equal warnings.


@dataclass(frozen=True)
class RelayUavSettings(VehicleSettings):
    """The parameters of the relay for a UAV."""

    max_speed: float
    max_acceleration: float


@dataclass(frozen=True)
class RelaySettings:
    """The parameters of the relay by their names."""

    uavs: Mapping[str, RelayUavSettings]
    origin: Origin | None
    mission_file: str
    service_introspection: str
    stack: str
    vehicles: tuple[str, ...]
    frame_id: str
    publish_odometry: bool
    setpoint_timeout: float
    max_jump: float
    start_tolerance: float

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> 'RelaySettings':
        """
        Return the settings for the values of all parameters by name.

        :raises PlanningError: for a wrong combination; it names the parameter.
        """
        _check_vehicles(values)
        check_references(values)
        return read_settings(cls, values, origin=origin_from(values), uavs={
            name: read_settings(RelayUavSettings, values, f'{name}.') for name in values['uavs']})


class Relay(WorkingNode):
    """Passes on setpoints and odometry; see docs/relay.md."""

    def __init__(self, **options: Any) -> None:
        super().__init__('relay', **options)
        self._declared = Settings(self, RELAY, RelaySettings.from_values, RELAY_MEMBERS)
        uavs = [*self._settings.uavs]
        self._stack = STACKS[self._settings.stack]
        names = [*(f'{self._stack.package}/{kind}' for kind in self._stack.topics),
                 *self._stack.states]
        self._kinds = dict(zip([*self._stack.topics, *self._stack.states], import_messages(
            'stack', self._settings.stack, self._stack, names), strict=True))
        check_versions(self, names)
        rotation((0.0, 0.0, 0.0, 1.0))  # It imports SciPy before the first setpoint.
        self._is_enabled = True
        self._guard_by_uav = {name: Guard() for name in uavs}
        # The stream of setpoints of each UAV, and its begin by time.monotonic.
        self._streams = {name: (Stream('silent'), time.monotonic()) for name in uavs}
        # A logger for each UAV, so that throttling one does not hide the warnings about another.
        self._loggers = {name: self.get_logger().get_child(name) for name in uavs}
        # Publishers to the autopilot, and last messages of its state, by UAV and kind of message.
        self._outputs: dict[str, dict[str, Publisher]] = {}
        self._states: dict[str, dict[str, Any]] = {name: {} for name in uavs}
        topics = dict(TOPICS['relay', 'pub'])
        if not self._settings.publish_odometry:
            del topics['<uav>/odom']
        self._node_outputs = publishers(self, topics, uavs)
        subscribe(self, TOPICS['relay', 'sub'], self._on_setpoint, self.default_callback_group,
                  uavs)
        vehicles = dict(zip(uavs, self._settings.vehicles or uavs, strict=True))
        for name, vehicle in vehicles.items():
            self._connect_vehicle(name, vehicle)
        self._frames = LocalFrames(
            self, lambda: self._settings, vehicles, self._on_frame_change)
        serve(self, {'~/enable': self._on_enable}, self.default_callback_group)
        self.create_timer(_HOLD_PERIOD, self._on_timer, clock=timer_clock(self))
        # Reports continue when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(REPORT_PERIOD, self._publish_reports, clock=steady)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self._declared.warn_of_unknown()
        if not self._settings.start_tolerance:
            self.get_logger().warning(
                'start_tolerance is 0: the first setpoint is relayed wherever the vehicle is')
        self.get_logger().info(brief(
            f'ready: relays the setpoints of {", ".join(uavs)} to {self._settings.stack}'))

    def _connect_vehicle(self, name: str, vehicle: str) -> None:
        """Create publishers to a UAV's autopilot, and subscriptions to its state, in `vehicle`."""
        self._outputs[name] = {kind: self.create_publisher(
            self._kinds[kind], f'{vehicle}/{topic}', **overridable(STREAM))
            for kind, topic in self._stack.topics.items()}
        for kind, topic in self._stack.states.items():
            self.create_subscription(
                self._kinds[kind], f'{vehicle}/{topic}', partial(self._on_state, name, kind),
                **overridable(SENSOR))

    @property
    def _settings(self) -> RelaySettings:
        return self._declared.current

    @property
    def _now(self) -> int:
        return self.get_clock().now().nanoseconds

    def _limits(self, name: str) -> Limits:
        """Return what the guard of a UAV allows, by the parameters."""
        settings = self._settings
        uav = settings.uavs[name]
        return Limits(uav.max_speed, uav.max_acceleration, settings.max_jump,
                      settings.start_tolerance, settings.setpoint_timeout)

    def _on_enable(self, is_enabled: bool) -> Answer:
        """Enable or disable the relay; after a change, the next setpoints begin new streams."""
        if is_enabled != self._is_enabled:
            for guard in self._guard_by_uav.values():
                guard.forget_stream()
        self._is_enabled = is_enabled
        return True, ('setpoints are passed on' if is_enabled else
                      'nothing is sent until ~/enable is called with true')

    def _on_frame_change(self, name: str, convert: Callable[[Vector], Vector] | None) -> None:
        if convert is not None:
            self._guard_by_uav[name].change_frame(convert)

    def _on_setpoint(self, topic: str, message: MultiDOFJointTrajectory) -> None:
        """Send a setpoint to its autopilot if the guard lets it pass; otherwise note why, warn."""
        if not self._is_enabled:
            return
        name, now = topic.partition('/')[0], self._now
        try:
            if message.joint_names not in ([], [name]):
                raise OptionError(f'joint_names is {quote(message.joint_names)}; it must be '
                                  f'{quote([name])}, or empty')
            if message.header.frame_id != self._settings.frame_id:
                raise OptionError(f'frame_id is {quote(message.header.frame_id)}; it must be '
                                  f'{quote(self._settings.frame_id)}')
            setpoint = read_setpoint(message)
            # The guard works in the vehicle's frame, so that it sees a change of the origin.
            setpoint = replace(setpoint, position=self._frames.to_local(name, setpoint.position))
            fields = self._stack.fields(setpoint, now)
            self._guard_by_uav[name].take(setpoint, now, self._limits(name))
            self._frames.moves.pop(name, None)
        except PlanningError as error:
            age = now - nanoseconds(message.header.stamp)
            if message.joint_names in ([], [name]) and (
                    abs(age) <= self._settings.setpoint_timeout * 1e9):
                # The guard may not have seen the setpoint, because the error came before.
                self._guard_by_uav[name].note_arrival(now, self._limits(name))
            self._guard_by_uav[name].note_refusal(brief(error), now)
            self._loggers[name].warning(
                f'a setpoint of {name} is not relayed: {brief(error)}',
                throttle_duration_sec=_WARN_AGAIN)
        else:
            self._publish(name, fields)

    def _on_timer(self) -> None:
        """Send each UAV's last place if no setpoint passes now; warn when the stream has ended."""
        now = self._now
        for name, guard in self._guard_by_uav.items():
            if guard.has_ended(now, self._limits(name)):
                self._loggers[name].warning(
                    f'no fresh setpoint of {name} has come for '
                    f'{self._settings.setpoint_timeout:g} s; nothing more is sent, so that its '
                    'autopilot notices')
            elif (held := guard.hold(now)) is not None:
                self._loggers[name].warning(
                    f'no setpoint of {name} can be relayed now; its last place is held',
                    throttle_duration_sec=_WARN_AGAIN)
                self._publish(name, self._stack.fields(held, now))

    def _relay_states(self) -> dict[str, RelayState]:
        """Return the state of each UAV's setpoints and its duration in real time [s], by name."""
        states, relay = {}, self.get_fully_qualified_name()
        for name, guard in self._guard_by_uav.items():
            stream = (guard.stream(self._now, self._limits(name)) if self._is_enabled
                      else Stream('disabled'))
            (last, begin), present = self._streams[name], time.monotonic()
            begin = begin if stream.state == last.state else present
            self._streams[name] = stream, begin
            states[name] = RelayState(relay, stream.state, present - begin, stream.reason)
        return states

    def _publish_reports(self) -> None:
        """Publish the state of each UAV's setpoints on its topic `<uav>/relay`."""
        for name, state in self._relay_states().items():
            self._node_outputs[f'{name}/relay'].publish(state.to_message(name))

    def _publish_diagnostics(self) -> None:
        """Publish a status of the vehicles' local frames, and one of each UAV's setpoints."""
        problems = self._frames.problems
        relay = self.get_fully_qualified_name()
        self._node_outputs['/diagnostics'].publish(DiagnosticArray(
            header=Header(stamp=self.get_clock().now().to_msg()), status=[diagnostic_status(
                f'{relay.lstrip("/")}: local frames',
                DiagnosticStatus.WARN if problems else DiagnosticStatus.OK,
                '; '.join(problems) or 'known', {}), *(
                    state._replace(relay=relay.lstrip('/')).to_message(name)
                    for name, state in self._relay_states().items())]))

    def _publish(self, name: str, fields: Mapping[str, Mapping[str, Any]]) -> None:
        for kind, values in fields.items():
            self._outputs[name][kind].publish(fill_message(self._kinds[kind](), values))

    def _on_state(self, name: str, kind: str, message: Any) -> None:
        """
        Keep a message of a vehicle's state; use the state after a message of the first kind.

        A state is the last message of every kind; it is not used while a kind is missing. The
        guard gets the position if it is finite. If also orientation and velocity are finite and
        the local frame is known, odometry is published, unless publish_odometry is off.
        """
        states = self._states[name]
        states[kind] = message
        kinds = list(self._stack.states)
        if kind != kinds[0] or len(states) < len(kinds):
            return
        try:
            odometry = fill_message(Odometry(), self._stack.odometry(*map(states.get, kinds)))
            pose = odometry.pose.pose
            place = _read_finite('position', pose.position, 'xyz')
            # A position is as old as its stamp says; PX4's have none.
            self._guard_by_uav[name].note_position(
                place, nanoseconds(odometry.header.stamp) or self._now)
            _read_finite('orientation', pose.orientation, 'xyzw')
            _read_finite('velocity', odometry.twist.twist.linear, 'xyz')
            place = self._frames.to_mission(name, place)
        except PlanningError as error:
            self._loggers[name].warning(
                f'what {name} reports of itself is not used: {brief(error)}',
                throttle_duration_sec=_WARN_AGAIN)
            return
        if f'{name}/odom' in self._node_outputs:
            self._publish_odometry(name, odometry, place)

    def _publish_odometry(self, name: str, odometry: Odometry, place: Vector) -> None:
        """Publish the odometry of a vehicle, at its `place` in the mission's frame, (3,) in m."""
        header, position = odometry.header, odometry.pose.pose.position
        position.x, position.y, position.z = place
        header.frame_id = self._settings.frame_id
        odometry.child_frame_id = f'{name}/base_link'
        if not (header.stamp.sec or header.stamp.nanosec):
            header.stamp = self.get_clock().now().to_msg()
        publisher = self._node_outputs[f'{name}/odom']
        publisher.publish(odometry)
        if self.count_publishers(publisher.topic_name) > 1:
            self._loggers[name].warning(
                f'another node publishes {publisher.topic_name}, too; set vehicle_odometry of '
                'the replay, or unset publish_odometry of the relay',
                throttle_duration_sec=_WARN_AGAIN)


def _read_finite(name: str, message: Any, fields: str) -> Any:
    """Return the numbers in fields of a message; raise a PoseError unless all are finite."""
    values = tuple(getattr(message, field) for field in fields)
    if not all(map(math.isfinite, values)):
        raise PoseError(f'its {name} is {quote(values)}; it must be finite')
    return values


def _check_vehicles(values: Mapping[str, Any]) -> None:
    """Raise a ParameterError unless `vehicles` is empty or has a unique name for each UAV."""
    vehicles, uavs = values['vehicles'], values['uavs']
    if len(set(vehicles)) < len(vehicles):
        raise ParameterError(f'vehicles is {quote(vehicles)}; the names must be unique')
    if vehicles and len(vehicles) != len(uavs):
        raise ParameterError(f'vehicles is {quote(vehicles)}; it must be empty or have a name for '
                             f'each of uavs, which is {quote(uavs)}')


main = partial(run_node, Relay)

if __name__ == '__main__':
    main()
