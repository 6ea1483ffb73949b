"""The replay node: it plays plans by their time, as setpoints that never jump."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
import math
import os
import time
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Float64

from .plan_reader import PlanReader
from .vehicles import Vehicles
from .. import messages
from ..parameters import REPLAY
from ..planner.status import WarningLog
from ..process import run_node, WorkingNode
from ..settings import read_settings, Settings
from ..topics import is_simulated, publishers, SENSOR, serve, subscribe, timer_clock, TOPICS
from ...errors import brief, OptionError, ParameterError, quote
from ...mission.scenario import Point
from ...plan.file import read_plan
from ...plan.flight import Flight
from ...plan.plan import Plan
from ...plan.playback import Moment
from ...plan.player import Player, Point3
from ...plan.tracking import PUNCTUAL

_LONGEST_WAIT = 10.0  # Longest time [s] that a release waits for subscribers of simulated UAVs.
_LONGEST_SIMULATED_TICK = 2.0  # Longest time [s] between two ticks of a simulated clock.
# Least frequency of plan_time [Hz]; after 1 s without it a follower is silent.
_TIME_FREQUENCY = 5.0
_CLOCK_ERROR = 0.25  # Largest error [s] of the node's clock between two ticks.
_LATE = 3.0  # Time [s] after point 0 beyond which `autostart` releases no plan.
_SILENCE = 5.0  # Time [s] without a plan, after which paths of another planner are looked for.


@dataclass(frozen=True)
class ReplaySettings:
    """The parameters of the replay by their names; no `true_eavesdropper` is None."""

    mission_file: str
    uavs: tuple[str, ...]
    service_introspection: str
    plan_file: str
    frame_id: str
    rate: float
    speed: float
    loop: bool
    autostart: bool
    vehicle_odometry: bool
    start_tolerance: float
    track_tolerance: float
    mute_unpromised: bool
    true_eavesdropper: Point | None

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> 'ReplaySettings':
        """Return the settings for values by name; a true_eavesdropper of one number is refused."""
        place = values['true_eavesdropper']
        if len(place) == 1:
            raise ParameterError(
                f'true_eavesdropper is {quote(place)}; it must be (x, y) in m, or empty')
        return read_settings(cls, values, true_eavesdropper=tuple(place) or None)


@dataclass
class Release:
    """
    The release of a plan, at a time in ns.

    It waits until no condition is `unmet`, and then flies.
    """

    time_ns: int
    unmet: list[str] = field(default_factory=list)

    def update(self, unmet: list[str]) -> str:
        """Keep unmet conditions; return them in words if others were unmet before, or ''."""
        before, self.unmet = self.unmet, unmet
        # A condition is compared without its distance, which follows a comma.
        kinds = [[condition.partition(',')[0] for condition in each] for each in (before, unmet)]
        return f'waiting for {", ".join(unmet)}' if unmet and kinds[0] != kinds[1] else ''


class Replay(WorkingNode):
    """Replays the plan of the topic, or a saved plan; see docs/replay.md."""

    def __init__(self, **options: Any) -> None:
        super().__init__('replay', **options)
        self._declared = Settings(self, REPLAY, ReplaySettings.from_values)
        self._uavs = [*self._settings.uavs]
        self._frame_id = self._settings.frame_id
        self._player = Player(lambda reason: self.get_logger().warning(
            brief(f'the new plan is not played: {reason}')), self._settings.mute_unpromised)
        self._is_promised = True  # Whether the slot of the last setpoint is promised.
        self._ticked = time.monotonic()  # Time of the last tick [s].
        self._release = Release(0)  # Release of the last start.
        self._vehicles = Vehicles()
        self._ticked_ns = 0  # Time of the last tick by the node's clock [ns].
        self._lost = set[str]()  # UAVs off their plan; while there is one, no UAV sends power.
        # The callbacks share the player, so they run one at a time.
        self._group = MutuallyExclusiveCallbackGroup()
        # Unique, because two nodes may have the same name.
        self._follower = f'{self.get_fully_qualified_name()} (process {os.getpid()})'
        plan, frame_id = _load_plan(self._settings.plan_file)
        if plan is not None:
            self._uavs = [uav.name for uav in plan.scenario.uavs]
        self._refusal = ''  # Why no plan of the topic is used.
        self._warnings = WarningLog(self.get_logger())
        self._reader = PlanReader(self.post, self._take, self._refuse)
        # A plan, and its frame, that came before simulated time was known.
        self._undated: tuple[Plan, str] | None = None
        self._stops = 0  # Calls of ~/pause and ~/reset.
        self._is_paused = False  # Whether ~/pause has stopped a flight since ~/start or ~/reset.
        self._make_interface()
        if plan is not None:
            self._adopt(plan, frame_id or self._frame_id)
        else:
            subscribe(self, {'plan': TOPICS['replay', 'sub']['plan']},
                      lambda _, message: self._reader.read(message.data), self._group, ())
            self.create_timer(_SILENCE, self._check_publisher, self._group,
                              Clock(clock_type=ClockType.STEADY_TIME))
        self._declared.warn_of_unknown()
        self.get_logger().info(brief('ready: ~/start replays ' + ', '.join(self._uavs)))

    def _make_interface(self) -> None:
        """Create the topics, services and the timer of the setpoints."""
        topics, relay = dict(TOPICS['replay', 'pub']), '<uav>/relay'
        subscribe(self, {relay: TOPICS['replay', 'sub'][relay]}, self._on_relay, self._group,
                  self._uavs)
        if self._settings.vehicle_odometry:
            odometry = topics.pop('<uav>/odom')
            subscribe(self, {'<uav>/odom': odometry._replace(qos=SENSOR)}, self._on_odometry,
                      self._group, self._uavs)
        self._outputs = publishers(self, topics, self._uavs)
        # A start may wait for a plan that is being read; setpoints are sent meanwhile.
        serve(self, {'~/start': self._on_start}, ReentrantCallbackGroup())
        serve(self, {'~/pause': self._on_pause, '~/reset': self._on_reset}, self._group)
        frequency = self._settings.rate
        # Ticks since the stream began, and ticks for each setpoint.
        self._streamed, self._ticks_each = 0, math.ceil(_TIME_FREQUENCY / frequency)
        self.create_timer(1.0 / (frequency * self._ticks_each), self._on_tick,
                          callback_group=self._group, clock=timer_clock(self))

    @property
    def _settings(self) -> ReplaySettings:
        return self._declared.current

    def close(self) -> bool:
        """Stop reading; return True, since no thread is left running."""
        super().close()
        self._reader.close()
        return True

    # Plans

    def _take(self, plan: Plan, frame_id: str) -> None:
        """
        Adopt a plan, or refuse it for other UAVs or for another frame than the stream's.

        While simulated time is not known, nobody can tell how late a plan is, so it is kept.
        """
        if not self.get_clock().now().nanoseconds:
            self._undated = plan, frame_id
            self._refuse('simulated time is not known yet; publish /clock')
            return
        self._undated = None
        names = [uav.name for uav in plan.scenario.uavs]
        if names != self._uavs:
            self._refuse(f'it is for {quote(names)}, and uavs is {quote(self._uavs)}')
            return
        self._refusal = ''
        self._warnings.clear('plan')
        if self._player.streaming and frame_id != self._frame_id:
            self._player.refuse(f'it is in frame {quote(frame_id)} and the setpoints are in '
                                f'{quote(self._frame_id)}; call ~/reset, then ~/plan and '
                                '~/start')
        else:
            self._adopt(plan, frame_id)

    def _refuse(self, reason: str) -> None:
        self._refusal = f'the plan of the topic is not used: {reason}'
        self._warnings.warn('plan', self._refusal)

    def _check_publisher(self) -> None:
        """Warn of a planner that publishes a path and no plan."""
        path = f'{self._uavs[0]}/path'
        if self._player.playback is None and not self._refusal and (
                self.count_publishers(path) and not self.count_publishers('plan')):
            self._refusal = (f'{path} is published and plan is not: use a planner of this '
                             'version, or publish plan as examples/ros/plan_from_path.py does')
            self._warnings.warn('plan', self._refusal)

    def _adopt(self, plan: Plan, frame_id: str) -> None:
        """Give a plan to the player; with `autostart`, release it if it is new and in time."""
        self.get_logger().info(f'got a plan of {plan.scenario.slots} slots for '
                               f'{", ".join(self._uavs)}: {plan.identity}')
        before = self._player.playback
        if self._player.load(plan):
            self._frame_id = frame_id
            # A revision of the present flight keeps its state, playing or paused. A plan that
            # comes after ~/pause waits for ~/start, too.
            autostarts = self._settings.autostart and not self._is_paused and (
                before is None or before.plan.start_ns != plan.start_ns)
            is_late = not self._settings.plan_file and (
                self.get_clock().now().nanoseconds - (plan.start_ns or 0) > _LATE * 1e9)
            if autostarts and not is_late:
                self.get_logger().info(self._start())
            elif autostarts:
                self.get_logger().warning(f'plan {plan.identity} is not started: its time has '
                                          'passed; ~/start plays it')

    @property
    def _flight(self) -> Flight:
        """Flight of the player, once there is a plan."""
        assert self._player.flight is not None
        return self._player.flight

    @property
    def _eavesdropper(self) -> Point | None:
        return self._settings.true_eavesdropper

    def _on_odometry(self, topic: str, message: Odometry) -> None:
        self._vehicles.take(topic, message, self.get_clock().now().nanoseconds)

    def _on_relay(self, topic: str, message: DiagnosticStatus) -> None:
        self._vehicles.relays.take(topic, message)

    # Services

    def _start(self) -> str:
        """Release the plan, return in words what follows; raise OptionError if none can begin."""
        player, now = self._player, self.get_clock().now().nanoseconds
        self._is_paused = False
        player.start([None if isinstance(place, str) else place for place in self._places(now)],
                     self._settings.start_tolerance)
        self._release = Release(now)
        if not player.streaming:
            self._release.unmet = self._unmet_conditions(now)
        flight, plan = self._flight, self._flight.playback.plan
        follows = [f'waits for {condition}' for condition in self._release.unmet]
        ahead = 0.0  # Time [s] until the flight is due to begin; negative if it is late.
        if flight.time <= flight.playback.begin:
            ahead = ((flight.playback.begin_ns or 0) - now) * 1e-9
        if ahead > 0:
            follows.append(f'begins in {ahead:.1f} s')
        if ahead < -PUNCTUAL and plan.promised_until is not None:
            follows.append(f'playing {-ahead:.1f} s late, so the rates are no longer '
                           'guaranteed; call ~/plan')
        return f'plan {plan.identity}: {"; ".join(follows) or "playing"}'

    async def _on_start(self) -> tuple[bool, str]:
        """Release the plan once it is read; return the answer (success, text)."""
        stops = self._stops
        await self._reader.wait()
        if self._stops > stops:
            return False, '~/pause or ~/reset was called before the plan was read'
        try:
            text = self._start()
        except OptionError as error:
            return False, f'{error}{self._refusal and ": "}{self._refusal}'
        self._on_tick()  # So that plan_time is published before the answer.
        return True, text

    def _on_pause(self) -> tuple[bool, str]:
        self._stops += 1
        is_paused = self._player.pause()
        self._is_paused |= is_paused
        self._on_tick()
        return is_paused, 'paused' if is_paused else 'nothing is playing'

    def _on_reset(self) -> tuple[bool, str]:
        self._stops += 1
        self._is_paused = False
        self._player.reset()
        self._on_tick()  # So that plan_time is published before the answer.
        return True, 'back at the start'

    # Time

    def _on_tick(self) -> None:
        """Advance the player, and publish the time of the plan and the setpoints that are due."""
        before, self._ticked, clock = self._ticked, time.monotonic(), self.get_clock().now()
        # Largest time [s] since the last tick that is not a jump of the node's clock.
        longest = (_LONGEST_SIMULATED_TICK if is_simulated(self)
                   else self._ticked - before + _CLOCK_ERROR)
        now, player = clock.nanoseconds, self._player
        if now and self._undated is not None:
            self._take(*self._undated)
        if not player.streaming:
            self._streamed = 0
            if player.playing and (waits := self._release.update(self._unmet_conditions(now))):
                self.get_logger().info(brief(waits))
        self._warn_of_lost_relays()
        may_end, has_plan = player.playing and not player.ended, player.flight is not None
        moment = player.tick(now, self._settings.speed, self._eavesdropper,
                             is_ready=not self._release.unmet, longest=longest,
                             is_silent=self._update_silence(now))
        self._ticked_ns = now
        if has_plan:
            self._outputs['plan_time'].publish(messages.plan_time(
                self._flight.playback.plan, self._flight.time, clock.to_msg(), self._follower))
        if moment is not None:
            if self._streamed % self._ticks_each == 0:
                self._publish(moment, clock.to_msg())
            self._streamed += 1
            self._log_promise()
        if may_end and player.ended:
            self._announce_end()

    def _update_silence(self, now_ns: int) -> bool:
        """
        Return True if no UAV may send power, because find_lost finds a lost UAV in the flight.

        If it finds other UAVs than at the last call, this is logged.
        """
        lost: dict[str, str] = {}  # The reason in words by UAV.
        if self._player.streaming and self._flight.is_under_way:
            lost = self._vehicles.find_lost(
                self._flight, self._ticked_ns, self._frame_id, self._settings.track_tolerance,
                now_ns)
        if {*lost} != self._lost:
            self.get_logger().warning(f'no power is sent: {"; ".join(lost.values())}' if lost else
                                      'power is sent again: all UAVs are on their plan')
        self._lost = {*lost}
        return bool(lost)

    def _warn_of_lost_relays(self) -> None:
        """Log the relays that were lost since the last tick; while nothing streams, drop them."""
        problems = self._vehicles.relays.find_newly_lost()
        for problem in problems if self._player.streaming else ():
            self.get_logger().warning(problem)

    def _places(self, now_ns: int) -> list[Point3 | str]:
        """Return the position of each UAV by its odometry, or the missing odometry in words."""
        return [self._vehicles.position(name, self._frame_id, now_ns) for name in self._uavs]

    def _unmet_conditions(self, now_ns: int) -> list[str]:
        """Return in words what the first setpoint waits for: odometry, starts, subscribers."""
        settings, has_odometry = self._settings, self._settings.vehicle_odometry
        places = [place if has_odometry else None for place in self._places(now_ns)]
        unmet = [place for place in places if isinstance(place, str)]
        unmet += self._player.unmet_conditions(
            [None if isinstance(place, str) else place for place in places],
            settings.start_tolerance, settings.speed)
        # Simulated UAVs wait for a subscriber only in the first _LONGEST_WAIT s of a release.
        if not has_odometry and not 0 <= now_ns - self._release.time_ns < _LONGEST_WAIT * 1e9:
            return unmet
        return unmet + [f'a subscriber of the setpoints of {name}'
                        for name in self._uavs
                        if not any(self._outputs[topic].get_subscription_count() for topic in (
                            f'{name}/setpoint/pose', f'{name}/setpoint/trajectory',
                            f'{name}/odom') if topic in self._outputs)]

    def _publish(self, moment: Moment, stamp: Stamp) -> None:
        """Publish the setpoints of a moment, and its secrecy rate if true_eavesdropper is set."""
        for topic, message in messages.setpoint_messages(
                self._flight.playback.plan.scenario, moment, self._frame_id, stamp):
            if topic in self._outputs:  # Without odometry where vehicles publish it.
                self._outputs[topic].publish(message)
        if self._eavesdropper is not None:
            flight = self._flight
            self._outputs['~/secrecy_rate'].publish(Float64(
                data=flight.playback.secrecy_rate(flight.time, self._eavesdropper)
                if moment.powers.any() else 0.0))

    def _log_promise(self) -> None:
        """Log when the flight enters slots that are not promised, and when it leaves them."""
        flight, plan = self._flight, self._flight.playback.plan
        slot = flight.playback.find_slot(flight.time)
        if flight.time < plan.scenario.slot_duration:
            self._is_promised = True  # Warn again in each flight.
        if not slot or plan.promised_slots[slot - 1] == self._is_promised:
            return
        self._is_promised = not self._is_promised
        if self._is_promised:
            self.get_logger().info(f'the rates of plan {plan.identity} are promised again')
        else:
            self.get_logger().warning(f'slot {slot} of plan {plan.identity} is not promised; ' + (
                'no power is sent' if self._settings.mute_unpromised else
                'powers are sent all the same, unless mute_unpromised is set'))

    def _announce_end(self) -> None:
        """Log what was delivered; play again if `loop` is set."""
        delivered, jump = self._player.delivered, self._player.largest_jump
        what = ('delivered' if self._eavesdropper is None else 'delivered in secret')
        detail = (' to the ground, whatever leaked (true_eavesdropper is not set)'
                  if self._eavesdropper is None else
                  f', {delivered / self._flight.playback.duration:.4f} bit/s/Hz on average')
        self.get_logger().info(
            f'end of the plan: {what} {delivered:.2f} bit/Hz{detail}; largest jump between '
            f'consecutive setpoints {jump:.3f} m')
        if self._settings.loop:
            self._player.reset()
            self._start()


def _load_plan(file: str) -> tuple[Plan | None, str | None]:
    """
    Return the plan of a file and its frame if it names one; None for no file.

    :raises ParameterError: for a bad file.
    """
    try:
        return read_plan(file, Plan) if file else (None, None)
    except (OSError, ValueError) as error:
        raise ParameterError(f'parameter plan_file: {brief(error)}') from None


main = partial(run_node, Replay)

if __name__ == '__main__':
    main()
