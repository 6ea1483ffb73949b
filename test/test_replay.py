"""The replay node over DDS."""

from dataclasses import replace
from itertools import pairwise
import time

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from ros_client import node_here, wait_for, wait_for_line
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.plan.player import Player
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.replay import Replay
from secure_uav_planner.ros.topics import LATCHED
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Float64


@pytest.fixture(scope='module')
def plan():
    return fly_hover_fly(Scenario.paper(104, slots=26), 'optimised')


@pytest.fixture
def file(plan, tmp_path):
    path = tmp_path / 'plan.json'
    plan.save(path)
    return path


@pytest.fixture
def poses(client):
    """Return the setpoints of a UAV as poses; a start waits for a subscriber of each UAV."""
    return [client.listen(PoseStamped, f'{name}/setpoint/pose', 10000)
            for name in ('uav1', 'uav2')][0]


def end_of(process):
    return next((line for line in process.lines if 'end of the plan' in line), None)


def test_a_saved_plan_is_flown_from_start_to_goal_and_what_it_delivered_is_logged(
        client, poses, plan, file):
    watts = client.listen(Float64, 'uav2/setpoint/power', 1000)
    odometry = client.listen(Odometry, 'uav2/odom', 1000)
    rates = client.listen(Float64, 'replay/secrecy_rate', 1000)
    with node_here('replay', plan_file=file, speed=20.0, rate=50.0,
                   true_eavesdropper='[204.0, 3.0]') as process:
        assert not client.set_parameters('replay', true_eavesdropper=[1.0])[0].successful
        assert not client.set_parameters('replay', frame_id='odom')[0].successful
        assert client.call('replay/start').success
        line = wait_for(lambda: end_of(process), what='the end of the plan')
        wait_for(lambda: poses and poses[-1].pose.position.y == -500.0)
        wait_for(lambda: odometry and len(rates) > 10)
        assert 'has ended, and no newer one has come' in client.call('replay/start').message
    assert poses[0].header.frame_id == 'map'
    path = np.array([(pose.pose.position.x, pose.pose.position.y) for pose in poses])
    # Every setpoint is on the planned path.
    at = np.interp(-path[:, 1], -plan.positions[0, :, 1], np.arange(28))
    assert path[:, 0] == pytest.approx(
        np.interp(at, np.arange(28), plan.positions[0, :, 0]), abs=1e-6)
    assert {round(watt.data, 9) for watt in watts} <= {
        0.0, *(round(power, 9) for power in plan.powers[1].tolist())}
    assert max(rate.data for rate in rates) > 1.0
    assert odometry[-1].child_frame_id == 'uav2/base_link'
    assert odometry[-1].pose.pose.position.z == 110.0
    player = Player()
    player.load(plan)
    player.start()
    for seconds in (0, 1000):
        player.tick((plan.start_ns or 0) + seconds * 10**9, 1.0, (204.0, 3.0), longest=1000.0)
    delivered = float(line.split('delivered in secret ')[1].split(' bit/Hz')[0])
    assert delivered == pytest.approx(player.delivered, rel=0.01)
    assert 'largest jump between consecutive setpoints 0.000 m' in line


def keep(kind, uav, message):
    """Leave a message as it is, in send."""


def send(client, plan, start_ns, change=None, topics=('path', 'power', 'trajectory')):
    """
    Send the messages of a plan, with no delay in between.

    :param change: changes each message. The planner's own powers name the messages that belong to
        them; with a change they name nothing, like those of another planner.
    """
    made = []
    for topic, message in messages.plan_messages(replace(plan, start_ns=start_ns), 'earth'):
        name, _, kind = topic.partition('/')
        if kind in topics:
            if change is not None:
                change(kind, name, message)
                if kind == 'power':
                    del message.layout.dim[1]
            made.append((client.publisher(type(message), topic, LATCHED), message))
    for publisher, message in made:
        publisher.publish(message)


def test_it_loops_and_starts_by_itself_when_asked(poses, file):
    with node_here('replay', plan_file=file, speed=2000.0, loop='true',
                   autostart='true') as process:
        wait_for(lambda: sum('end of the plan' in line for line in process.lines) >= 3)


def begins_at(seconds):
    """Return the time of point 0 in ns of a plan that begins so many s from now."""
    return time.time_ns() + round(seconds * 1e9)


def got(process):
    return sum('got a plan' in line for line in process.lines)


def test_autostart_begins_neither_a_late_plan_nor_a_replan_of_one_that_is_paused(
        client, poses, plan):
    with node_here('replay', autostart='true') as process:
        send(client, plan, begins_at(-60.0))
        wait_for_line(process, 'is not started: its time has passed; ~/start plays it')
        assert not client.call('replay/pause').success and not poses
        assert client.call('replay/start').success
        wait_for(lambda: poses)
        assert client.call('replay/reset').success
        start_ns = begins_at(3600.0)
        send(client, plan, start_ns)
        wait_for(lambda: client.call('replay/pause').success)
        # A plan of the same flight.
        send(client, replace(plan, powers=plan.powers * 0.5), start_ns)
        wait_for(lambda: got(process) == 3)
        assert not client.call('replay/pause').success
        # Another flight, from where the setpoints rest.
        send(client, plan, start_ns + 10**9)
        wait_for(lambda: got(process) == 4)
        assert client.call('replay/pause').success


def move_elsewhere(kind, uav, message):
    """Set another frame of the paths, which the poses leave out."""
    if kind == 'path':
        message.header.frame_id = 'elsewhere'
        for pose in message.poses:
            pose.header.frame_id = ''


