"""The relay node, with real messages of the stacks over DDS."""

from contextlib import ExitStack
from dataclasses import replace
import math
import os
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fuzzing import Target
from nav_msgs.msg import Odometry, Path
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from relay_client import Autopilot, listen_to_mavros, MISSION, rests, Source
from ros_client import numbers, pose_message, stamp_at, values_of
from ros_nodes import has_said, node_here, node_process, refusal, wait_for, wait_for_line
from secure_uav_planner.output.autopilots import STACKS, TRIED_VERSIONS
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.relay_reports import RelayReports, RelayState
from secure_uav_planner.ros.topics import TOPICS
from std_msgs.msg import Float64
from std_srvs.srv import SetBool
from test_messages import sent


@pytest.mark.parametrize('stack', STACKS)
def test_without_the_message_package_it_says_in_one_line_what_is_missing_and_how_to_get_it(
        capfd, monkeypatch, stack):
    # Another test of this process may have built the package.
    package = STACKS[stack].package
    for name in (package, *(name for name in sys.modules if name.startswith(f'{package}.'))):
        monkeypatch.setitem(sys.modules, name, None)
    line = refusal(capfd, 'relay', stack=stack)
    assert line.startswith(f'cannot start: parameter stack is {stack}: its message package '
                           f'{STACKS[stack].package} is missing')
    assert (STACKS[stack].debian or STACKS[stack].source) in line
    # ROS from apt says its name in the environment; beside ROS from wheels nothing can be built.
    assert ('ROS from wheels cannot have it' in line) == ('ROS_DISTRO' not in os.environ)


def fill_state(message):
    """Set the state of a vehicle in a message of any stack: 9 m, 3 m/s and the nose ahead."""
    if hasattr(message, 'pose_frame'):
        message.pose_frame, message.velocity_frame = (
            message.POSE_FRAME_NED, message.VELOCITY_FRAME_NED)
        message.position, message.velocity = [4.0, 9.0, 5.0], [0.0, 3.0, 0.0]
        message.q = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]  # The nose to the east.
        return
    message.header.frame_id, message.header.stamp.sec = 'map', 77
    if hasattr(message, 'pose'):
        pose = getattr(message.pose, 'pose', message.pose)
        pose.position.x, pose.orientation.w = 9.0, 1.0
    if hasattr(message, 'twist'):
        getattr(message.twist, 'twist', message.twist).linear.x = 3.0
    if isinstance(message, Odometry):
        message.pose.covariance[0], message.child_frame_id = 0.5, 'base_link'


@pytest.mark.parametrize('name', STACKS)
def test_each_stack_gets_setpoints_and_its_odometry_is_passed_on_both_moved_by_the_origin(
        packages, client, name):
    """What a message is to say is told by test_autopilots.py."""
    stack = STACKS[name]
    targets = {kind: client.listen(packages(stack.package, kind), f'drone/{topic}', 1000)
               for kind, topic in stack.topics.items()}
    odometry = client.listen(Odometry, 'uav2/odom', 10)
    with node_here('relay', stack=name, start_tolerance=0.0, vehicles='[other, drone]',
                   frame_id='earth', uav2__origin='[1.0, 2.0, 3.0]') as process:
        source = Source(client, 'uav2')
        source.message.header.frame_id = 'earth'
        source.until(lambda: all(targets.values()))
        fields = stack.fields(replace(
            messages.read_setpoint(source.message), position=(9.0, 18.0, 27.0)), 0)
        for kind, (target, *_) in targets.items():
            expected = messages.fill_message(type(target)(), fields[kind])
            if hasattr(target, 'header'):
                assert target.header.stamp in source.stamps
                assert target.header.frame_id == 'earth'
                expected.header = target.header
            else:
                assert target.timestamp > 0
                expected.timestamp = target.timestamp
            assert str(target) == str(sent(expected))  # As it is after its way over DDS.

        states = [messages.message_class(kind)() if kind.startswith(('nav', 'geometry'))
                  else packages(*kind.split('/'))() for kind in stack.states]
        publishers = [client.publisher(type(state), f'drone/{topic}', QoSProfile(
            depth=5, reliability=ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL))
            for state, topic in zip(states, stack.states.values())]

        def report():
            for state, publisher in zip(states, publishers):
                publisher.publish(state)
            time.sleep(0.02)

        for state in states:
            fill_state(state)
        wait_for(lambda: report() or odometry, what='odometry')
        expected = messages.fill_message(Odometry(), stack.odometry(*states))
        there = odometry[-1]
        assert (there.header.frame_id, there.child_frame_id) == ('earth', 'uav2/base_link')
        assert there.header.stamp.sec == 77 or name == 'px4'  # PX4 has a clock of its own.
        assert numbers(there.pose.pose.position) == [
            at + shift for at, shift in zip(numbers(expected.pose.pose.position), (1, 2, 3))]
        assert (there.pose.covariance == expected.pose.covariance).all()
        assert there.pose.pose.orientation == expected.pose.pose.orientation
        assert there.twist == expected.twist
        assert numbers(there.twist.twist.linear) == pytest.approx([3.0, 0.0, 0.0])
        client.node.create_publisher(Odometry, 'uav2/odom', 10)
        wait_for(lambda: report() or has_said(
            process, 'another node publishes /uav2/odom, too; set vehicle_odometry'))


