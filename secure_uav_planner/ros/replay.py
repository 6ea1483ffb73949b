"""The replay node: a team of UAVs that follows a plan exactly."""

import math

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from . import messages
from .parameters import Parameters, REPLAY
from .process import run_node
from .qos import LATCHED, OVERRIDABLE, STREAM
from ..plan import Plan
from ..playback import Player

# The messages of a plan come one by one; after this long without another they are one set.
_SETTLING_NS = 100_000_000


class Replay(Node):
    """
    Replays the plan of the topics, or a saved one; the README has its interface.

    :raises ValueError: for a wrong parameter or plan file, naming it.
    """

    def __init__(self, **options):
        super().__init__('replay', **options)
        self._settings = Parameters(self, REPLAY, _check)
        self._uavs = self._settings['uavs']
        self._frame_id = self._settings['frame_id']
        self._player = Player()
        self._last_tick = None
        self._paths, self._powers = {}, {}
        self._received = None
        self._announced_end = False
        # All callbacks share the player: one at a time.
        self._group = MutuallyExclusiveCallbackGroup()
        if self._settings['plan_file']:
            self._load_file(self._settings['plan_file'])
        else:
            self._subscribe()
        self._make_interface()
        self.get_logger().info('ready: ~/start replays ' + ', '.join(self._uavs))

    def _load_file(self, file):
        try:
            plan = Plan.load(file)
        except (OSError, ValueError) as error:
            raise ValueError(f'parameter plan_file: {error}') from None
        self._uavs = [uav.name for uav in plan.scenario.uavs]
        self._take(plan)

    def _subscribe(self):
        for name in self._uavs:
            for kind, topic, kept in ((Path, 'path', self._paths),
                                      (Float64MultiArray, 'power', self._powers)):
                self.create_subscription(
                    kind, f'{name}/{topic}',
                    lambda message, name=name, kept=kept: self._on_message(kept, name, message),
                    LATCHED, callback_group=self._group, qos_overriding_options=OVERRIDABLE)

    def _make_interface(self):
        def stream(kind, topic):
            return self.create_publisher(
                kind, topic, STREAM, qos_overriding_options=OVERRIDABLE)

        self._poses = [stream(PoseStamped, f'{name}/setpoint/pose') for name in self._uavs]
        self._watts = [stream(Float64, f'{name}/setpoint/power') for name in self._uavs]
        self._odometry = [stream(Odometry, f'{name}/odom') for name in self._uavs]
        self._rate = stream(Float64, '~/secrecy_rate')
        self._markers = stream(MarkerArray, '~/markers')
        for name, action in (('start', self._on_start), ('pause', self._on_pause),
                             ('reset', self._on_reset)):
            self.create_service(Trigger, f'~/{name}', action, callback_group=self._group)
        self.create_timer(1.0 / self._settings['rate'], self._on_tick,
                          callback_group=self._group)

    def close(self):
        """Return that nothing is left running."""
        return True

    def _on_message(self, kept, name, message):
        kept[name] = message
        self._received = self.get_clock().now().nanoseconds

    def _assemble(self):
        """Take the plan of the topics if all of it has come."""
        if self._received is None:
            return
        stamps = {str(path.header.stamp) for path in self._paths.values()}
        if (len(self._paths) < len(self._uavs) or len(self._powers) < len(self._uavs)
                or len(stamps) > 1):
            return
        self._received = None
        paths = [self._paths[name] for name in self._uavs]
        try:
            plan = messages.plan_from(
                self._uavs, paths, [self._powers[name] for name in self._uavs],
                self._settings['ground_node'], self._settings['reference_snr_db'],
                self._eavesdropper)
        except (ValueError, IndexError, ZeroDivisionError) as error:
            self.get_logger().warning(f'the plan of the topics is not used: {error}')
            return
        self._frame_id = paths[0].header.frame_id
        self._take(plan)

    def _take(self, plan):
        self._player.load(plan)
        self._announced_end = False
        self.get_logger().info(f'got a plan of {plan.scenario.slots} slots for '
                               f'{", ".join(self._uavs)}')
        if self._settings['autostart']:
            self._player.start()
        if self._settings['picture_file']:
            self._draw(plan, self._settings['picture_file'])

    def _draw(self, plan, file):
        try:
            from ..view.picture import save_picture  # Only now: Matplotlib need not be there.
            save_picture(plan, file)
        except (ImportError, OSError, ValueError) as error:
            self.get_logger().warning(f'picture_file: {error}; the replay goes on without')

    @property
    def _eavesdropper(self):
        return tuple(self._settings['true_eavesdropper']) or None

    def _on_start(self, _request, response):
        self._assemble()
        response.success = self._player.playback is not None
        if response.success:
            self._player.start()
            self._announced_end = False
        response.message = 'playing' if response.success else 'there is no plan yet'
        return response

    def _on_pause(self, _request, response):
        response.success = self._player.playing
        response.message = 'paused' if response.success else 'nothing is playing'
        self._player.pause()
        return response

    def _on_reset(self, _request, response):
        self._player.reset()
        response.success, response.message = True, 'back at the start'
        return response

    def _on_tick(self):
        clock = self.get_clock().now()
        now = clock.nanoseconds
        if self._received is not None and not 0 <= now - self._received < _SETTLING_NS:
            self._assemble()
        # A clock that jumps back costs one tick, not the flight.
        seconds = 0.0 if self._last_tick is None else max(0, now - self._last_tick) * 1e-9
        self._last_tick = now
        if not self._player.streaming:
            return
        moment = self._player.advance(
            seconds * self._settings['speed'], self._eavesdropper)
        self._publish(moment, clock.to_msg())
        if self._player.finished and not self._announced_end:
            self._announce_end()

    def _publish(self, moment, stamp):
        scenario = self._player.playback.plan.scenario
        places = []
        for index, (uav, (x, y), yaw) in enumerate(
                zip(scenario.uavs, moment.positions, moment.headings)):
            places.append((x, y, uav.altitude))
            self._poses[index].publish(
                messages.pose_stamped(self._frame_id, stamp, *places[-1], yaw))
            self._watts[index].publish(messages.float64(moment.powers[index]))
            velocity = moment.velocities[index] * self._settings['speed']
            self._odometry[index].publish(messages.odometry(
                self._frame_id, f'{uav.name}/base_link', stamp, places[-1], yaw,
                velocity if self._player.playing else 0 * velocity))
        self._markers.publish(
            messages.slot_markers(self._frame_id, stamp, places, moment.powers))
        if self._eavesdropper is not None:
            self._rate.publish(messages.float64(
                self._player.playback.secrecy_rate(moment, self._eavesdropper)))

    def _announce_end(self):
        delivered, step = self._player.delivered, self._player.largest_step
        what = ('delivered' if self._eavesdropper is None else 'delivered in secret')
        whom = (' to the ground node, whatever leaked (true_eavesdropper is not set)'
                if self._eavesdropper is None else
                f', {delivered / self._player.playback.duration:.4f} bit/s/Hz on average')
        self.get_logger().info(
            f'end of the plan: {what} {delivered:.2f} bit/Hz{whom}; largest deviation between '
            f'consecutive setpoints {step:.3f} m')
        if self._settings['loop']:
            self._player.start()
        else:
            self._player.pause()
            self._announced_end = True


def _check(values):
    place = values.get('true_eavesdropper', [])
    if len(place) not in (0, 2) or not all(map(math.isfinite, place)):
        raise ValueError(f'true_eavesdropper is {place!r}; it must be (x, y) in m, or empty')


def main(args=None):
    """Run the replay node as a process."""
    run_node(Replay, args)


if __name__ == '__main__':
    main()
