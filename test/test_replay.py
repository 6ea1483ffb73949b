"""The replay node over DDS."""

from dataclasses import replace
from itertools import pairwise
from queue import Queue
from threading import Event
import time

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from rclpy.clock import ClockType
from ros_nodes import has_said, node_here, PATIENCE, wait_for, wait_for_line
from secure_uav_planner import fly_hover_fly, Plan, Scenario
from secure_uav_planner.plan.file import parse_text, write_plan
from secure_uav_planner.plan.player import Player
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.replay import plan_reader
from secure_uav_planner.ros.replay.node import Replay
from secure_uav_planner.ros.topics import LATCHED
from sensor_msgs.msg import TimeReference
from simulation import SimulatedTime
from std_msgs.msg import Float64, String
from studies.flown.missions import limit_acceleration
from test_security import lone_node


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
        line = wait_for_line(process, 'end of the plan')
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
    average = float(line.split('bit/Hz, ')[1].split(' bit/s/Hz')[0])
    flown = [rate.data for rate in rates]
    assert len(flown) > 50 and np.mean(flown) == pytest.approx(average, rel=0.15)
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


def send(client, plan, start_ns, frame_id='earth'):
    """Send a plan that begins at a time in ns."""
    client.publisher(String, 'plan', LATCHED).publish(
        messages.plan_text(replace(plan, start_ns=start_ns), frame_id))


def test_it_loops_and_starts_by_itself_when_asked(poses, file):
    with node_here('replay', plan_file=file, speed=2000.0, loop='true',
                   autostart='true') as process:
        wait_for(lambda: has_said(process, 'end of the plan', 3))


def test_setpoints_of_a_saved_plan_are_in_the_frame_of_its_file(poses, plan, file):
    write_plan(plan, file, frame_id='odom')
    with node_here('replay', plan_file=file, autostart='true'):
        wait_for(lambda: poses)
    assert poses[0].header.frame_id == 'odom'


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
        # Another flight, from where the setpoints rest: a pause ends by ~/start or ~/reset alone.
        send(client, plan, start_ns + 10**9)
        wait_for(lambda: got(process) == 4)
        assert not client.call('replay/pause').success
        assert client.call('replay/start').success
        send(client, plan, start_ns + 2 * 10**9)
        wait_for(lambda: got(process) == 5)
        assert client.call('replay/pause').success


def test_autostart_judges_the_time_of_a_plan_once_simulated_time_is_known(client, plan):
    with node_here('replay', autostart='true', use_sim_time='true') as process:
        send(client, plan, 400 * 10**9)
        wait_for_line(process, 'simulated time is not known yet; publish /clock')
        assert not client.call('replay/start').success
        with SimulatedTime(client, start=500.0):
            wait_for_line(process, 'is not started: its time has passed; ~/start plays it')


def test_a_flight_whose_promise_has_ended_is_not_promised_again_at_its_end(client, poses, file):
    plan = fly_hover_fly(limit_acceleration(Scenario.paper(120.0, slots=60), 3.0))
    replace(plan, promised_until=10.0).save(file)
    with node_here('replay', plan_file=file, speed=50.0, autostart='true',
                   loop='true') as process:
        wait_for(lambda: has_said(process, 'end of the plan', 2))
        assert has_said(process, 'is not promised; powers are sent', 2)  # Once in each flight.
        assert not has_said(process, 'promised again')


def test_setpoints_stay_in_the_frame_of_the_plan_that_is_played(client, poses, plan):
    with node_here('replay', autostart='true') as process:
        start_ns = begins_at(3600.0)
        send(client, plan, start_ns)
        wait_for(lambda: poses)
        for seconds in (0, 1):
            send(client, replace(plan, powers=plan.powers * 0.5), start_ns + seconds * 10**9,
                 'elsewhere')
            wait_for(lambda: has_said(
                process, "it is in frame 'elsewhere' and the setpoints are in 'earth'; call "
                '~/reset, then ~/plan and ~/start', seconds + 1))
        count = len(poses)
        wait_for(lambda: len(poses) > count + 3)
        assert {pose.header.frame_id for pose in poses} == {'earth'}
        # Without setpoints it is a plan like any other; one that is refused changes nothing.
        assert client.call('replay/reset').success
        send(client, plan, start_ns + 2 * 10**9, 'elsewhere')
        wait_for(lambda: poses[-1].header.frame_id == 'elsewhere')


