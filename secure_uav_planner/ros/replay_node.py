"""The replay node: UAVs that follow a plan exactly."""

from collections.abc import Mapping
import math
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from . import messages
from .assembly import Assembly
from .drawing import Drawing
from .node_parameters import Parameters
from .parameters import REPLAY
from .qos import LATCHED, OVERRIDABLE, STREAM
from .text import brief
from ..errors import ParameterError, PlanningError, shown
from ..plan import Plan
from ..playback import Moment, Player
from ..scenario import Point

_MOST_WARNINGS = 5  # About the plan of the topics, until a plan is valid.


class Replay(Node):
    """
    Replays the plan of the topics, or a saved plan; docs/reference.md describes its interface.

    :raises PlanningError: for a wrong parameter or plan file; the text names it.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__('replay', **options)
        self._settings = Parameters(self, REPLAY, _check)
        self._uavs = self._settings['uavs']
        self._frame_id = self._settings['frame_id']
        self._player = Player()
        self._last_tick: int | None = None
        self._trajectory_topics: dict[str, str] = {}
        self._assembly = Assembly(self._uavs, lambda name: self.count_publishers(
            self._trajectory_topics[name]) > 0)
        self._warned: set[str] = set()
        self._drawing = Drawing(lambda reason: self.get_logger().warning(
            f'picture_file: {reason}; the replay goes on without'))
        self._announced_end = False
        # All callbacks use the same player, so they run one at a time.
        self._group = MutuallyExclusiveCallbackGroup()
        if self._settings['plan_file']:
            self._load_file(self._settings['plan_file'])
        else:
            self._subscribe()
        self._make_interface()
        self._settings.warn_of_unknown()
        self.get_logger().info(brief('ready: ~/start replays ' + ', '.join(self._uavs)))

    def _load_file(self, file: str) -> None:
        try:
            plan = Plan.load(file)
        except (OSError, ValueError) as error:
            raise ParameterError(f'parameter plan_file: {brief(error)}') from None
        self._uavs = [uav.name for uav in plan.scenario.uavs]
        self._take(plan)

    def _subscribe(self) -> None:
        for name in self._uavs:
            for kind, topic in ((Path, 'path'), (Float64MultiArray, 'power'),
                                (MultiDOFJointTrajectory, 'trajectory')):
                subscription = self.create_subscription(
                    kind, f'{name}/{topic}',
                    lambda message, name=name: self._assembly.take(
                        name, message, self.get_clock().now().nanoseconds),
                    LATCHED, callback_group=self._group, qos_overriding_options=OVERRIDABLE)
            self._trajectory_topics[name] = subscription.topic_name

    def _make_interface(self) -> None:
        def stream(kind: type, topic: str) -> Publisher:
            return self.create_publisher(
                kind, topic, STREAM, qos_overriding_options=OVERRIDABLE)

        self._poses = [stream(PoseStamped, f'{name}/setpoint/pose') for name in self._uavs]
        self._trajectories = [stream(MultiDOFJointTrajectory, f'{name}/setpoint/trajectory')
                              for name in self._uavs]
        self._watts = [stream(Float64, f'{name}/setpoint/power') for name in self._uavs]
        self._odometry = [stream(Odometry, f'{name}/odom') for name in self._uavs]
        self._rate = stream(Float64, '~/secrecy_rate')
        self._markers = stream(MarkerArray, '~/markers')
        for name, action in (('start', self._on_start), ('pause', self._on_pause),
                             ('reset', self._on_reset)):
            self.create_service(Trigger, f'~/{name}', action, callback_group=self._group)
        self.create_timer(1.0 / self._settings['rate'], self._on_tick,
                          callback_group=self._group)

    def close(self) -> bool:
        """Stop drawing; return whether nothing is left running."""
        return self._drawing.close(timeout=0.5)

    def _assemble(self) -> str:
        """Load the plan of the topics; return the reason if that fails, or an empty string."""
        try:
            plan, frame_id = self._assembly.plan(
                self._settings['ground_node'], self._settings['reference_snr_db'],
                self._eavesdropper)
        except PlanningError as error:
            reason = brief(error)
            if reason not in self._warned and len(self._warned) < _MOST_WARNINGS:
                self._warned.add(reason)
                self.get_logger().warning(f'the plan of the topics is not used: {reason}')
            return reason
        self._warned.clear()
        self._frame_id = frame_id
        self._take(plan)
        missing = self._assembly.without_trajectory()
        if missing:
            self.get_logger().warning(brief(
                'nothing has come on ' + ', '.join(f'{name}/trajectory' for name in missing)
                + ' that belongs to this plan; it is flown straight from point to point'))
        return ''

    def _take(self, plan: Plan) -> None:
        self._player.load(plan)
        self._announced_end = False
        self.get_logger().info(f'got a plan of {plan.scenario.slots} slots for '
                               f'{", ".join(self._uavs)}')
        if self._settings['autostart']:
            self._player.start()
        if self._settings['picture_file']:
            self._drawing.draw(plan, self._settings['picture_file'])

    @property
    def _eavesdropper(self) -> Point | None:
        return tuple(self._settings['true_eavesdropper']) or None

    def _on_start(self, _request: Trigger.Request, response: Trigger.Response
                  ) -> Trigger.Response:
        reason = self._assemble() if self._assembly.is_whole() else ''
        response.success = self._player.playback is not None
        if response.success:
            self._player.start()
            self._announced_end = False
            response.message = 'playing'
        else:
            response.message = 'there is no plan yet' + (f': {reason}' if reason else '')
        return response

    def _on_pause(self, _request: Trigger.Request, response: Trigger.Response
                  ) -> Trigger.Response:
        response.success = self._player.playing
        response.message = 'paused' if response.success else 'nothing is playing'
        self._player.pause()
        return response

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response
                  ) -> Trigger.Response:
        self._player.reset()
        response.success, response.message = True, 'back at the start'
        return response

    def _on_tick(self) -> None:
        clock = self.get_clock().now()
        now = clock.nanoseconds
        if self._assembly.is_due(now):
            self._assemble()
        # If the clock jumps back, time stands still for one tick and the flight continues.
        seconds = 0.0 if self._last_tick is None else max(0, now - self._last_tick) * 1e-9
        self._last_tick = now
        if not self._player.streaming:
            return
        moment = self._player.advance(
            seconds * self._settings['speed'], self._eavesdropper)
        self._publish(moment, clock.to_msg())
        if self._player.finished and not self._announced_end:
            self._announce_end()

    def _publish(self, moment: Moment, stamp: Stamp) -> None:
        scenario = self._player.playback.plan.scenario
        speed = self._settings['speed'] if self._player.playing else 0.0
        places = []
        for index, (uav, (x, y), yaw) in enumerate(
                zip(scenario.uavs, moment.positions, moment.headings)):
            places.append((x, y, uav.altitude))
            self._poses[index].publish(
                messages.pose_stamped(self._frame_id, stamp, *places[-1], yaw))
            self._watts[index].publish(messages.float64(moment.powers[index]))
            velocity = moment.velocities[index] * speed
            self._odometry[index].publish(messages.odometry(
                self._frame_id, f'{uav.name}/base_link', stamp, places[-1], yaw, velocity))
            self._trajectories[index].publish(messages.trajectory_setpoint(
                uav.name, self._frame_id, stamp,
                (places[-1], yaw, velocity, moment.accelerations[index] * speed**2)))
        self._markers.publish(
            messages.slot_markers(self._frame_id, stamp, places, moment.powers))
        if self._eavesdropper is not None:
            self._rate.publish(messages.float64(
                self._player.playback.secrecy_rate(moment, self._eavesdropper)))

    def _announce_end(self) -> None:
        delivered, step = self._player.delivered, self._player.largest_step
        what = ('delivered' if self._eavesdropper is None else 'delivered in secret')
        detail = (' to the ground node, whatever leaked (true_eavesdropper is not set)'
                  if self._eavesdropper is None else
                  f', {delivered / self._player.playback.duration:.4f} bit/s/Hz on average')
        self.get_logger().info(
            f'end of the plan: {what} {delivered:.2f} bit/Hz{detail}; largest deviation between '
            f'consecutive setpoints {step:.3f} m')
        if self._settings['loop']:
            self._player.start()
        else:
            self._player.pause()
            self._announced_end = True


def _check(values: Mapping[str, Any]) -> None:
    place = values.get('true_eavesdropper', [])
    if len(place) not in (0, 2) or not all(map(math.isfinite, place)):
        raise ParameterError(
            f'true_eavesdropper is {shown(place)}; it must be (x, y) in m, or empty')
