from dataclasses import replace
import json
import math

from hypothesis import given
from hypothesis import strategies as st
import pytest
from secure_uav_planner import Eavesdropper, Scenario, Uav
from strategies import scenarios


def test_paper_scenario_is_section_iv():
    scenario = Scenario.paper(duration=104.0, error_radius=5.0)
    assert scenario.slots == 104
    assert scenario.slot_duration == 1.0
    assert scenario.max_step.tolist() == [10.0, 10.0]
    assert scenario.reference_snr == pytest.approx(1e8)
    assert scenario.eavesdroppers == (Eavesdropper((200.0, 0.0), 5.0),)
    assert [uav.altitude for uav in scenario.uavs] == [100.0, 110.0]


@pytest.mark.parametrize('field', ['altitude', 'max_speed', 'average_power', 'peak_power'])
@pytest.mark.parametrize('value', [0.0, -1.0, math.nan, math.inf, 'high', None, True])
def test_a_wrong_number_of_a_uav_names_uav_field_and_value(field, value):
    good = Uav('scout', (0, 0), (1, 1), 100.0, 10.0)
    with pytest.raises(ValueError) as error:
        replace(good, **{field: value})
    assert f'scout.{field} is {value!r}; it must be' in str(error.value)


@pytest.mark.parametrize('value', [(1.0,), (1.0, 2.0, 3.0), (math.nan, 0.0), 'xy', 7, (1e9, 0)])
def test_a_wrong_place_names_field_and_value(value):
    for make, field in ((lambda: Eavesdropper(value), 'eavesdropper position'),
                        (lambda: Uav('a', value, (0, 0), 1, 1), 'a.start'),
                        (lambda: replace(Scenario.paper(), ground_node=value), 'ground_node')):
        with pytest.raises(ValueError) as error:
            make()
        assert f'{field} is {value!r}; it must be two coordinates' in str(error.value)


@pytest.mark.parametrize('field, value', [
    ('slots', 0), ('slots', 2.5), ('slots', 10**9), ('slots', True), ('duration', 0.0),
    ('duration', math.inf), ('reference_snr_db', math.nan), ('eavesdroppers', ()),
    ('eavesdroppers', 'eve'), ('uavs', ()), ('uavs', [1])])
def test_a_wrong_field_of_a_scenario_is_named(field, value):
    with pytest.raises(ValueError, match=field):
        replace(Scenario.paper(), **{field: value})


def test_peak_power_below_average_power_is_refused():
    with pytest.raises(ValueError, match=r'a\.peak_power is 1\.0; it must be at least'):
        Uav('a', (0, 0), (0, 0), 100, 10, average_power=2.0, peak_power=1.0)


def test_names_of_uavs_are_unique():
    uav = Scenario.paper().uavs[0]
    with pytest.raises(ValueError, match='unique'):
        replace(Scenario.paper(), uavs=(uav, uav))


@given(st.integers(1, 500), st.floats(1, 50))
def test_the_shortest_duration_named_can_be_flown_and_a_shorter_one_cannot(slots, speed):
    uav = Uav('slow', (0.0, 0.0), (300.0, 400.0), 50.0, speed)
    scenario = Scenario((0, 0), (Eavesdropper((1, 1)),), (uav,), 1e6, slots)
    with pytest.raises(ValueError, match=r'slow needs at least') as error:
        replace(scenario, duration=500 / speed * 0.3)
    shortest = float(str(error.value).split('at least ')[1].split(' s')[0])
    assert shortest == pytest.approx(500 / speed * slots / (slots + 1), abs=1e-3)
    replace(scenario, duration=shortest)
    if shortest > 0.01:
        with pytest.raises(ValueError):
            replace(scenario, duration=shortest - 0.002)


@given(scenarios())
def test_a_scenario_survives_its_dictionary_as_json(scenario):
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario


@pytest.mark.parametrize('damage', [
    lambda data: data.pop('slots'), lambda data: data.update(extra=1),
    lambda data: data.update(uavs=5), lambda data: data.update(uavs=[[]]),
    lambda data: data['uavs'][0].pop('goal')])
def test_a_damaged_dictionary_is_refused(damage):
    data = json.loads(json.dumps(Scenario.paper().to_dict()))
    damage(data)
    with pytest.raises(ValueError):
        Scenario.from_dict(data)
