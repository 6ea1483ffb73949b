"""What the nodes may do, compared with what they do, and what their output gives away."""

from contextlib import contextmanager
from itertools import chain
import math
from pathlib import Path
import re
from xml.etree import ElementTree

import pytest
import rclpy
from rclpy.context import Context
from ros_client import Client
from ros_nodes import has_said, node_process, output_of, wait_for, wait_for_line
from secure_uav_planner.ros.planner.node import Planner
from secure_uav_planner.ros.relay.node import Relay
from secure_uav_planner.ros.replay.node import Replay

POLICY = Path(__file__).parents[1] / 'config' / 'sros2_policy.xml'
ALL_NODES = ('planner', 'replay', 'relay')

OF_TF2 = {'/tf', '/tf_static', '/tf2_frames'}
"""What tf2's buffer and listener use, from the first pose of another frame on."""

# What a rule of the policy allows, and which query of the graph shows it.
QUERIES = {
    ('topics', 'publish'): 'get_publisher_names_and_types_by_node',
    ('topics', 'subscribe'): 'get_subscriber_names_and_types_by_node',
    ('services', 'reply'): 'get_service_names_and_types_by_node',
    ('services', 'request'): 'get_client_names_and_types_by_node',
}


def allowed(node):
    """Return the names that the policy allows a node, by kind and right."""
    profiles = [profile for profile in ElementTree.parse(POLICY).getroot().iter('profile')
                if profile.get('node') == node]
    assert len(profiles) == 1
    found = {key: [] for key in QUERIES}
    for rules in profiles[0]:
        (right, qualifier), = rules.items()
        assert qualifier == 'ALLOW'
        for entry in rules:
            name = entry.text.replace('~/', f'{node}/')
            found[rules.tag, right].append(name if name.startswith('/') else f'/{name}')
    return found


@contextmanager
def lone_node(kind, *parameters, namespace='/'):
    """Give a node of a class in a context of its own, with parameters as `name:=value`."""
    context = Context()
    rclpy.init(context=context, args=['--ros-args', *chain(*(
        ('-p', parameter) for parameter in parameters))])
    node = kind(context=context, namespace=namespace)
    try:
        yield node
    finally:
        node.close()
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize('kind, settings', [
    (Planner, [()]), (Replay, [(), ('vehicle_odometry:=true',)]), (Relay, [()])])
def test_the_policy_allows_what_a_node_uses_in_all_of_its_settings_and_nothing_else(
        kind, settings, request):
    if kind is Relay:
        request.getfixturevalue('packages')  # The relay starts only with messages of a stack.
    found = {key: set() for key in QUERIES}
    for parameters in settings:
        with lone_node(kind, 'use_sim_time:=true', *parameters) as node:
            for key, query in QUERIES.items():
                found[key] |= {name for name, _ in getattr(node, query)(node.get_name(), '/')}
    policy = allowed(kind.__name__.lower())
    for key, names in found.items():
        assert len({*policy[key]}) == len(policy[key])
        assert {*policy[key]} - OF_TF2 == names - OF_TF2, key


def test_only_the_planner_may_use_what_transforms_poses():
    may = {node: OF_TF2.intersection(set().union(*allowed(node).values())) for node in ALL_NODES}
    assert may == {'planner': OF_TF2, 'replay': set(), 'relay': set()}
    assert {'/tf', '/tf_static'} <= set(allowed('planner')['topics', 'subscribe'])
    assert '/tf2_frames' in allowed('planner')['services', 'reply']


def test_the_policy_has_an_enclave_of_its_own_for_every_node_without_wildcards():
    root = ElementTree.parse(POLICY).getroot()
    assert [(enclave.tag, enclave.get('path')) for enclave in root.find('enclaves')] == [
        ('enclave', f'/secure_uav_planner/{node}') for node in ALL_NODES]
    for rules in root.findall('enclaves/enclave/profiles/profile/*'):
        assert (rules.tag, *rules.keys()) in QUERIES
        names = [entry.text for entry in rules]
        assert names and len(set(names)) == len(names)
        assert {entry.tag for entry in rules} == {rules.tag[:-1]}
        assert not any(set(name) & set('*?[') for name in names)


# Places nobody would write by chance: their digits must not turn up in any output.
GROUND, EVE = (1731.41592, -1627.18281), (1916.80339, 1814.14213)


def given_away(place):
    """Return a pattern of what gives a coordinate away, at a resolution of a metre or finer."""
    metres = {f'{function(abs(number)):.0f}' for number in place
              for function in (math.floor, math.ceil)}
    return re.compile(rf'(?<![\d.])(?:{"|".join(sorted(metres))})(?!\d)')


def test_no_place_of_ground_node_or_eavesdropper_is_in_the_output():
    with Client() as client, \
            node_process('planner', duration=150.0, slots=33, uav1__use_pose='false',
                         uav2__use_pose='false') as planner, \
            node_process('replay', true_eavesdropper=list(EVE), ground_node=list(GROUND),
                         speed=100.0) as replay:
        client.send_pose('ground_node/pose', *GROUND)
        client.send_estimate('eavesdropper/pose', *EVE, variance=2.0)
        assert client.call('planner/plan').success
        wait_for_line(replay, 'got a plan')
        assert client.call('replay/start').success
        wait_for_line(replay, 'end of the plan')

        # Every way to be refused, with the same places.
        def warnings():
            return sum('[WARN]' in line for line in planner.lines)

        far = EVE[0] + 2e7
        for send in (
                lambda: client.send_pose('ground_node/pose', *GROUND, frame_id='odom'),
                lambda: client.send_pose('ground_node/pose', GROUND[0], math.nan),
                lambda: client.send_estimate('eavesdropper/pose', *EVE, variance=-1.0),
                lambda: client.send_estimate('eavesdropper/pose', *EVE, variance=1e30),
                lambda: client.send_estimate('eavesdropper/pose', far, EVE[1])):
            before = warnings()
            # It is refused when it comes, or else when it is planned with.
            wait_for(lambda: (send(), client.call('planner/plan'), warnings() > before)[-1])
            client.send_pose('ground_node/pose', *GROUND)
            client.send_estimate('eavesdropper/pose', *EVE)
        for values in ({'duration': 20.0}, {'uav1__start': [math.nan, EVE[0]]}):
            client.set_parameters('planner', **values)
        client.set_parameters('replay', true_eavesdropper=[EVE[0]])
        # From where a flight has come to, no duration may be too short.
        wait_for(lambda: (client.call('replay/reset'), client.call('planner/plan'),
                          has_said(planner, 'no new plan: duration'))[-1])
    output = output_of(planner) + output_of(replay)
    assert 'no new plan: duration' in output and 'is not used' in output  # it does speak
    for place in (GROUND, EVE):
        assert not given_away(place).findall(output), output
