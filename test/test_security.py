"""What the nodes may do, compared with what they do, and what their output gives away."""

from importlib.util import find_spec
import math
from pathlib import Path
import re
import time
from xml.etree import ElementTree

import pytest
from ros_client import Client, node_process, output_of, PATIENCE, wait_for

POLICY = Path(__file__).parents[1] / 'config' / 'sros2_policy.xml'
NODES = ('planner', 'replay')
ALL_NODES = (*NODES, 'relay')

HAS_TF2 = find_spec('tf2_ros') is not None
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


def policy_of(node):
    """Return what used() returns of a node that uses all that it is allowed, and that it can."""
    unused = set() if HAS_TF2 else OF_TF2
    return {key: sorted(set(names) - unused) for key, names in allowed(node).items()}


def used(client, node):
    """Return the names that a running node uses, by kind and right."""
    return {key: sorted(name for name, _ in getattr(client.node, query)(node, '/'))
            for key, query in QUERIES.items()}


@pytest.fixture(scope='module')
def graph():
    """Return what both nodes use once discovery has settled, in all of their settings together."""
    with Client() as client, \
            node_process('planner', use_sim_time='true'), \
            node_process('replay', use_sim_time='true'), \
            node_process('replay', '-r', '__node:=vehicles', vehicle_odometry='true'):
        def known():
            names = client.node.get_node_names()
            return all(node in names for node in (*NODES, 'vehicles'))

        def used_together():
            both = {node: used(client, node) for node in (*NODES, 'vehicles')}
            for key, names in both.pop('vehicles').items():
                names = [name.replace('/vehicles/', '/replay/') for name in names]
                both['replay'][key] = sorted({*both['replay'][key], *names})
            return both

        wait_for(known, what='discovery of both nodes')
        policy = {node: policy_of(node) for node in NODES}
        found, since = None, time.monotonic()

        def settled():
            nonlocal found, since
            client.send_pose('uav1/pose', 0.0, 0.0, frame_id='elsewhere', until_known=False)
            now = used_together()
            if now != found:
                found, since = now, time.monotonic()
            # As it should be it has to stay for a while only; else a slow machine may discover on.
            return time.monotonic() - since > (2.0 if now == policy else PATIENCE)

        wait_for(settled, patience=5 * PATIENCE, what='a graph that stands still')
        return found


@pytest.mark.parametrize('node', NODES)
def test_the_policy_allows_what_the_running_node_uses_and_nothing_else(graph, node):
    assert policy_of(node) == graph[node]


def test_only_the_planner_may_use_what_transforms_poses():
    may = {node: OF_TF2.intersection(set().union(*allowed(node).values())) for node in ALL_NODES}
    assert may == {'planner': OF_TF2, 'replay': set(), 'relay': set()}
    assert {'/tf', '/tf_static'} <= set(allowed('planner')['topics', 'subscribe'])
    assert '/tf2_frames' in allowed('planner')['services', 'reply']


def test_the_policy_has_an_enclave_of_its_own_for_every_node_in_the_schemas_form():
    root = ElementTree.parse(POLICY).getroot()
    assert (root.tag, root.attrib) == ('policy', {'version': '0.2.0'})
    assert [one.tag for one in root] == ['enclaves']
    assert [one.get('path') for one in root[0]] == [
        f'/secure_uav_planner/{node}' for node in ALL_NODES]
    for enclave in root[0]:
        profiles, = enclave
        profile, = profiles
        assert enclave.tag == 'enclave' and profiles.tag == 'profiles'
        assert profile.tag == 'profile' and profile.get('ns') == '/'
        for rules in profile:
            assert (rules.tag, *rules.keys()) in QUERIES
            names = [entry.text for entry in rules]
            assert names and len(set(names)) == len(names)
            assert {entry.tag for entry in rules} == {rules.tag[:-1]}
            assert not any(set(name) & set('*?[') for name in names)  # no wildcards


# Places nobody would write by chance: their digits must not turn up in any output.
GROUND, EVE = (1731.41592, -1627.18281), (1916.80339, 1814.14213)


def given_away(place):
    """Return a pattern of what gives a coordinate away, at a resolution of a metre or finer."""
    metres = {f'{function(abs(number)):.0f}' for number in place
              for function in (math.floor, math.ceil)}
    return re.compile(rf'(?<![\d.])(?:{"|".join(sorted(metres))})(?!\d)')


def test_the_pattern_finds_what_gives_a_place_away():
    for text in ('(1916.80339, 0.0)', 'x is 1917', '[2e7, 1814.1]', '-1627.2 m', 'at 1731.'):
        assert any(given_away(place).search(text) for place in (GROUND, EVE))
    for text in ('1795247976.1731', '[1731247976.17]', 'rate 3.1814', '21732 slots'):
        assert not any(given_away(place).search(text) for place in (GROUND, EVE))


def test_no_place_of_ground_node_or_eavesdropper_is_in_the_output():
    with Client() as client, \
            node_process('planner', duration=150.0, slots=33, uav1__use_pose='false',
                         uav2__use_pose='false') as planner, \
            node_process('replay', true_eavesdropper=list(EVE), ground_node=list(GROUND),
                         speed=100.0) as replay:
        client.send_pose('ground_node/pose', *GROUND)
        client.send_estimate('eavesdropper/pose', *EVE, variance=2.0)
        assert client.call('planner/plan').success
        wait_for(lambda: any('got a plan' in line for line in replay.lines))
        assert client.call('replay/start').success
        wait_for(lambda: any('end of the plan' in line for line in replay.lines))

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
        wait_for(lambda: (client.call('replay/reset'), client.call('planner/plan'), any(
            'no new plan: duration' in line for line in planner.lines))[-1])
    output = output_of(planner) + output_of(replay)
    assert 'no new plan: duration' in output and 'is not used' in output  # it does speak
    for place in (GROUND, EVE):
        assert not given_away(place).findall(output), output
