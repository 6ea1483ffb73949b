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
from secure_uav_planner.ros.messages import read_plan_time
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


def end_of(process):
    return next((line for line in process.lines if 'end of the plan' in line), None)


def test_a_saved_plan_is_flown_from_start_to_goal_and_what_it_delivered_is_logged(
        client, plan, file):
    poses = client.listen(PoseStamped, 'uav1/setpoint/pose', 1000)
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


ALL = ('path', 'power', 'trajectory')


def keep(kind, uav, message):
    """Leave a message as it is, in send."""


def send(client, plan, start_ns, change=None, topics=None):
    """
    Send the messages of a plan, with no delay in between.

    :param change: changes each message. The planner's own powers name the messages that belong to
        them; with a change they name nothing, like those of another planner.
    :param topics: which kinds; by default all, but for trajectories with a change.
    """
    topics = topics or (ALL if change is None else ALL[:2])
    plan = replace(plan, start_ns=start_ns)
    found, made = dict(messages.plan_messages(plan, 'earth')), []
    for index, uav in enumerate(plan.scenario.uavs):
        for topic in topics:
            message = found[f'{uav.name}/{topic}']
            if change is not None:
                change(topic, index, message)
                if topic == 'power':
                    del message.layout.dim[1]
            publisher = client.publisher(type(message), f'{uav.name}/{topic}', LATCHED)
            made.append((publisher, message))
    for publisher, message in made:
        publisher.publish(message)


def test_it_loops_and_starts_by_itself_when_asked(file):
    with node_here('replay', plan_file=file, speed=2000.0, loop='true',
                   autostart='true') as process:
        wait_for(lambda: sum('end of the plan' in line for line in process.lines) >= 3)


def begins_at(seconds):
    """Return the time of point 0 in ns of a plan that begins so many s from now."""
    return time.time_ns() + round(seconds * 1e9)


def got(process):
    return sum('got a plan' in line for line in process.lines)


def test_autostart_leaves_a_plan_whose_time_has_passed_to_a_start(client, plan):
    poses = client.listen(PoseStamped, 'uav1/setpoint/pose', 1000)
    with node_here('replay', autostart='true') as process:
        send(client, plan, begins_at(-60.0))
        wait_for_line(process, 'is not started: its time has passed; ~/start plays it')
        assert not client.call('replay/pause').success and not poses
        assert client.call('replay/start').success
        wait_for(lambda: poses)


def test_with_autostart_a_pause_lasts_through_a_replan_until_a_start(client, plan):
    poses = client.listen(PoseStamped, 'uav1/setpoint/pose', 1000)
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


def wrong(topic, index, field, value):
    """
    Return a change for send of the message of a topic and a UAV, or of all UAVs for None.

    :param field: its name, after those of what it is in, such as 'poses.7.header.frame_id'.
    :param value: the new one, or a function of the old one.
    """
    def change(kind, uav, message):
        if kind == topic and index in (uav, None):
            *way, name = field.split('.')
            for part in way:
                message = message[int(part)] if part.isdigit() else getattr(message, part)
            new = value(getattr(message, name)) if callable(value) else value
            setattr(message, name, new)
    return change


ENDLESS = wrong('power', 1, 'data', lambda data: [1e308, *data[1:]])


def of_frame(frame_id):
    """Return a change for send after which all paths are in a frame, which the poses leave out."""
    def change(kind, uav, message):
        if kind == 'path':
            message.header.frame_id = frame_id
            for pose in message.poses:
                pose.header.frame_id = ''
    return change


def test_setpoints_stay_in_the_frame_of_the_plan_that_is_played(client, plan):
    poses = client.listen(PoseStamped, 'uav1/setpoint/pose', 10000)
    with node_here('replay', autostart='true') as process:
        start_ns = begins_at(3600.0)
        send(client, plan, start_ns, keep)
        wait_for(lambda: poses)
        for seconds in (0, 1):
            send(client, replace(plan, powers=plan.powers * 0.5), start_ns + seconds * 10**9,
                 of_frame('elsewhere'))
            wait_for(lambda: sum(
                "it is in frame 'elsewhere' and the setpoints are in 'earth'" in line
                for line in process.lines) > seconds)
        count = len(poses)
        wait_for(lambda: len(poses) > count + 3)
        assert {pose.header.frame_id for pose in poses} == {'earth'}
        # Without setpoints it is a plan like any other; one that is refused changes nothing.
        assert client.call('replay/reset').success
        send(client, plan, start_ns + 2 * 10**9, of_frame('elsewhere'))
        wait_for(lambda: poses[-1].header.frame_id == 'elsewhere')


