"""
The planner node: plans from poses and parameters.

One thread, the state thread, runs all callbacks, and only it may use poses, tracking, plan and
outcome. Solves run in a thread of their own and post their results to the state thread. `~/plan`
waits in a callback group of its own, so that other callbacks run meanwhile.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import TimeReference

from .frames import Frames, Message
from .plan_file import check_plan_file, load_plan, reserve_plan_file, save_plan
from .plan_tracking import PlanTracking
from .poses import PoseBook
from .replan import Remainder, Replanning
from .request import (
    Call, earliest_request, explain_infeasible, make_request, Request, StartTime)
from .settings import PlannerSettings
from .solver import Job, Result, SolverThread
from .status import (
    log_at, make_status, State, warn_of_namesakes, WarningLog)
from .. import messages
from ..parameters import PLANNER, PLANNER_MEMBERS
from ..process import run_node, WorkingNode
from ..references import LocalFrames
from ..settings import Settings
from ..topics import is_simulated, publishers, serve, subscribe, TOPICS
from ...bound import explain_refusal
from ...errors import (
    brief, BusyError, describe_error, LateError, PlanningError, PoseError, StoppedError)
from ...optimize.initial import is_similar
from ...plan.flight import Flight
from ...plan.plan import Plan

_CHECK_PERIOD = 0.1  # Time [s] between checks of the UAVs' positions and of replans.
_WARN_AGAIN_S = 5.0  # Least time between two equal warnings about poses, good ones between.
_CLOCK_LAG = 2.0  # Largest lag [s] of simulated time, whose messages may come late.
_DISCOVERY = 3.0  # Longest time [s] that nodes of one host took to discover each other.


class Planner(WorkingNode):
    """Plans on request and, if enabled, again in flight; see docs/planner.md."""

    def __init__(self, **options: Any) -> None:
        super().__init__('planner', **options)
        self._declared = Settings(self, PLANNER, PlannerSettings.from_values, PLANNER_MEMBERS)
        check_plan_file(self._settings.plan_file)
        self._plan_file = self._settings.plan_file
        self._file_reservation = reserve_plan_file(self._plan_file) if self._plan_file else None
        if self._plan_file and self._file_reservation is None:
            self.get_logger().warning(
                f'plan_file: another planner keeps its plan in {brief(self._plan_file)}; this one '
                'neither reads nor writes it; give each planner a file of its own')
            self._plan_file = ''
        self._uavs = [*self._settings.uavs]
        self._local_frames = LocalFrames(
            self, lambda: self._settings, {name: name for name in self._uavs},
            lambda *_: self._publish_status())
        self._poses = PoseBook(Frames(self).transform, self._local_frames.to_mission)
        self._poses.on_jump = self._on_jump
        self._pose_warnings = WarningLog(self.get_logger())  # Why poses are refused.
        self._notes: dict[str, str] = {}  # About each receiver, as logged.
        self._tracking = PlanTracking(self._poses)
        self._followed = self._tracking.followed
        self._state = State()
        self._solver = SolverThread(self.post, self._publish_status)
        self._call = Call('answered')  # The last call of ~/plan.
        # Time [s] that the clock must have reached if it was not set back since a restored plan.
        self._reached = -math.inf
        # Time, by time.monotonic, until which a restored plan's follower may be discovered.
        self._discovery_deadline = 0.0
        self._replanning = Replanning(self._poses, self._tracking)
        self._replan_problem = ''  # Why the rest of the mission cannot be planned again.
        self._make_interface()
        self._restore()
        self._publish_status()
        self._declared.warn_of_unknown()
        if reason := explain_infeasible(self._settings):
            self.get_logger().warning(f'the mission cannot be flown as it is set: {reason}')
        self.get_logger().info(brief('ready: ~/plan plans for ' + ', '.join(self._uavs)))

    def _make_interface(self) -> None:
        """Create the topics, services and timers."""
        group, settings = self.default_callback_group, self._settings
        self._outputs = publishers(self, TOPICS['planner', 'pub'], self._uavs)
        # A second ~/plan is answered while the first waits.
        serve(self, {'~/plan': self._on_plan}, ReentrantCallbackGroup())
        serve(self, {'~/cancel': self._on_cancel}, group)
        # Both timers continue when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.create_timer(_CHECK_PERIOD, self._on_check, clock=steady)
        topics = dict(TOPICS['planner', 'sub'])
        subscribe(self, {'plan_time': topics.pop('plan_time')}, self._on_plan_time, group, ())
        subscribe(self, {'<uav>/relay': topics.pop('<uav>/relay')}, self._on_relay, group,
                  self._uavs)
        subscribe(self, topics, self._on_pose, group, self._uavs, {
            '<ground_node>': [*settings.ground_nodes],
            '<eavesdropper>': [*settings.eavesdroppers]})

    @property
    def _settings(self) -> PlannerSettings:
        return self._declared.current

    def close(self) -> bool:
        """Answer the present call, and stop the solve; return True if its thread has ended."""
        super().close()
        if self._file_reservation is not None:
            self._file_reservation.close()
        self._call.reply(False, 'the planner is stopping')
        return self._solver.close(timeout=1.0)

    def _read_clock_ns(self) -> int:
        return self.get_clock().now().nanoseconds

    def _now_ns(self) -> int:
        """Return the time of the clock [ns], and note a jump; called in the state thread."""
        longest, now_ns = self.find_longest_step(), self._read_clock_ns()
        self._poses.follow_clock(now_ns * 1e-9, longest)
        return now_ns

    def _now(self) -> float:
        return self._now_ns() * 1e-9

    # The state thread

    def _on_pose(self, topic: str, message: Message) -> None:
        """Keep a pose of a receiver or UAV, or warn why it is not used."""
        is_first = self._poses.get(topic) is None
        try:
            remark = self._poses.take(topic, message, self._settings, self._now(),
                                      _CLOCK_LAG if is_simulated(self) else 0.0)
        except PoseError as error:
            self._pose_warnings.warn(topic, f'{topic}: {brief(error)}; it is not used')
            return
        self._pose_warnings.clear(topic, _WARN_AGAIN_S)
        if remark:
            self.get_logger().warning(remark)
        if is_first or remark:
            self._publish_status()

    def _on_plan_time(self, _: str, message: TimeReference) -> None:
        self._followed.add_report(message, self._now())

    def _on_relay(self, topic: str, message: DiagnosticStatus) -> None:
        if self._tracking.relays.take(topic, message):
            self._publish_status()

    def _on_jump(self, before: float, now: float) -> None:
        """
        End the promise of the last plan if its flight has not begun, because the clock jumped.

        That plan's receivers are predicted for the clock before the jump. A flight that has begun
        becomes early or late, and so its promise ends by itself. The last call is marked as
        jumped. The followers' reports are forgotten if the clock was set back.
        """
        self._call.has_jumped = True
        plan = self._state.plan
        ended = plan
        if plan is not None and plan.promised_until is not None and (
                self._followed.is_waiting(plan, before)):
            ended = plan.end_promise(0.0)
        if now < before:
            self._followed.forget_reports()
        if ended is not None and ended is not plan:
            self._state.plan = ended
            self._publish_plan(ended, messages.serialize_plan(ended, self._settings.frame_id))
            self._save(ended)

    # Planning on request

    async def _on_plan(self) -> tuple[bool, str]:
        """Return the answer (success, text) to a call; refuse it while another is unanswered."""
        if self._call.state != 'answered':
            busy = BusyError('a solve is under way')
            self._refuse(busy)
            return False, str(busy)
        self._call = Call()
        self._plan_if_discovered()
        return await self._call.answer

    def _plan_if_discovered(self) -> None:
        """Start the solve of a call that waits, once a follower is heard or discovery is over."""
        if self._call.state == 'waits' and (
                self._followed.has_time_scale or time.monotonic() >= self._discovery_deadline):
            self._call.state = 'solved'
            self._plan()

    def _plan(self) -> None:
        """Start the solve of the present call's request, or answer the call with a refusal."""
        began, now_ns = time.monotonic(), self._now_ns()
        self._call.has_jumped = False  # What matters is a jump from now on.
        settings, now, last = self._settings, now_ns * 1e-9, self._state.plan
        try:
            self._followed.check_steady(now)
            self._followed.check_known(now)
            flight = self._flight(now)
            start = StartTime.from_settings(
                settings, now_ns, flight, self._followed.until_superseded(flight, now))
            limit = start.time_limit(settings.time_limit or None)
            request = make_request(
                settings, self._poses, start, self._tracking.states(flight, settings, now),
                flight)
        except Exception as error:
            self._call.reply(False, self._refuse(error))
            return
        self._log_notes(request.receivers.notes)
        # The solve begins from the last plan if that has a similar mission.
        initial = last if last and is_similar(request.scenario, last.scenario) else None
        self._solve(request, initial, None if limit is None else began + limit)

    def _solve(self, request: Request, initial: Plan | None = None, until: float | None = None
               ) -> None:
        self._start(lambda job: request.solve(job, initial, until, self._read_clock_ns),
                    partial(self._finish_request, request), 'cancelled')

    def _finish_request(self, request: Request, result: Result) -> None:
        """Publish the plan of a request, or refuse it, and answer its call."""
        try:
            plan, outgoing = result()
            now_ns = self._now_ns()
            now = now_ns * 1e-9
            # Predictions, and a point 0 by start_delay, are for the clock before the jump.
            if self._call.has_jumped and (
                    plan.promised_until is not None or request.start.delay):
                raise LateError('the clock jumped while the plan was made; ask again')
            if request.is_outlasted_by(plan):  # Predict the receivers again, and answer later.
                self._solve(request.predict_again(plan, self._poses, now_ns))
                return
            request.start.check_in_time(now_ns)
            self._followed.check_steady(now)
            request.check_flight(self._flight(now), now)
            self._state.keep_requested(plan)
            self._local_frames.moves.clear()  # They are no problem of the new plan.
            self._publish_plan(plan, outgoing)
            self._save(plan)
            text = self._log_outcome()
        except Exception as error:
            self._call.reply(False, self._refuse(request.start.explain(error, request.settings)))
            return
        unknown = self._followed.unknown_plan(self._now())
        self._call.reply(True, f'plan {plan.identity}: {text}{request.flight_text}' + (
            '' if unknown is None else f'; the follower has another plan, {unknown}'))

    def _log_notes(self, notes: Mapping[str, str]) -> None:
        """Log the note about each receiver that differs from its last logged note."""
        for receiver, note in notes.items():
            if self._notes.get(receiver) != note:
                self.get_logger().warning(note)
        self._notes |= notes

    def _start(self, work: Callable[[Job], Any], finish: Callable[[Result], None], cancelled: str
               ) -> None:
        """Start a solve; when it ends, call `finish` and begin to prove the last plan's bound."""
        def then(result: Result) -> None:
            finish(result)
            self._prove_bound()

        self._solver.start(work, then, cancelled)
        self._publish_status()

    def _flight(self, now: float) -> Flight | None:
        """Return the flight that a new plan continues, or None if no follower reports now."""
        flight = self._followed.flight(now)
        return flight if flight is not None and flight.is_reported else None

    def _on_cancel(self) -> tuple[bool, str]:
        if self._call.state == 'waits':
            self._call.reply(False, self._refuse(StoppedError('cancelled')))
        elif not self._solver.cancel():
            return False, 'no solve is under way'
        return True, 'cancelling'

    def _refuse(self, error: Exception, is_replan: bool = False) -> str:
        """Note, log and return the reason why there is no new plan."""
        outcome = self._state.refuse(error, is_replan)
        log_at(self.get_logger(), outcome.level, f'no new plan: {outcome.text}')
        self._publish_status()
        return outcome.text

    # Replanning

    def _on_check(self) -> None:
        """Update what is known of the flight, and begin a replan that is due."""
        settings, now = self._settings, self._now()
        if 0.0 < now:  # Simulated time is 0 until it is known.
            reached, self._reached = self._reached, -math.inf
            if now < reached:
                self._on_jump(reached, now)
        self._tracking.observe(settings, now)
        self._plan_if_discovered()
        if (ended := self._tracking.check_promise(now)) is not None:
            self._keep_ended(ended)
        flight = self._followed.flight(now)
        if flight is not None and flight.state == 'ended':
            self._state.forget_replan()
        for problem in self._tracking.relays.find_newly_lost():
            if flight is not None and flight.is_under_way:
                self.get_logger().warning(problem)
                self._publish_status()
        if self._solver.is_solving or self._state.plan is None or self.is_closed:
            return
        try:
            rule = self._replanning.find_rule(settings, now)
            if rule is None and self._replanning.is_settled(settings, now):
                self._state.forget_replan()
            remainder = rule and self._replanning.take_remainder(rule, settings, now)
            self._replan_problem = ''
        except PlanningError as error:
            problem = f'the rest of the mission cannot be planned again: {brief(error)}'
            if problem != self._replan_problem:
                self.get_logger().warning(problem)
            self._replan_problem = problem
            return
        if remainder is not None:
            self._log_notes(remainder.receivers.notes)
            self._start(remainder.solve, partial(self._finish_replan, remainder),
                        'the replan was cancelled')

    def _keep_ended(self, plan: Plan) -> None:
        """Keep and save a plan whose promise has ended, if it is the last plan."""
        if self._state.plan is not None and plan.identity == self._state.plan.identity:
            self._state.plan = plan
            self._save(plan)

    def _finish_replan(self, remainder: Remainder, result: Result) -> None:
        """Publish the plan of a remainder, or note its failure and refuse it."""
        try:
            plan, rejoin, begin, outgoing = result()
            now = self._now()
            remainder.check_in_time(rejoin, self._followed.flight(now), now)
        except Exception as error:
            self._replanning.note_failure(remainder.rule)
            self._refuse(error, is_replan=True)
            return
        # A plan with the last plan's identity is published too: its receivers have moved.
        is_new = self._state.keep_replan(plan)
        self._local_frames.moves.clear()  # They are no problem of the new plan.
        self._publish_plan(plan, outgoing, begin)
        self._save(plan)
        if is_new:
            self._log_outcome()

    # Publishing

    def _restore(self) -> None:
        """Publish the plan in the plan file, if there is one, or warn why it cannot be used."""
        file = self._plan_file
        try:
            if not file or (plan := load_plan(file, self._settings)) is None:
                return
            outgoing = messages.serialize_plan(plan, self._settings.frame_id)
            self._state.keep_restored(plan)
            self._publish_plan(plan, outgoing)
            self._log_outcome()
            self._reached = earliest_request(plan, self._settings)
            self._discovery_deadline = time.monotonic() + _DISCOVERY  # ~/plan may wait till then.
        except Exception as error:
            describe = brief if isinstance(error, (PlanningError, OSError)) else describe_error
            self.get_logger().warning(f'plan_file: {describe(error)}; it is not published')

    def _publish_plan(self, plan: Plan, outgoing: Mapping[str, bytes], begin: float = -math.inf
                      ) -> None:
        """
        Publish the last plan of the state by its messages, track it, and publish the status.

        :param outgoing: serialized messages of the plan by topic.
        :param begin: time of the plan [s] from which its receivers are the present ones.
        """
        for topic, message in outgoing.items():
            self._outputs[topic].publish(message)
        now = self._now()
        self._followed.add_plan(plan, now)
        self._poses.expect(plan.scenario, begin)
        self._replanning.note_plan(now, begin)
        self._publish_status()

    def _log_outcome(self) -> str:
        """Log and return the outcome of the last request or replan in one line."""
        outcome = self._state.outcome
        log_at(self.get_logger(), outcome.level, outcome.text)
        return outcome.text

    def _prove_bound(self) -> None:
        """With `bound` 'after' and an idle solver, prove the last plan's bound if it has none."""
        plan = self._state.plan
        if (self._settings.bound != 'after' or plan is None or self._state.bound is not None
                or self._solver.job is not None):
            return
        if refusal := explain_refusal(plan.scenario):
            self.get_logger().info(f'no bound: {refusal}', once=True)
            return

        def finish(result: Result) -> None:
            """Keep the bound of the plan and save it, or log why there is none."""
            try:
                bound = result()
            except Exception as error:
                self.get_logger().error(f'the bound cannot be computed: {describe_error(error)}')
                return
            self._state.bound = bound
            # The promise of the plan may have ended during the proof.
            self._save((self._state.plan or plan).with_bound(bound))
            self.get_logger().info(f'{plan.rate:.4f} bit/s/Hz, {bound.claim(plan)}')
            self._publish_status()

        self._solver.start(lambda job: job.prove_bound(plan), finish, is_solve=False)

    def _save(self, plan: Plan) -> None:
        """Save a plan in another thread, since writing to a disk takes time."""
        if file := self._plan_file:
            self._solver.save(partial(
                save_plan, plan, file, self._settings.frame_id, self.get_logger()))

    def _status_message(self) -> DiagnosticStatus:
        """Return the message of the status: plan, solver, flight, poses and problems."""
        now, settings = self._now(), self._settings
        problems, track = self._tracking.status(settings, now)
        status = make_status(self._state, self._solver.progress, self._solver.is_solving, [
            *self._poses.problems(settings, now), *self._local_frames.problems, *problems,
            *filter(None, [self._replan_problem, warn_of_namesakes(self)])], now)
        return replace(
            status, pose_age=self._poses.ages(settings, now), track=track,
            relay=self._tracking.relays.names(settings.uavs)).to_message(
                self.get_fully_qualified_name().lstrip('/') + ': plan')

    def _publish_status(self) -> None:
        self._outputs['~/status'].publish(self._status_message())

    def _publish_diagnostics(self) -> None:
        """Publish the status on ~/status and /diagnostics."""
        status = self._status_message()
        self._outputs['~/status'].publish(status)
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._outputs['/diagnostics'].publish(message)


main = partial(run_node, Planner)

if __name__ == '__main__':
    main()
