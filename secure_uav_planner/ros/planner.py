"""The planner node: poses and parameters in, plans out."""

from concurrent.futures import CancelledError
from dataclasses import replace
import math
from pathlib import Path as FilePath
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Path
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from . import messages
from .parameters import eavesdropper_parameters, Parameters, PLANNER, uav_from, uav_parameters
from .poses import PoseBook, PoseError
from .process import run_node
from .qos import LATCHED, OVERRIDABLE, SENSOR
from .scenarios import (
    GROUND_NODE_TOPIC, has_moved, pose_problems, pose_topic, scenario_from, updated)
from .status import level_and_text, summary, values
from .worker import Busy, Worker
from ..optimize.feasible import similar
from ..plan import Plan

_STATUS_PERIOD = 0.1
_REPLAN_CHECK_PERIOD = 0.1
_PAUSE = 0.005
_MOST_WARNINGS = 5  # Of a topic, until a good pose comes on it.


class Planner(Node):
    """
    Plans on request and, where asked to, again on the way; the README has its interface.

    :raises ValueError: for a wrong parameter, naming it.
    """

    def __init__(self, **options):
        super().__init__('planner', **options)
        self._settings = Parameters(self, PLANNER)
        self._uavs = self._settings['uavs']
        self._eavesdroppers = self._settings['eavesdroppers']
        names = self._uavs + self._eavesdroppers + ['ground_node']
        if len(set(names)) < len(names):
            raise ValueError(f'parameters uavs and eavesdroppers give the names {names[:-1]}; '
                             f"they must be unique and not 'ground_node'")
        for index, name in enumerate(self._uavs):
            self._settings.declare(uav_parameters(name, index))
        for name in self._eavesdroppers:
            self._settings.declare(eavesdropper_parameters(name))
        self._settings.apply(self._check)

        self._poses = PoseBook()
        self._warned = set()
        self._worker = Worker(self._on_iteration)
        self._plan = None
        self._progress = None
        self._progress_shown = 0.0
        self._outcome = (DiagnosticStatus.OK, 'no plan yet')
        self._counts = {'plans': 0, 'replans': 0, 'refusals': 0}
        self._last_planned = -math.inf
        self._lock = threading.RLock()
        self._make_interface()
        self._restore()
        self._publish_status()
        self.get_logger().info('ready: ~/plan plans for ' + ', '.join(self._uavs))

    def _make_interface(self):
        poses, services = MutuallyExclusiveCallbackGroup(), ReentrantCallbackGroup()
        kinds = {GROUND_NODE_TOPIC: PoseStamped}
        kinds.update({pose_topic(name): PoseWithCovarianceStamped
                      for name in self._eavesdroppers})
        kinds.update({pose_topic(name): PoseStamped for name in self._uavs})
        for topic, kind in kinds.items():
            self.create_subscription(
                kind, topic, lambda message, topic=topic: self._on_pose(topic, message), SENSOR,
                callback_group=poses, qos_overriding_options=OVERRIDABLE)

        def latched(kind, topic):
            return self.create_publisher(
                kind, topic, LATCHED, qos_overriding_options=OVERRIDABLE)

        self._paths = [latched(Path, f'{name}/path') for name in self._uavs]
        self._powers = [latched(Float64MultiArray, f'{name}/power') for name in self._uavs]
        self._trajectories = [
            latched(MultiDOFJointTrajectory, f'{name}/trajectory') for name in self._uavs]
        self._markers = latched(MarkerArray, '~/markers')
        self._status = latched(DiagnosticStatus, '~/status')
        self._diagnostics = self.create_publisher(
            DiagnosticArray, '/diagnostics', 10, qos_overriding_options=OVERRIDABLE)
        # A waiting ~/plan keeps one of the executor's threads; everything else goes on.
        self.create_service(Trigger, '~/plan', self._on_plan, callback_group=services)
        self.create_service(Trigger, '~/cancel', self._on_cancel, callback_group=services)
        # Both timers go on while simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, callback_group=services, clock=steady)
        self.create_timer(_REPLAN_CHECK_PERIOD, self._replan_when_due, clock=steady)

    def close(self):
        """Stop the solve under way; return whether nothing is left running."""
        return self._worker.close(timeout=1.0)

    def _now(self):
        return self.get_clock().now().nanoseconds * 1e-9

    def _check(self, values):
        for name in self._uavs:
            uav_from(values, name)

    # Poses

    def _on_pose(self, topic, message):
        frame_id = self._settings['frame_id']
        first = self._poses.get(topic) is None
        try:
            self._poses.take(topic, message, frame_id, self._now())
        except PoseError as error:
            reason = str(error)
            if (topic, reason) not in self._warned and (
                    sum(known[0] == topic for known in self._warned) < _MOST_WARNINGS):
                self._warned.add((topic, reason))
                self.get_logger().warning(f'{topic}: {reason}; it is not used')
        else:
            self._warned -= {known for known in self._warned if known[0] == topic}
            if first:
                self._publish_status()

    # Planning on request

    def _on_plan(self, _request, response):
        settings = self._settings.snapshot()
        try:
            scenario = scenario_from(settings, self._poses, self._now())
            plan = self._worker.start(
                scenario, method=settings['method'],
                time_limit=settings['time_limit'] or None,
                initial=self._initial(scenario)).result()
            if plan.status == 'cancelled':
                raise CancelledError('cancelled')
            plan = replace(plan, start_ns=self.get_clock().now().nanoseconds)
            text = self._publish_plan(plan, 'plans')
        except (ValueError, Busy, CancelledError) as error:
            response.success = False
            response.message = self._failed(str(error), DiagnosticStatus.WARN)
        except Exception as error:
            response.success = False
            response.message = self._failed(
                f'the solve failed: {type(error).__name__}: {error}', DiagnosticStatus.ERROR)
        else:
            response.success, response.message = True, text
        return response

    def _initial(self, scenario):
        """Return the last plan where it is a good start for the scenario."""
        if self._plan is not None and similar(scenario, self._plan.scenario):
            return self._plan
        return None

    def _failed(self, reason, level):
        """Note, log and return why there is no new plan."""
        stands = '' if self._plan is None else '; the last plan stands'
        with self._lock:
            self._counts['refusals'] += 1
            self._outcome = (level, reason + stands)
        log = self.get_logger()
        (log.error if level == DiagnosticStatus.ERROR else log.warning)(
            f'no new plan: {reason}{stands}')
        self._publish_status()
        return reason + stands

    def _on_cancel(self, _request, response):
        response.success = self._worker.cancel()
        response.message = 'cancelling' if response.success else 'no solve is under way'
        return response

    def _on_iteration(self, iteration):
        self._progress = iteration
        if time.monotonic() - self._progress_shown > _STATUS_PERIOD:
            self._progress_shown = time.monotonic()
            self._publish_status()

    # Planning again on the way

    def _replan_when_due(self):
        settings = self._settings.snapshot()
        period, distance = settings['replan_period'], settings['replan_distance']
        plan, now = self._plan, self._now()
        if plan is None or not (period or distance) or self._worker.busy:
            return
        elapsed = now - plan.start_ns * 1e-9
        point = max(0, math.ceil(
            (elapsed + settings['replan_lead']) / plan.scenario.slot_duration))
        if point >= plan.scenario.slots:
            return  # The mission ends before a new plan could take effect.
        try:
            known = updated(plan.scenario, settings, self._poses, now)
        except ValueError:
            return  # The poses are missing or old, as the diagnostics say.
        # Against the clock jumping back, too: the period has passed when it is not to come.
        due = period and not 0 <= now - self._last_planned < period
        if not (due or (distance and has_moved(plan.scenario, known, distance))):
            return
        tail = plan.tail(point)
        scenario = replace(tail.scenario, ground_node=known.ground_node,
                           eavesdroppers=known.eavesdroppers)
        try:
            future = self._worker.start(
                scenario, method=settings['method'], initial=tail,
                time_limit=settings['replan_lead'])
        except Busy:
            return
        self._last_planned = now
        future.add_done_callback(lambda done: self._on_replanned(done, plan, point, tail))

    def _on_replanned(self, future, plan, point, tail):
        """Join what a replan found to the plan it began with; runs in the solver's thread."""
        try:
            found = future.result()
            if found.status == 'cancelled':
                raise CancelledError('cancelled')
            if self._now() > tail.start_ns * 1e-9:
                raise ValueError('the new plan came after the moment it was to take effect; '
                                 'a longer replan_lead gives it more time')
            if self._plan is not plan:
                raise ValueError('another plan came in between')
            self._publish_plan(plan.continued(point, found), 'replans')
        except CancelledError as error:
            if str(error) == 'cancelled':
                self._failed('the replan was cancelled', DiagnosticStatus.OK)
        except ValueError as error:
            self._failed(f'replan: {error}', DiagnosticStatus.WARN)
        except Exception as error:
            self._failed(f'the replan failed: {type(error).__name__}: {error}',
                         DiagnosticStatus.ERROR)

    # Publishing

    def _restore(self):
        """Publish the plan of the plan file, if there is one."""
        file = self._settings['plan_file']
        if not file or not FilePath(file).exists():
            return
        try:
            plan = Plan.load(file)
            if [uav.name for uav in plan.scenario.uavs] != self._uavs or plan.start_ns is None:
                raise ValueError(f'{file} is not a plan for {", ".join(self._uavs)}')
        except (OSError, ValueError) as error:
            self.get_logger().warning(f'plan_file: {error}; it is not published')
            return
        self._publish_plan(plan, 'plans', restored=True)

    def _publish_plan(self, plan, count, restored=False):
        """Publish all of a plan and return it in one line."""
        frame_id = self._settings['frame_id']
        # Everything is made before anything is sent: all of a plan is published, or nothing.
        made = [(publisher, make(plan, index, *more))
                for publishers, make, more in (
                    (self._paths, messages.path, (frame_id,)),
                    (self._powers, messages.power, ()),
                    (self._trajectories, messages.trajectory, (frame_id,)))
                for index, publisher in enumerate(publishers)]
        made.append((self._markers, messages.markers(plan, frame_id)))
        if self._settings['plan_file'] and not restored:
            self._save(plan)
        for publisher, message in made:
            publisher.publish(message)
        level = DiagnosticStatus.OK if plan.status == 'converged' else DiagnosticStatus.WARN
        # Outside the lock, for it evaluates the rates; the plan keeps them for the status.
        text = ('restored: ' if restored else '') + summary(plan)
        with self._lock:
            self._plan, self._last_planned = plan, self._now()
            self._counts[count] += 1
            self._outcome = (level, text)
        log = self.get_logger()
        (log.info if level == DiagnosticStatus.OK else log.warning)(text)
        self._publish_status()
        return text

    def _save(self, plan):
        try:
            plan.save(self._settings['plan_file'])
        except OSError as error:
            self.get_logger().error(f'plan_file: {error}; the plan is published all the same')

    def _status_message(self):
        now = self._now()
        with self._lock:
            busy = self._worker.busy
            progress = self._progress if busy else None
            level, text = level_and_text(
                self._outcome, pose_problems(self._settings, self._poses, now), progress)
            return messages.status(
                self.get_fully_qualified_name().lstrip('/'), level, text, values(
                    self._plan, progress, busy, self._poses, self._settings, self._counts, now))

    def _publish_status(self):
        with self._lock:
            self._status.publish(self._status_message())

    def _publish_diagnostics(self):
        message = DiagnosticArray(status=[self._status_message()])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def main(args=None):
    """Run the planner node as a process."""
    run_node(Planner, args, pause=_PAUSE)


if __name__ == '__main__':
    main()
