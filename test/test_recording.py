"""The recording of a plan and its replay, read back; the layouts that show it."""

from dataclasses import replace
import json
import pathlib
import re

import city
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from secure_uav_planner import (
    compare, Eavesdropper, fly_hover_fly, Plan, read_flight, Scenario)
from secure_uav_planner.apps.cli import main
from secure_uav_planner.ros.planner_status import PlannerStatus
from secure_uav_planner.ros.recording import record
from secure_uav_planner.ros.topics import LATCHED, TOPICS
from strategies import with_uavs
from test_tracks import drive
import yaml


@pytest.fixture(scope='module')
def plan():
    return fly_hover_fly(Scenario.paper(104, slots=26), 'optimised')


@pytest.fixture(scope='module')
def file(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp('recording') / 'plan.mcap'
    record(plan, path, frame_id='earth', frequency=2.0)
    return path


def messages(file):
    """Return the messages by topic, decoded from the definitions in the file alone."""
    entries = {}
    with file.open('rb') as stream:
        for schema, channel, message, decoded in make_reader(
                stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            entries.setdefault(channel.topic, []).append((message.log_time, schema.name, decoded))
    return entries


@pytest.fixture(scope='module')
def read(file):
    return messages(file)


def test_the_command_writes_the_same_recording_on_request(tmp_path):
    Scenario.paper(120.0, slots=6).save(tmp_path / 'mission.yaml')
    assert main(['plan', str(tmp_path / 'mission.yaml'), '-o', str(tmp_path / 'out'), '--mcap',
                 '--bound-time-limit', '0', '--time-limit', '1']) == 0
    record(Plan.load(tmp_path / 'out' / 'plan.json'), tmp_path / 'plan.mcap')
    written, again = (messages(path) for path in (
        tmp_path / 'out' / 'plan.mcap', tmp_path / 'plan.mcap'))
    assert str(written) == str(again) and sum(map(len, written.values())) > 100
    # It is a flight of the plan beside it, which has no start time.
    plan = Plan.load(tmp_path / 'out' / 'plan.json')
    flown = compare(plan, read_flight(tmp_path / 'out' / 'plan.mcap', plan))
    assert plan.start_ns is None and not flown.broken.any()


def test_every_topic_of_both_nodes_is_there_with_its_type_and_latched_as_it_is(read, file):
    expected = {'/ground_node/pose': 'PoseStamped', '/eavesdropper/pose':
                'PoseWithCovarianceStamped'}
    for node in ('planner', 'replay'):
        for topic, entry in TOPICS[node, 'pub'].items():
            for name in ('uav1', 'uav2'):
                path = topic.replace('<uav>', name).replace('~/', f'/{node}/')
                expected[f'/{path.lstrip("/")}'] = entry.kind.__name__
    del expected['/diagnostics']
    assert {topic: entries[0][1].rpartition('/')[2] for topic, entries in read.items()} == expected
    with file.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    offered = {channel.topic: yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]
               for channel in summary.channels.values()}
    assert offered['/uav1/path']['durability'] == LATCHED.durability.name.lower()
    assert offered['/uav1/odom']['durability'] == 'volatile'


def test_every_receiver_has_a_topic_of_its_name_and_moves_and_markers_show_its_way(tmp_path):
    scenario = drive(Scenario.paper(120, slots=30))
    moving, = scenario.eavesdroppers
    record(fly_hover_fly(replace(scenario, eavesdroppers=(
        replace(moving, name='car'), Eavesdropper((0.0, 150.0), 10.0, 'mallory')))),
        tmp_path / 'plan.mcap', frequency=1.0)
    topics = messages(tmp_path / 'plan.mcap')
    assert {topic for topic in topics if re.fullmatch('/[^/]+/pose', topic)} == {
        '/ground_node/pose', '/car/pose', '/mallory/pose'}
    places = [message.pose.pose.position.y for _, _, message in topics['/car/pose']]
    assert len(places) == 32 and places[15] == pytest.approx(0.0) and places[-1] == 300.0
    way, = (marker for marker in topics['/planner/markers'][-1][2].markers
            if marker.ns == 'track')
    assert (way.points[0].y, way.points[-1].y) == (-300.0, 300.0)


def test_zones_fence_and_distances_are_recorded(tmp_path):
    path = tmp_path / 'city.mcap'
    record(city.plan_by_hand(Scenario.load(city.FILE)), path, frequency=0.1)
    topics = messages(path)
    names = [marker.ns for marker in topics['/planner/markers'][-1][2].markers]
    assert names.count('no_fly_zone') == 3 and names.count('geofence') == 1
    plan = PlannerStatus.from_message(topics['/planner/status'][-1][2]).plan
    assert plan.uav_distance.distance > 20
    assert plan.zone_distance.between == 'courier, hospital'
    assert plan.curve_rate == pytest.approx(plan.guaranteed_rate, abs=0.01)


def test_the_plan_and_its_replay_to_the_goal_can_be_read_back_with_its_rate(read, plan, file):
    for index, name in enumerate(('uav1', 'uav2')):
        (_, _, path), = read[f'/{name}/path']
        assert path.header.frame_id == 'earth'
        assert np.array([(at.pose.position.x, at.pose.position.y) for at in path.poses]
                        ) == pytest.approx(plan.positions[index])
        (_, _, power), = read[f'/{name}/power']
        assert np.array(power.data) == pytest.approx(plan.powers[index])
    times = [time for time, _, _ in read['/uav1/odom']]
    assert np.diff(times).max() == 500_000_000 and times[-1] == 108_000_000_000
    assert read['/uav1/odom'][-1][2].pose.pose.position.y == -500.0
    rates = [message.data for time, _, message in read['/replay/secrecy_rate']
             if time >= 4_000_000_000][:-1]
    # Sampled between the points, the rate is only nearly that of the points.
    assert np.mean(rates) == pytest.approx(plan.worst_case_rate, rel=0.05)
    with AnyReader([file]) as reader:  # rosbags opens it as well.
        connections = [connection for connection in reader.connections
                       if connection.topic == '/uav1/setpoint/pose']
        *_, last = (reader.deserialize(data, connection.msgtype)
                    for connection, _, data in reader.messages(connections))
    assert last.pose.position.y == -500.0


def test_a_wrong_rate_is_refused_and_leaves_no_file(plan, tmp_path):
    with pytest.raises(ValueError, match='frequency is 0'):
        record(plan, tmp_path / 'plan.mcap', frequency=0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('layout', ['foxglove.json', 'planner.rviz'])
def test_a_layout_shows_only_topics_that_are_recorded(read, layout):
    text = (pathlib.Path(__file__).parents[1] / 'config' / layout).read_text()
    (json.loads if layout.endswith('.json') else yaml.safe_load)(text)
    named = set(re.findall(r'(/(?:planner|replay|uav\d)/\w+(?:/\w+)?)', text))
    assert {'/planner/markers', '/replay/markers', '/uav1/path'} <= named <= set(read)


@pytest.mark.parametrize('start_ns', [None, 0, 10**18])
def test_a_recording_begins_when_the_uavs_leave_their_starts(start_ns, tmp_path):
    # With a limit of acceleration this is half a slot before point 0. Time 0 is the first of all.
    scenario = with_uavs(Scenario.paper(160.0, slots=8), max_acceleration=2.0)
    plan, path = replace(fly_hover_fly(scenario), start_ns=start_ns), tmp_path / 'plan.mcap'
    record(plan, path)
    topics = messages(path)
    first = 0 if not start_ns else start_ns - 10 * 10**9
    for topic in ('/plan', '/plan_time', '/uav1/odom', '/uav1/setpoint/power'):
        assert topics[topic][0][0] == first
    if start_ns != 0:  # No time is before 0.
        flown = compare(plan, read_flight(path, plan))
        assert all(errors.gap_max_s < 0.5 for errors in flown.uavs.values())
