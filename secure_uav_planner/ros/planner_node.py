"""The planner node: it makes plans from poses and parameters."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path as FilePath
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from . import messages
from .background import Bounding, LatestOnlyWorker
from .frames import Frames
from .mission_parameters import airspace_from, channel_from, objective_from, uav_from
from .node_parameters import Parameters
from .parameters import eavesdropper_parameters, PLANNER, uav_parameters, zone_parameters
from .plan_tracking import check_goes_on, PlanTracking
from .poses import Message, PoseBook
from .replanning import check_in_time, Replanning
from .scenarios import scenario_from, StartTime
from .spec import Spec
from .status import is_evaluated, level_and_text, log_at, State, values
from .topics import publishers, serve, subscribe, TOPICS
from .worker import Worker
from ..errors import (
    brief, ParameterError, PlanFileError, PlanningError, PoseError, StoppedError,
    SupersededError, with_type)
from ..optimize.rejoin import Rejoin
from ..optimize.warm_start import similar
from ..plan.bound import Bound
from ..plan.plan import Plan
from ..plan.tracking import Flight

_STATUS_PERIOD = 0.1
_CHECK_PERIOD = 0.1  # Of where the UAVs are, and whether a replan is due.
_EVALUATION = 0.5  # How long a plan waits for its worst-case rate before publication, in s.
_SHORTEST_SOLVE = 0.01
_LONGEST_REASON = 4000
_MOST_WARNINGS = 5  # Of the poses of each topic, until a valid one arrives.


class Planner(Node):
    """Plans on request and, if enabled, again in flight; see docs/planner.md."""

    def __init__(self, **options: Any) -> None:
        super().__init__('planner', **options)
        self._settings = Parameters(self, PLANNER, _check, _parameters_of_members)
        self._uavs = self._settings['uavs']
        self._poses = PoseBook(Frames(self).moved)
        self._warned: dict[str, set[str]] = {}  # Of the poses of each topic.
        self._tracking = PlanTracking(self._poses)
        self._state = State()
        self._closed = False
        self._progress_sent = 0.0
        self._lock = threading.RLock()  # Protects the state.
        # Held while a plan is compared with the last one and replaces it.
        self._publishing = threading.Lock()
        self._worker = Worker(self._on_iteration)
        self._replanning = Replanning(self._worker, self._poses, self._tracking,
                                      self._publish_replan, partial(self._refuse, is_replan=True))
        self._evaluation = LatestOnlyWorker(self._evaluate)
        self._bounding = Bounding(self._add_bound, self.get_logger().error)
        self._make_interface()
        self._restore()
        self._publish_status()
        self._settings.warn_of_unknown()
        self.get_logger().info(brief('ready: ~/plan plans for ' + ', '.join(self._uavs)))

    def _make_interface(self) -> None:
        checks, services = MutuallyExclusiveCallbackGroup(), ReentrantCallbackGroup()
        self._publishers_of = publishers(self, TOPICS['planner', 'pub'], self._uavs)
        # A waiting ~/plan occupies one of the executor's threads; the others continue.
        serve(self, {'~/plan': self._on_plan, '~/cancel': self._on_cancel}, services)
        # Both timers continue when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, callback_group=services, clock=steady)
        self.create_timer(_CHECK_PERIOD, self._on_check, callback_group=checks, clock=steady)
        topics = dict(TOPICS['planner', 'sub'])
        subscribe(self, {'plan_time': topics.pop('plan_time')},
                  lambda _, message: self._tracking.hear(message),
                  MutuallyExclusiveCallbackGroup(), self._uavs)
        subscribe(self, topics, self._on_pose, MutuallyExclusiveCallbackGroup(), self._uavs,
                  self._settings['eavesdroppers'])

    def close(self) -> bool:
        """Stop the solve that is under way; return whether nothing is left running."""
        with self._lock:
            self._closed = True
        self._bounding.cancel()
        return all([self._worker.close(timeout=1.0), self._bounding.close(timeout=0.6),
                    self._evaluation.close(timeout=0.1)])

    def _now_ns(self) -> int:
        return self.get_clock().now().nanoseconds

    def _now(self) -> float:
        return self._now_ns() * 1e-9

    def _on_pose(self, topic: str, message: Message) -> None:
        """Keep a valid pose, and warn once of each kind of other ones."""
        is_first, member = self._poses.get(topic) is None, topic.partition('/')[0]
        origin = self._settings[f'{member}.origin'] if member in self._uavs else (0.0, 0.0, 0.0)
        warned = self._warned.setdefault(topic, set())
        try:
            self._poses.take(topic, message, self._settings['frame_id'], self._now(), origin)
        except PoseError as error:
            reason = brief(error)
            if reason not in warned and len(warned) < _MOST_WARNINGS:
                warned.add(reason)
                self.get_logger().warning(f'{topic}: {reason}; it is not used')
        else:
            warned.clear()
            if is_first:
                self._publish_status()

    # Planning on request

    def _on_plan(self) -> tuple[bool, str]:
        began, now_ns = time.monotonic(), self._now_ns()
        settings, now = self._settings.snapshot(), now_ns * 1e-9
        flight = self._flight(now)
        is_flying = flight is not None and flight.state == 'flying'
        start = StartTime.of(settings, now_ns, is_flying)
        limit = start.time_limit(settings['time_limit'] or None)

        def check_still_wanted() -> None:
            start.check_in_time(self._now_ns())
            check_goes_on(flight, self._flight(self._now()), self._now() - now)

        try:
            self._tracking.check_steady(now)
            scenario = scenario_from(
                settings, self._poses, start, self._tracking.sightings(flight, settings, now),
                flight)
            # This stops a replan, and no other one starts before this request is answered.
            with self._worker.reserved(limit):
                self._bounding.cancel()  # Only now: a request that is refused leaves it alone.
                left = None if limit is None else max(
                    _SHORTEST_SOLVE, limit - (time.monotonic() - began))
                last = self._state.plan
                plan = self._worker.start(lambda solve: solve(
                    scenario, method=settings['method'], objective=objective_from(settings),
                    time_limit=left, initial=(
                        last if last and similar(scenario, last.scenario) else None))).result()
                text = self._publish_plan(
                    replace(plan, start_ns=start.start_of(self._now_ns())), 'plans',
                    check_still_wanted)
            self._publish_status()  # Now the request has been answered.
        except Exception as error:
            return False, self._refuse(error)
        if flight is not None and flight.is_under_way:
            text += (f'; it goes on from plan {flight.playback.plan.identity}, which is '
                     f'{flight.state}')
        stranger = self._tracking.stranger(self._now())
        return True, text + (
            '' if stranger is None else f'; the follower flies another plan, {stranger}')

    def _flight(self, now: float) -> Flight | None:
        """Return the flight from which a new plan goes on, or None."""
        flight = self._tracking.flight(now)
        if flight is None or flight.is_reported:
            return flight
        # Who would report, and never did, has not begun.
        reports = self._tracking.has_reports or not self.count_publishers('plan_time')
        # Somebody receives paths or trajectories, and so may fly by them.
        is_followed = any(publisher.get_subscription_count()
                          for topic, publisher in self._publishers_of.items()
                          if topic.endswith(('/path', '/trajectory')))
        return flight if flight.state == 'flying' and is_followed and reports else None

    def _on_cancel(self) -> tuple[bool, str]:
        cancelled = self._worker.cancel()
        return cancelled, 'cancelling' if cancelled else 'no solve is under way'

    def _on_iteration(self) -> None:
        progress = self._worker.progress
        first = progress is not None and progress.number == 0
        if first or time.monotonic() - self._progress_sent > _STATUS_PERIOD:
            self._progress_sent = time.monotonic()
            self._publish_status()

    def _refuse(self, error: Exception, is_replan: bool = False) -> str:
        """Note, log and return why there is no new plan."""
        if isinstance(error, SupersededError):
            self._publish_status()  # The plan that came first has been reported.
            return str(error)
        level, reason = DiagnosticStatus.WARN, brief(error, _LONGEST_REASON)
        if not isinstance(error, PlanningError):
            what = 'replan' if is_replan else 'solve'
            level, reason = DiagnosticStatus.ERROR, f'the {what} failed: {with_type(error)}'
        elif is_replan and isinstance(error, StoppedError):
            level = DiagnosticStatus.OK
        with self._lock:
            text = self._state.refuse(error, reason, level, is_replan)
        log_at(self.get_logger(), level, f'no new plan: {text}')
        self._publish_status()
        return text

    # Replanning

    def _on_check(self) -> None:
        settings, now = self._settings.snapshot(), self._now()
        self._tracking.observe(settings, now)
        flight = self._tracking.flight(now)
        if flight is not None and flight.state == 'ended':
            with self._lock:
                self._state.end_flight()
        self._replanning.start_when_due(lambda: self._state.plan, settings, now)

    def _publish_replan(self, plan: Plan, rejoin: Rejoin, last: Plan) -> None:
        self._publish_plan(plan, 'replans', lambda: check_in_time(
            self._state.plan is last, rejoin, self._tracking.flight(self._now())))

    # Publishing

    def _restore(self) -> None:
        """Publish the plan in the plan file, if there is one."""
        file = self._settings['plan_file']
        try:
            if not file or not FilePath(file).exists():
                return
            plan = Plan.load(file)
            if [uav.name for uav in plan.scenario.uavs] != self._uavs or plan.start_ns is None:
                raise PlanFileError(f'{file} is not a plan for {", ".join(self._uavs)}')
            self._publish_plan(plan, 'plans', restored=True)
        except Exception as error:
            text = brief(error) if isinstance(error, (PlanningError, OSError)) else (
                with_type(error))
            self.get_logger().warning(f'plan_file: {text}; it is not published')

    def _publish_plan(self, plan: Plan, count: str,
                      check_still_wanted: Callable[[], None] = lambda: None,
                      restored: bool = False) -> str:
        """
        Publish all messages of a plan, increase a count, and return its summary in one line.

        :param check_still_wanted: called when all messages are ready; an error that it raises
            prevents the publication.
        :param restored: whether the plan comes from the plan file.
        """
        evaluation = self._evaluation.put(plan)
        outgoing = dict(messages.of_plan(plan, self._settings['frame_id']))
        evaluation.join(_EVALUATION)
        with self._publishing:
            check_still_wanted()
            if not restored:
                self._save(plan)
            for topic, message in outgoing.items():
                self._publishers_of[topic].publish(message)
            with self._lock:
                outcome = self._state.publish(plan, count, 'restored: ' if restored else '')
            self._tracking.follow(plan, self._now())
            self._replanning.planned(self._now())
            if self._settings['bound'] == 'after' and plan.bound is None:
                self._bounding.put(plan)
            else:
                self._bounding.cancel()
        log_at(self.get_logger(), outcome.level, outcome.text)
        self._publish_status()
        return outcome.text

    def _evaluate(self, plan: Plan) -> None:
        """Evaluate the rates of a plan, in a background thread, because it can take long."""
        try:
            plan.evaluated()
        except Exception as error:
            self.get_logger().error(f'the rates cannot be evaluated: {with_type(error)}')
            return
        with self._lock:
            if plan is self._state.plan and not self._closed:
                self._publish_status()

    def _add_bound(self, plan: Plan, bound: Bound) -> None:
        """Publish and keep the last plan's bound, unless another plan came in between."""
        plan.evaluated()
        with self._publishing:
            with self._lock:
                if self._closed or self._state.plan is not plan:
                    return
                self._state.bound = bound
            self._save(plan.with_bound(bound))
        self.get_logger().info(f'{plan.rate:.4f} bit/s/Hz, {bound.claim(plan)}')
        self._publish_status()

    def _save(self, plan: Plan) -> None:
        file = self._settings['plan_file']
        if not file:
            return
        try:
            plan.save(file, evaluate=is_evaluated(plan))
        except (OSError, ValueError) as error:
            self.get_logger().error(
                f'plan_file: {brief(error)}; the plan is published all the same')

    def _status_message(self) -> DiagnosticStatus:
        now, settings = self._now(), self._settings.snapshot()
        with self._lock:
            busy, progress = self._worker.busy, self._worker.progress
            problems, tracks = self._tracking.report(settings, now)
            level, text = level_and_text(
                self._state.outcome, [*self._poses.problems(settings, now), *problems], progress)
            return messages.diagnostic_status(
                self.get_fully_qualified_name().lstrip('/') + ': plan', level, text,
                {**values(self._state, progress, busy, self._poses, settings, now), **tracks})

    def _publish_status(self) -> None:
        with self._lock:
            self._publishers_of['~/status'].publish(self._status_message())

    def _publish_diagnostics(self) -> None:
        now = self._now()
        flight = self._tracking.flight(now)
        with self._lock:
            status = self._status_message()
            if flight is not None and flight.is_reported or (
                    self._tracking.distances(self._settings.snapshot(), now)):
                self._publishers_of['~/status'].publish(status)
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._publishers_of['/diagnostics'].publish(message)


def _parameters_of_members(values: Mapping[str, Any]) -> dict[str, Spec]:
    """Return the parameters of the members that the values name."""
    uavs, eavesdroppers, zones = (
        values[kind] for kind in ('uavs', 'eavesdroppers', 'no_fly_zones'))
    names = [*uavs, *eavesdroppers, *zones, 'ground_node']
    if len(set(names)) < len(names):
        raise ParameterError('parameters uavs, eavesdroppers and no_fly_zones give the names '
                             f"{names[:-1]}; they must be unique and not 'ground_node'")
    of_each = [*(uav_parameters(name, index) for index, name in enumerate(uavs)),
               *map(eavesdropper_parameters, eavesdroppers), *map(zone_parameters, zones)]
    return {name: spec for specs in of_each for name, spec in specs.items()}


def _check(values: Mapping[str, Any]) -> None:
    objective_from(values)
    for name in values['uavs']:
        uav_from(values, name)
    airspace_from(values)
    channel_from(values)
