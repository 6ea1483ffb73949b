"""What a campaign file asks for, and the tasks that it stands for."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
import copy
from dataclasses import asdict, dataclass
import difflib
from itertools import product
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from .tasks import Task, task_of
from ..assessment.monte_carlo import arguments
from ..errors import OptionError, quote, ScenarioError, yaml_notation
from ..mission import METHODS, OBJECTIVES
from ..mission.formats.documents import make_file_error, Problem, read_document
from ..mission.propagation import Channel
from ..mission.scenario import Scenario
from ..optimize.methods import check_objective

BASELINES = ('fly_hover_fly_constant', 'fly_hover_fly_optimised')
"""What `methods` may name beside the methods of solve."""

LAWS = {'uniform': 'the first at most the second', 'normal': 'the second at least 0'}
"""How a field can be drawn at random, and what its two numbers must be."""

MOST_TASKS = 10**6
"""The most missions of a campaign, which has a row for each in memory, and values of a field."""

_LEFT_OUT = {'channel': asdict(Channel()), 'colluding': False}
"""What Scenario.to_dict leaves out, and so do the missions of a campaign that does not vary it."""

_DEFAULTS: dict[str, Any] = {
    'mission': None, 'vary': {}, 'samples': 1, 'seed': 0, 'methods': [METHODS[0]],
    'objectives': None, 'time_limit': None, 'bound_time_limit': None, 'plans': False,
    'assess': None}


@dataclass(frozen=True)
class Campaign:
    """A base mission, the fields that change, and how each mission is planned."""

    mission: dict[str, Any]  # The base, as plain values.
    grid: dict[str, list[Any]]  # The values of each field that has several.
    laws: dict[str, tuple[str, Any, Any]]  # For each random field, its law and two numbers.
    samples: int  # How often the random fields are drawn.
    seed: int  # Of the draws; sample k has the same draws at every place of the grid.
    schemes: list[tuple[str, str]]  # Pairs of a method and an objective.
    settings: dict[str, Any]  # As for task_of.

    @property
    def size(self) -> int:
        """How many missions it has."""
        places = math.prod(len(values) for values in self.grid.values())
        return places * self.samples * len(self.schemes)

    def tasks(self) -> Iterator[Task]:
        """Yield a task for every mission and scheme."""
        for values in product(*self.grid.values()):
            chosen = dict(zip(self.grid, values))
            for sample in range(self.samples):
                fields = {**chosen, **self._drawn(sample)}
                mission = copy.deepcopy(self.mission)
                for name, value in fields.items():
                    for owner, field in _targets(mission, name):
                        owner[field] = value
                for method, objective in self.schemes:
                    yield task_of(mission, method, objective, self.settings, fields, sample)

    def _drawn(self, sample: int) -> dict[str, Any]:
        rng = np.random.default_rng([self.seed, sample])
        return {name: np.asarray(getattr(rng, law)(first, second)).tolist()
                for name, (law, first, second) in self.laws.items()}


def load_campaign(path: str | os.PathLike[str]) -> Campaign:
    """
    Return the campaign of a file: YAML, or JSON if its name ends with .json.

    :raises OSError: when it or its mission cannot be read.
    :raises MissionFileError: with all that is wrong, each with its line.
    """
    document = read_document(path)
    problems = [*document.problems]

    @contextmanager
    def noting(*place: Any) -> Iterator[None]:
        try:
            yield
        except OptionError as error:
            problems.append(Problem(document.line((*place, *error.place)), str(error)))

    campaign = None
    with yaml_notation(), noting():
        campaign = _campaign(document.data, Path(path).parent, noting)
    if campaign is None or problems:
        raise make_file_error(path, problems)
    return campaign


def _campaign(data: Any, folder: Path, noting: Callable[..., AbstractContextManager[None]]
              ) -> Campaign | None:
    """
    Return the Campaign that the data of a file in a folder mean, or None.

    :param noting: returns a context that notes an OptionError in a place of the data.
    """
    if not isinstance(data, dict):
        raise OptionError('it must be a mapping with a mission and the fields to vary')
    if 'uavs' in data:
        raise OptionError('it is a mission; a campaign names one by its field mission')
    for name in [name for name in data if name not in _DEFAULTS]:
        with noting(name):
            near = difflib.get_close_matches(str(name), _DEFAULTS, 1)
            hint = f'did you mean {near[0]}?' if near else f'it has {", ".join(_DEFAULTS)}'
            raise OptionError(f'a campaign has no field {quote(name)}; {hint}')
    values = {**_DEFAULTS, **data}
    wrong = {name: allowed for name, is_right, allowed in _checks(values) if not is_right}
    for name, allowed in wrong.items():
        with noting(name):
            raise OptionError(f'{name} is {quote(values[name])}; it must be {allowed}')
    mission, grid, laws = None, {}, {}
    with noting('mission'):
        mission = _mission(values['mission'], folder)
    for name, value in () if 'vary' in wrong else values['vary'].items():
        with noting('vary', name):
            found = _varied(mission, name, value)
            if isinstance(found, tuple):
                laws[name] = found
            else:
                grid[name] = found
    if values['assess'] is not None:
        with noting('assess'):
            try:
                arguments(values['assess'])
            except OptionError as error:
                raise OptionError(f'assess: {error}', error.place) from None
    if mission is None or wrong:
        return None
    # Without plans and assess, rows are those of a campaign that has no such fields.
    settings = {name: values[name] for name in (
        'time_limit', 'bound_time_limit',
        *(one for one in ('plans', 'assess') if values[one] not in (None, False)))}
    campaign = Campaign(mission, grid, laws, values['samples'], values['seed'],
                        _schemes(values['methods'], values['objectives']), settings)
    if not 1 <= campaign.size <= MOST_TASKS:
        raise OptionError(f'it has {quote(campaign.size)} missions; it must have 1 to '
                          f'{MOST_TASKS}')
    return campaign


def _checks(values: dict[str, Any]) -> Iterator[tuple[str, bool, str]]:
    """Yield fields, whether their values are right, and what they must be."""
    yield 'vary', isinstance(values['vary'], dict), 'a mapping of fields'
    for name, least in (('samples', 1), ('seed', 0)):
        value = values[name]
        yield (name, isinstance(value, int) and not isinstance(value, bool) and value >= least,
               f'a whole number, at least {least}')
    for name in ('time_limit', 'bound_time_limit'):
        value = values[name]
        yield (name, value is None or isinstance(value, (int, float)) and not isinstance(
            value, bool) and value > 0, 'above 0 s, or null')
    yield 'plans', isinstance(values['plans'], bool), 'true or false'
    for name, known in (('methods', (*METHODS, *BASELINES)), ('objectives', OBJECTIVES)):
        given = values[name]
        yield (name, name == 'objectives' and given is None or isinstance(given, list)
               and bool(given) and all(one in known for one in given),
               f'a list of {", ".join(known)}')


def _mission(given: Any, folder: Path) -> dict[str, Any]:
    """Return the base mission, which is in the campaign itself or in a file beside it."""
    try:
        if isinstance(given, str):
            scenario = Scenario.load(folder / given)
        elif isinstance(given, dict):
            scenario = Scenario.from_dict(given)
        else:
            raise OptionError(f'mission is {quote(given)}; it must be the name of a mission file, '
                              'or the fields of a mission')
    except OSError as error:
        raise OptionError(f'the mission {folder / given} cannot be read: '
                          f'{error.strerror or error}') from None
    except ScenarioError as error:
        raise OptionError(f'the mission cannot be used: {error}') from None
    # As JSON has it: with lists, whose members can be replaced.
    plain: dict[str, Any] = json.loads(json.dumps(scenario.to_dict()))
    return plain


def _varied(mission: dict[str, Any] | None, name: str, value: Any) -> Any:
    """Return the values of a field, or a tuple of the law and the two numbers of it."""
    if mission is not None:
        try:
            if (field := name.partition('.')[0]) in _LEFT_OUT:
                mission.setdefault(field, copy.deepcopy(_LEFT_OUT[field]))
            _targets(mission, name)
        except LookupError:
            raise OptionError(
                f'the mission has no field {quote(name)}; name it as duration, uavs.0.max_speed '
                'or eavesdroppers.*.error_radius') from None
    allowed = ('it must be a list of values, {from, to, count}, {uniform: [low, high]} or '
               '{normal: [mean, deviation]}')
    if isinstance(value, list) and value:
        if _is_json(value):
            return value
        allowed = 'its numbers must be finite, and null stands for no limit'
    elif isinstance(value, dict) and set(value) == {'from', 'to', 'count'}:
        allowed = f'from and to must be numbers, count a whole number from 1 to {MOST_TASKS}'
        with suppress(TypeError, ValueError), np.errstate(all='ignore'):
            if 1 <= value['count'] <= MOST_TASKS:
                found = np.linspace(value['from'], value['to'], value['count']).tolist()
                if _is_json(found):
                    return found
    elif isinstance(value, dict) and len(value) == 1 and set(value) <= set(LAWS):
        [(law, numbers)] = value.items()
        allowed = (f'{law} must have two numbers, or two places; they must be finite, and '
                   f'{LAWS[law]}')
        with suppress(TypeError, ValueError, OverflowError):
            first, second = numbers
            if np.isfinite(getattr(np.random.default_rng(0), law)(first, second)).all():
                return law, first, second
    raise OptionError(f'{name} is {quote(value)}; {allowed}')


def _schemes(methods: list[str], objectives: list[str] | None) -> list[tuple[str, str]]:
    """Return the pairs of a method and an objective that exist."""
    if objectives is None:
        return [(method, OBJECTIVES[0] if method in BASELINES else check_objective(method))
                for method in methods]
    pairs = [(method, objective) for method in methods for objective in objectives
             if method == METHODS[0] or objective == OBJECTIVES[0]]
    if not pairs:
        raise OptionError(
            f'only the method {METHODS[0]} has the objective {OBJECTIVES[1]}', ('methods',))
    return pairs


def _targets(mission: Any, name: str) -> list[tuple[Any, Any]]:
    """
    Return the owners and names of the fields that a dotted name means; `*` means all of a list.

    :raises LookupError: when there is no such field.
    """
    found: list[tuple[Any, Any]] = [([mission], 0)]
    for part in name.split('.'):
        owners = [owner[key] for owner, key in found]
        found = [(owner, key) for owner in owners for key in _keys(owner, part)]
    if not found:
        raise LookupError(name)
    return found


def _keys(owner: Any, part: str) -> list[Any]:
    """Return what a part of a dotted name means in a list or a mapping."""
    if isinstance(owner, list):
        keys = list(range(len(owner))) if part == '*' else [int(part)] if part.isdecimal() else []
        return [key for key in keys if key < len(owner)]
    return [part] if isinstance(owner, dict) and part in owner else []


def _is_json(values: list[Any]) -> bool:
    """Return whether values can be part of a row of results, as all finite numbers can."""
    try:
        json.dumps(values, allow_nan=False)
    except ValueError:
        return False
    return True