def test_with_few_setpoints_the_time_of_the_plan_is_still_told_often(client, file):
    poses = client.listen(PoseStamped, 'uav1/setpoint/pose', 1000)
    times = client.listen(TimeReference, 'plan_time', 1000)
    with node_here('replay', plan_file=file, rate=0.5):
        assert client.call('replay/start').success

        def is_told():
            told, stamps = ([(one.header.stamp.sec, one.header.stamp.nanosec) for one in list(got)]
                            for got in (times, poses))
            # A busy machine tells less in some of the periods of 2 s.
            return any(sum(begin < stamp <= end for stamp in told) >= 8
                       for begin, end in pairwise(stamps))
        wait_for(is_told)
        assert poses[0].pose.position.y == 500.0  # The start itself.


def test_a_start_and_a_pause_tell_the_time_of_the_plan_at_once(client, file):
    times = client.listen(TimeReference, 'plan_time', 1000)
    # Nobody sends the simulated time, so that nothing else tells it.
    with node_here('replay', plan_file=file, use_sim_time='true'):
        wait_for(lambda: client.call('replay/start').success and times)
        count = len(times)
        assert client.call('replay/pause').success
        wait_for(lambda: len(times) > count)


def test_a_plan_of_constant_power_is_played_although_its_mean_is_rounded_up(client, plan):
    powers = np.full_like(plan.powers, 0.38)
    assert powers[0].mean() > 0.38
    with node_here('replay') as process:
        send(client, replace(plan, powers=powers), 10**18)
        wait_for(lambda: got(process) or any('not used' in line for line in process.lines))
        assert got(process), process.lines


def test_a_start_waits_for_the_rest_of_a_plan_however_late_that_comes(client, plan):
    poses = client.listen(PoseStamped, 'uav1/setpoint/pose', 1000)
    with node_here('replay') as process:
        def waits():
            send(client, plan, 10**18, topics=('path',))
            return 'waits for the rest of the plan' in client.call('replay/start').message

        wait_for(waits)
        wait_for_line(process, 'no new message on')
        send(client, plan, 10**18)
        wait_for(lambda: poses, what='the flight')


def test_abnormal_messages_on_any_topic_are_told_once_and_calls_are_answered(client, plan):
    topics = {topic.replace('<uav>', 'uav1'): kind.kind for topic, kind in {
        **TOPICS['replay', 'sub'], '<uav>/odom': TOPICS['replay', 'pub']['<uav>/odom']}.items()}
    stamps = client.listen(PoseStamped, 'uav1/setpoint/pose', 1000)
    with node_here('replay', autostart='true') as process, node_process(
            'replay', '-r', '__node:=vehicles', vehicle_odometry='true') as vehicles:
        send(client, plan, begins_at(3600.0))
        wait_for(lambda: stamps)

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
            check_abnormal(client, node, publish, topics, lambda: client.call(f'{name}/start'))
        count = len(stamps)
        wait_for(lambda: len(stamps) > count + 3)


@pytest.mark.parametrize('service', ['pause', 'reset'])
def test_a_start_that_waits_for_the_rest_of_a_plan_can_be_withdrawn(client, plan, service):
    with node_here('replay') as process:
        def is_withdrawn():
            # The rest is waited for for two seconds only, which may pass on a busy machine.
            send(client, plan, 10**18, topics=('path',))
            return 'waits for the rest of the plan' in client.call('replay/start').message and (
                client.call(f'replay/{service}').success)

        wait_for(is_withdrawn)
        send(client, plan, 10**18)
        wait_for(lambda: got(process))
        assert client.call('replay/pause').message == 'nothing is playing'


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


def test_setpoints_go_on_when_the_clock_is_set_back(client, plan, tmp_path, set_back):
    file = tmp_path / 'plan.json'
    replace(plan, start_ns=begins_at(0.0)).save(file)
    poses = client.listen(PoseStamped, 'uav1/setpoint/pose', 10000)
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


