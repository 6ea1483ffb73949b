"""Parameters of nodes: what a start accepts, what is checked when, and what comes back."""

from collections import Counter
from dataclasses import fields, FrozenInstanceError, replace
from itertools import count
import math
from typing import get_origin, get_type_hints, Literal

import city
from processes import ROOT
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from ros_client import DEFAULTS, flat
from ros_nodes import has_said, node_here, refusal, wait_for
from secure_uav_planner import GroundNode, NoFlyZone, Scenario
from secure_uav_planner.errors import ParameterError
from secure_uav_planner.mission import METHODS, OBJECTIVES
from secure_uav_planner.mission.polygons import MAX_VERTICES
from secure_uav_planner.mission.propagation import ENVIRONMENTS
from secure_uav_planner.mission.scenario import MAX_MEMBERS, MAX_ZONES
from secure_uav_planner.mission.tracks import MAX_SPEED
from secure_uav_planner.output.autopilots import STACKS
from secure_uav_planner.ros.parameters import (
    PLANNER, PLANNER_MEMBERS, read_member_specs, read_specs, RELAY, RELAY_MEMBERS, REPLAY, Spec)
from secure_uav_planner.ros.planner.settings import PlannerSettings
from secure_uav_planner.ros.relay.node import RelaySettings
from secure_uav_planner.ros.replay.node import ReplaySettings
from secure_uav_planner.ros.settings import airspace_from, mission_values, Settings
from secure_uav_planner.ros.topics import LATCHED, overridable, TOPICS
from std_msgs.msg import Float64
import yaml

SPECS = {'rate': Spec(1.0, 'A rate.', (0.0, 9.0)), 'name': Spec('a', 'A name.', length=(0, 5)),
         'names': Spec(['a'], 'Names.', length=(1, 3))}


