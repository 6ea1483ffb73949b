"""Followers of a plan over DDS: two that report at once, and one that reports nothing."""

import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from ros_client import node_process, stamp_at, values_of, wait_for
from secure_uav_planner import Scenario
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.client import SecurePlanner
from simulation import DEEP

PARAMETERS = {'duration': 150.0, 'slots': 75, 'uav1__max_acceleration': 2.0,
              'uav2__max_acceleration': 2.0, 'replan_deviation': 8.0}
UAVS = ('uav1', 'uav2')


def check_on_plan(statuses, replans):
    """Check that the UAVs were on their plan in each status, and how often it was replanned."""
    for status in statuses:
        values = values_of(status)
        assert 'from its plan' not in status.message, status.message
        assert all(values[f'track.distance.{name}'] == 'none' or float(
            values[f'track.distance.{name}']) < 1.0 for name in UAVS), values
        assert values['replans'] in replans, values


def test_of_two_followers_the_planner_tracks_one_and_says_so(client):
    apart = [word for name in UAVS for word in ('-r', f'{name}/odom:=second/{name}/odom')]
    with node_process('planner', **PARAMETERS), \
            node_process('replay', '-r', '__node:=second', *apart), node_process('replay'):
        status = client.listen(DiagnosticStatus, 'planner/status', DEEP)

        def time_of_plan():
            return float(values_of(status[-1])['track.time'])
        client.plan_paper()
        wait_for(lambda: client.call('replay/start').success, what='the plan at the replay')
        wait_for(lambda: time_of_plan() > 4.0)
        status.clear()
        wait_for(lambda: client.call('second/start').success)
        wait_for(lambda: any('followers' in message.message for message in status))
        wait_for(lambda: time_of_plan() > 14.0)
        times = [float(values_of(message)['track.time']) for message in status]
        assert times == sorted(times), times
        check_on_plan(status, '0')


class Vehicles:
    """Vehicles that fly the plans of a client by their stamps, and send odometry only."""

    def __init__(self, client):
        self._client, self._plans = client, []
        self._publishers = {name: client.node.create_publisher(Odometry, f'{name}/odom', 10)
                            for name in UAVS}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()

    def _run(self):
        while not self._stop.wait(0.05):
            plan, now = self._client.last_plan, time.time()
            if plan is None:
                continue
            if not self._plans or self._plans[-1].plan is not plan:
                self._plans.append(Playback(plan))
            begun = [playback for playback in self._plans
                     if playback.plan.start_ns * 1e-9 + playback.begin <= now]
            playback = (begun or self._plans)[-1]
            moment = playback.at(now - playback.plan.start_ns * 1e-9)
            for index, (name, publisher) in enumerate(self._publishers.items()):
                publisher.publish(messages.odometry(
                    'map', f'{name}/base_link', stamp_at(now),
                    (*moment.positions[index], playback.plan.scenario.uavs[index].altitude), 0.0,
                    moment.velocities[index]))


def test_a_follower_by_stamps_alone_stays_on_its_plan_through_plans_and_replans():
    statuses = []
    with node_process('planner', **PARAMETERS, pose_timeout=0.0), \
            SecurePlanner(Scenario.paper(150.0, slots=75), on_status=statuses.append) as client:
        client.wait_until(client.knows_poses, repeat=client.send_poses)
        client.plan()
        with Vehicles(client):
            def fly(seconds):
                until = time.time() + seconds
                client.wait_until(lambda: time.time() > until)
            client.wait_until(lambda: client.knows_poses('uav1/odom', 'uav2/odom'))
            statuses.clear()
            fly(8.0)
            for _ in range(2):
                client.plan()
                fly(6.0)
            assert {values_of(status)['track.state'] for status in statuses} <= {
                'flying by stamps'}
            check_on_plan(statuses, '0')