def test_setpoints_stay_in_the_frame_of_the_plan_that_is_played(client, poses, plan):
    with node_here('replay', autostart='true') as process:
        start_ns = begins_at(3600.0)
        send(client, plan, start_ns, keep, ('path', 'power'))
        wait_for(lambda: poses)
        for seconds in (0, 1):
            send(client, replace(plan, powers=plan.powers * 0.5), start_ns + seconds * 10**9,
                 move_elsewhere, ('path', 'power'))
            wait_for(lambda: sum(
                "it is in frame 'elsewhere' and the setpoints are in 'earth'" in line
                for line in process.lines) > seconds)
        count = len(poses)
        wait_for(lambda: len(poses) > count + 3)
        assert {pose.header.frame_id for pose in poses} == {'earth'}
        # Without setpoints it is a plan like any other; one that is refused changes nothing.
        assert client.call('replay/reset').success
        send(client, plan, start_ns + 2 * 10**9, move_elsewhere, ('path', 'power'))
        wait_for(lambda: poses[-1].header.frame_id == 'elsewhere')


def test_the_time_of_the_plan_is_told_often_and_at_once_after_a_start_and_a_pause(
        client, poses, file):
    times = client.listen(TimeReference, 'plan_time', 1000)

    def stamps_of(received):
        return [(message.header.stamp.sec, message.header.stamp.nanosec) for message in received]

    with node_here('replay', plan_file=file, rate=0.5):
        assert client.call('replay/start').success
        # A busy machine leaves some out.
        wait_for(lambda: any(
            sum(begin < stamp <= end for stamp in stamps_of(times)) >= 8
            for begin, end in pairwise(stamps_of(poses))), what='8 reports in 2 s')
        assert poses[0].pose.position.y == 500.0  # The start itself.
    times.clear()
    # Nobody sends the simulated time, so that nothing else tells it.
    with node_here('replay', plan_file=file, use_sim_time='true'):
        wait_for(lambda: client.call('replay/start').success and times)
        count = len(times)
        assert client.call('replay/pause').success
        wait_for(lambda: len(times) > count)


@pytest.mark.parametrize('service', ['', 'pause', 'reset'])
def test_a_start_waits_for_the_rest_of_a_plan_until_that_comes_or_it_is_withdrawn(
        client, poses, plan, service):
    with node_here('replay') as process:
        def waits():
            # The rest is waited for for two seconds only, which may pass on a busy machine.
            send(client, plan, 10**18, topics=('path',))
            return 'waits for the rest of the plan' in client.call('replay/start').message and (
                not service or client.call(f'replay/{service}').success)

        wait_for(waits)
        if not service:
            wait_for_line(process, 'no new message on')
        send(client, plan, 10**18)
        wait_for(lambda: got(process))
        if service:
            assert client.call('replay/pause').message == 'nothing is playing'
        else:
            wait_for(lambda: poses, what='the flight')


def test_setpoints_go_on_when_the_clock_is_set_back(client, poses, plan, file, monkeypatch):
    timers, behind, create_timer = [], [0.0], Node.create_timer

    class SetBack:
        """The clock of a node, which is set back."""

        def __init__(self, node):
            self._clock = Node.get_clock(node)
            self.ros_time_is_active = False

        def now(self):
            return self._clock.now() - Duration(seconds=behind[0])

    def note_timer(*arguments, **options):
        timers.append(create_timer(*arguments, **options))
        return timers[-1]

    monkeypatch.setattr(Replay, 'get_clock', lambda node: SetBack(node))
    monkeypatch.setattr(Replay, 'create_timer', note_timer)
    replace(plan, start_ns=begins_at(0.0)).save(file)
    with node_here('replay', plan_file=file):
        assert client.call('replay/start').success
        wait_for(lambda: poses and poses[-1].pose.position.y < 495.0)
        before, behind[0] = poses[-1], 3600.0
        wait_for(lambda: poses[-1].header.stamp.sec < before.header.stamp.sec - 1800)
        wait_for(lambda: poses[-1].pose.position.y < before.pose.position.y - 10.0)
        assert client.call('replay/pause').success
        # It has begun, although its time is to come once more.
        assert client.call('replay/start').message.partition(': playing')[1]
        # What calls it is not set back.
        assert {timer.clock.clock_type for timer in timers} == {ClockType.STEADY_TIME}


def test_messages_that_make_no_plan_are_told_once_and_leave_the_last_plan(client, plan):
    def remove_limit(kind, uav, message):
        if kind == 'power':
            message.data[0] = 1e308

    with node_here('replay') as process:
        send(client, plan, 10**18, remove_limit)
        wait_for_line(process, 'values beyond')
        answer = client.call('replay/start')
        assert not answer.success
        assert 'there is no plan yet' in answer.message and 'values beyond' in answer.message
        send(client, plan, 11 * 10**17, keep)
        wait_for(lambda: got(process) == 1)
        assert sum('values beyond' in line for line in process.lines) == 1, process.lines
        send(client, plan, 12 * 10**17, remove_limit)
        wait_for(lambda: sum('values beyond' in line for line in process.lines) == 2)
        assert client.call('replay/start').success
        send(client, plan, 13 * 10**17, keep)
        wait_for(lambda: got(process) == 2)
        # Somebody publishes trajectories, so that they are waited for.
        send(client, plan, 14 * 10**17, keep, ('path', 'power'))
        wait_for_line(process, 'no new message on uav1/trajectory, uav2/trajectory')
