"""Local frames of vehicles: references over DDS, and places that move with them."""

from dataclasses import replace
import math
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
import pytest
from relay_client import listen_to_mavros, local_place, MISSION, reference_at, Source, ZURICH
from ros_client import numbers, pose_message
from ros_nodes import has_said, node_here, wait_for, wait_for_line
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.ros.topics import LATCHED
from strategies import with_uavs


@pytest.mark.parametrize('stack, kind, topic', [
    ('px4', 'VehicleLocalPosition', 'fmu/out/vehicle_local_position_v1'),
    ('mavros', 'GeoPointStamped', 'mavros/global_position/gp_origin')])
def test_a_reference_that_was_published_once_before_the_relay_had_started_is_used(
        packages, client, stack, kind, topic):
    kind = packages({'px4': 'px4_msgs', 'mavros': 'geographic_msgs'}[stack], kind)
    reference = reference_at(kind, 25.0) if stack == 'px4' else kind()
    if stack == 'mavros':
        reference.position.latitude, reference.position.longitude = map(
            float, ZURICH.to_geographic(25.0, 0.0))
    client.node.create_publisher(kind, f'uav1/{topic}', LATCHED).publish(reference)
    with node_here('relay', stack=stack, uav1__reference=stack, **MISSION) as process:
        wait_for_line(process, 'the local frame of uav1 begins at (25.00, 0.00) m')


def test_two_vehicles_with_references_400_m_apart_fly_one_plan_through_a_pause_to_the_goal(
        packages, client, tmp_path):
    scenario = with_uavs(Scenario.paper(slots=16), goal=(100.0, 460.0), max_acceleration=4.0)
    fly_hover_fly(replace(scenario, duration=20.0)).save(tmp_path / 'plan.json')
    reference, setpoint = (packages('px4_msgs', kind) for kind in (
        'VehicleLocalPosition', 'TrajectorySetpoint'))
    streams = {name: client.listen(setpoint, f'{name}/fmu/in/trajectory_setpoint', 1000)
               for name in ('uav1', 'uav2')}
    sources = {name: client.listen(PoseStamped, f'{name}/setpoint/pose', 1000)
               for name in streams}
    references = {'uav1': reference_at(reference, 0.0), 'uav2': reference_at(reference, 400.0)}
    with node_here('relay', start_tolerance=0.0, stack='px4', setpoint_timeout=60.0,
                   uav1__reference='px4', uav2__reference='px4', **MISSION) as relay, \
            node_here('replay', plan_file=tmp_path / 'plan.json') as replay:
        for name, message in references.items():
            publisher = client.publisher(reference, f'{name}/fmu/out/vehicle_local_position')
            wait_for(lambda: publisher.publish(message) or has_said(
                relay, f'the local frame of {name} begins at'))
        # However slow this machine is, the stream does not end in between.
        assert client.call('replay/start').success
        wait_for(lambda: any(target.velocity[0] < -5.0 for target in streams['uav1']))
        assert client.call('replay/pause').success
        wait_for(lambda: streams['uav1'][-1].velocity[0] == 0.0)
        assert client.call('replay/start').success
        wait_for_line(replay, 'end of the plan')
        for name, message in references.items():
            def arrived():
                return streams[name][-1].position[:2].tolist() == pytest.approx(
                    local_place(message, (100.0, 460.0))[::-1], abs=1e-3)
            wait_for(arrived)
            places = [local_place(message, numbers(pose.pose.position, 'xy'))
                      for pose in sources[name]]
            for target in streams[name]:  # Each is a setpoint of the replay in its own frame.
                north, east, _ = target.position.tolist()
                assert min(math.dist(place, (east, north)) for place in places) < 1e-3
    assert not has_said(relay, 'is not relayed')