def test_the_end_is_logged_once_where_a_plan_that_waited_for_it_is_refused(client, poses, plan):
    with node_here('replay', speed=40.0) as process:
        start_ns = begins_at(0.0)
        send(client, plan, start_ns)
        wait_for(lambda: got(process))
        assert client.call('replay/start').success
        wait_for(lambda: poses and poses[-1].pose.position.y < 495.0)
        send(client, plan, start_ns + 3600 * 10**9)
        wait_for_line(process, 'the new plan is not played: its setpoint of uav1')
        assert not client.call('replay/pause').success  # It is answered after that tick.
        assert sum('end of the plan' in line for line in process.lines) == 1


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


def test_a_long_plan_is_read_in_another_process_and_a_start_waits_for_it(
        client, poses, plan, monkeypatch):
    long = fly_hover_fly(Scenario.paper(104, slots=20000))
    with node_here('replay') as process:
        monkeypatch.setattr(plan_reader, 'parse_text', None)  # In the process of the stream.
        send(client, long, 10**18)
        # The order of messages and requests is not kept.
        wait_for(lambda: client.call('replay/start').success)
        wait_for(lambda: poses)
        assert got(process) == 1
        send(client, replace(long, start_ns=None), None)
        wait_for_line(process, 'start_ns is null; it must be the time of point 0 in ns')


def test_texts_are_read_in_their_order_and_of_those_that_wait_only_the_newest(plan):
    posted, taken, refused = Queue(), [], []
    texts = [messages.plan_text(replace(plan, start_ns=10**18 + at), 'map').data
             for at in range(4)]
    reader = plan_reader.PlanReader(
        posted.put, lambda plan, frame: taken.append((plan.start_ns - 10**18, frame)),
        refused.append)
    reader.read(texts[0])
    assert taken == [(0, 'map')]
    reader.read(texts[1] + ' ' * plan_reader.MOST_CHARACTERS)
    reader.read('no plan')
    reader.read(texts[2])
    reader.read(texts[3])
    assert taken == [(0, 'map')]
    posted.get(timeout=PATIENCE)()
    assert taken == [(0, 'map'), (1, 'map'), (3, 'map')]
    reader.read('[' * plan_reader.MOST_CHARACTERS + '[')
    posted.get(timeout=PATIENCE)()
    assert len(refused) == 1 and 'the message is not a plan' in refused[0]
    reader.close()


@pytest.mark.parametrize('service', ['pause', 'reset'])
def test_a_start_is_withdrawn_while_a_long_plan_is_read(client, poses, plan, monkeypatch, service):
    reads, waits, may_end, wait = Event(), Event(), Event(), plan_reader.PlanReader.wait

    def read(process, text):
        reads.set()
        assert may_end.wait(PATIENCE)
        return parse_text(text, Plan)

    def note_wait(reader):
        waits.set()
        return wait(reader)

    monkeypatch.setattr(plan_reader.ReaderProcess, 'read', read)
    monkeypatch.setattr(plan_reader.PlanReader, 'wait', note_wait)
    monkeypatch.setattr(plan_reader, 'MOST_CHARACTERS', 0)
    with node_here('replay') as process:
        send(client, plan, 10**18)
        wait_for(reads.is_set)
        answer = client.ask('replay/start')
        wait_for(waits.is_set)
        client.call(f'replay/{service}')
        may_end.set()
        wait_for(answer.done)
        assert '~/pause or ~/reset was called before' in answer.result().message
        wait_for(lambda: got(process))
        assert client.call('replay/pause').message == 'nothing is playing' and not poses


