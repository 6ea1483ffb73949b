"""Every public function names an argument of a wrong type, its value and what is allowed."""

from importlib import import_module
import inspect
import math
from pathlib import Path
import re

import pytest
from secure_uav_planner import (
    assess, Assessment, Bound, Channel, fly_hover_fly, Iteration, NoFlyZone, Propulsion, Scenario,
    upper_bound, World)
from secure_uav_planner.errors import PlanFileError, PlanningError
from secure_uav_planner.plan.playback import Moment, Playback

API = (Path(__file__).parents[1] / 'docs' / 'api.rst').read_text()
HIDDEN = set(re.findall(r'\w+', ' '.join(re.findall('exclude-members: (.+)', API))))
ANSWERS = (Assessment, Bound, Iteration, Moment)  # Nobody makes them but the package.
WRONG = ('x', None, [], math.nan, {}, object())


def public():
    """Yield the names of all that the page of the API shows, and what they are."""
    for module in map(import_module, re.findall('automodule:: (.+)', API)):
        for name, one in vars(module).items():
            if getattr(one, '__module__', None) == module.__name__ and name[0] != '_':
                yield name, one
        yield from ((name, getattr(module, name)) for name in getattr(module, '__all__', ()))
    home = import_module(re.search('currentmodule:: (.+)', API)[1])
    yield from ((name, getattr(home, name)) for name in re.findall('autofunction:: (.+)', API))


def signatures():
    """Yield the name, the class or None, and the parameters of all that can be called."""
    for name, one in dict(public()).items():
        if inspect.isfunction(one) and name not in HIDDEN:
            yield name, None, inspect.signature(one).parameters
        elif inspect.isclass(one) and not issubclass(one, Exception):
            if one not in ANSWERS:
                yield name, None, inspect.signature(one).parameters
            yield from (
                (method, one, inspect.signature(getattr(one, method)).parameters)
                for method, code in vars(one).items()
                if method[0] != '_' and method not in HIDDEN and callable(getattr(one, method)))


CASES = [(name, owner, parameter) for name, owner, parameters in signatures()
         for parameter in parameters if parameter != 'self']


@pytest.fixture(scope='module')
def examples():
    """Return an instance of every class, and a right value of every parameter that needs one."""
    scenario = Scenario.paper(104.0, slots=8)
    plan = fly_hover_fly(scenario)
    uav, eavesdropper = scenario.uavs[0], scenario.eavesdroppers[0]
    zone = NoFlyZone(((900.0, 0.0), (910.0, 0.0), (900.0, 10.0)))
    playback = Playback(plan)
    instances = (scenario, plan, uav, eavesdropper, zone, playback, Propulsion(), Channel(),
                 World(), assess(plan, draws=2), upper_bound(scenario, time_limit=0.01))
    return {type(one): one for one in instances}, {
        **{name: value for one in (zone, eavesdropper, uav, scenario, plan)
           for name, value in vars(one).items()},
        'scenario': scenario, 'plan': plan, 'tail': plan.tail(2), 'point': 2, 'path': 'file.yaml',
        'bound': None, 'speeds': [1.0], 'data': None, 'share': 0.5, 'time': 1.0,
        'times': [1.0],
        'moment': playback.at(1.0), 'eavesdropper': (0.0, 0.0), 'carrier_hz': 1e9,
        'bandwidth_hz': 1e6, 'uav_positions': plan.positions[:, 1:-1]}


@pytest.mark.parametrize('name, owner, parameter', CASES, ids=lambda one: getattr(
    one, '__name__', one))
def test_a_wrong_type_is_refused_in_words(examples, name, owner, parameter, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    instances, right = examples
    call = dict(public())[name] if owner is None else getattr(instances[owner], name)
    needed = {one.name: right[one.name] for one in inspect.signature(call).parameters.values()
              if one.default is one.empty}
    if 'data' in needed:
        needed['data'] = getattr(instances[owner], 'to_dict', dict)()
    for value in WRONG:
        try:
            call(**{**needed, parameter: value})
        except (OSError, PlanFileError):
            assert parameter == 'path'
        except PlanningError as error:
            told = str(error)
            assert parameter in told or parameter == 'data' and owner.__name__ in told.title()
            assert re.search('must (be|have)|lacks', told), told
        else:
            assert type(value) is not object or parameter == 'evaluate'  # Whatever is true.
