"""The parameter files say what the code says."""

from pathlib import Path

from hypothesis import example, given
import pytest
from ros_client import flat
from secure_uav_planner.errors import ParameterError
from secure_uav_planner.ros.parameters import PLANNER, read_specs, REPLAY
from secure_uav_planner.ros.settings import channel_from, mission_values, uav_from
from strategies import missions
from test_mission_file import RICH
import yaml

CONFIG = Path(__file__).resolve().parents[1] / 'config'


@pytest.mark.parametrize('node', ['planner', 'replay'])
def test_the_papers_parameters_are_the_defaults(node):
    written = yaml.safe_load((CONFIG / 'paper.yaml').read_text())
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


@given(missions())
@example(RICH)
def test_the_parameters_of_the_nodes_stand_for_every_channel_and_uav(scenario):
    values = {name: spec.default for name, spec in PLANNER.items()} | mission_values(scenario)
    assert tuple(uav_from(values, name) for name in values['uavs']) == scenario.uavs
    checked = {name: PLANNER[name].convert(name, value) for name, value in values.items()
               if name.startswith('channel.')}
    assert channel_from(checked) == scenario.channel
    with pytest.raises(ParameterError, match='channel.los_numbers is .*; it must be empty'):
        channel_from({**checked, 'channel.los': 'urban', 'channel.los_numbers': [1.0, 1.0, 1.0]})
