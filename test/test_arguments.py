"""Each public function names an argument of a wrong type, its value and what is allowed."""

from dataclasses import replace
from importlib import import_module
import inspect
import math
from pathlib import Path
import re

import pytest
from secure_uav_planner import (
    assess, Assessment, Bound, Channel, compare, Comparison, FlownFlight, fly_hover_fly, Iteration,
    NoFlyZone, Origin, Propulsion, read_flight, Scenario, upper_bound, World)
from secure_uav_planner.errors import PlanFileError, PlanningError
from secure_uav_planner.mission.fields import REQUIRED
from secure_uav_planner.plan.playback import Moment, Playback
from secure_uav_planner.plan.splice import cut_tail
from studies.flown.logs import fly, write_csv

API = (Path(__file__).parents[1] / 'docs' / 'api.rst').read_text()
HIDDEN = set(re.findall(r'\w+', ' '.join(re.findall('exclude-members: (.+)', API))))
# Made by the package only.
ANSWERS = (Assessment, Bound, Comparison, FlownFlight, Iteration, Moment)
WRONG = ('x', None, [], math.nan, {}, object())


def list_public():
    """Yield name and value of all objects on the page of the API."""
    module = None
    for kind, name in re.findall(r'\.\. (\w+module|autoclass|autofunction):: (.+)', API):
        if kind.endswith('module'):
            module = import_module(name)
        if kind == 'automodule':
            yield from ((member, value) for member, value in vars(module).items()
                        if getattr(value, '__module__', None) == name and member[0] != '_')
        elif kind != 'currentmodule':
            yield name, getattr(module, name)


def list_signatures():
    """Yield name, class or None, and parameters of all public functions and methods."""
    for name, value in dict(list_public()).items():
        if inspect.isfunction(value) and name not in HIDDEN:
            yield name, None, inspect.signature(value).parameters
        elif inspect.isclass(value) and not issubclass(value, Exception):
            if value not in ANSWERS:
                yield name, None, inspect.signature(value).parameters
            yield from (
                (method, value, inspect.signature(getattr(value, method)).parameters)
                for method in dir(value)
                if method[0] != '_' and method not in HIDDEN and callable(getattr(value, method)))


CASES = [(name, owner, parameter) for name, owner, parameters in list_signatures()
         for parameter in parameters if parameter != 'self']


@pytest.fixture(scope='module')
def examples(tmp_path_factory):
    """Return an instance of each class, and a right value of each required parameter."""
    origin = Origin(47.0, 8.0)
    scenario = replace(Scenario.paper(104.0, slots=8), origin=origin)
    plan = fly_hover_fly(scenario)
    uav, eavesdropper = scenario.uavs[0], scenario.eavesdroppers[0]
    zone = NoFlyZone(((900.0, 0.0), (910.0, 0.0), (900.0, 10.0)))
    playback = Playback(plan)
    log = tmp_path_factory.mktemp('logs') / 'flight.csv'
    write_csv(fly(plan), log)
    flight = read_flight(log, plan)
    instances = (scenario, plan, uav, eavesdropper, zone, playback, Propulsion(), Channel(),
                 World(), origin, assess(plan, draws=2), upper_bound(scenario, time_limit=0.01),
                 flight, compare(plan, flight))
    return {type(instance): instance for instance in instances}, {
        **{name: value for instance in (origin, zone, eavesdropper, uav, scenario, plan)
           for name, value in vars(instance).items()},
        'scenario': scenario, 'plan': plan, 'tail': cut_tail(plan, 2), 'point': 2,
        'path': 'file.yaml',
        'campaign': {'mission': scenario, 'methods': ['fly_hover_fly_constant']},
        'source': scenario, 'log': log, 'flight': flight,
        'bound': None, 'bits': 10.0, 'speeds': [1.0], 'data': None,
        'share': 0.5, 'time': 1.0, 'times': [1.0],
        'moment': playback.at(1.0), 'eavesdropper': (0.0, 0.0), 'carrier_hz': 1e9,
        'bandwidth_hz': 1e6, 'east': 0.0, 'north': 0.0, 'uav_positions': plan.positions[:, 1:-1]}


@pytest.mark.parametrize('name, owner, parameter', CASES,
                         ids=lambda value: getattr(value, '__name__', value))
def test_a_wrong_type_is_refused_by_name(examples, name, owner, parameter, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    instances, right = examples
    call = dict(list_public())[name] if owner is None else getattr(instances[owner], name)
    required = {name: right[name] for name, value in inspect.signature(call).parameters.items()
                if value.default in (value.empty, REQUIRED)
                or name in ('position', 'ground_nodes')}
    if name == 'read_flight':
        required['source'] = right['log']
    if 'data' in required:
        required['data'] = getattr(instances[owner], 'to_dict', dict)()
    for value in WRONG:
        try:
            call(**{**required, parameter: value})
        except (OSError, PlanFileError):
            assert parameter in ('path', 'campaign')
        except PlanningError as error:
            text = str(error).lower()
            assert parameter in text or parameter == 'data' and owner.__name__.lower() in text
            assert re.search('must (be|have)|lacks', text), text
            assert parameter in error.field or not error.field, (error.field, text)
        else:
            assert type(value) is not object or parameter in (
                'evaluate', 'title')  # They take any truth.
