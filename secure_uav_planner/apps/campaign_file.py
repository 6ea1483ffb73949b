"""Campaign files: the mission, the fields that vary, and the tasks of all combinations."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
import copy
from dataclasses import asdict, dataclass
import difflib
from itertools import chain, product
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from .tasks import load_scheme, make_task, Task
from ..assessment.monte_carlo import arguments
from ..errors import OptionError, quote, ScenarioError, yaml_notation
from ..mission import METHODS, OBJECTIVES
from ..mission.formats.documents import Document, FileProblem, make_file_error, read_document
from ..mission.propagation import Channel
from ..mission.scenario import Scenario
from ..optimize.methods import check_objective

BASELINES = ('fly_hover_fly_constant', 'fly_hover_fly_optimised')
"""The names in `methods` beside the methods of solve and schemes `module:function`."""

LAWS = {'uniform': 'the first at most the second', 'normal': 'the second at least 0'}
"""Random laws of a field, with the condition on their two numbers."""

MOST_TASKS = 10**6
"""The most missions of a campaign, whose rows are in memory, and the most values of a field."""

_LEFT_OUT = {'channel': asdict(Channel()), 'colluding': False}
"""Defaults that Scenario.to_dict leaves out, and so do missions of campaigns that do not vary
them."""

_DEFAULTS: dict[str, Any] = {
    'mission': None, 'vary': {}, 'samples': 1, 'seed': 0, 'methods': [METHODS[0]],
    'objectives': None, 'time_limit': None, 'bound_time_limit': None, 'plans': False,
    'assess': None}


@dataclass(frozen=True)
class Campaign:
    """A base mission, the fields that vary, and how each mission is planned."""

    mission: dict[str, Any]  # The base mission as plain values.
    grid: dict[str, list[Any]]  # The values of each field of the grid.
    laws: dict[str, tuple[str, Any, Any]]  # Of each random field, its law and two numbers.
    samples: int  # Draws of the random fields.
    seed: int  # Of the draws; sample k has the same draws at all places of the grid.
    schemes: list[tuple[str, str]]  # Pairs of a method and an objective.
    settings: dict[str, Any]  # As for make_task.

    @property
    def size(self) -> int:
        """Return the number of missions."""
        places = math.prod(len(values) for values in self.grid.values())
        return places * self.samples * len(self.schemes)

    def tasks(self) -> Iterator[Task]:
        """Yield a task for each mission and scheme."""
        for values in product(*self.grid.values()):
            for sample in range(self.samples):
                fields = {**dict(zip(self.grid, values)), **self._draw_fields(sample)}
                mission = copy.deepcopy(self.mission)
                for name, value in fields.items():
                    for owner, key in _resolve_field(mission, name):
                        owner[key] = value
                _leave_out_decided(mission, fields)
                for method, objective in self.schemes:
                    yield make_task(mission, method, objective, self.settings, fields, sample)

    def _draw_fields(self, sample: int) -> dict[str, Any]:
        rng = np.random.default_rng([self.seed, sample])
        return {name: np.asarray(getattr(rng, law)(first, second)).tolist()
                for name, (law, first, second) in self.laws.items()}


def load_campaign(source: Mapping[str, Any] | str | os.PathLike[str]) -> Campaign:
    """
    Return the campaign of a file, YAML, or JSON if its name ends with .json, or of its fields.

    :raises OSError: when the file or its mission cannot be read.
    :raises MissionFileError: with all problems, each with its line in the file.
    """
    if isinstance(source, Mapping):
        path, document = 'campaign', Document(_make_plain(source), {})
    else:
        path, document = os.fspath(source), read_document(source)
    problems = [*document.problems]

    @contextmanager
    def collecting(*place: Any) -> Iterator[None]:
        try:
            yield
        except OptionError as error:
            problems.append(FileProblem(document.line((*place, *error.place)), str(error)))

    campaign = None
    with yaml_notation(), collecting():
        campaign = _parse_campaign(document.data, Path(path).parent, collecting)
    if campaign is None or problems:
        raise make_file_error(path, problems)
    return campaign


def _make_plain(fields: Mapping[str, Any]) -> Any:
    """Return the fields of a campaign in Python as those of a file: lists, numbers and text."""
    def convert(value: Any) -> Any:
        if isinstance(value, Scenario):
            return value.to_dict()
        if isinstance(value, (np.ndarray, np.generic)):
            return value.tolist()
        raise OptionError(f'campaign has the value {quote(value)}; its values must be numbers, '
                          'text, lists and mappings, and its mission may be a Scenario')
    return json.loads(json.dumps(dict(fields), default=convert))


def _parse_campaign(data: Any, folder: Path,
                    collecting: Callable[..., AbstractContextManager[None]]) -> Campaign | None:
    """
    Return the Campaign of the data of a file in a folder, or None.

    :param collecting: returns a context that collects an OptionError for a place of the data.
    """
    if not isinstance(data, dict):
        raise OptionError('it must be a mapping with a mission and the fields to vary')
    if 'uavs' in data:
        raise OptionError('it is a mission; a campaign names one by its field mission')
    for name in [name for name in data if name not in _DEFAULTS]:
        with collecting(name):
            near = difflib.get_close_matches(str(name), _DEFAULTS, 1)
            hint = f'did you mean {near[0]}?' if near else f'it has {", ".join(_DEFAULTS)}'
            raise OptionError(f'a campaign has no field {quote(name)}; {hint}')
    values = {**_DEFAULTS, **data}
    wrong = {name: allowed for name, is_valid, allowed in _check_fields(values) if not is_valid}
    for name, allowed in wrong.items():
        with collecting(name):
            raise OptionError(f'{name} is {quote(values[name])}; it must be {allowed}')
    mission, grid, laws = None, {}, {}
    with collecting('mission'):
        mission = _load_mission(values['mission'], folder)
    for name, value in () if 'vary' in wrong else values['vary'].items():
        with collecting('vary', name):
            if mission is not None:
                _check_tracks(mission, name, values['vary'])
            variation = _parse_variation(mission, name, value)
            if isinstance(variation, tuple):
                laws[name] = variation
            else:
                grid[name] = variation
    if values['assess'] is not None:
        with collecting('assess'):
            try:
                arguments(values['assess'])
            except OptionError as error:
                raise OptionError(f'assess: {error}', error.place) from None
    schemes: list[tuple[str, str]] = []
    if not {'methods', 'objectives'} & wrong.keys():
        with collecting('methods'):
            schemes = _list_schemes(values['methods'], values['objectives'])
    if mission is None or wrong or not schemes:
        return None
    # Without plans and assess, tasks have the keys of a campaign that has no such fields.
    settings = {name: values[name] for name in (
        'time_limit', 'bound_time_limit',
        *(name for name in ('plans', 'assess') if values[name] not in (None, False)))}
    campaign = Campaign(mission, grid, laws, values['samples'], values['seed'],
                        schemes, settings)
    if not 1 <= campaign.size <= MOST_TASKS:
        raise OptionError(f'it has {quote(campaign.size)} missions; it must have 1 to '
                          f'{MOST_TASKS}')
    return campaign


def _check_fields(values: dict[str, Any]) -> Iterator[tuple[str, bool, str]]:
    """Yield the name of each field, whether its value is valid, and the allowed values."""
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
    methods, objectives = values['methods'], values['objectives']
    yield ('methods', isinstance(methods, list) and bool(methods) and all(
        isinstance(name, str) and (name in (*METHODS, *BASELINES) or ':' in name)
        for name in methods), f'a list of {", ".join((*METHODS, *BASELINES))} and functions of '
           'your own, module:function')
    yield ('objectives', objectives is None or isinstance(objectives, list) and bool(
        objectives) and all(name in OBJECTIVES for name in objectives),
           f'a list of {", ".join(OBJECTIVES)}')


def _load_mission(source: Any, folder: Path) -> dict[str, Any]:
    """Return the base mission, which is in the campaign itself or in a file beside it."""
    try:
        if isinstance(source, str):
            scenario = Scenario.load(folder / source)
        elif isinstance(source, dict):
            scenario = Scenario.from_dict(source)
        else:
            raise OptionError(f'mission is {quote(source)}; it must be the name of a mission '
                              'file, or the fields of a mission')
    except OSError as error:
        raise OptionError(f'the mission {folder / source} cannot be read: '
                          f'{error.strerror or error}') from None
    except ScenarioError as error:
        raise OptionError(f'the mission cannot be used: {error}') from None
    # By JSON tuples become lists, whose members can be replaced.
    plain: dict[str, Any] = json.loads(json.dumps(scenario.to_dict()))
    return plain


def _check_tracks(mission: dict[str, Any], name: str, names: Iterable[str]) -> None:
    """Raise an OptionError for a field that the track of a receiver decides; there are names."""
    owner, *rest = str(name).split('.')
    if owner == 'ground_node':
        if isinstance(mission[owner], dict) and rest[:1] != ['track']:
            raise OptionError(f'{name} is decided by the track of the ground node; vary '
                              'ground_node.track and its knots')
    elif owner == 'eavesdroppers' and rest[1:2] in (['position'], ['error_radius']):
        for number, eavesdropper in enumerate(mission[owner]):
            track = f'eavesdroppers.{number}.track'
            if rest[0] in ('*', str(number)) and (eavesdropper.get('track') is not None or any(
                    f'{varied}.'.startswith((f'{track}.', 'eavesdroppers.*.track.'))
                    for varied in names)):
                raise OptionError(f'{name} is decided by the track of eavesdropper {number}; vary '
                                  f'{track} and its knots')


def _leave_out_decided(mission: dict[str, Any], names: Iterable[str]) -> None:
    """Leave out of a mission what tracks decide that are among the names of varied fields."""
    for name in names:
        owner, *rest = name.split('.')
        if 'track' not in rest[:2]:
            continue
        for receiver in mission[owner] if owner == 'eavesdroppers' else [mission[owner]]:
            if receiver.get('track') is not None:
                receiver.pop('position', None)
                receiver.pop('error_radius', None)


def _parse_variation(mission: dict[str, Any] | None, name: str, value: Any) -> Any:
    """Return the values of a field, or a tuple of a law and its two numbers."""
    if mission is not None:
        try:
            if (field := name.partition('.')[0]) in _LEFT_OUT:
                mission.setdefault(field, copy.deepcopy(_LEFT_OUT[field]))
            if field == 'eavesdroppers' and name.endswith('.track'):
                for eavesdropper in mission[field]:
                    eavesdropper.setdefault('track', None)
            _resolve_field(mission, name)
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
                steps = np.linspace(value['from'], value['to'], value['count']).tolist()
                if _is_json(steps):
                    return steps
    elif isinstance(value, dict) and len(value) == 1 and set(value) <= set(LAWS):
        [(law, numbers)] = value.items()
        allowed = (f'{law} must have two numbers, or two places; they must be finite, and '
                   f'{LAWS[law]}')
        with suppress(TypeError, ValueError, OverflowError):
            first, second = numbers
            if np.isfinite(getattr(np.random.default_rng(0), law)(first, second)).all():
                return law, first, second
    raise OptionError(f'{name} is {quote(value)}; {allowed}')


def _list_schemes(methods: list[str], objectives: list[str] | None) -> list[tuple[str, str]]:
    """
    Return the pairs of a method and an objective.

    Baselines and schemes of one's own are compared by the objectives of the methods of solve.
    """
    for method in methods:
        if ':' in method:
            load_scheme(method)
    if objectives is None:
        own = {method: [check_objective(method)] for method in methods if method in METHODS}
        shared = list(dict.fromkeys(chain(*own.values()))) or [check_objective(METHODS[0])]
    else:
        own = {'alternating': [name for name in objectives if name == OBJECTIVES[0]]}
        shared = objectives
    pairs = [(method, objective) for method in methods for objective in own.get(method, shared)]
    if not pairs:
        raise OptionError(
            f'only the method {METHODS[0]} has the objective {OBJECTIVES[1]}')
    return pairs


def _resolve_field(mission: Any, name: str) -> list[tuple[Any, Any]]:
    """
    Return the owners and keys of the fields with a dotted name; `*` means all of a list.

    :raises LookupError: when there is no such field.
    """
    targets: list[tuple[Any, Any]] = [([mission], 0)]
    for part in name.split('.'):
        owners = [owner[key] for owner, key in targets]
        targets = [(owner, key) for owner in owners for key in _match_keys(owner, part)]
    if not targets:
        raise LookupError(name)
    return targets


def _match_keys(owner: Any, part: str) -> list[Any]:
    """Return the keys of a list or a mapping that a part of a dotted name means."""
    if isinstance(owner, list):
        keys = list(range(len(owner))) if part == '*' else [int(part)] if part.isdecimal() else []
        return [key for key in keys if key < len(owner)]
    return [part] if isinstance(owner, dict) and part in owner else []


def _is_json(values: list[Any]) -> bool:
    """Return True if JSON can hold the values: all finite numbers."""
    try:
        json.dumps(values, allow_nan=False)
    except ValueError:
        return False
    return True
