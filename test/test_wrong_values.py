"""What Python refuses: the field that an error blames, its code, and what its text has to say."""

from dataclasses import fields, replace
from functools import partial
import json
import math

import numpy as np
import pytest
from secure_uav_planner import (
    assess, Bound, Channel, Eavesdropper, fly_hover_fly, GroundNode, Iteration, NoFlyZone, Origin,
    Propulsion, Scenario, shortest_duration, solve, Uav, upper_bound, World)
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.mission.fields import Number
from secure_uav_planner.mission.propagation import reference_snr_db
from secure_uav_planner.output.autopilots import Setpoint
from secure_uav_planner.plan.splice import cut_tail
from secure_uav_planner.ros.parameters import Spec
from strategies import make_crowd
from test_airspace import around
from test_margin import make_team

PAPER = Scenario.paper(120.0, slots=10)
SQUARE = ((0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0))
SCOUT = Uav('scout', (0.0, 0.0), (1.0, 1.0), 100.0, 10.0)
TOWER = NoFlyZone(SQUARE, name='tower')
CAR = Eavesdropper(name='car', track=((0, 200, -300, 10), (9, 2, 2, 2)))
STILL = Eavesdropper((0.0, 0.0), 1.0)
DRIVING = replace(PAPER, ground_node=None, ground_node_track=((0, 0, 0), (60, 5, 5)))
FADING = Channel(rician_k_db=0.0, outage=0.1)
ZURICH = Origin(47.3977, 8.5456)
PLAN = fly_hover_fly(PAPER)
SETPOINT = Setpoint('map', 0, (0.0, 0.0, 0.0), 0.0)
LINK = partial(reference_snr_db, **{'carrier_hz': 2.4e9, 'bandwidth_hz': 1e6})
HERE = {'latitude': 47.0, 'longitude': 8.0}


def between(start, goal, name):
    """Return a UAV from start to goal."""
    return Uav(name, start, goal, 50.0, 10.0)


def accelerate(*limits):
    """Return the UAVs of the paper with limits of acceleration."""
    return tuple(replace(uav, max_acceleration=limit)
                 for uav, limit in zip(PAPER.uavs, limits, strict=True))


def serve(names):
    """Return the paper's mission with ground nodes of such names."""
    return replace(PAPER, ground_node=None, ground_nodes=tuple(
        GroundNode((index, 0), name) for index, name in enumerate(names)))


FARM = fly_hover_fly(serve('ab'))


BARE = {'eavesdroppers': PAPER.eavesdroppers, 'uavs': PAPER.uavs, 'duration': 110, 'slots': 8}


def read_mission(**changes):
    """Return the mission of plain values."""
    return Scenario.from_dict(json.loads(json.dumps(PAPER.to_dict())) | changes)


def change_plan(field, index, value):
    """Return the plan with a changed element of an array."""
    array = getattr(PLAN, field).copy()
    array[index] = value
    return replace(PLAN, **{field: array})


KNOTS = '2 to 10000 knots (t, x, y, radius)'
NO_ORIGIN = 'a place in degrees needs a mission file with an origin'