def test_the_wrong_eavesdropper_is_refused(client, file):
    with node_here('replay', plan_file=file):
        result = client.set_parameters('replay', true_eavesdropper=[1.0])[0]
        assert not result.successful and 'true_eavesdropper' in result.reason
        assert client.set_parameters('replay', true_eavesdropper=[1.0, 2.0])[0].successful


def test_the_frame_of_a_saved_plan_is_set_at_start_only(client, file):
    with node_here('replay', plan_file=file):
        assert not client.set_parameters('replay', frame_id='odom')[0].successful


@pytest.mark.parametrize('change, reason', [
    (wrong('power', 0, 'data', lambda data: data[:5]), 'uav1 has 28 points and 5 powers'),
    (wrong('path', 1, 'header.frame_id', 'odom'), "uav1/path in 'earth', uav2/path in 'odom'"),
    (of_frame('x' * 10_000), 'frame_id of the paths has 10000 characters'),
    (wrong('path', 1, 'poses.3.header.frame_id', 'odom'), "has a pose in frame 'odom'"),
    (wrong('path', 1, 'header.stamp.sec', lambda sec: sec + 5), 'their stamps differ'),
    (wrong('path', 0, 'poses.7.header.stamp.sec', lambda sec: sec + 1), 'equally spaced'),
    (wrong('path', 1, 'poses.9.pose.position.z', 115.0), 'the altitude must be constant'),
    (wrong('path', 0, 'poses.2.pose.position.x', 1e300), 'coordinates beyond'),
    (ENDLESS, 'values beyond')])
def test_messages_that_do_not_make_a_plan_are_refused_once_with_a_reason(
        client, recwarn, plan, change, reason):
    with node_here('replay') as process:
        def refusals():
            # On a busy machine, messages may have to wait for each other.
            return [line for line in process.lines
                    if 'not used' in line and 'no new message' not in line]

        send(client, plan, 10**18, keep)
        wait_for_line(process, 'got a plan')
        send(client, plan, 11 * 10**17, change)
        wait_for(refusals, what='the refusal')
        time.sleep(0.5)
        assert len(refusals()) == 1 and reason in refusals()[0], process.lines
        assert got(process) == 1
        assert not any('np.' in line for line in process.lines)
        assert not [one for one in recwarn if issubclass(one.category, RuntimeWarning)]
        assert client.call('replay/start').success  # the previous plan is kept
        send(client, plan, 12 * 10**17, keep)
        wait_for(lambda: got(process) == 2)


def test_a_start_says_why_the_messages_that_have_come_make_no_plan(client, plan):
    with node_here('replay') as process:
        send(client, plan, 10**18, ENDLESS)
        wait_for(lambda: any('values beyond' in line for line in process.lines))
        answer = client.call('replay/start')
        assert not answer.success
        assert 'there is no plan yet' in answer.message and 'values beyond' in answer.message


def test_a_power_that_comes_alone_is_not_joined_to_an_old_path(client, plan):
    watts = client.listen(Float64, 'uav1/setpoint/power', 1000)
    with node_here('replay', speed=50.0) as process:
        send(client, plan, 10**18, keep)
        wait_for_line(process, 'got a plan')
        lone = messages.power(plan, 0)
        del lone.layout.dim[1]
        for slot in range(len(lone.data)):
            lone.data[slot] = 3.21
        client.publisher(type(lone), 'uav1/power', LATCHED).publish(lone)
        wait_for(lambda: any('no new message on uav1/path, uav2/path, uav2/power' in line
                             for line in process.lines), what='the reason')
        assert client.call('replay/start').success
        wait_for(lambda: end_of(process))
        wait_for(lambda: watts)
        assert not any(watt.data == 3.21 for watt in watts)
        assert got(process) == 1


