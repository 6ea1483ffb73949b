"""The fields of a channel: what is right survives files, what is wrong is refused."""

from dataclasses import replace
import json
import math

import pytest
from secure_uav_planner import Channel, PlanningError, Scenario
from secure_uav_planner.errors import MissionFileError
from secure_uav_planner.mission.propagation import ENVIRONMENTS
from secure_uav_planner.ros.mission_parameters import channel_from, values_of
from secure_uav_planner.ros.parameters import PLANNER

CHANNELS = (
    Channel(), Channel(2.6), Channel(los='urban', cautious=True), Channel(3.0, (5, 0.2, 12)),
    Channel(rician_k_db=6.0, outage=0.05), Channel(2.2, 'highrise', True, -3.0, 1e-3))


@pytest.mark.parametrize('channel', CHANNELS, ids=range(len(CHANNELS)))
@pytest.mark.parametrize('name', ['a.yaml', 'a.json'])
def test_a_channel_survives_its_file(tmp_path, channel, name):
    scenario = replace(Scenario.paper(), channel=channel, colluding=True)
    scenario.save(tmp_path / name)
    found = Scenario.load(tmp_path / name)
    assert found == scenario and hash(found) == hash(scenario)
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario


@pytest.mark.parametrize('channel', CHANNELS, ids=range(len(CHANNELS)))
def test_the_parameters_of_the_nodes_stand_for_every_channel(channel):
    values = values_of(replace(Scenario.paper(), channel=channel, colluding=True))
    checked = {name: spec.checked(name, values[name])
               for name, spec in PLANNER.items() if name.startswith(('channel.', 'colluding'))}
    assert channel_from(checked) == channel and checked['colluding']
    with pytest.raises(PlanningError, match='channel.los_numbers is .*; it must be empty'):
        channel_from({**checked, 'channel.los': 'urban', 'channel.los_numbers': [1.0, 1.0, 1.0]})


def test_free_space_writes_the_file_of_before():
    assert not {'channel', 'colluding'} & set(Scenario.paper().to_dict())


@pytest.mark.parametrize('field, value', [
    ('exponent', 1.99), ('exponent', math.nan), ('exponent', True), ('los', 'city'),
    ('los', (1, 2)), ('los', (9.61, 0.16, -1)), ('cautious', 1), ('rician_k_db', 41),
    ('rician_k_db', None), ('outage', 0.6), ('outage', 1e-9), ('outage', None)])
def test_a_wrong_value_is_refused_with_its_field_and_what_is_allowed(field, value):
    given = {'rician_k_db': 0.0, 'outage': 0.1, field: value}
    with pytest.raises(PlanningError, match=rf'channel\.{field} is .*it must be') as error:
        Channel(**given)
    assert error.value.field == field
    data = {**json.loads(json.dumps(Scenario.paper().to_dict())), 'channel': given}
    with pytest.raises(PlanningError) as error:
        Scenario.from_dict(data)
    assert error.value.field == f'channel.{field}'


@pytest.mark.parametrize('field, value', [
    ('channel', {}), ('channel', 'urban'), ('channel', None), ('colluding', 1)])
def test_a_scenario_refuses_what_is_no_channel(field, value):
    with pytest.raises(PlanningError, match=f'{field} is ') as error:
        replace(Scenario.paper(), **{field: value})
    assert error.value.field == field


def test_all_that_is_wrong_with_the_channel_of_a_file_is_told_with_its_lines(tmp_path):
    file = tmp_path / 'a.yaml'
    Scenario.paper().save(file)
    first = len(file.read_text().splitlines()) + 1
    file.write_text(file.read_text() + 'channel:\n  exponent: 7\n  loss: urban\n  los: town\n'
                    '  outage: 0.1\ncolluding: maybe\n')
    with pytest.raises(MissionFileError) as error:
        Scenario.load(file)
    found = {problem.line - first: problem.text for problem in error.value.problems}
    assert any('rician_k_db is null' in text for text in found.values())
    assert 'channel.exponent is 7' in found[1] and "no field 'loss'" in found[2]
    assert all(name in found[3] for name in ENVIRONMENTS) and 'colluding is' in found[5]
