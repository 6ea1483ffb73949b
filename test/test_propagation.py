"""The fields of a channel: what is right survives files, what is wrong is refused."""

from dataclasses import replace
import json

import pytest
from secure_uav_planner import Channel, PlanningError, Scenario
from secure_uav_planner.ros.parameters import PLANNER
from secure_uav_planner.ros.settings import channel_from, mission_values

CHANNELS = (
    Channel(), Channel(2.6), Channel(los='urban', cautious=True), Channel(3.0, (5, 0.2, 12)),
    Channel(los='urban', outage=0.1), Channel(rician_k_db=6.0, outage=0.05),
    Channel(2.2, 'highrise', True, -3.0, 1e-3))


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
    values = mission_values(replace(Scenario.paper(), channel=channel, colluding=True))
    checked = {name: spec.convert(name, values[name])
               for name, spec in PLANNER.items() if name.startswith(('channel.', 'colluding'))}
    assert channel_from(checked) == channel and checked['colluding']
    with pytest.raises(PlanningError, match='channel.los_numbers is .*; it must be empty'):
        channel_from({**checked, 'channel.los': 'urban', 'channel.los_numbers': [1.0, 1.0, 1.0]})


def test_free_space_writes_the_file_of_before():
    assert not {'channel', 'colluding'} & set(Scenario.paper().to_dict())
