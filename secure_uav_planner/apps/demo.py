"""
The demo: plan a mission with both nodes, replay it, save it and draw it.

The planner and the replay node run in separate processes. This third process uses their topics
and services over DDS, like any other program.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
import pathlib
import sys
import time
from typing import Any

from ament_index_python import get_package_share_path
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
import numpy as np
import rclpy
from rclpy.client import Client
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from .. import Channel, fly_hover_fly, Plan, Scenario, solve, upper_bound
from ..errors import PlanningError
from ..mission import Objective
from ..output.page import save_page
from ..output.picture import save_picture
from ..output.table import table
from ..ros.graph import isolated, node_process
from ..ros.messages import pose
from ..ros.recording import record
from ..ros.topics import LATCHED

_PATIENCE = 120.0
_REPLAY_SPEED = 50.0
_PROOF = 10.0


class DemoError(PlanningError, RuntimeError):
    """The demo cannot continue; the text gives the reason."""

    code = 'demo'


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--mission', default='paper',
                        help="'paper', 'city', or a mission file")
    parser.add_argument('--out', type=pathlib.Path,
                        help='folder for the results, by default out, or out/MISSION')
    parser.add_argument('--method', help="optimisation method, by default the planner's")
    options = parser.parse_args(argv)
    try:
        file = _mission_file(options.mission)
        scenario = Scenario.load(file) if file else Scenario.paper()
        out = options.out or pathlib.Path('out', file.stem if file else '')
        out.mkdir(parents=True, exist_ok=True)
        with isolated(out):
            plan = _plan_and_replay(scenario, file, options.method)
        plans = [fly_hover_fly(plan.scenario, 'constant'),
                 fly_hover_fly(plan.scenario, 'optimised'), plan]
        if plan.scenario.channel.is_free_space:
            print(f'proving how good they are, for at most {_PROOF:g} s ...', flush=True)
            bound = upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                                time_limit=_PROOF)
            plans = [one.with_bound(bound) for one in plans]
        else:
            print('planning for free space, to see what that would cost ...', flush=True)
            plans.insert(2, planned_for_free_space(plan.scenario, plan.objective))
    except (PlanningError, OSError) as error:
        print(f'demo: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    print()
    *others, plan = plans
    print(table(plans))
    files = [out / f'plan.{ending}' for ending in ('json', 'png', 'html', 'mcap')]
    plan.save(files[0])
    save_picture(plan, files[1], others)
    save_page(plan, files[2])
    record(plan, files[3])
    print(f'\nsaved: {", ".join(map(str, files))}')
    return 0


def planned_for_free_space(scenario: Scenario, objective: Objective) -> Plan:
    """Return the plan for free space, with the rates that it has in the scenario's channel."""
    plan = solve(replace(scenario, channel=Channel()), objective=objective)
    return replace(plan, scenario=scenario, method='planned for free space')


def _mission_file(mission: str) -> pathlib.Path | None:
    """Return the file of a mission: one of the package's by name, one by path, or the paper's."""
    file = pathlib.Path(mission)
    if file.suffix:
        return file
    folder: pathlib.Path = get_package_share_path('secure_uav_planner') / 'config'
    return None if mission == 'paper' else folder / f'{mission}.yaml'


def _plan_and_replay(scenario: Scenario, file: pathlib.Path | None, method: str | None) -> Plan:
    """Let the nodes plan and replay the scenario of a file; return the plan that was received."""
    parameters = ['-p', f'mission_file:={file}'] if file else []  # The paper's is the default.
    planner = [*parameters, '-p', f'method:={method}'] if method else parameters
    place = np.array(scenario.eavesdroppers[0].position) - [
        scenario.eavesdroppers[0].error_radius, 0.0]
    replay = [*parameters, '-p', f'speed:={_REPLAY_SPEED}',
              '-p', f'true_eavesdropper:={place.tolist()}']
    with node_process('planner', planner), node_process('replay', replay):
        with _client(scenario) as client:
            return client.run()


@contextmanager
def _client(scenario: Scenario) -> Iterator['_Client']:
    rclpy.init(args=[])
    try:
        client = _Client(scenario)
        try:
            yield client
        finally:
            client.destroy_node()
    finally:
        rclpy.try_shutdown()


