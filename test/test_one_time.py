"""Planner and replay agree on the plan that is flown and on its time, over DDS."""

from itertools import pairwise
import math
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry, Path
import numpy as np
from processes import ROOT
import pytest
from ros_client import Client, odometry_message, places_of
from ros_nodes import has_said, node_process, wait_for, wait_for_line
from secure_uav_planner.ros.messages import read_plan_time
from sensor_msgs.msg import TimeReference
from simulation import ACCELERATION, explain_jump, Setpoints
from std_msgs.msg import Float64

PARAMETERS = {'duration': 150.0, 'slots': 75, 'uav1__max_acceleration': ACCELERATION,
              'uav2__max_acceleration': ACCELERATION}
UAVS = 'uav1', 'uav2'


@pytest.fixture
def flown(client):
    """Yield a client, a planner and a replay with odometry of its own, and the stream."""
    with node_process('planner', **PARAMETERS), node_process('replay') as replay:
        client.replay, client.stream = replay, Setpoints(client, UAVS)
        client.send_paper()
        client.times = client.listen(TimeReference, 'plan_time', 100)
        client.powers = [client.listen(Float64, f'{name}/setpoint/power', 100)
                         for name in UAVS]
        yield client


def is_on_its_plan(client):
    distance = client.status.track.distance
    return client.status.level == DiagnosticStatus.OK and all(
        distance.get(name, math.inf) < 0.5 for name in UAVS)


def plan(client):
    """Ask for a plan; return the text of the answer, once the replay has adopted it."""
    before = client.status.plan.identity
    answer = client.call('planner/plan')
    assert answer.success, answer.message

    def is_adopted():
        identity = client.status.plan.identity
        return identity not in ('', before) and (
            client.times and read_plan_time(client.times[-1])[0] == identity)
    wait_for(is_adopted, what='the new plan in the replay')
    assert not has_said(client.replay, 'not played')
    return answer.message


def test_a_flight_released_late_paused_and_planned_again_from_there_is_smooth_and_on_its_plan(
        flown):
    paths = flown.listen(Path, 'uav1/path')
    plan(flown)
    wait_for(lambda: flown.status.track.state == 'waiting', what='a plan that waits')
    time.sleep(3.0)
    answer = flown.call('replay/start')
    assert answer.success and flown.status.plan.identity in answer.message
    wait_for(lambda: flown.status.track.time > 5.0 and is_on_its_plan(flown))
    wait_for(lambda: flown.powers[0] and flown.powers[0][-1].data > 0, what='power in flight')
    assert flown.call('replay/pause').success
    # The planner takes a silence for a hold as well, so the reports are compared, too.
    wait_for(lambda: flown.status.track.state == 'held' and (
        flown.times[-1].time_ref == flown.times[-2].time_ref), what='a flight that is held')
    wait_for(lambda: not any(watts[-1].data for watts in flown.powers),
             what='silence, since the receivers move on')
    wait_for(lambda: is_on_its_plan(flown))
    held = flown.stream.last_place('uav1')
    assert 'which is held' in plan(flown)
    assert np.linalg.norm(flown.stream.last_place('uav1') - held) < 0.01
    assert flown.call('replay/start').success
    wait_for(lambda: np.linalg.norm(flown.stream.last_place('uav1') - held) > 20.0)
    wait_for(lambda: flown.powers[0][-1].data > 0, what='the powers of the plan again')
    wait_for(lambda: is_on_its_plan(flown))
    # Another altitude in flight is refused; UAVs without odometry count as on their plan.
    assert flown.set_parameters('planner', uav1__altitude=150.0)[0].successful
    answer = flown.call('planner/plan')
    assert not answer.success
    assert 'uav1.altitude is 150 m and uav1 flies at 100 m' in answer.message
    assert all(result.successful for result in flown.set_parameters(
        'planner', uav1__altitude=100.0, uav1__use_pose=False, uav2__use_pose=False))
    assert 'it goes on from plan' in plan(flown)
    for name, rows in flown.stream.rows.items():
        for before, after in pairwise(rows):
            assert not explain_jump(before, after), name
    # After a reset they wait until they can be back, and the next plan begins there.
    assert flown.call('replay/reset').success
    answer = flown.call('replay/start')
    assert answer.success and 'waits for' in answer.message and 'to reach its start' in (
        answer.message)
    assert flown.call('replay/pause').success
    wait_for(lambda: flown.status.track.state == 'waiting', what='a plan that waits')
    # For a second after the reset the flight counts as one that slows down.
    wait_for(lambda: 'ask again when it' not in flown.call('planner/plan').message)
    assert 'goes on' not in plan(flown)
    at = paths[-1].poses[0].pose.position
    assert (at.x, at.y) == (100.0, 500.0)