def test_a_stream_that_stops_is_held_without_speed_with_the_heartbeat_of_px4_and_then_ends(
        packages, client):
    targets = client.listen(packages('px4_msgs', 'TrajectorySetpoint'),
                            'uav1/fmu/in/trajectory_setpoint', 1000)
    modes = client.listen(packages('px4_msgs', 'OffboardControlMode'),
                          'uav1/fmu/in/offboard_control_mode', 1000)
    with node_here('relay', start_tolerance=0.0, stack='px4', setpoint_timeout=3.0) as process:
        source = Source(client, 'uav1')
        assert not modes  # Nothing keeps PX4 in a mode that nobody flies in.
        source.until(lambda: targets and modes)
        # Setpoints stop: the last place is held for a while, and then nothing comes any more.
        wait_for_line(process, 'no fresh setpoint of uav1 has come for 3 s; nothing more is sent')
        flown = sum(target.velocity.any() for target in targets)
        assert flown <= len(source.stamps)
        wait_for(lambda: rests(modes))
        held, count = targets[flown:], len(modes)
        assert len(held) >= 5
        for last in held:
            assert last.position.tolist() == targets[0].position.tolist()
            assert last.velocity.tolist() == last.acceleration.tolist() == [0.0, 0.0, 0.0]
        # The heartbeat comes with them, for PX4 more often than at 2 Hz.
        beats = {mode.timestamp for mode in modes}
        assert sum(last.timestamp in beats for last in held) >= 0.9 * len(held)
        # It goes on when they do.
        source.until(lambda: len(modes) > count + 3)


def test_a_message_of_a_version_that_was_not_tried_is_told_at_the_start(packages, monkeypatch):
    for tried, told in (((0,), False), ((1, 2), True)):
        monkeypatch.setitem(TRIED_VERSIONS, 'px4_msgs/TrajectorySetpoint', tried)
        with node_here('relay', stack='px4', uav1__reference='px4', **MISSION) as process:
            assert has_said(process, 'ready: relays')
            assert has_said(process, 'TrajectorySetpoint has version 0 and was tried with 1 and 2'
                            ) == told
            assert not has_said(process, 'VehicleLocalPosition has version')


def test_a_planner_plans_from_where_px4_says_that_its_vehicle_is(packages, client):
    """From PX4 to the relay to the planner; the pose of another UAV comes to the planner."""
    paths = {name: client.listen(Path, f'{name}/path') for name in ('uav1', 'uav2')}
    state = packages('px4_msgs', 'VehicleOdometry')()
    fill_state(state)
    with node_here('relay', stack='px4', uav1__origin='[80.0, 480.0, 5.0]'), \
            node_here('planner', duration=150.0, slots=30, uav2__origin='[0.0, 490.0, 0.0]'):
        publisher = client.publisher(type(state), 'uav1/fmu/out/vehicle_odometry')
        wait_for(lambda: publisher.publish(state) or time.sleep(0.02) or (
            client.status.has_pose('uav1/odom')))
        client.send_pose('uav2/pose', 110.0, 10.0)
        client.plan_paper()
        wait_for(lambda: all(paths.values()))
    starts = {name: numbers(path[-1].poses[0].pose.position, 'xy') for name, path in paths.items()}
    assert starts == {'uav1': [89.0, 484.0], 'uav2': [110.0, 500.0]}


