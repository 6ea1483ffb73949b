"""Parameters of nodes: what a start accepts, what is checked when, and what comes back."""

from collections import Counter
from itertools import count
import math

import city
from hypothesis import given
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from ros_client import Client, DEFAULTS, node_process, refusal, wait_for_line
from secure_uav_planner import Scenario
from secure_uav_planner.errors import ParameterError
from secure_uav_planner.mission import METHODS, OBJECTIVES
from secure_uav_planner.mission.polygons import MAX_VERTICES
from secure_uav_planner.mission.propagation import ENVIRONMENTS
from secure_uav_planner.mission.scenario import MAX_MEMBERS, MAX_ZONES
from secure_uav_planner.mission.tracks import MAX_SPEED
from secure_uav_planner.output.autopilots import STACKS
from secure_uav_planner.ros.parameters import (
    PLANNER, read_fields, read_specs, RELAY, REPLAY, Spec)
from secure_uav_planner.ros.settings import (
    airspace_from, load_mission, mission_values, Settings, uav_from)
from secure_uav_planner.ros.topics import LATCHED, OVERRIDABLE
from std_msgs.msg import Float64
from strategies import scenarios
import yaml

EMPTY = {'geofence': [], 'no_fly_zones': [], 'uav1__start_velocity': [],
         'uav2__goal_velocity': []}
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
    settings = Settings(node, SPECS, lambda values: next(calls))
    for number in range(5):
        node.create_publisher(Float64, f'topic{number}', LATCHED,
                              qos_overriding_options=OVERRIDABLE)
    assert next(calls) == 1
    assert node.set_parameters([rclpy.Parameter('rate', value=2)])[0].successful
    assert next(calls) == 3 and settings['rate'] == 2.0


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
    for section, name in (('uav', 'uav1'), ('eavesdropper', 'eve'), ('no_fly_zone', 'zone'),
                          ('relay_uav', 'uav1')):
        specs += read_specs(section, name).items()
    judged = Counter()
    for name, spec in specs:
        if name == 'mission_file' or spec.read_only:
            continue
        usable = [0.0, 1.0] * 3 if name == 'zone.vertices' else spec.default
        node._parameter_overrides = {name: rclpy.Parameter(name, value=usable)}
        running = Settings(node, {name: spec}, lambda values: None)
        for value in [*ANYTHING, *edges(spec)]:
            given = rclpy.Parameter(name, value=value)
            node._parameter_overrides = {'start': rclpy.Parameter('start', value=value)}
            try:
                started = Settings(node, {'start': spec}, lambda values: None)
                expected = started['start']
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
                assert repr(running[name]) == repr(expected), (name, value)
                numbers = expected if isinstance(expected, list) else [expected]
                assert spec.limits is None or all(
                    spec.limits[0] <= number <= spec.limits[1] for number in numbers)
            judged[result.successful] += 1
        node.remove_on_set_parameters_callback(running._on_set)
        node.undeclare_parameter(name)
    assert min(judged.values()) > 500, judged


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


def test_empty_lists_and_the_word_off_can_be_given_at_the_start(capfd):
    with node_process('planner', bound='off', **EMPTY), Client() as client:
        names = [name.replace('__', '.') for name in EMPTY]
        assert client.get_parameters('planner', 'bound', *names) == ['off', *[[]] * 4]
    with node_process('replay', true_eavesdropper=[]) as process:
        wait_for_line(process, 'ready')
    assert 'parameter uavs is []; it must be a list of 1 to 32 names' in refusal(
        capfd, 'planner', uavs=[])


@pytest.mark.parametrize('file', ['no/plan.json', '~/plan.json'])
def test_a_plan_file_in_a_folder_that_is_not_there_is_refused_at_the_start(capfd, tmp_path, file):
    path = file if file.startswith('~') else tmp_path / file
    assert f'parameter plan_file: {path} must be in a folder that is there' in refusal(
        capfd, 'planner', plan_file=path)


def test_the_defaults_are_those_of_the_papers_mission():
    mission = mission_values(Scenario.paper())
    shared = DEFAULTS.keys() & mission.keys()
    assert len(shared) > 20
    assert {name: DEFAULTS[name] for name in shared} == {name: mission[name] for name in shared}


@given(scenarios())
def test_the_values_that_stand_for_a_mission_give_the_same_mission(scenario):
    values = {name: spec.default for name, spec in PLANNER.items()} | mission_values(scenario)
    assert tuple(uav_from(values, name) for name in values['uavs']) == scenario.uavs
    for field, value in {
            **airspace_from(values), **read_fields('planner', Scenario, values)}.items():
        assert value == getattr(scenario, field)
    assert [values[f'{name}.error_radius'] for name in values['eavesdroppers']] == [
        eve.error_radius for eve in scenario.eavesdroppers]


def test_a_mission_file_gives_names_and_values_and_what_is_set_overrides_it():
    with node_process('planner', mission_file=city.FILE, slots=85,
                      courier__altitude=95) as process, Client() as client:
        found = client.all_parameters('planner')
        city_values = city.values()
        assert found['uavs'] == ['courier', 'escort1', 'escort2'] == city_values['uavs']
        assert (found['slots'], found['courier.altitude']) == (85, 95.0)
        for name in city_values.keys() - {'mission_file', 'slots', 'courier.altitude'}:
            assert found[name] == city_values[name], name
        wait_for_line(process, 'ready')
        assert not any('there is no parameter' in line for line in process.lines)
    with node_process('replay', mission_file=city.FILE), Client() as client:
        assert client.get_parameters('replay', 'uavs') == [['courier', 'escort1', 'escort2']]


@pytest.mark.parametrize('text, reason', [
    (None, 'cannot be read: No such file'), ('duration: 5', ':1: mission lacks'),
    ('/**: {ros__parameters: {}}', 'it is a parameter file of nodes')])
def test_a_mission_file_that_is_none_is_named(tmp_path, text, reason):
    file = tmp_path / 'mission.yaml'
    if text is not None:
        file.write_text(text)
    with pytest.raises(ParameterError, match=f'^parameter mission_file: {file}.*{reason}'):
        load_mission(file)


def test_the_parameters_of_a_running_node_start_another_one_with_the_same(tmp_path):
    """As `ros2 param dump` writes them."""
    with node_process('planner', geofence=[-9e3, -9e3, 9e3, -9e3, 0.0, 9e3], bound='after',
                      slots=20), Client() as client:
        before = client.all_parameters('planner')
    assert len(before) > 50
    file = tmp_path / 'planner.yaml'
    file.write_text(yaml.dump({'/planner': {'ros__parameters': before}}))
    with node_process('planner', '--params-file', file), Client() as client:
        assert client.all_parameters('planner') == before