def test_real_vehicles_are_waited_for_at_their_start_and_begin_the_next_plan_where_they_are():
    with Client('/team') as client, node_process(
            'planner', namespace='/team', **PARAMETERS), node_process(
                'replay', namespace='/team', vehicle_odometry='true') as replay:
        stream, places = Setpoints(client, UAVS), {}
        client.send_paper()
        publishers = {name: client.publisher(Odometry, f'{name}/odom')
                      for name in UAVS}

        def report(change=lambda message: None):
            for name, z in (('uav1', 100.0), ('uav2', 110.0)):
                message = odometry_message(*places[name], stamp=client.now())
                message.pose.pose.position.z = z
                change(message)
                publishers[name].publish(message)

        assert client.call('planner/plan').success

        def has_answer(text, *change):
            report(*change)
            answer = client.call('replay/start')
            return answer.success and text in answer.message

        def change_frame(message):
            message.header.frame_id = 'uav1_ned'

        def remove_position(message):
            message.pose.pose.position.z = math.nan

        def change_day(message):
            message.header.stamp.sec -= 86400

        for text, y, *change in (
                ('uav1 to be at its start, 100.0 m away', 400.0),
                ("odometry of uav1 in frame 'map'", 499.0, change_frame),
                ('finite odometry of uav1', 499.0, remove_position),
                ('odometry of uav1 of now', 499.0, change_day)):
            places |= dict.fromkeys(publishers, (100.0, y))
            wait_for(lambda: has_answer(text, *change), what=text)
            assert not stream.have_begun()

        def remove_stamp(message):
            message.header.stamp = Time()

        def is_started():
            report(remove_stamp)
            time.sleep(0.05)
            return stream.have_begun()
        wait_for(is_started, what='setpoints')
        assert math.dist(stream.rows['uav1'][0][2:5], (100.0, 500.0, 100.0)) < 0.1

        assert client.set_parameters('replay', speed=30.0)[0].successful
        client.node.create_timer(0.1, report)
        wait_for_line(replay, 'end of the plan')
        # A pilot has put one of them down 19 m from its goal, and turns it round.
        places |= {'uav1': (119.0, -500.0), 'uav2': (100.0, -500.0)}
        assert client.set_parameters(
            'planner', uav1__goal=[100.0, 500.0], uav2__goal=[100.0, 500.0])[0].successful
        wait_for(lambda: abs(client.status.track.distance['uav1'] - 19.0) < 0.01)
        assert client.call('planner/plan').success
        wait_for_line(replay, '~/start begins it where the UAVs are')
        count = len(stream.rows['uav1'])
        answer = client.call('replay/start')
        assert answer.success and 'playing' in answer.message or 'begins in' in answer.message
        wait_for(lambda: stream.last_place('uav1')[0] > 115.0, what='a setpoint at the vehicle')
        nearest = min(math.dist(row[2:4], places['uav1']) for row in stream.rows['uav1'][count:])
        assert nearest < 5.0
        wait_for(lambda: stream.last_place('uav1')[1] > 499.0, what='the other end')


def test_a_plan_is_flown_as_soon_as_somebody_reports_it_and_not_before(client):
    with node_process('planner', duration=120.0, slots=40, replan_period=0.5):
        client.plan_paper()
        # A passive subscriber, such as RViz, does not fly: the next plan begins at the start.
        path = client.listen(Path, 'uav1/path')
        assert client.call('planner/plan').success
        wait_for(lambda: path)
        assert places_of(path[-1])[0].tolist() == [100.0, 500.0]
        assert not any(status.track.plan for status in client.statuses)
        with node_process(ROOT / 'examples/ros/report_time.py'):
            wait_for(lambda: client.status.replans > 0, what='a replan')
            wait_for(lambda: client.status.track.state == 'flying')
            # A plan that begins later is not reported before its time.
            count, stamp = len(client.statuses), client.status.plan.stamp
            assert client.call('planner/plan').success
            wait_for(lambda: client.status.plan.stamp > stamp and client.status.plan.age > 1.0)
            assert {status.track.state for status in client.statuses[count:]} == {'flying'}
        wait_for(lambda: 'is silent' in client.statuses[-1].text)