def test_a_setpoint_that_is_invalid_or_jumps_is_refused_with_throttled_warnings(packages, client):
    """What is a jump, or too fast, is told by test_guard.py; what is no setpoint, elsewhere."""
    targets = listen_to_mavros(packages, client)
    with node_here('relay', start_tolerance=0.0, stack='mavros', setpoint_timeout=3.0,
                   uav1__max_acceleration=2.0) as process:
        source = Source(client, 'uav1')
        linear = source.message.points[0].accelerations[0].linear
        for target, field, wrong, right, text in (
                (source.place, 'x', math.nan, 10.0, 'position is'),
                (linear, 'z', 500.0, 0.0, 'it has 500 m/s^2, and max_acceleration '),
                (source.message, 'joint_names', ['uav2'], [],
                 "joint_names is ['uav2']; it must be ['uav1'], or empty"),
                (source.message.header, 'frame_id', 'odom', 'map',
                 "frame_id is 'odom'; it must be 'map'")):
            setattr(target, field, wrong)
            source.until(lambda: has_said(process, text))
            setattr(target, field, right)
        assert not targets
        source.until(lambda: targets)
        # A jump, such as that of another source, 400 m away: the last place is held.
        source.place.x = 410.0
        source.until(lambda: has_said(
            process, 'a setpoint of uav1 is not relayed: it is 400.0 m from the last one'))
        source.until(lambda: not numbers(targets[-1].velocity, 'xy')[0])
        assert {target.position.x for target in targets} == {10.0}
        # Setpoints in another frame hold the place, too, also beyond setpoint_timeout.
        source.message.header.frame_id, until = 'odom', time.monotonic() + 4.0
        source.until(lambda: time.monotonic() > until)
        count = len(targets)
        source.until(lambda: len(targets) > count)
        assert not has_said(process, 'nothing more is sent')
        source.message.header.frame_id = 'map'
        # It follows again from there.
        source.place.x = 12.0
        source.until(lambda: targets[-1].position.x == 12.0)
        assert targets[-1].velocity.x == 3.0
        assert not has_said(process, 'is not relayed', 40)


def test_a_stream_is_relayed_from_where_odometry_says_that_the_vehicle_is_and_unless_disabled(
        packages, client):
    targets, odometry = listen_to_mavros(packages, client), client.listen(
        Odometry, 'uav1/odom', 1000)
    with node_here('relay', stack='mavros', setpoint_timeout=60.0) as process:
        source = Source(client, 'uav1')
        publisher = client.publisher(Odometry, 'uav1/mavros/local_position/odom')

        def stands_at(x, velocity=0.0, turn=0.0, stamp=None):
            message = pose_message(Odometry, x, 20.0, 30.0, stamp=stamp)
            message.twist.twist.linear.x, message.pose.pose.orientation.x = velocity, turn
            publisher.publish(message)
            return True

        def until_said(text, place=None, count=1):
            source.until(lambda: (place is None or stands_at(*place)) and has_said(
                process, text, count))

        until_said('the position of the vehicle is not known, or its stamp is old')
        # Of odometry that is not finite only the place counts, and nothing is passed on.
        until_said('it is 20.0 m from the vehicle', (30.0, math.nan))
        until_said('its velocity is (nan, ', (30.0, math.nan))
        until_said('its orientation is (nan, ', (30.0, 0.0, math.nan))
        assert not targets and not odometry
        # A position that was measured long ago says nothing, whenever it comes.
        until_said('or its stamp is old', (11.0, 0.0, 0.0, stamp_at(time.time() - 100.0)), 2)
        assert not targets
        source.until(lambda: stands_at(11.0) and targets and odometry)
        enable_again = client.call('relay/enable', SetBool, SetBool.Request(data=True))
        stands_at(30.0)  # Only a change of ~/enable ends a stream.
        count = len(targets)
        source.until(lambda: enable_again.success and len(targets) > count + 3)

        def enable(is_enabled):
            assert client.call('relay/enable', SetBool, SetBool.Request(data=is_enabled)).success

        enable(False)
        source.until(lambda: rests(targets, source.send))
        count = len(targets)
        stands_at(30.0)
        enable(True)
        until_said('it is 20.0 m from the vehicle', count=2)
        assert len(targets) == count
        source.until(lambda: stands_at(11.0) and len(targets) > count + 1)


def test_of_several_relays_that_report_on_a_vehicle_one_that_passes_setpoints_counts():
    now = 0.0
    reports = RelayReports(lambda: now)

    def report(relay, name):
        return reports.take('uav1/relay', RelayState(relay, name, 1.0, 'why').to_message('uav1'))

    # The second relay runs on the computer of another vehicle, or waits as a reserve.
    assert report('/a', 'passing')
    for name in ('refused', 'disabled', 'silent'):
        assert not report('/b', name) and reports.state('uav1').name == 'passing'
    now = 0.9
    report('/b', 'refused')
    now = 1.5
    assert reports.state('uav1').name == 'refused' and not reports.find_newly_lost()
    assert report('/a', 'passing') and reports.state('uav1').relay == '/a'
    now = 3.0
    assert reports.state('uav1').name == 'lost' and len(reports.find_newly_lost()) == 1