@pytest.fixture
def node():
    context = Context()
    rclpy.init(context=context)
    node = Node('alone', context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_what_rclpy_declares_for_a_topic_is_no_reason_to_check_all_values(node):
    calls = count()
    settings = Settings(node, SPECS, lambda values: (next(calls), values)[1])
    for number in range(5):
        node.create_publisher(Float64, f'topic{number}', **overridable(LATCHED))
    assert next(calls) == 1
    assert node.set_parameters([rclpy.Parameter('rate', value=2)])[0].successful
    assert next(calls) == 3 and settings.current['rate'] == 2.0


ANYTHING = [
    math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0, 0.5, 0, 1, -1, 2**62, -2**62, True,
    False, '', 'a', 'nan', 'off', 'x' * 300, [b'a'], [''], ['a', 'a'], ['a' * 101], [True],
    [math.nan], [math.nan] * 2, [math.inf] * 3, [1e308] * 3, [0.0] * 2, [1, 2, 3], [0.0] * 6,
    [0.0] * 1000]


def edges(spec):
    """Return the values at, just inside and just outside the limits and lengths of a Spec."""
    numbers = [number for limit in spec.limits or () for number in (
        limit, math.nextafter(limit, math.inf), math.nextafter(limit, -math.inf))]
    if spec.length is None or isinstance(spec.default, str):
        return [*numbers, *(spec.choices or ())]
    return [count * [value] for count in {*spec.length, spec.length[1] + 1}
            for value in numbers or ['a']]


def test_each_parameter_of_each_node_is_judged_alike_at_the_start_and_at_run_time(node):
    specs = [*PLANNER.items(), *REPLAY.items(), *RELAY.items()]
    for section, name in (('uav', 'uav1'), ('ground_node', 'barn'), ('eavesdropper', 'eve'),
                          ('no_fly_zone', 'zone'), ('relay_uav', 'uav1')):
        specs += read_specs(section, name).items()
    judged = Counter()
    for name, spec in specs:
        if name == 'mission_file' or spec.read_only:
            continue
        usable = [0.0, 1.0] * 3 if name == 'zone.vertices' else spec.default
        node._parameter_overrides = {name: rclpy.Parameter(name, value=usable)}
        running = Settings(node, {name: spec}, dict)
        for value in [*ANYTHING, *edges(spec)]:
            given = rclpy.Parameter(name, value=value)
            node._parameter_overrides = {'start': rclpy.Parameter('start', value=value)}
            try:
                started = Settings(node, {'start': spec}, dict)
                expected = started.current['start']
                node.remove_on_set_parameters_callback(started._on_set)
                node.undeclare_parameter('start')
            except ParameterError as error:
                assert 'start is ' in str(error) and len(str(error)) < 1000
                expected = None
            result, = node.set_parameters([given])
            assert result.successful == (expected is not None), (name, value, result.reason)
            if expected is None:
                assert name in result.reason and len(result.reason) < 1000
            else:
                assert repr(running.current[name]) == repr(expected), (name, value)
                numbers = expected if isinstance(expected, list) else [expected]
                assert spec.limits is None or all(
                    spec.limits[0] <= number <= spec.limits[1] for number in numbers)
            judged[result.successful] += 1
        node.remove_on_set_parameters_callback(running._on_set)
        node.undeclare_parameter(name)
    assert min(judged.values()) > 400, judged


@pytest.mark.parametrize('node', ['planner', 'replay'])
def test_the_papers_parameter_file_has_the_defaults(node):
    written = yaml.safe_load((ROOT / 'config' / 'paper.yaml').read_text())
    values = dict(flat(written[f'/**/{node}']['ros__parameters']))
    specs = {'planner': {**PLANNER, **read_specs('uav', 'uav1'), **read_specs('uav', 'uav2', 1),
                         **read_specs('eavesdropper', 'eavesdropper')}, 'replay': REPLAY}[node]
    assert values
    for name, value in values.items():
        assert specs[name].convert(name, value) == specs[name].default, name


def test_every_parameter_has_a_description_and_says_what_it_allows():
    for specs in (PLANNER, REPLAY, read_specs('uav', 'a'), read_specs('ground_node', 'g'),
                  read_specs('eavesdropper', 'e')):
        for name, spec in specs.items():
            assert spec.description.endswith('.'), name
            assert spec.allowed in spec.descriptor().additional_constraints
            assert spec.convert(name, spec.default) == spec.default


def test_choices_and_lengths_in_the_table_of_parameters_are_those_of_the_package():
    assert PLANNER['method'].choices == METHODS
    assert PLANNER['objective'].choices[1:] == OBJECTIVES
    assert PLANNER['channel.los'].choices[1:] == tuple(ENVIRONMENTS)
    assert RELAY['stack'].choices == tuple(STACKS)
    assert {PLANNER['uavs'].length[1], PLANNER['eavesdroppers'].length[1],
            REPLAY['uavs'].length[1], RELAY['vehicles'].length[1]} == {MAX_MEMBERS}
    assert PLANNER['no_fly_zones'].length == (0, MAX_ZONES)
    assert PLANNER['geofence'].length[1] == 2 * MAX_VERTICES
    assert read_specs('no_fly_zone', 'zone')['zone.vertices'].length[1] == 2 * MAX_VERTICES
    assert read_specs('eavesdropper', 'eve')['eve.max_speed'].limits[1] == MAX_SPEED


@pytest.mark.parametrize('specs, settings, sections', [
    (PLANNER, PlannerSettings, PLANNER_MEMBERS), (REPLAY, ReplaySettings, {}),
    (RELAY, RelaySettings, RELAY_MEMBERS)], ids=['planner', 'replay', 'relay'])
def test_the_settings_of_a_node_have_a_field_of_its_type_for_each_parameter(
        specs, settings, sections):
    values = {name: spec.default for name, spec in specs.items()}
    members = {name: spec.default for name, spec in read_member_specs(values, sections).items()}
    made, made_of = settings.from_values({'tracks': {}} | values | members), {
        'true_eavesdropper', 'objective', 'origin', 'geofence', *sections}
    for name, value in values.items():
        if name in made_of or '.' in name or name in getattr(made, 'mission', {}):
            continue
        hint = get_type_hints(settings)[name]
        kind = get_origin(hint) or hint
        assert isinstance(getattr(made, name), str if kind is Literal else kind), name
        assert getattr(made, name) == (tuple(value) if isinstance(value, list) else value)
    with pytest.raises(FrozenInstanceError):
        made.frame_id = 'odom'
    for kind in sections:  # Of UAVs, receivers and zones.
        for member, of_member in getattr(made, kind, {}).items():
            for entry in fields(of_member):
                assert entry.name == 'mission' or f'{member}.{entry.name}' in members, entry


# What a start says

FILES = {'foreign.json': '{"format": "other"}', 'broken.json': '[1, 2',
         'lacks.yaml': 'duration: 5', 'nodes.yaml': '/**: {ros__parameters: {}}'}
NO_NAMES = 'it must be a list of 1 to 16 names of letters, digits and _'


@pytest.mark.parametrize('node, parameters, reason', [
    ('planner', {'slots': 'many'}, 'slots'), ('planner', {'uavs': '[a, a]'}, 'uavs'),
    ('planner', {'uav2.peak_power': 0.1}, 'uav2.peak_power'),
    ('planner', {'uav1.max_acceleration': 2.0, 'uav1.start_velocity': '[20.0, 0.0]'},
     'uav1.start_velocity'),
    ('planner', {'no_fly_zones': '[tower]'}, 'tower.vertices is []; it must be a list of 6'),
    ('planner', {'no_fly_zones': '[uav1]'}, 'no_fly_zones give the names'),
    ('planner', {'ground_nodes': "['barn', 'a-b']"}, f"['barn', 'a-b']; {NO_NAMES}"),
    ('planner', {'ground_nodes': "['barn', 'uav1']"},
     "['uav1', 'uav2', 'barn', 'uav1', 'eavesdropper']; they must be unique"),
    ('planner', {'channel.los': 'urban', 'channel.los_numbers': '[1.0, 1.0, 1.0]'},
     'channel.los_numbers is [1.0, 1.0, 1.0]; it must be empty'),
    ('planner', {'mission_file': 'farm.yaml'}, f"['north farm']; {NO_NAMES}"),
    ('planner', {'plan_file': 'no/plan.json'}, 'plan.json must be in a folder that is there'),
    ('planner', {'plan_file': '~/plan.json'},
     'parameter plan_file: ~/plan.json must be in a folder that is there'),
    ('planner', {'mission_file': 'missing.yaml'}, 'missing.yaml cannot be read: No such file'),
    ('planner', {'mission_file': 'lacks.yaml'}, 'lacks.yaml:1: mission lacks'),
    ('replay', {'mission_file': 'nodes.yaml'}, 'it is a parameter file of nodes'),
    ('replay', {'plan_file': 'missing.json'}, 'missing.json'),
    ('replay', {'plan_file': 'foreign.json'}, 'foreign.json is not a plan'),
    ('replay', {'plan_file': 'broken.json'}, 'broken.json is not a plan'),
    ('relay', {'stack': 'paparazzi'},
     "stack is 'paparazzi'; it must be one of mavros, px4, aerostack2"),
    ('relay', {'vehicles': '[a]'}, "vehicles is ['a']; it must be empty or have a name for each"),
    ('relay', {'vehicles': '[a, a]'}, "vehicles is ['a', 'a']; the names must be unique"),
    ('relay', {'uav1.origin': '[1.0, 2.0]'},
     'uav1.origin is [1.0, 2.0]; it must be a list of 3 numbers'),
    ('relay', {'uav2.reference': 'mavros'},
     'uav2.reference is mavros and origin.projection is none; it'),
    ('relay', {'uav1.reference': 'px4', 'origin.projection': 'ardupilot'},
     'it must be px4, and origin'),
    ('relay', {'uav1.reference': 'px4', 'origin.projection': 'px4',
               'uav1.origin': '[1.0, 0.0, 2.0]'},
     'uav1.origin is [1.0, 0.0, 2.0]; with uav1.reference, x and y must be 0'),
    ('relay', {'origin.latitude': 86.0}, 'origin.latitude is 86')])
def test_a_wrong_parameter_at_the_start_ends_the_node_with_one_line(
        capfd, tmp_path, monkeypatch, node, parameters, reason):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    replace(Scenario.paper(), ground_node=None, ground_nodes=(
        GroundNode((0.0, 0.0), 'north farm'),)).save('farm.yaml')
    assert reason in refusal(capfd, node, **parameters)


def test_what_is_odd_at_the_start_is_a_warning(tmp_path):
    file = tmp_path / 'mission.yaml'
    file.write_text("""
/**:
  ros__parameters:
    use_sim_time: false
    durration: 150.0
    uav1: {max_sped: 12.0}
    qos_overrides: {/parameter_events: {publisher: {depth: 10}}}
/**/replay:
  ros__parameters: {loup: true}
""")
    expected = {
        'planner': ['durration, it is ignored; did you mean duration?',
                    'uav1.max_sped, it is ignored; did you mean uav1.max_speed?',
                    'cannot be flown as it is set: duration is 20 s; uav1 needs at least',
                    'depth, it is ignored; did you mean qos_overrides./plan.publisher.depth?'],
        'replay': ['no parameter durration, ', 'no parameter uav1.max_sped, ',
                   'loup, it is ignored; did you mean loop?']}
    for node, texts in expected.items():
        own = {'duration': 20.0, 'qos_overrides.plan.publisher.depth': 5} if (
            node == 'planner') else {}
        with node_here(node, '--params-file', str(file), **own) as process:
            warnings = [line for line in process.lines if '[WARN]' in line]
        assert len(warnings) == len(texts), warnings
        for text in texts:
            assert any(text in line for line in warnings), text


@pytest.mark.parametrize('node, topic, kind, policy, value', [
    ('planner', 'ground_node/pose', 'subscription', 'reliability', 'reliable'),
    ('planner', 'plan', 'publisher', 'durability', 'volatile'),
    ('replay', 'uav1/setpoint/pose', 'publisher', 'reliability', 'best_effort'),
    ('relay', 'uav1/odom', 'publisher', 'reliability', 'best_effort')])
def test_an_override_of_the_quality_of_service_of_a_topic_changes_no_other_topic(
        client, packages, node, topic, kind, policy, value):
    packages('mavros_msgs', 'PositionTarget')  # The relay needs it.
    expected = {
        name.replace('<uav>', 'uav1').replace('<', '').replace('>', ''):
        getattr(entry.qos, policy).name.lower() for (owner, _), topics in TOPICS.items()
        if owner == node for name, entry in topics.items() if '~' not in name}

    def find_used(name):
        ends = (client.node.get_publishers_info_by_topic(name)
                + client.node.get_subscriptions_info_by_topic(name))
        return [getattr(end.qos_profile, policy).name.lower()
                for end in ends if end.node_name == node]
    with node_here(node, **{f'qos_overrides./{topic}.{kind}.{policy}': value}):
        for name in expected:
            used = wait_for(lambda: find_used(name), what=name)
            assert used == [value if name == topic else expected[name]], name


def test_the_defaults_are_those_of_the_papers_mission():
    mission = mission_values(Scenario.paper())
    shared = DEFAULTS.keys() & mission.keys()
    assert len(shared) > 20
    assert {name: DEFAULTS[name] for name in shared} == {name: mission[name] for name in shared}


def test_each_zone_of_a_mission_file_becomes_parameters_whatever_its_name():
    names = ['tower a', 'tower_a', 'Tower-1', '7 Elms', 'uav1', '', 'Z\u00fcrich', 'x' * 200]
    zones = tuple(NoFlyZone(((x, 0), (x + 9, 0), (x, 9)), name=name)
                  for x, name in zip(range(900, 1000, 10), names))
    values = mission_values(replace(Scenario.paper(), no_fly_zones=zones))
    assert PLANNER['no_fly_zones'].convert('', values['no_fly_zones']) == [
        'tower_a5', 'tower_a6', 'Tower_1', '_7_Elms', 'uav19', 'zone_6', 'Z_rich', 'x' * 80]
    read_member_specs(values, PLANNER_MEMBERS)
    assert [zone.vertices for zone in airspace_from(values)['no_fly_zones']] == [
        zone.vertices for zone in zones]


def test_a_mission_file_gives_names_and_values_and_what_is_set_overrides_it(client):
    city_values = city.values()
    with node_here('planner', mission_file=city.FILE, slots=85, courier__altitude=95) as process:
        found = client.all_parameters('planner')
        assert found['uavs'] == ['courier', 'escort1', 'escort2'] == city_values['uavs']
        assert (found['slots'], found['courier.altitude']) == (85, 95.0)
        for name in city_values.keys() - {'mission_file', 'slots', 'courier.altitude'}:
            assert found[name] == city_values[name], name
    assert not has_said(process, 'there is no parameter')
    with node_here('replay', mission_file=city.FILE):
        assert client.get_parameters('replay', 'uavs') == [['courier', 'escort1', 'escort2']]


def test_the_parameters_of_a_running_node_start_another_one_with_the_same(client, tmp_path):
    """As `ros2 param dump` writes them, empty lists and the word off included."""
    empty = {'no_fly_zones': [], 'uav1.start_velocity': [], 'uav2.goal_velocity': []}
    with node_here('planner', bound='off', slots=20, **empty,
                   geofence=[-9e3, -9e3, 9e3, -9e3, 0.0, 9e3]):
        before = client.all_parameters('planner')
    assert len(before) > 50 and before['bound'] == 'off'
    assert [before[name] for name in empty] == [[]] * 3
    file = tmp_path / 'planner.yaml'
    file.write_text(yaml.dump({'/planner': {'ros__parameters': before}}))
    with node_here('planner', '--params-file', str(file)):
        assert client.all_parameters('planner') == before
    with node_here('replay', true_eavesdropper=[]):
        assert client.get_parameters('replay', 'true_eavesdropper') == [[]]
