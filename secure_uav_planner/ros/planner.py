"""
The planner node: it makes plans from poses and parameters.

Everything that touches poses, tracking, plan and outcome runs in one mutually exclusive callback
group, the state thread. Subscriptions only keep messages for it. Solves run in a thread of their
own and post their results to it; `~/plan` waits in a group of its own.
"""

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
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
from rclpy.serialization import serialize_message
from sensor_msgs.msg import TimeReference

from . import messages
from .frames import Frames
from .mission_parameters import airspace_from, channel_from, objective_from, uav_from
from .node_parameters import Parameters
from .parameters import eavesdropper_parameters, PLANNER, uav_parameters, zone_parameters
from .plan_tracking import check_goes_on, PlanTracking
from .poses import Message, PoseBook
from .process import run_node
from .replanning import check_in_time, Replanning, Rest
from .scenarios import parameter_scenario, scenario_from, StartTime
from .solver import Job, Result, SolverThread
from .spec import Spec
from .status import level_and_text, log_at, State, values
from .topics import publishers, serve, subscribe, TOPICS
from ..bound import explain_refusal, upper_bound
from ..errors import (
    brief, BusyError, describe_error, ParameterError, PlanFileError, PlanningError, PoseError,
    StoppedError)
from ..mission.scenario import Scenario
from ..optimize import solve
from ..optimize.initial import is_similar
from ..optimize.rejoin import Rejoin
from ..plan.plan import Iteration, Plan
from ..plan.results import Bound
from ..plan.tracking import Flight