def test_what_becomes_of_each_stream_is_in_the_diagnostics_and_in_the_status_of_the_planner(
        packages, client):
    reports = client.listen(DiagnosticArray, '/diagnostics', 1000)
    assert listen_to_mavros(packages, client) == []
    with node_process('relay', stack='mavros') as relay, \
            node_here('planner', duration=150.0, slots=30):
        source = Source(client, 'uav1')
        publisher = client.publisher(Odometry, 'uav1/mavros/local_position/odom')

        def until(state, level, text, x=None, sends=True):
            """Wait until diagnostics and the planner's status tell a state of uav1."""
            def is_told():
                if x is not None:
                    publisher.publish(pose_message(Odometry, x, 20.0, 30.0))
                if sends:
                    source.send()
                told = [status for message in reports for status in message.status
                        if status.name == 'relay: uav1']
                return told and text in told[-1].message and (
                    values_of(told[-1])['state'] == state and told[-1].level == level
                    and client.status.relay.get('uav1') == state)
            wait_for(is_told, what=state)

        ok, warn = DiagnosticStatus.OK, DiagnosticStatus.WARN
        until('silent', warn, 'has sent nothing for ', sends=False)
        until('refused', warn, 'it is 20.0 m from the vehicle and start_tolerance is 5 m', 30.0)
        wait_for(lambda: 'the relay of uav1, /relay, has refused setpoints for ' in (
            client.statuses[-1].text), what='the reason in the status of the planner')
        until('passing', ok, 'passes setpoints on', 11.0)
        source.place.x = 410.0
        until('holding', warn, 's: it is 400.0 m from the last one', 11.0)
        client.call('relay/enable', SetBool, SetBool.Request(data=False))
        until('disabled', warn, 'sends nothing until ~/enable is called with true', 11.0)
        client.follow()
        client.plan_paper()
        wait_for(lambda: 'the relay of uav1, /relay, sends nothing' in client.statuses[-1].text)
        relay.kill()
        wait_for(lambda: client.status.relay['uav1'] == 'lost' and (
            'the relay of uav1, /relay, has not reported for ' in client.statuses[-1].text))


@pytest.mark.parametrize('is_killed', [False, True], ids=['disabled for 3 s', 'killed'])
def test_vehicles_that_lost_their_relay_come_back_and_send_no_power_meanwhile(
        packages, client, is_killed):
    names, options = ('uav1', 'uav2'), {'stack': 'mavros', 'uav1__max_speed': 10.0}
    powers = [client.listen(Float64, f'{name}/setpoint/power', 10000) for name in names]

    def are_flown():
        """Return True if both are on their plan, and send power."""
        distances = client.status.track.distance
        return all(distances.get(name, math.nan) < 3.0 for name in names) and (
            powers[0][-1].data > 0)

    with node_process('planner', duration=300.0, slots=150, replan_deviation=8.0, replan_lead=3.0,
                      uav1__max_acceleration=2.5, uav2__max_acceleration=2.5,
                      uav2__altitude=100.0) as planner, \
            node_process('replay', vehicle_odometry=True) as replay, \
            node_process('relay', **options) as relay, ExitStack() as later:
        vehicles = [Autopilot(packages, client, name, (100.0, 500.0)) for name in names]
        wait_for(lambda: vehicles and all(
            client.status.has_pose(f'{name}/odom') for name in names))
        client.plan_paper()
        assert client.call('replay/start').success
        wait_for(lambda: client.status.track.time > 6.0 and are_flown(), what='a flight')
        if is_killed:
            relay.kill()
            text = 'the relay of uav1, /relay, has not reported for '
            for node in (replay, planner):  # About a second later.
                wait_for_line(node, text)
            wait_for(lambda: text in client.statuses[-1].text, what='the name of the relay')
            later.enter_context(node_process('relay', **options))
            client.send_paper()  # Its poses ended with the relay.
        else:
            client.call('relay/enable', SetBool, SetBool.Request(data=False))
            time.sleep(3.0)
            client.call('relay/enable', SetBool, SetBool.Request(data=True))
        wait_for(lambda: 'uav1 is held ' in client.statuses[-1].text,
                 what='the word that uav1 is held')
        wait_for_line(replay, 'no power is sent: ')
        wait_for(lambda: not any(watts[-1].data for watts in powers), what='silence')
        wait_for(are_flown, what='both on their plan')


def test_abnormal_messages_on_any_topic_are_told_once_and_calls_are_answered(packages, client):
    topics = {topic.replace('<uav>', 'uav1'): kind.kind
              for topic, kind in TOPICS['relay', 'sub'].items()}
    topics['uav1/mavros/local_position/odom'] = Odometry
    with node_here('relay', stack='mavros') as process:
        Target(client, 'relay', process, topics).check_abnormal(
            ['enable', SetBool, SetBool.Request(data=True)])
