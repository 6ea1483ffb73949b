import copy
from dataclasses import replace
from itertools import combinations
import math
import pickle

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import (
    Channel, Eavesdropper, errors, NoFlyZone, PlanningError, Scenario, Uav)
from secure_uav_planner.errors import ScenarioError
from secure_uav_planner.mission.validation import make_unique, round_down, round_up


@given(st.integers(1, 500), st.floats(1, 50))
def test_the_shortest_duration_of_the_error_is_feasible_and_a_shorter_one_is_not(slots, speed):
    uav = Uav('slow', (0.0, 0.0), (300.0, 400.0), 50.0, speed)
    scenario = Scenario((0, 0), (Eavesdropper((1, 1)),), (uav,), 1e6, slots)
    with pytest.raises(ValueError, match=r'slow needs at least') as error:
        replace(scenario, duration=500 / speed * 0.3)
    shortest = float(str(error.value).split('at least ')[1].split(' s')[0])
    assert shortest == pytest.approx(500 / speed * slots / (slots + 1), abs=1.001e-3)
    replace(scenario, duration=shortest)
    if shortest > 0.01:
        with pytest.raises(ValueError):
            replace(scenario, duration=shortest - 0.002)


@given(st.integers(0, 2**32 - 1))
def test_the_separation_that_a_refusal_names_is_accepted(seed):
    rng = np.random.default_rng(seed)
    size = 10**rng.uniform(-2, 6)
    uavs = tuple(Uav(f'uav{number}', start, goal, rng.uniform(50, 60), 1e5)
                 for number, (start, goal) in enumerate(
                     rng.uniform(0, size, (rng.integers(2, 5), 2, 2))))
    fields = {'uavs': uavs, 'tracking_margin': float(rng.choice([0.0, rng.uniform(0, size)]))}
    with pytest.raises(ScenarioError, match='separation is') as error:
        replace(Scenario.paper(), separation=1e6, **fields)
    most = float(str(error.value).split('at most ')[1].split(' m')[0])
    assert replace(Scenario.paper(), separation=most, **fields).separation == most
    assert most == 0 or most >= 0.9999 * min(
        math.hypot(math.dist(getattr(first, end), getattr(second, end)),
                   first.altitude - second.altitude)
        for end in ('start', 'goal') for first, second in combinations(uavs, 2)) - 2 * fields[
            'tracking_margin'] - 1e-4


def test_a_margin_that_leaves_nothing_of_the_fence_does_not_hide_other_errors():
    wide = ((-400.0, -800.0), (600.0, -800.0), (600.0, 800.0), (-400.0, 800.0))
    uav = Scenario.paper().uavs[0]
    with pytest.raises(ScenarioError) as error:
        replace(Scenario.paper(), geofence=wide, tracking_margin=600.0, uavs=(uav, uav))
    texts = [str(item) for item in (error.value, *error.value.further)]
    assert 'must be unique' in texts[0] and texts[1].startswith('tracking_margin is 600 m')
    assert len(texts) == 2


def test_numbers_of_numpy_are_taken_and_what_only_looks_like_numbers_is_named():
    scenario = replace(Scenario.paper(), colluding=np.bool_(True), duration=np.float32(200),
                       slots=np.int64(200), ground_node=np.zeros(2, np.float32),
                       reference_snr_db=np.array(80.0), separation=np.int8(2),
                       channel=Channel(cautious=np.bool_(False)))
    assert scenario.colluding is True and scenario.channel.cautious is False
    for value, named in (({3.0, 4.0}, '{3.0, 4.0}'), (b'ab', "b'ab'"), ({0: 1, 1: 2}, '{0: 1'),
                         ((True, 1.0), 'True'), (np.array([True, False]), '[True'),
                         ((1.0, np.ones(1)), '[1.0]'), (np.array(3.0), '3.0')):
        for make in (lambda value: Eavesdropper(value),
                     lambda value: Uav('uav', value, (0, 0), 100.0, 10.0),
                     lambda value: NoFlyZone((value, (9, 9), (0, 9)))):
            with pytest.raises(ScenarioError, match='two coordinates') as error:
                make(value)
            assert named in str(error.value), error.value
    with pytest.raises(ScenarioError, match='}; it must be a list of vertices'):
        NoFlyZone({(0, 0), (0, 9), (9, 9)})


def test_the_arrays_of_a_scenario_are_computed_once_and_read_only():
    scenario = Scenario.paper()
    for instance in (scenario, copy.deepcopy(scenario), pickle.loads(pickle.dumps(scenario))):
        for name in ('max_step', 'altitudes', 'max_speeds', 'average_powers', 'peak_powers',
                     'starts', 'goals', 'landmarks'):
            assert getattr(instance, name) is getattr(instance, name)
            with pytest.raises(ValueError):
                getattr(instance, name)[0] = 0.0


def test_equal_names_of_eavesdroppers_are_refused_and_default_names_numbered():
    def scenario(*names):
        return replace(Scenario.paper(), eavesdroppers=tuple(
            Eavesdropper((0, 0), **({} if name is None else {'name': name})) for name in names))
    assert scenario('north', 'south').eavesdropper_names == ('north', 'south')
    assert scenario(None, 'a', None).eavesdropper_names == ('eavesdropper1', 'a', 'eavesdropper3')
    with pytest.raises(ScenarioError) as caught:
        scenario('a', 'b', 'a')
    assert caught.value.field == 'eavesdroppers[2].name'


def test_a_mission_that_is_too_large_is_refused_with_the_most_slots():
    uav = Scenario.paper().uavs[0]
    crowd = tuple(replace(uav, name=f'uav{number}') for number in range(32))
    with pytest.raises(ScenarioError, match='with 32 uavs it must be at most 1085'):
        replace(Scenario.paper(200.0, slots=1), uavs=crowd, slots=20000)
    assert replace(Scenario.paper(200.0, slots=1085), uavs=crowd).slots == 1085
    assert Scenario.paper(200.0, slots=20000).slots == 20000


def test_each_error_has_a_code_of_its_own_and_is_a_value_or_runtime_error():
    classes = [kind for kind in vars(errors).values()
               if isinstance(kind, type) and issubclass(kind, PlanningError)]
    codes = [kind.code for kind in classes]
    assert len(set(codes)) == len(codes) > 10
    assert all(issubclass(kind, (ValueError, RuntimeError)) for kind in classes
               if kind is not PlanningError)


@given(st.floats(-1e300, 1e300, allow_subnormal=False), st.integers(1, 9))
def test_a_rounded_limit_is_on_its_side_of_the_limit_and_near(value, digits):
    down, up = round_down(value, digits), round_up(value, digits)
    assert down <= value <= up and up - down <= 1.001 * 10.0**(1 - digits) * abs(value)
    assert float(f'{down:.{digits - 1}e}') == down and float(f'{up:.{digits - 1}e}') == up
    assert round_up(math.inf) == round_down(math.inf) == math.inf


@given(st.lists(st.sampled_from(['', 'a', 'b', 'a1', 'a2', 'a12', '1']), max_size=7))
def test_names_made_unique_differ_and_keep_those_that_are_unique(names):
    unique = make_unique(names)
    assert len(set(unique)) == len(unique) == len(names)
    assert all(new.startswith(name) for new, name in zip(unique, names))
    assert all(new == name for new, name in zip(unique, names) if names.count(name) == 1)
