"""The planner node: poses and parameters in, plans out."""

from concurrent.futures import CancelledError
from dataclasses import replace
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
from .mission import GROUND_NODE_TOPIC, pose_problems, pose_topic, scenario_from
from .parameters import eavesdropper_parameters, Parameters, PLANNER, uav_from, uav_parameters
from .poses import PoseBook, PoseError
from .process import run_node
from .qos import LATCHED, OVERRIDABLE, SENSOR
from .solver import Busy, Solver
from ..optimize.feasible import similar

_STATUS_PERIOD = 0.1


class Planner(Node):
    """
    Plans on request; the README has its topics, services and parameters.

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
        self._solver = Solver(self._on_iteration)
        self._plan = None
        self._progress = None
        self._progress_shown = 0.0
        self._outcome = (DiagnosticStatus.OK, 'no plan yet')
        self._refusals = 0
        self._status_lock = threading.Lock()
        self._make_interface()
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
        # Diagnostics go on while simulated time stands still.
        self.create_timer(1.0, self._publish_diagnostics, callback_group=services,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def close(self):
        """Stop the solve under way; return whether nothing is left running."""
        return self._solver.close(timeout=1.0)

    def _now(self):
        return self.get_clock().now().nanoseconds * 1e-9

    def _check(self, values):
        for name in self._uavs:
            uav_from(values, name)

    def _on_pose(self, topic, message):
        frame_id = self._settings['frame_id']
        first = self._poses.get(topic) is None
        try:
            self._poses.take(topic, message, frame_id, self._now())
        except PoseError as error:
            reason = str(error)
            if (topic, reason) not in self._warned:
                self._warned.add((topic, reason))
                self.get_logger().warning(f'{topic}: {reason}; it is not used')
        else:
            self._warned -= {known for known in self._warned if known[0] == topic}
            if first:
                self._publish_status()

    def _on_plan(self, _request, response):
        try:
            scenario = scenario_from(self._settings, self._poses, self._now())
            future = self._solver.start(
                scenario, method=self._settings['method'],
                time_limit=self._settings['time_limit'] or None,
                initial=self._initial(scenario))
        except (ValueError, Busy) as error:
            return self._refuse(response, str(error))
        try:
            plan = future.result()
        except CancelledError:
            return self._refuse(response, 'the planner is shutting down')
        except Exception as error:
            self.get_logger().error(f'the solve failed: {type(error).__name__}: {error}')
            return self._refuse(response, f'the solve failed: {error}', DiagnosticStatus.ERROR)
        finally:
            self._progress = None
        if plan.status == 'cancelled':
            return self._refuse(response, 'cancelled; the last plan stands')
        self._publish_plan(replace(plan, start_ns=self.get_clock().now().nanoseconds))
        response.success, response.message = True, self._outcome[1]
        return response

    def _initial(self, scenario):
        """Return the last plan where it is a good start for the scenario."""
        if self._plan is not None and similar(scenario, self._plan.scenario):
            return self._plan
        return None

    def _refuse(self, response, reason, level=DiagnosticStatus.WARN):
        self._refusals += 1
        self._outcome = (level, reason)
        self.get_logger().warning(f'no plan: {reason}')
        self._publish_status()
        response.success, response.message = False, reason
        return response

    def _on_cancel(self, _request, response):
        response.success = self._solver.cancel()
        response.message = ('cancelling; the last plan stands' if response.success
                            else 'no solve is under way')
        return response

    def _on_iteration(self, iteration):
        self._progress = iteration
        if time.monotonic() - self._progress_shown > _STATUS_PERIOD:
            self._progress_shown = time.monotonic()
            self._publish_status()

    def _publish_plan(self, plan):
        frame_id = self._settings['frame_id']
        # Everything is made before anything is sent: all of a plan is published, or nothing.
        paths, powers, trajectories = ([make(index) for index in range(len(self._uavs))]
                                       for make in (
            lambda index: messages.path(plan, index, frame_id),
            lambda index: messages.power(plan, index),
            lambda index: messages.trajectory(plan, index, frame_id)))
        markers = messages.markers(plan, frame_id)
        for publishers, made in ((self._paths, paths), (self._powers, powers),
                                 (self._trajectories, trajectories)):
            for publisher, message in zip(publishers, made):
                publisher.publish(message)
        self._markers.publish(markers)
        self._plan = plan
        level = (DiagnosticStatus.OK if plan.status == 'converged' else DiagnosticStatus.WARN)
        self._outcome = (level, summary(plan))
        log = self.get_logger()
        (log.info if level == DiagnosticStatus.OK else log.warning)(self._outcome[1])
        self._publish_status()

    def _status_message(self):
        now = self._now()
        plan, progress = self._plan, self._progress
        level, text = self._outcome
        problems = pose_problems(self._settings, self._poses, now)
        values = {'state': 'solving' if self._solver.busy else 'idle'}
        if progress is not None and self._solver.busy:
            level, text = DiagnosticStatus.OK, 'solving'
            values.update({
                'progress.iteration': progress.number, 'progress.step': progress.step,
                'progress.guaranteed_rate': progress.guaranteed_rate,
                'progress.elapsed': progress.elapsed})
        elif problems and level == DiagnosticStatus.OK:
            level = DiagnosticStatus.STALE if 's old' in ' '.join(problems) else (
                DiagnosticStatus.WARN)
            text = '; '.join(problems)
        if plan is not None:
            values.update({
                'plan.stamp': f'{plan.start_ns * 1e-9:.9f}',
                'plan.age': now - plan.start_ns * 1e-9,
                'plan.guaranteed_rate': plan.guaranteed_rate,
                'plan.worst_case_rate': plan.worst_case_rate, 'plan.method': plan.method,
                'plan.status': plan.status, 'plan.iterations': plan.history[-1].number,
                'plan.solve_time': plan.solve_time})
        for topic in [GROUND_NODE_TOPIC, *map(pose_topic, self._eavesdroppers + self._uavs)]:
            known = self._poses.get(topic)
            values[f'pose_age.{topic}'] = 'none' if known is None else known.age(now)
        values['refusals'] = self._refusals
        return messages.status(self.get_fully_qualified_name().lstrip('/'), level, text, values)

    def _publish_status(self):
        with self._status_lock:
            self._status.publish(self._status_message())

    def _publish_diagnostics(self):
        message = DiagnosticArray(status=[self._status_message()])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def summary(plan):
    """Return a plan in one line."""
    reasons = {
        'converged': 'converged',
        'iteration_limit': 'stopped at the iteration limit',
        'time_limit': 'stopped at time_limit with the best feasible plan so far',
        'numerical_trouble': 'a step of the solver failed, the best feasible plan is kept',
    }
    return (f'{plan.method} plan of {plan.scenario.slots} slots: guaranteed rate '
            f'{plan.guaranteed_rate:.4f}, worst-case rate {plan.worst_case_rate:.4f} bit/s/Hz, '
            f'{plan.solve_time:.2f} s, {plan.history[-1].number} iterations, '
            f'{reasons[plan.status]}')


def main(args=None):
    """Run the planner node as a process."""
    run_node(Planner, args)


if __name__ == '__main__':
    main()