def test_messages_of_two_plans_of_one_flight_never_make_a_plan_together(client, plan):
    times = client.listen(TimeReference, 'plan_time', 10000)
    start_ns = begins_at(3600.0)
    first, second = (replace(plan, start_ns=start_ns, powers=plan.powers * share,
                             positions=plan.positions + np.pad(
                                 np.full((2, plan.scenario.slots, 2), 1e-7 * share),
                                 ((0, 0), (1, 1), (0, 0)))) for share in (0.5, 0.75))
    with node_here('replay') as process:
        def send_parts(plan, *parts):
            parts = {f'{uav}/{part}' for uav in ('uav1', 'uav2') for part in parts}
            for topic, message in messages.plan_messages(plan, 'earth'):
                if topic in parts:
                    client.publisher(type(message), topic, LATCHED).publish(message)

        send_parts(first, 'path', 'trajectory')
        wait_for_line(process, 'no new message on uav1/power, uav2/power')
        send_parts(second, 'power')
        wait_for_line(process, 'no new message on uav1/path, uav1/trajectory, uav2/path')
        assert not got(process)
        send_parts(second, 'path', 'trajectory')
        wait_for(lambda: times and read_plan_time(times[-1])[0] == second.identity)
        assert got(process) == 1


def at_of(setpoint):
    """Return the place (2,) and the velocity (2,) of a setpoint."""
    point, = setpoint.points
    place, velocity = point.transforms[0].translation, point.velocities[0].linear
    return np.array([place.x, place.y]), np.array([velocity.x, velocity.y])


def test_setpoints_have_position_velocity_and_acceleration_that_belong_together(client, tmp_path):
    scenario = with_uavs(Scenario.paper(120.0, slots=40), max_acceleration=1.5)
    smooth = fly_hover_fly(scenario)
    smooth.save(tmp_path / 'smooth.json')
    found = client.listen(MultiDOFJointTrajectory, 'uav1/setpoint/trajectory', 10000)
    with node_here('replay', plan_file=tmp_path / 'smooth.json', speed=2.0, rate=50.0):
        assert client.call('replay/start').success
        wait_for(lambda: len(found) > 200)
        assert client.call('replay/pause').success
        wait_for(lambda: not found[-1].points[0].velocities[0].linear.y)
    assert found[0].joint_names == ['uav1'] and found[0].header.frame_id == 'map'
    curve = Curve(scenario, smooth.positions)
    times = np.linspace(curve.begin, curve.end, 20001)
    motion = curve.at(times)
    for message in found[:200:10]:
        point, = message.points
        assert point.transforms[0].translation.z == scenario.uavs[0].altitude
        place, velocity = at_of(message)
        nearest = np.linalg.norm(motion.positions[0] - place, axis=-1).argmin()
        # Played at twice the speed.
        assert velocity == pytest.approx(2 * motion.velocities[0, nearest], abs=0.1)
        assert np.hypot(point.accelerations[0].linear.x,
                        point.accelerations[0].linear.y) <= 4 * 1.5 + 1e-6
    # It begins near rest and does not jump: from each to the next as its velocity says, however
    # much later that one is.
    y, speeds = np.array(list(map(at_of, found[:200])))[:, :, 1].T
    later = np.diff([message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
                     for message in found[:200]])
    assert (abs(np.diff(y) - speeds[:-1] * later) <= 4 * 1.5 / 2 * later**2 + 1e-3).all()
    assert y[0] == pytest.approx(500.0, abs=5.0)


# The curve of a plan on the topics

@pytest.fixture(scope='module')
def smooth():
    """Return a plan with limits of acceleration, which begins and ends at speed."""
    return fly_hover_fly(with_uavs(
        Scenario.paper(120.0, slots=30), max_acceleration=1.5, start_velocity=(1.0, -2.0),
        goal_velocity=None), 'optimised')


def distance_from_curve(plan, uav, setpoints):
    """Return how far setpoints are at most from the curve of a plan, in m and in m/s."""
    curve = Curve(plan.scenario, plan.positions)
    motion = curve.at(np.linspace(curve.begin, curve.end, 20001))
    places, velocities = map(np.array, zip(*map(at_of, setpoints)))
    apart = np.linalg.norm(motion.positions[uav][:, None] - places, axis=-1)
    nearest = apart.argmin(axis=0)
    off = np.linalg.norm(velocities - motion.velocities[uav][nearest], axis=-1)
    return apart.min(axis=0).max(), off.max()