def test_paths_without_a_plan_are_told_in_one_line(client):
    with node_here('replay') as process:
        client.node.create_publisher(Path, 'uav1/path', LATCHED)
        line = wait_for_line(process, 'uav1/path is published and plan is not')
        assert 'examples/ros/plan_from_path.py' in line
        answer = client.call('replay/start')
        assert not answer.success and 'uav1/path is published' in answer.message


def test_a_flight_goes_on_when_the_clock_is_set_back_before_its_begin(client, poses, plan, file):
    replace(plan, start_ns=1000 * 10**9).save(file)
    with node_here('replay', plan_file=file, use_sim_time='true'), SimulatedTime(
            client, start=1000.0) as clock:
        assert client.call('replay/start').success
        wait_for(lambda: poses and poses[-1].pose.position.y < 495.0)
        before = poses[-1].pose.position.y
        clock.jump(10.0)
        wait_for(lambda: poses[-1].pose.position.y < before - 10.0)
        assert client.call('replay/pause').success
        # It has begun, although its time is to come once more.
        assert client.call('replay/start').message.partition(': playing')[1]


def test_setpoints_are_timed_by_a_clock_that_nobody_sets_back():
    with lone_node(Replay) as node:
        assert {timer.clock.clock_type for timer in node.timers} == {ClockType.STEADY_TIME}


def test_a_message_that_is_no_plan_is_told_once_and_leaves_the_last_plan(client, plan):
    stranger = replace(plan, scenario=replace(plan.scenario, uavs=tuple(
        replace(uav, name=f'other_{uav.name}') for uav in plan.scenario.uavs)))
    with node_here('replay') as process:
        publisher = client.publisher(String, 'plan', LATCHED)
        for text, reason in (('{', 'the message is not a plan: line 1 is not JSON'),
                             ('[]', 'the message is not a plan: it is not a secure_uav_planner')):
            publisher.publish(String(data=text))
            wait_for_line(process, reason)
            answer = client.call('replay/start')
            assert not answer.success and 'there is no plan yet' in answer.message
            assert f'the plan of the topic is not used: {reason}' in answer.message
        send(client, stranger, 10**18)
        wait_for_line(process, "it is for ['other_uav1', 'other_uav2'], and uavs is ['uav1', ")
        send(client, plan, 11 * 10**17)
        wait_for(lambda: got(process) == 1)
        assert sum('not JSON' in line for line in process.lines) == 1, process.lines
        publisher.publish(String(data='{'))
        wait_for(lambda: has_said(process, 'not JSON', 2))
        assert client.call('replay/start').success


def test_a_slot_that_is_not_promised_is_told_and_muted_if_that_is_asked_for(
        client, poses, plan, file):
    watts = client.listen(Float64, 'uav1/setpoint/power', 10000)
    replace(plan, promised_until=200.0, gaps=((20.0, 60.0),), start_ns=time.time_ns(),
            promise_speed=20.0).save(file)
    with node_here('replay', plan_file=file, speed=20.0, rate=50.0, autostart='true',
                   mute_unpromised='true') as process:
        wait_for_line(process, 'end of the plan')
        line = next(line for line in process.lines if 'is not promised; ' in line)
    assert 'no power is sent' in line
    flown = np.array([watt.data for watt in watts])
    signs = ''.join('01'[int(value > 0)] for value in flown)
    longest = max(map(len, signs.split('1')))  # Setpoints without power.
    assert longest > 50 or not flown.any()


@pytest.mark.parametrize('promised_until, is_told', [(None, False), (104.0, True)])
def test_a_late_start_ends_a_promise_only_where_receivers_move(
        client, poses, plan, file, promised_until, is_told):
    """Before, it was told of every plan that was made by ~/plan and started by ~/start."""
    replace(plan, promised_until=promised_until, start_ns=time.time_ns() - 10**9).save(file)
    with node_here('replay', plan_file=file):
        answer = client.call('replay/start')
    assert answer.success and (' late, so the rates are no longer guaranteed' in answer.message
                               ) == is_told, answer.message