_STATUS_PERIOD = 0.1
_CHECK_PERIOD = 0.1  # Of where the UAVs are, and whether a replan is due.
_DISCOVERY = 3.0  # s that nodes of one host took at most to find each other.
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
        # What has come for the state thread: the newest pose of each topic and when it came, the
        # reports of a follower, and functions to run.
        self._new_poses: dict[str, tuple[Message, float]] = {}
        self._new_reports: deque[tuple[TimeReference, float]] = deque()
        self._posted: deque[Callable[[], None]] = deque()
        self._solver = SolverThread(self._post)
        self._progress_sent = 0.0
        self._request = threading.Lock()  # Held while ~/plan waits for its answer.
        self._answer: 'Future[tuple[bool, str]]' = Future()
        self._closed = False
        self._discovered = 0.0  # When who flies a restored plan has been met, by time.monotonic.
        self._replanning = Replanning(self._poses, self._tracking)
        self._make_interface()
        self._restore()
        self._publish_status()
        self._settings.warn_of_unknown()
        self._warn_of_infeasible()
        self.get_logger().info(brief('ready: ~/plan plans for ' + ', '.join(self._uavs)))

    def _make_interface(self) -> None:
        state, inputs = MutuallyExclusiveCallbackGroup(), ReentrantCallbackGroup()
        self._wake = self.create_guard_condition(self._run_posted, callback_group=state)
        self._publishers_of = publishers(self, TOPICS['planner', 'pub'], self._uavs)
        # A waiting ~/plan occupies one of the executor's threads, and never more than one.
        serve(self, {'~/plan': self._on_plan}, ReentrantCallbackGroup())
        serve(self, {'~/cancel': self._on_cancel}, state)
        # Both timers continue when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, callback_group=state, clock=steady)
        self.create_timer(_CHECK_PERIOD, self._on_check, callback_group=state, clock=steady)
        topics = dict(TOPICS['planner', 'sub'])
        subscribe(self, {'plan_time': topics.pop('plan_time')},
                  lambda _, message: self._new_reports.append((message, self._now())),
                  MutuallyExclusiveCallbackGroup(), self._uavs)  # They keep their order.
        subscribe(self, topics, self._on_pose, inputs, self._uavs,
                  self._settings['eavesdroppers'])

    def close(self) -> bool:
        """Stop the solve that is under way; return whether nothing is left running."""
        self._closed = True
        self._reply(False, 'the planner is stopping')
        return self._solver.close(timeout=1.0)

    def _now_ns(self) -> int:
        return self.get_clock().now().nanoseconds

    def _now(self) -> float:
        return self._now_ns() * 1e-9

    # What comes to the state thread

    def _post(self, function: Callable[[], None]) -> None:
        """Have a function run in the state thread; from any thread."""
        if not self._closed:
            self._posted.append(function)
            self._wake.trigger()

    def _on_pose(self, topic: str, message: Message) -> None:
        self._new_poses[topic] = message, self._now()

    def _run_posted(self) -> None:
        """Take the messages that have come, and run what was posted, in this order."""
        for topic in [*self._new_poses]:
            self._take_pose(topic, *self._new_poses.pop(topic))
        while self._new_reports:
            self._tracking.take_report(*self._new_reports.popleft())
        while self._posted and not self._closed:
            self._posted.popleft()()

    def _take_pose(self, topic: str, message: Message, arrived: float) -> None:
        """Keep a valid pose, and warn once of each kind of invalid ones."""
        is_first, member = self._poses.get(topic) is None, topic.partition('/')[0]
        origin = self._settings[f'{member}.origin'] if member in self._uavs else (0.0, 0.0, 0.0)
        warned = self._warned.setdefault(topic, set())
        try:
            # With simulated time, a pose can be there before the clock has come to its stamp.
            self._poses.take(
                topic, message, self._settings['frame_id'], self._now(), origin, arrived)
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
        """Wait for the answer of the state thread."""
        if not self._request.acquire(blocking=False):
            busy = BusyError('a solve is under way')
            self._post(lambda: self._refuse(busy))
            return False, str(busy)
        try:
            self._answer = answer = Future()
            # A restored plan may be flown by somebody who has not been discovered yet.
            while time.monotonic() < self._discovered and not (
                    self._tracking.has_reports or self._closed):
                time.sleep(_CHECK_PERIOD)
            if self._closed:
                return False, 'the planner is stopping'
            self._post(self._plan)
            return answer.result()
        finally:
            self._request.release()

    def _reply(self, success: bool, text: str) -> None:
        """Answer the request, if that has not been done."""
        with suppress(InvalidStateError):
            self._answer.set_result((success, text))

    def _plan(self) -> None:
        """Start the solve of a request."""
        began, now_ns = time.monotonic(), self._now_ns()
        settings, now = self._settings.snapshot(), now_ns * 1e-9
        flight = self._flight(now)
        is_flying = flight is not None and flight.state == 'flying'
        start = StartTime.of(settings, now_ns, is_flying)
        limit = start.time_limit(settings['time_limit'] or None)
        try:
            self._tracking.check_steady(now)
            scenario = scenario_from(
                settings, self._poses, start, self._tracking.states(flight, settings, now),
                flight)
        except Exception as error:
            self._reply(False, self._refuse(error))
            return
        last = self._state.plan
        initial = last if last and is_similar(scenario, last.scenario) else None

        def work(job: Job) -> tuple[Plan, dict[str, bytes]]:
            left = None if limit is None else max(
                _SHORTEST_SOLVE, limit - (time.monotonic() - began))
            plan = self._solve(job, scenario, settings, left, initial)
            plan = replace(plan, start_ns=start.start_of(self._now_ns()))
            return plan, self._messages_of(plan)

        def finish(result: Result) -> None:
            try:
                plan, outgoing = result()
                start.check_in_time(self._now_ns())
                self._tracking.check_steady(self._now())
                check_goes_on(flight, self._flight(self._now()), self._now() - now)
                text = self._publish_plan(plan, outgoing, 'plans')
            except Exception as error:
                self._reply(False, self._refuse(error))
                return
            if flight is not None and flight.is_under_way:
                text += (f'; it goes on from plan {flight.playback.plan.identity}, which is '
                         f'{flight.state}')
            unknown = self._tracking.unknown_plan(self._now())
            self._reply(True, text + (
                '' if unknown is None else f'; the follower flies another plan, {unknown}'))

        self._start(work, finish, 'cancelled')

    def _start(self, work: Callable[[Job], Any], finish: Callable[[Result], None], cancelled: str
               ) -> None:
        """Start a solve, and prove the bound of the last plan after it, if that has none."""
        def then(result: Result) -> None:
            finish(result)
            self._prove_bound()

        self._solver.start(work, then, cancelled)
        self._publish_status()

    def _solve(self, job: Job, scenario: Scenario, settings: Mapping[str, Any],
               time_limit: float | None, initial: Plan | None) -> Plan:
        """Solve in the solver's thread, until the job is stopped."""
        def on_iteration(iteration: Iteration) -> bool:
            job.progress = iteration
            if iteration.number == 0 or time.monotonic() - self._progress_sent > _STATUS_PERIOD:
                self._progress_sent = time.monotonic()
                self._post(self._publish_status)
            return job.stop.is_set()

        plan = solve(scenario, method=settings['method'], objective=objective_from(settings),
                     time_limit=time_limit, initial=initial, on_iteration=on_iteration)
        job.check()
        return plan

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
        self._run_posted()  # A request that came before is cancelled as well.
        if not self._solver.is_solving:
            return False, 'no solve is under way'
        self._solver.job.stop.set()
        return True, 'cancelling'

    def _refuse(self, error: Exception, is_replan: bool = False) -> str:
        """Note, log and return why there is no new plan."""
        level, reason = DiagnosticStatus.WARN, brief(error, _LONGEST_REASON)
        if not isinstance(error, PlanningError):
            what = 'replan' if is_replan else 'solve'
            level, reason = DiagnosticStatus.ERROR, f'the {what} failed: {describe_error(error)}'
        elif is_replan and isinstance(error, StoppedError):
            level = DiagnosticStatus.OK
        text = self._state.refuse(error, reason, level, is_replan)
        log_at(self.get_logger(), level, f'no new plan: {text}')
        self._publish_status()
        return text

    # Replanning

    def _on_check(self) -> None:
        self._run_posted()
        settings, now = self._settings.snapshot(), self._now()
        self._tracking.observe(settings, now)
        flight = self._tracking.flight(now)
        if flight is not None and flight.state == 'ended':
            self._state.end_flight()
        if self._solver.is_solving or self._state.plan is None or self._closed:
            return
        rest = self._replanning.rest_if_due(self._state.plan, settings, now)
        if rest is not None:
            self._replan(rest, settings)

    def _replan(self, rest: Rest, settings: Mapping[str, Any]) -> None:
        """Start the solve of a replan."""
        def work(job: Job) -> tuple[Plan, Rejoin, dict[str, bytes]]:
            rejoin = rest.rejoin()
            plan = rejoin.splice(
                self._solve(job, rejoin.scenario, settings, rest.time_limit, rejoin.tail))
            return plan, rejoin, self._messages_of(plan)

        def finish(result: Result) -> None:
            try:
                plan, rejoin, outgoing = result()
                check_in_time(rejoin, self._tracking.flight(self._now()))
            except Exception as error:
                self._replanning.failed()
                self._refuse(error, is_replan=True)
                return
            if plan.identity != self._state.plan.identity:
                self._publish_plan(plan, outgoing, 'replans')
            else:  # The same flight, perhaps against receivers that have moved.
                self._keep_plan(plan)

        self._start(work, finish, 'the replan was cancelled')

    # Publishing

    def _warn_of_infeasible(self) -> None:
        """Log why the mission of the parameters cannot be flown, if it cannot."""
        try:
            parameter_scenario(self._settings.snapshot())
        except PlanningError as error:
            self.get_logger().warning(f'the mission cannot be flown as it is set: {brief(error)}')

    def _restore(self) -> None:
        """Publish the plan in the plan file, if there is one."""
        file = self._settings['plan_file']
        try:
            if not file or not FilePath(file).exists():
                return
            plan = Plan.load(file)
            if [uav.name for uav in plan.scenario.uavs] != self._uavs or plan.start_ns is None:
                raise PlanFileError(f'{file} is not a plan for {", ".join(self._uavs)}')
            self._publish_plan(plan, self._messages_of(plan), 'plans', restored=True)
            if self._tracking.flight(self._now()).state != 'ended':
                self._discovered = time.monotonic() + _DISCOVERY
        except Exception as error:
            text = brief(error) if isinstance(error, (PlanningError, OSError)) else (
                describe_error(error))
            self.get_logger().warning(f'plan_file: {text}; it is not published')

    def _messages_of(self, plan: Plan) -> dict[str, bytes]:
        """Return all messages of a plan, serialised; that takes seconds for 20,000 slots."""
        plan.evaluate()
        return {topic: serialize_message(message) for topic, message in messages.of_plan(
            plan, self._settings['frame_id'])}

    def _publish_plan(self, plan: Plan, outgoing: Mapping[str, bytes], count: str,
                      restored: bool = False) -> str:
        """
        Publish all messages of a plan, increase a count, and return its summary in one line.

        :param restored: whether the plan comes from the plan file.
        """
        for topic, message in outgoing.items():
            self._publishers_of[topic].publish(message)
        self._state.count(count, 'restored: ' if restored else '')
        self._keep_plan(plan)
        if not restored:
            self._save(plan)
        outcome = self._state.outcome
        log_at(self.get_logger(), outcome.level, outcome.text)
        return outcome.text

    def _keep_plan(self, plan: Plan) -> None:
        """Take a plan for that which is flown."""
        self._state.keep(plan)
        self._tracking.follow(plan, self._now())
        self._replanning.planned(self._now())
        self._publish_status()

    def _prove_bound(self) -> None:
        """Start the proof of the last plan's bound, if it is wanted and there is none."""
        plan = self._state.plan
        if (self._settings['bound'] != 'after' or plan is None or self._state.bound is not None
                or self._solver.job is not None):
            return
        if refusal := explain_refusal(plan.scenario):
            self.get_logger().info(f'no bound: {refusal}', once=True)
            return

        def work(job: Job) -> Bound:
            return upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                               on_progress=lambda _: job.stop.is_set())

        def finish(result: Result) -> None:
            try:
                bound = result()
            except Exception as error:
                self.get_logger().error(f'the bound cannot be computed: {describe_error(error)}')
                return
            self._state.bound = bound
            self._save(plan.with_bound(bound))
            self.get_logger().info(f'{plan.rate:.4f} bit/s/Hz, {bound.claim(plan)}')
            self._publish_status()

        self._solver.start(work, finish, is_solve=False)

    def _save(self, plan: Plan) -> None:
        """Save a plan in the solver's thread, since writing to a disk takes time."""
        file = self._settings['plan_file']
        if not file:
            return

        def save() -> None:
            try:
                plan.save(file)
            except (OSError, ValueError) as error:
                self.get_logger().error(
                    f'plan_file: {brief(error)}; the plan is published all the same')

        self._solver.run(save)

    def _status_message(self) -> DiagnosticStatus:
        now, settings = self._now(), self._settings.snapshot()
        is_solving = self._solver.is_solving
        progress = self._solver.job.progress if is_solving else None
        problems, tracks = self._tracking.report(settings, now)
        level, text = level_and_text(
            self._state.outcome, [*self._poses.problems(settings, now), *problems], progress)
        return messages.diagnostic_status(
            self.get_fully_qualified_name().lstrip('/') + ': plan', level, text,
            {**values(self._state, progress, is_solving, self._poses, settings, now), **tracks})

    def _publish_status(self) -> None:
        self._publishers_of['~/status'].publish(self._status_message())

    def _publish_diagnostics(self) -> None:
        self._run_posted()
        now, status = self._now(), self._status_message()
        flight = self._tracking.flight(now)
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


main = partial(run_node, Planner)

if __name__ == '__main__':
    main()