def moving(setpoints):
    """Return the setpoints before the first that rests, after those that wait at the start."""
    speeds = [np.hypot(*at_of(one)[1]) for one in setpoints]
    first = next(number for number, speed in enumerate(speeds) if speed)
    return setpoints[first:next(
        (number for number, speed in enumerate(speeds) if number > first and not speed), None)]


def test_a_plan_of_the_topics_with_its_trajectories_flies_the_same_curve_as_from_a_file(
        client, smooth):
    setpoints = client.listen(MultiDOFJointTrajectory, 'uav1/setpoint/trajectory', 10000)
    with node_here('replay', speed=20.0, rate=50.0) as process:
        answer = client.call('replay/start')
        assert not answer.success and answer.message == 'there is no plan yet'
        send(client, smooth, 10**18, topics=ALL)
        wait_for_line(process, 'got a plan of 30 slots')
        assert not setpoints  # Nobody asked for it to start.
        assert client.call('replay/start').success
        wait_for(lambda: end_of(process))
    assert {one.header.frame_id for one in setpoints} == {'earth'}
    for message in setpoints:
        # As a vehicle sees it at real time.
        linear = message.points[0].velocities[0].linear
        linear.x, linear.y = linear.x / 20, linear.y / 20
    flown = moving(setpoints)
    assert len(flown) > 50
    assert distance_from_curve(smooth, 0, flown)[0] < 0.05
    # It begins and ends at speed, which the setpoints reach from rest and leave for rest.
    ends = [np.array(at_of(flown[end])[0]) for end in (0, -1)]
    inner = [message for message in flown if min(
        np.linalg.norm(at_of(message)[0] - end) for end in ends) > np.linalg.norm(
            ends[1] - ends[0]) / 5]
    assert distance_from_curve(smooth, 0, inner)[1] < 0.05
    # The points are farther from the curve than that: nobody flies straight between them.
    curve = Curve(smooth.scenario, smooth.positions).at(smooth.times).positions
    assert np.linalg.norm(curve - smooth.positions, axis=-1)[0].max() > 0.5
    assert not any('straight' in line for line in process.lines)


def test_trajectories_of_another_planner_may_come_in_any_order_and_are_waited_for(client, smooth):
    with node_here('replay') as process:
        send(client, smooth, 10**18, keep, topics=('trajectory', 'power', 'path'))
        wait_for(lambda: got(process) == 1)
        # The replay knows now that somebody publishes trajectories, and misses them.
        send(client, smooth, 11 * 10**17, keep)
        wait_for_line(process, 'no new message on uav1/trajectory, uav2/trajectory')
        assert got(process) == 1
        send(client, smooth, 11 * 10**17, topics=('trajectory',))
        wait_for(lambda: got(process) == 2)
        # A new plan of the same flight has the same stamp.
        send(client, smooth, 11 * 10**17, keep, topics=ALL)
        wait_for(lambda: got(process) == 3)
        assert sum('not used' in line for line in process.lines) == 1


@pytest.mark.parametrize('change, reason', [
    (wrong('trajectory', 0, 'points.7.transforms.0.translation.x', lambda x: x + 0.5),
     'uav1/trajectory is not the curve of uav1/path: at point 7'),
    (wrong('trajectory', 0, 'points.0.accelerations.0.linear.x', math.nan),
     'uav1/trajectory has values beyond'),
    (wrong('trajectory', 0, 'points', lambda points: points[:-1]),
     'uav1/trajectory has 31 points and uav1/path 32'),
    (wrong('trajectory', 1, 'points.3.accelerations', []),
     'uav1/trajectory has accelerations, uav2/trajectory is missing or has none'),
    (wrong('trajectory', 0, 'header.frame_id', 'odom'),
     "uav1/path is in frame 'earth', uav1/trajectory in 'odom'")])
def test_trajectories_that_do_not_belong_to_their_paths_are_refused(
        client, smooth, change, reason):
    with node_here('replay') as process:
        send(client, smooth, 10**18, change, topics=ALL)
        wait_for(lambda: any('not used' in line and reason in line for line in process.lines))
        assert not any('got a plan' in line for line in process.lines)
        # The right one completes the plan.
        send(client, smooth, 10**18, topics=('trajectory',))
        wait_for_line(process, 'got a plan')
