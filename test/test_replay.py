"""The replay node, in a process of its own over DDS."""

from dataclasses import replace
from itertools import pairwise
import math
import shutil
import subprocess
import time

from fuzzing import check_abnormal
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_client import node_here, node_process, refusal, wait_for, wait_for_line
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.model.curve import Curve
from secure_uav_planner.plan.player import Player
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.topics import LATCHED, TOPICS
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Float64
from strategies import with_uavs
from trajectory_msgs.msg import MultiDOFJointTrajectory


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


def test_autostart_leaves_a_plan_whose_time_has_passed_to_a_start(client, poses, plan):
    with node_here('replay', autostart='true') as process:
        send(client, plan, begins_at(-60.0))
        wait_for_line(process, 'is not started: its time has passed; ~/start plays it')
        assert not client.call('replay/pause').success and not poses
        assert client.call('replay/start').success
        wait_for(lambda: poses)


def test_with_autostart_a_pause_lasts_through_a_replan_until_a_start(client, poses, plan):
    with node_here('replay', autostart='true') as process:
        start_ns = begins_at(3600.0)
        send(client, plan, start_ns)
        wait_for(lambda: len(poses) > 3)
        assert client.call('replay/pause').success
        # A plan of the same flight.
        send(client, replace(plan, powers=plan.powers * 0.5), start_ns)
        wait_for(lambda: got(process) == 2)
        assert not client.call('replay/pause').success
        # Another flight, from where the setpoints rest.
        send(client, plan, start_ns + 10**9)
        wait_for(lambda: got(process) == 3)
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


def test_with_few_setpoints_the_time_of_the_plan_is_still_told_often(client, poses, file):
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


def test_a_start_and_a_pause_tell_the_time_of_the_plan_at_once(client, file):
    times = client.listen(TimeReference, 'plan_time', 1000)
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


def test_abnormal_messages_on_any_topic_are_told_once_and_calls_are_answered(
        client, poses, plan):
    topics = {topic.replace('<uav>', 'uav1'): kind.kind for topic, kind in {
        **TOPICS['replay', 'sub'], '<uav>/odom': TOPICS['replay', 'pub']['<uav>/odom']}.items()}
    with node_here('replay', autostart='true') as process, node_process(
            'replay', '-r', '__node:=vehicles', vehicle_odometry='true') as vehicles:
        send(client, plan, begins_at(3600.0))
        wait_for(lambda: poses)

        def publish(topic, message):
            # With the rest of a plan, so that it is used.
            for name, part in messages.plan_messages(plan, 'earth'):
                if name != topic and name.endswith(('/path', '/power')):
                    if name.endswith('/power'):
                        part.layout.dim = part.layout.dim[:1]
                    client.publisher(type(part), name, LATCHED).publish(part)
            qos = 10 if topic.endswith('/odom') else LATCHED
            client.publisher(type(message), topic, qos).publish(message)

        for node, name in ((process, 'replay'), (vehicles, 'vehicles')):
            check_abnormal(node, publish, topics, lambda: client.call(f'{name}/start'))
        count = len(poses)
        wait_for(lambda: len(poses) > count + 3)


# For a process whose system clock is as many s off as a file is long in bytes, backward.
SHIFTED_CLOCK = """
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now) {
  int result = syscall(SYS_clock_gettime, clock, now);
  struct stat file;
  if (!result && clock == CLOCK_REALTIME && !stat(getenv("CLOCK_BEHIND"), &file))
    now->tv_sec -= file.st_size;
  return result;
}
"""


@pytest.fixture
def set_back(tmp_path, monkeypatch):
    """Return a function that sets the clock of processes, which start from now on, back by s."""
    if shutil.which('gcc') is None:
        pytest.skip('the clock of a process is changed by a library, which gcc builds')
    library, file = tmp_path / 'clock.so', tmp_path / 'behind'
    subprocess.run(['gcc', '-shared', '-fPIC', '-x', 'c', '-', '-o', library],
                   input=SHIFTED_CLOCK, text=True, check=True)
    monkeypatch.setenv('LD_PRELOAD', str(library))
    monkeypatch.setenv('CLOCK_BEHIND', str(file))
    return lambda seconds: file.write_bytes(bytes(seconds))