class _Client(Node):
    """A client that sends the poses, requests a plan and its replay, and receives both."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__('demo')
        self._scenario = scenario
        self._names = [uav.name for uav in scenario.uavs]
        self._paths, self._powers, self._places, self._status = {}, {}, {}, {}
        self._ground_node = self.create_publisher(PoseStamped, 'ground_node/pose', 10)
        self._estimates = {
            eve.name: self.create_publisher(PoseWithCovarianceStamped, f'{eve.name}/pose', 10)
            for eve in scenario.eavesdroppers}
        for name in self._names:
            self._receive(Path, f'{name}/path', self._paths, LATCHED)
            self._receive(Float64MultiArray, f'{name}/power', self._powers, LATCHED)
            self._receive(Odometry, f'{name}/odom', self._places, 10)
        self.create_subscription(DiagnosticStatus, 'planner/status', self._on_status, LATCHED)
        self.create_timer(0.2, self._send_poses)

    def run(self) -> Plan:
        """Return the plan that was received, once its replay has ended."""
        services = {name: self.create_client(Trigger, name)
                    for name in ('planner/plan', 'replay/start')}
        for name, service in services.items():
            self._wait(service.service_is_ready, f'the service {name}')
        self._wait(self._poses_known, 'a status of the planner with all poses')
        started = time.monotonic()
        print('planning ...', flush=True)
        answer = self._call(services['planner/plan'])
        if not answer.success:
            raise DemoError(f'planner/plan: {answer.message}')
        elapsed = time.monotonic() - started
        self._wait(lambda: 'plan.objective' in self._status, 'the status of the plan')
        self._wait(lambda: len(self._paths) == len(self._powers) == len(self._names), 'the plan')
        print(f'replaying at {_REPLAY_SPEED:g} times real time ...', flush=True)
        # The replay node may receive the plan later than this process.
        self._wait(lambda: self._call(services['replay/start']).success, 'the replay')
        self._wait(self._arrived, 'the end of the replay')
        positions = [[(at.pose.position.x, at.pose.position.y) for at in self._paths[name].poses]
                     for name in self._names]
        return Plan(self._scenario, positions, [self._powers[name].data for name in self._names],
                    method='planned over DDS', solve_time=elapsed,
                    objective=self._status['plan.objective'])

    def _receive(self, kind: type, topic: str, kept: dict[str, Any], qos: QoSProfile | int
                 ) -> None:
        name = topic.split('/')[0]
        self.create_subscription(kind, topic, lambda message: kept.update({name: message}), qos)

    def _send_poses(self) -> None:
        place = PoseStamped()
        place.header.frame_id = 'map'
        place.header.stamp = self.get_clock().now().to_msg()
        place.pose = pose(*self._scenario.ground_node, 0.0, 0.0)
        self._ground_node.publish(place)
        for eve in self._scenario.eavesdroppers:
            estimate = PoseWithCovarianceStamped(header=place.header)
            # Without a covariance, the planner uses its parameter <eavesdropper>.error_radius.
            estimate.pose.pose = pose(*eve.position, 0.0, 0.0)
            self._estimates[eve.name].publish(estimate)

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._status = {entry.key: entry.value for entry in message.values}
        if 'progress.iteration' in self._status:
            print(f'  iteration {self._status["progress.iteration"]:>3}  '
                  f'{self._status["progress.rate"]} bit/s/Hz', flush=True)

    def _poses_known(self) -> bool:
        return all(self._status.get(f'pose_age.{name}/pose', 'none') != 'none'
                   for name in ('ground_node', *self._estimates))

    def _call(self, service: Client) -> Trigger.Response:
        future = service.call_async(Trigger.Request())
        self._wait(future.done, f'the answer of {service.srv_name}')
        return future.result()

    def _wait(self, condition: Callable[[], object], what: str) -> None:
        until = time.monotonic() + _PATIENCE
        while not condition():
            if time.monotonic() > until:
                raise DemoError(f'{what} did not come within {_PATIENCE:g} s')
            rclpy.spin_once(self, timeout_sec=0.1)

    def _arrived(self) -> bool:
        for name in self._names:
            here = self._places.get(name)
            goal = self._paths[name].poses[-1].pose.position
            if here is None or abs(here.pose.pose.position.x - goal.x) + abs(
                    here.pose.pose.position.y - goal.y) > 1e-6:
                return False
        return True


if __name__ == '__main__':
    sys.exit(main())