def test_a_frame_that_moves_in_flight_is_held_until_the_vehicle_is_where_it_is_to_be(
        packages, client):
    reference = packages('px4_msgs', 'VehicleLocalPosition')
    targets = listen_to_mavros(packages, client)
    statuses = client.listen(DiagnosticArray, '/diagnostics', 10)
    with node_here('relay', stack='mavros', setpoint_timeout=60.0, uav1__reference='px4',
                   **MISSION) as process:
        source = Source(client, 'uav1')
        publishers = [client.publisher(kind, f'uav1/{topic}') for kind, topic in (
            (reference, 'fmu/out/vehicle_local_position'),
            (Odometry, 'mavros/local_position/odom'))]

        def until(report, place, condition):
            """Report a reference, and a place in it unless it is None, until a condition holds."""
            def holds():
                publishers[0].publish(report)
                if place is not None:
                    publishers[1].publish(
                        pose_message(Odometry, *local_place(report, place), 30.0))
                return condition()
            source.until(holds)

        first, moved = (reference_at(reference, *of) for of in ((0.0,), (30.0, 1)))
        until(reference_at(reference, 0.0, is_valid=False), None, lambda: has_said(
            process, 'the local frame of uav1 is not known: xy_valid is True and xy_global is'))
        assert not targets
        until(first, (11.0, 20.0), lambda: targets and targets[-1].velocity.x == 3.0)
        # It is lost: the place is held.
        until(reference_at(reference, 0.0, is_valid=False), (11.0, 20.0),
              lambda: targets[-1].velocity.x == 0.0)
        held = len(targets)
        until(moved, None, lambda: has_said(
            process, 'the local frame of uav1 has moved by 30.00 m'))
        until(moved, None, lambda: has_said(process, 'the position of the vehicle is not known'))
        until(moved, None, lambda: targets[-1].position.x < -10.0)
        assert not any(target.velocity.x for target in targets[held:])
        wait_for(lambda: any(
            status.level == DiagnosticStatus.WARN and 'has moved by 30.00 m' in status.message
            for message in statuses for status in message.status))
        until(moved, (31.0, 20.0), lambda: has_said(process, 'it is 21.0 m from the vehicle'))
        until(moved, (11.0, 20.0), lambda: targets[-1].velocity.x == 3.0)
        until(moved, (11.0, 20.0), lambda: any(
            status.level == DiagnosticStatus.OK for status in statuses[-1].status))
        # All are the same place on Earth.
        places = [local_place(report, (10.0, 20.0)) for report in (first, moved)]
        assert all(min(math.dist(place, numbers(target.position, 'xy')) for place in places) < 1e-6
                   for target in targets)


def test_the_planner_takes_a_place_from_degrees_and_says_what_a_frame_lacks(packages, client):
    kind = packages('geographic_msgs', 'GeoPointStamped')
    with node_here('planner', duration=150.0, slots=30, uav1__reference='mavros', **MISSION
                   ) as planner:
        origin, paths = kind(), client.listen(Path, 'uav1/path')
        publisher = client.publisher(kind, 'uav1/mavros/global_position/gp_origin')

        def until_said(text, *values):
            origin.position.latitude, origin.position.longitude, origin.position.altitude = values

            def is_said():
                publisher.publish(origin)
                time.sleep(0.1)
                status = client.statuses[-1]
                return text in status.text and status.level == DiagnosticStatus.WARN
            wait_for(is_said, what=text)

        until_said('the local frame of uav1 is not known: its position is earth-centred (ECEF)',
                   4278990.0, 642970.0, 4670820.0)
        until_said('a place is ', 8.5456, 47.3977, 400.0)
        latitude, longitude = map(float, ZURICH.to_geographic(-10.0, 0.0))
        client.send_pose('uav1/pose', 100.0, 490.0, until_known=False)

        def is_known():
            origin.position.latitude, origin.position.longitude = latitude, longitude
            publisher.publish(origin)
            client.send_pose('uav1/pose', 100.0, 490.0, until_known=False)
            return client.status.has_pose('uav1/pose')
        wait_for(is_known)
        client.send_pose('uav1/pose', 100.0, 490.0)
        client.plan_paper()
        wait_for(lambda: paths)
        assert numbers(paths[-1].poses[0].pose.position, 'xy') == pytest.approx(
            [90.0, 490.0], abs=0.1)
        wait_for(lambda: client.send_pose('uav1/pose', 150e3, 490.0, until_known=False)
                 or has_said(planner, 'uav1/pose: a place is 150 km from the origin, east and '
                             'north; it must be at most 100 km; it is not used'))
        until_said('the local frame of uav1 has moved by 5.00 m',
                   latitude, float(ZURICH.to_geographic(-5.0, 0.0)[1]), 400.0)