MISSIONS = [
    (SCOUT, {'start': (1.0,)}, 'start', ''),
    (SCOUT, {'goal': (1e9, 0)}, 'goal', 'from -1e+07 to 1e+07 m'),
    (SCOUT, {'start_velocity': (8.0, 8.0)}, 'start_velocity', 'at most max_speed, which is 10'),
    (SCOUT, {'goal_velocity': 3}, 'goal_velocity', 'None or two components'),
    (PAPER, {'ground_node': (math.nan, 0.0)}, 'ground_node', 'is (nan, 0.0)'),
    (partial(Scenario, None), BARE, 'ground_nodes', 'ground_node is None; it must be two'),
    (PAPER, {'head_starts': (100.0,)}, 'head_starts', 'empty, as there is a single ground node'),
    (PAPER, {'slots': 2.5}, 'slots', 'must be a whole number'),
    (PAPER, {'eavesdroppers': ()}, 'eavesdroppers', 'a list of 1 to 32 Eavesdropper'),
    (PAPER, {'uavs': [1]}, 'uavs[0]', 'is 1; it must be a Uav or'),
    (PAPER, {'uavs': accelerate(None, 2.0)}, 'uavs[0].max_acceleration', 'all uavs have'),
    (PAPER, {'uavs': accelerate(2.0, None)}, 'uavs[1].max_acceleration', 'all uavs have'),
    (PAPER, {'channel': 'urban'}, 'channel', 'must be a Channel or a mapping'),
    (FADING, {'los': 'city'}, 'los', 'suburban, urban, dense_urban, highrise, or three numbers'),
    (FADING, {'los': (1, 2)}, 'los', ''),
    (FADING, {'los': (9.61, 0.16, -1)}, 'los', 'channel.los.loss_db is -1; it must be'),
    (FADING, {'rician_k_db': None}, 'rician_k_db', 'as channel.outage is 0.1'),
    (FADING, {'outage': None}, 'outage', 'as channel.rician_k_db is one'),
    (read_mission, {'channel': {'outage': 0.1}}, 'channel.rician_k_db', ''),
    (TOWER, {'floor': 50.0, 'ceiling': 49.0}, 'floor', 'is 50.0 m; it must be at most ceiling'),
    (TOWER, {'name': 3}, 'name', 'zone name is 3'),
    (TOWER, {'name': '', 'vertices': 3}, 'vertices', 'zone vertices is 3'),
    *((whole, {field: value}, path, text) for whole, field in ((TOWER, 'vertices'), (
        PAPER, 'geofence')) for value, path, text in (
        ('square', field, 'must be a list of vertices'),
        ((*SQUARE[:2], SQUARE[0]), field, 'at least three different vertices'),
        (((0, 0), (0, 50), (1e-9, 20)), field, 'has no area'),
        (((0, 0), (40, 40), (40, 0), (0, 40)), field, 'crosses or touches itself near (20, 20)'),
        (((0, 0), (40, 0), (40, 40), (40, 0), (0, 40)), field, 'crosses or touches itself'),
        (((0, 0), (math.inf, 0), (40, 40)), f'{field}[1]', 'must be two coordinates'),
        ([(n, n * n) for n in range(257)], field, 'has 257 vertices; it must have at most 256'))),
    (PAPER, {'no_fly_zones': [TOWER] * 65}, 'no_fly_zones', 'a list of 0 to 64 NoFlyZone'),
    (PAPER, {'no_fly_zones': [NoFlyZone(around((100, 500)), name='tower')]}, 'uavs[0].start',
     'uav1.start is (100.0, 500.0) at 100 m, inside tower'),
    (PAPER, {'no_fly_zones': [TOWER, NoFlyZone(around((100, -500)), 105)]}, 'uavs[1].goal',
     'uav2.goal is (100.0, -500.0) at 110 m, inside zone 2'),
    (PAPER, {'geofence': around((100, -500), 400.0)}, 'uavs[0].start', 'outside the geofence'),
    (PAPER, {'geofence': around((100, 0), 500.5), 'uavs': [replace(
        uav, max_acceleration=2.0, start=(100.0, 500.0 + lift), start_velocity=None)
        for uav, lift in zip(PAPER.uavs, (0.0, 0.6))]}, 'uavs[1].start', 'outside the geofence'),
    (PAPER, {'separation': 11.0}, 'separation',
     'at most 10 m, the distance between the starts of uav1 and uav2'),
    (PAPER, {'uavs': (between((0, 0), (0, 0), 'a'), between((50, 0), (0, 0), 'b')),
             'separation': 30.0}, 'separation', '0 m, the distance between the goals of a and b'),
    (make_team, {'tracking_margin': 8.1}, 'separation',
     'the tracking_margin of 8.1 m it must be at most 3.8 m'),
    (make_team, {'tracking_margin': 10.1, 'separation': 0.0}, 'uavs[0].start',
     'inside wall with the tracking_margin of 10.1 m'),
    (make_team, {'tracking_margin': 10.1, 'separation': 0.0, 'no_fly_zones': ()},
     'uavs[1].start', 'outside the geofence with the tracking_margin of 10.1 m'),
    (make_team, {'tracking_margin': 64.6, 'no_fly_zones': ()}, 'tracking_margin',
     '64.6 m, which leaves'),
    (GroundNode, {}, 'position', 'ground_node.position is None'),
    (GroundNode((0, 0)), {'trusted': 'no'}, 'trusted', 'true or false'),
    (serve('ab'), {'ground_node': (1, 1)}, 'ground_node',
     'must be left out where there are ground_nodes'),
    (serve('ab'), {'ground_node_track': ((0, 0, 0), (1, 1, 1))}, 'ground_node_track', 'left out'),
    (serve('ab'), {'head_starts': (1.0,)}, 'head_starts', 'a number for each of the 2'),
    (read_mission, {'ground_nodes': [{'position': [0, 0]}]}, 'ground_node',
     'must be left out where there are ground_nodes'),
    (read_mission, {'ground_node': {'weight': 0}}, 'ground_node.weight', 'from 0.001 to 1000'),
    (serve, {'names': 'abcdefghijklmnopq'}, 'ground_nodes', 'a list of 1 to 16 GroundNode'),
    (serve, {'names': 'aa'}, 'ground_nodes[1].name', 'must be unique'),
    (Scenario, {'ground_node': (0, 0)}, '', 'lacks eavesdroppers, uavs, duration, slots'),
    (Eavesdropper, {}, 'position', 'is None; it must be two coordinates (x, y) in m, or'),
    (CAR, {'error_radius': 60.0}, 'error_radius', 'left out, or that of the track'),
    (CAR, {'position': (0, 0)}, 'position', 'left out, or that of the track'),
    (CAR, {'track': ((0, 1, 1, 1), (9, 2, 2, 2))}, 'position', 'or that of the track'),
    (DRIVING, {'ground_node': (5.0, 0.0), 'ground_node_track': DRIVING.ground_node_track},
     'ground_node', 'left out, or that of the track'),
    *((STILL, {'track': track}, path, text) for track, path, text in (
        (((0, 0, 0, 1),), 'track', KNOTS), ('0 0 0 1', 'track', KNOTS), (5, 'track', KNOTS),
        (tuple((t, 0, 0, 1) for t in range(10_001)), 'track', KNOTS),
        (((0, 0, 0, 1), (0, 1, 1, 1)), 'track[1]', 'has the time 0.0 s; it must be after'),
        (((0, 0, 0, 1), (1, math.nan, 1, 1)), 'track[1]', '.x is nan; it must be a'),
        (((0, 0, 0, 1), (1, 0, 1, -1)), 'track[1]', '.radius is -1; it must be a'),
        (((0, 0, 0, 1), ('1 s', 0, 1, 1)), 'track[1]', 'in s, without its unit'),
        (((0, 0, 0, 1), (1, 0, 1001, 1)), 'track[1]', 'at most 1000 m/s'),
        (((0, 0, 0), (1, 0, 1)), 'track[0]', 'is (0, 0, 0); it must be the numbers'),
        (((0, 0, 0, 1), 3), 'track[1]', 'is 3; it must be the numbers'))),
    (ZURICH, {'projection': 'utm'}, 'projection', 'one of px4, ardupilot'),
    *((read_mission, {field: place, 'origin': origin}, path, words)
      for origin, field, path, place, words in (
        (None, 'ground_node', 'ground_node', HERE, NO_ORIGIN),
        (HERE, 'ground_node', 'ground_node', {'latitude': 8.0, 'longitude': 47.1},
         'at most 100 km; latitude and longitude are swapped'),
        (HERE, 'ground_node', 'ground_node', {'latitude': 49.0, 'longitude': 8.0},
         'a place is 222.4 km from the origin, east and north; it must be at most 100 km'),
        (HERE, 'ground_node', 'ground_node', {'latitude': 47.4}, 'a latitude and a longitude'),
        (HERE, 'ground_node', 'ground_node', {'latitude': '47.4', 'longitude': 8.5},
         'latitude is nan and longitude 8.5; they must be from -90 to 90'),
        (None, 'geofence', 'geofence[0]', [HERE] * 4, NO_ORIGIN),
        (None, 'ground_node', 'ground_node.track[0]', {'track': [[0, HERE], [1, 0, 0]]},
         NO_ORIGIN))),
    (read_mission, {'origin': 5}, 'origin', 'it must be an Origin or a mapping of its fields'),
    (SCOUT, {'name': '\ud83d one'}, 'name', 'text of whole characters'),
    (TOWER, {'name': '\ude81\ud83d'}, 'name', 'text of whole characters'),
]
OPTIONS = [
    (World, {'place': 'here'}, 'place', 'must be one of disc, normal, beyond, fixed'),
    (World, {'beyond': 5.0}, 'beyond', "and place is 'disc'; it counts only with the place"),
    (World, {'place': 'beyond'}, 'beyond', 'must be above 0 m'),
    (World, {'place': 'fixed', 'positions': ((0, 'x'),)}, 'positions[0]', 'two coordinates'),
    (World, {'place': 'fixed', 'positions': 5}, 'positions', 'must be a list of pairs'),
    (World, {'place': 'normal', 'covariance': ((1, 0),)}, 'covariance', 'a list of 2 pairs'),
    (World, {'place': 'normal', 'covariance': ((1, 2), (2, 1))}, 'covariance', 'semidefinite'),
    (World, {'place': 'normal', 'covariance': ((1, 2), (0, 9))}, 'covariance', 'symmetric'),
    (World, {'channel': {'exponent': 1.0}}, 'channel.exponent', 'must be a number from 2 to 6'),
    (partial(assess, PLAN), {'draws': 0}, 'draws', 'a whole number from 1 to 1000000'),
    (partial(assess, PLAN), {'flown': [[['x']]]}, 'flown', 'of the shape (2, 10, 2)'),
    (partial(assess, PLAN), {'flown': np.ma.masked_less(np.zeros((2, 10, 2)), 1.0)}, 'flown',
     'an array of numbers'),
    *((partial(assess, PLAN), {'flown': np.zeros(shape)}, 'flown', 'of the shape (2, 10, 2)')
      for shape in ((2, 9, 2), (2, 10))),
    (partial(assess, PLAN), {'flown': np.full((2, 10, 2), np.nan)}, 'flown', 'finite positions'),
    (partial(assess, PLAN), {'world': World('fixed', positions=((0, 0), (1, 1)))}, '',
     'positions has 2 places; it must have one for each of the 1 eavesdroppers'),
    (partial(assess, PLAN), {'world': World(tracking_std=1.0), 'flown': np.zeros((2, 10, 2))},
     'tracking_std', 'tracking_std is 1 m'),
    (partial(cut_tail, PLAN), {'point': 10}, 'point', 'is 10; it must be'),
    (Propulsion().power, {'speeds': [1.0, -2.0]}, 'speeds', 'of at least 0 m/s'),
    *((Propulsion().power, {'speeds': speeds}, 'speeds', 'array of numbers') for speeds in (
        'x', None, [[1], [1, 2]], [10**400], ['1', '2'], [True, False], [1j, 2.0],
        np.ma.masked_array([1.0, 2.0], [True, False]))),
    (LINK, {'carrier_hz': 2.4}, 'carrier_hz', 'from 1e+06 to 1e+12 Hz'),
    (LINK, {'bandwidth_hz': '1 MHz'}, 'bandwidth_hz', 'in Hz, without its unit'),
    (ZURICH.to_local, {'latitude': 8.5, 'longitude': 47.4}, '', 'must be at most 100 km'),
    (ZURICH.to_local, {'latitude': [47.0, math.nan], 'longitude': 8.0}, '', 'from -90 to 90 and'),
    (ZURICH.to_geographic, {'east': [0, 2e5], 'north': 0}, '', 'must be at most 100 km'),
    *((partial(call, PAPER), {'time_limit': limit}, 'time_limit', 'must be a number above 0 s')
      for call in (solve, upper_bound)
      for limit in (0, -1.0, math.nan, -math.inf, True, '10')),
    *((partial(solve, replace(PAPER, **change)), {'method': 'alternating'}, field, "use 'joint'")
      for field, change in (
        ('no_fly_zones', {'no_fly_zones': (NoFlyZone(((800, 0), (810, 0), (810, 10))),)}),
        ('separation', {'separation': 5.0}), ('', {
            'colluding': True, 'eavesdroppers': (STILL, Eavesdropper((9.0, 9.0), name='b'))}),
        ('uavs[0].max_acceleration', {'uavs': accelerate(3.0, 3.0)}),
        ('geofence', {'geofence': ((-900, -900), (900, -900), (0, 5000))}))),
    (partial(solve, make_crowd(32, 32, 1085)), {'method': 'alternating'}, '',
     "eavesdroppers, and this scenario has 1111040: use 'joint'"),
    (partial(solve, PAPER), {'initial': fly_hover_fly(make_crowd(3, 1, 4))}, 'initial',
     'is a plan for 3 UAVs; it must be one for 2'),
    (partial(upper_bound, Scenario.paper(105, slots=13)), {'plan': PLAN}, 'plan',
     'another scenario'),
    (upper_bound(PAPER, time_limit=0.01).gap, {'plan': fly_hover_fly(Scenario.paper(105))}, 'plan',
     'another scenario'),
    (partial(upper_bound, make_crowd(3, 1, 6)), {}, '', '2 jammers'),
    (partial(upper_bound, DRIVING), {}, '', 'tracks'),
    (partial(upper_bound, FARM.scenario), {}, '', 'holds for a single one'),
    (partial(solve, FARM.scenario), {'method': 'alternating'}, 'ground_nodes',
     'the mean rate of a single ground node, and this scenario has 2 ground_nodes'),
    *((partial(shortest_duration, PAPER), {'bits': bits}, 'bits', 'must be a number from')
      for bits in (0.0, -1.0, math.inf)),
    *((SETPOINT, {field: value}, field, 'must be from -1e+07 to 1e+07') for field, value in (
        ('position', (math.nan, 0.0, 0.0)), ('yaw', math.inf), ('velocity', (0.0, 0.0, 1e300)),
        ('acceleration', (0.0, -math.inf, 0.0)), ('yaw_rate', math.nan))),
]
PLANS = [
    *((PLAN, {'start_ns': start}, 'start_ns', '') for start in (-5, 2**63 - 1, 1.5, True)),
    (PLAN, {'positions': np.zeros((2, 103, 2))}, 'positions', ''),
    (PLAN, {'history': (5,)}, 'history[0]', 'must be'),
    (PLAN, {'history': (Iteration(0, 'start', -math.inf, 0.0, 0.0),)}, 'history', 'finite'),
    *((PLAN, {'gaps': gaps}, 'gaps', '') for gaps in (5, [[2, 1]], [[1, 3], [2, 4]])),
    *((PLAN, {'gaps': [gap]}, 'gaps[0]', '') for gap in (
        5, [1], [1, 2, 3], ['a', 1], [1, math.nan])),
    *((FARM, {'shares': shares}, 'shares', '')
      for shares in (np.ones((2, 10)), -FARM.shares, FARM.shares[:, 1:])),
    *((PLAN.with_bound, {'bound': bound}, 'bound', 'must be None or a Bound of') for bound in (
        3.0, Bound(Scenario.paper(105, slots=13), 3.0))),
    *((PLAN, {field: np.ma.masked_greater(getattr(PLAN, field), 0.5)}, field, 'some are masked')
      for field in ('positions', 'powers')),
    *((PLAN, {'powers': PLAN.powers.astype(kind)}, 'powers', 'truth values or complex')
      for kind in (bool, complex)),
    *((partial(change_plan, field), {'index': index, 'value': value}, '', text)
      for field, index, value, text in (
        ('positions', (0, 5, 0), -450.0, 'uav1 moves'),
        ('powers', (0, 3), -0.1, 'the power of uav1 is -0.1 W in slot 4'),
        ('powers', (1, 7), 5.0, 'the power of uav2 is 5 W in slot 8; at most 4 W'),
        ('powers', (1, 7), 4.00000001, 'is 4.00000001 W in slot 8; at most 4 W'),
        ('powers', (1, slice(0, 9)), 2.0, 'the average power of uav2'))),
    (PLAN, {'scenario': replace(PAPER, uavs=accelerate(0.6, 0.6))}, '',
     'uav1 accelerates by'),
    (partial(change_plan, 'positions'), {'index': (0, 0, 0), 'value': 101.0}, 'positions',
     'the start of uav1'),
    (partial(change_plan, 'positions'), {'index': (1, -1, 1), 'value': -499.0}, 'positions',
     'the goal of uav2'),
    (partial(change_plan, 'powers'), {'index': (0, 0), 'value': np.nan}, 'powers',
     'powers has the shape'),
]
NAMES = Spec(['a'], 'Names.', length=(1, 3))
PARAMETERS = [
    *((partial(spec.convert, 'given'), {'value': value}, 'given', text) for spec, value, text in (
        (Spec('a', 'A name.', length=(0, 5)), 'abcdef', 'a string of at most 5 characters'),
        (Spec(1.0, 'A rate.', (0.0, 9.0)), '1', 'a number from 0 to 9'),
        (NAMES, [], 'a list of 1 to 3 names of letters, digits and _, at most 100 each'),
        (NAMES, ['a' * 101], 'names'), (NAMES, ['a.b'], 'names'), (NAMES, ['a/b'], 'names'))),
]
CASES = [(code, *case) for code, cases in (
    ('invalid_scenario', MISSIONS), ('invalid_option', OPTIONS), ('invalid_plan', PLANS),
    ('invalid_parameter', PARAMETERS)) for case in cases]