def test_setpoints_go_on_when_the_clock_is_set_back(client, poses, plan, tmp_path, set_back):
    file = tmp_path / 'plan.json'
    replace(plan, start_ns=begins_at(0.0)).save(file)
    with node_process('replay', plan_file=file):
        assert client.call('replay/start').success
        wait_for(lambda: poses and poses[-1].pose.position.y < 495.0)
        before = poses[-1]
        set_back(3600)
        wait_for(lambda: poses[-1].header.stamp.sec < before.header.stamp.sec - 1800)
        wait_for(lambda: poses[-1].pose.position.y < before.pose.position.y - 10.0)
        assert client.call('replay/pause').success
        # It has begun, although its time is to come once more.
        assert client.call('replay/start').message.partition(': playing')[1]


@pytest.mark.parametrize('text, reason', [
    (None, ''), ('{"format": "other"}', ' is not a plan'), ('[1, 2', ' is not a plan')])
def test_a_file_that_is_no_plan_ends_the_node_with_one_clear_line(tmp_path, capfd, text, reason):
    path = tmp_path / 'foreign.json'
    if text is not None:
        path.write_text(text)
    line = refusal(capfd, 'replay', plan_file=path)
    assert 'parameter plan_file' in line and f'foreign.json{reason}' in line


def test_the_wrong_eavesdropper_and_a_new_frame_of_a_saved_plan_are_refused(client, file):
    with node_here('replay', plan_file=file):
        result = client.set_parameters('replay', true_eavesdropper=[1.0])[0]
        assert not result.successful and 'true_eavesdropper' in result.reason
        assert client.set_parameters('replay', true_eavesdropper=[1.0, 2.0])[0].successful
        assert not client.set_parameters('replay', frame_id='odom')[0].successful


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


@pytest.fixture(scope='module')
def smooth():
    """Return a plan with limits of acceleration."""
    return fly_hover_fly(with_uavs(
        Scenario.paper(120.0, slots=30), max_acceleration=1.5), 'optimised')


def test_setpoints_are_on_the_curve_of_the_trajectories_and_have_its_velocity(
        client, poses, smooth):
    speed = 10.0
    setpoints = client.listen(MultiDOFJointTrajectory, 'uav1/setpoint/trajectory', 10000)
    with node_here('replay', speed=speed, rate=50.0) as process:
        answer = client.call('replay/start')
        assert not answer.success and answer.message == 'there is no plan yet'
        send(client, smooth, 10**18)
        wait_for_line(process, 'got a plan of 30 slots')
        assert not setpoints  # Nobody asked for it to start.
        assert client.call('replay/start').success
        wait_for(lambda: setpoints and (
            setpoints[-1].points[0].transforms[0].translation.y == -500.0), what='the goal')
    curve = Curve(smooth.scenario, smooth.positions)
    motion = curve.at(np.linspace(curve.begin, curve.end, 20001))
    for message in setpoints:
        assert (message.header.frame_id, message.joint_names) == ('earth', ['uav1'])
        point, = message.points
        place, velocity, acceleration = (
            point.transforms[0].translation, point.velocities[0].linear,
            point.accelerations[0].linear)
        apart = np.linalg.norm(motion.positions[0] - (place.x, place.y), axis=-1)
        assert apart.min() < 0.05 and place.z == smooth.scenario.uavs[0].altitude
        assert [velocity.x / speed, velocity.y / speed] == pytest.approx(
            motion.velocities[0, apart.argmin()], abs=0.1)
        assert math.hypot(acceleration.x, acceleration.y) <= 1.5 * speed**2 + 1e-6
    # The points are farther from the curve than that: nobody flies straight between them.
    corners = curve.at(smooth.times).positions - smooth.positions
    assert np.linalg.norm(corners, axis=-1)[0].max() > 0.5
