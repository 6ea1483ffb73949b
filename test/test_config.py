"""The parameter files say what the code says."""


from processes import ROOT
import pytest
from ros_client import flat
from secure_uav_planner.ros.parameters import PLANNER, read_specs, REPLAY
import yaml

CONFIG = ROOT / 'config'


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