@pytest.mark.parametrize('code, make, change, field, text', CASES, ids=range(len(CASES)))
def test_a_wrong_value_is_refused_with_its_field_code_and_what_is_allowed(
        code, make, change, field, text):
    with pytest.raises(PlanningError) as error:
        make(**change) if callable(make) else replace(make, **change)
    message = str(error.value)
    assert (error.value.code, error.value.field) == (code, field), message
    assert text in message and '\n' not in message and len(message) < 400, message
    assert isinstance(error.value, ValueError)


NUMBERS = [(whole, field) for whole in (
    PAPER, SCOUT, STILL, GroundNode((0, 0)), TOWER, Propulsion(), FADING, ZURICH, World())
           for field in fields(whole)
           if isinstance(field.metadata['check'], Number)]


@pytest.mark.parametrize('whole, field', NUMBERS, ids=lambda value: getattr(value, 'name', ''))
def test_each_number_is_refused_beyond_its_range_and_as_text(whole, field):
    allowed = field.metadata['check']
    above = math.nextafter(allowed.high, math.inf)
    for value in (math.nextafter(allowed.low, -math.inf), above, math.nan, math.inf, 10**400,
                  True, np.True_, 'much', '2', b'2', 2j, np.complex64(2), [2.0], np.array([2.0]),
                  np.timedelta64(2, 's')):
        with pytest.raises(PlanningError, match=rf'\b{field.name} is .*; it must be a .*number'
                           ) as error:
            replace(whole, **{field.name: value})
        assert error.value.field == field.name
