"""Campaign files: the mission, the fields that vary, and the tasks of all combinations."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
import copy
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from itertools import chain, combinations, product
import json
import math
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .tasks import load_scheme, make_task, Task
from ..assessment.monte_carlo import arguments
from ..errors import describe_class, OptionError, quote, ScenarioError, yaml_notation
from ..mission import METHODS, OBJECTIVES
from ..mission.fields import (
    Checked, checked_by, checked_text, checked_truth, ErrorList, raise_all, read_object, refuse,
    WholeNumber)
from ..mission.formats.documents import Document, FileProblem, make_file_error, read_document
from ..mission.formats.mission_file import check_foreign
from ..mission.propagation import Channel
from ..mission.scenario import Scenario
from ..mission.validation import to_number
from ..optimize.methods import check_objective

BASELINES = ('fly_hover_fly_constant', 'fly_hover_fly_optimised')
"""The names in `methods` beside the methods of solve and schemes `module:function`."""

LAWS = {'uniform': 'the first at most the second', 'normal': 'the second at least 0'}
"""Random laws of a field, with the condition on their two numbers."""

MOST_TASKS = 10**6
"""Largest number of missions of a campaign, whose rows are in memory, and of values in a range."""

_LEFT_OUT = {'channel': asdict(Channel()), 'colluding': False}
"""Defaults that Scenario.to_dict leaves out; a mission gets them only if they vary."""

_OWN = 'module:function'  # Notation of a user's own planner among the methods.


class Law(NamedTuple):
    """A random law of a field: a name in LAWS, and two numbers or two places."""

    name: str
    first: Any
    second: Any

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a plain number or place; raise ValueError for numbers that the law refuses."""
        return np.asarray(getattr(rng, self.name)(self.first, self.second)).tolist()


def _checked_mission(value: Any) -> Scenario:
    """Return the Scenario of a mission file, given by its path, or of a mapping of fields."""
    if not isinstance(value, str):
        return Scenario.from_dict(value)
    try:
        return Scenario.load(value)
    except OSError as error:
        raise ScenarioError(
            f'the mission {value} cannot be read: {error.strerror or error}') from None


def _checked_variations(value: Any) -> dict[str, list[Any] | Law]:
    """Return the values or the Law of each varied field; raise all ScenarioErrors together."""
    if not isinstance(value, dict):
        raise refuse(value, 'a mapping of fields')
    errors, variations = ErrorList(), {}
    for varied, values in value.items():
        with errors.collecting(varied):
            variations[varied] = _parse_variation(varied, values)
    raise_all(errors)
    return variations


def _parse_variation(name: str, value: Any) -> list[Any] | Law:
    """Return a field's variation, a list of values or a Law, or raise a ScenarioError."""
    allowed = ('it must be a list of values, {from, to, count}, {uniform: [low, high]} or '
               '{normal: [mean, deviation]}')
    if isinstance(value, list) and value:
        with suppress(ValueError):
            json.dumps(value, allow_nan=False)
            return value
        allowed = 'its numbers must be finite, and null stands for no limit'
    elif isinstance(value, dict) and set(value) == {'from', 'to', 'count'}:
        allowed = f'from and to must be numbers, count a whole number from 1 to {MOST_TASKS}'
        with suppress(TypeError, ValueError), np.errstate(all='ignore'):
            if 1 <= value['count'] <= MOST_TASKS:
                steps = np.linspace(value['from'], value['to'], value['count'])
                if np.isfinite(steps).all():
                    return list(steps.tolist())
    elif isinstance(value, dict) and len(value) == 1 and set(value) <= set(LAWS):
        [(law_name, numbers)] = value.items()
        allowed = (f'{law_name} must have two numbers, or two places; they must be finite, and '
                   f'{LAWS[law_name]}')
        with suppress(TypeError, ValueError, OverflowError):
            law = Law(law_name, *numbers)
            if np.isfinite(law.draw(np.random.default_rng(0))).all():
                return law
    raise ScenarioError(f'{name} is {quote(value)}; {allowed}')


def _checked_limit(value: Any) -> Any:
    if not to_number(value) > 0:
        raise refuse(value, 'above 0 s, or null')
    return value


def _checked_names(allowed: tuple[str, ...], value: Any) -> list[str]:
    """Return `value`, a list of `allowed` names and, with _OWN, of planners `module:function`."""
    planners = [item for item in value if isinstance(item, str) and ':' in item] if (
        _OWN in allowed and isinstance(value, list)) else []
    if not isinstance(value, list) or not value or not all(
            item in (*allowed, *planners) for item in value):
        raise refuse(value, f'a list of {", ".join(allowed)}')
    with _blaming_field():
        for planner in planners:
            load_scheme(planner)
    return value


def _checked_assessment(value: Any) -> Any:
    with _blaming_field():
        arguments(value)
    return value


@contextmanager
def _blaming_field() -> Iterator[None]:
    """Turn an OptionError into a ScenarioError 'is wrong: ...' about a field of the campaign."""
    try:
        yield
    except OptionError as error:
        raise ScenarioError(f'is wrong: {error}', error.place, ()) from None


@dataclass(frozen=True)
class Campaign(Checked):
    """A base mission, the fields that vary, and how each mission is planned."""

    mission: Scenario = field(metadata=checked_by(_checked_mission))
    vary: dict[str, list[Any] | Law] | None = field(
        default=None, metadata=checked_by(_checked_variations))
    samples: int = field(default=1, metadata=checked_by(WholeNumber(1, MOST_TASKS)))
    seed: int = field(default=0, metadata=checked_by(WholeNumber(0, 2**53)))
    methods: list[str] | None = field(
        default=None, metadata=checked_by(partial(_checked_names, (*METHODS, *BASELINES, _OWN))))
    objectives: list[str] | None = field(
        default=None, metadata=checked_by(partial(_checked_names, OBJECTIVES)))
    time_limit: float | None = field(default=None, metadata=checked_by(_checked_limit, 's'))
    bound_time_limit: float | None = field(
        default=None, metadata=checked_by(_checked_limit, 's'))
    plans: bool = field(default=False, metadata=checked_by(checked_truth))
    assess: dict[str, Any] | None = field(default=None, metadata=checked_by(_checked_assessment))

    def __post_init__(self) -> None:
        """Check each field, then what varies, and that there are 1 to MOST_TASKS tasks."""
        super().__post_init__()
        raise_all(self._find_unfit())
        if not 1 <= self.size <= MOST_TASKS:
            raise ScenarioError(f'it has {quote(self.size)} missions; it must have 1 to '
                                f'{MOST_TASKS}')

    def _find_unfit(self) -> Iterator[ScenarioError]:
        """Yield errors: varied fields that are missing or decided by a track; no scheme left."""
        parts_of = {name: name.split('.') for name in (*self.grid, *self.laws)}
        tracks = [parts[:2] for parts in parts_of.values() if parts[2:] == ['track']]
        for name, parts in parts_of.items():
            is_disc = parts[2:3] in (['position'], ['error_radius'])
            if is_disc and any(
                    owner == parts[0] and (number == parts[1] or '*' in (number, parts[1]))
                    for owner, number in tracks):
                yield ScenarioError(f'{name} is decided by a track that varies; vary its knots',
                                    ('vary', name))
                continue
            for member in self._list_members(name):
                if any(_resolve_field(self._base, member)):
                    continue
                owner = '.'.join(member.split('.')[:2])
                has_track = is_disc and any(
                    item['track'] for item, _ in _resolve_field(self._base, f'{owner}.track'))
                advice = ('vary the knots of the track instead, which decides it' if has_track else
                          'name it as duration, uavs.0.max_speed or eavesdroppers.*.error_radius')
                yield ScenarioError(f'the mission has no field {quote(member)}; {advice}',
                                    ('vary', name))
                break
        for (name, parts), (other, more) in combinations(parts_of.items(), 2):
            if all(one == two or '*' in (one, two) for one, two in zip(parts, more)):
                yield ScenarioError(f'{name} and {other} set the same field; vary it once',
                                    ('vary', name))
        if not self.schemes:
            yield ScenarioError(f'only the method {METHODS[0]} has the objective {OBJECTIVES[1]}',
                                ('methods',))

    def _list_members(self, name: str) -> list[str]:
        """Return a varied field's name with the index of each member for its first `*`."""
        head, star, rest = name.partition('.*.')
        return [f'{head}.{number}.{rest}' for owner, key in _resolve_field(self._base, head)
                if star and isinstance(owner[key], list)
                for number in range(len(owner[key]))] or [name]

    @cached_property
    def grid(self) -> dict[str, list[Any]]:
        """Values of each field that varies by a list or a range."""
        return {name: values for name, values in (self.vary or {}).items()
                if isinstance(values, list)}

    @cached_property
    def laws(self) -> dict[str, Law]:
        """Law of each field that is drawn."""
        return {name: law for name, law in (self.vary or {}).items() if isinstance(law, Law)}

    @cached_property
    def _base(self) -> dict[str, Any]:
        """Plain values of the mission, with the defaults of varied fields that to_dict omits."""
        # JSON turns tuples into lists, whose members can be replaced.
        mission: dict[str, Any] = json.loads(json.dumps(self.mission.to_dict()))
        for name in (*self.grid, *self.laws):
            owner = name.partition('.')[0]
            if owner in _LEFT_OUT:
                mission.setdefault(owner, copy.deepcopy(_LEFT_OUT[owner]))
            if owner == 'eavesdroppers' and name.endswith('.track'):
                for eavesdropper in mission[owner]:
                    eavesdropper.setdefault('track', None)
        return mission

    @cached_property
    def schemes(self) -> list[tuple[str, str]]:
        """
        Pairs (method, objective) with which each mission is planned, in the order of `methods`.

        Each method has all `objectives`, and alternating at most 'guaranteed'. If `objectives` is
        None, a method of solve has its default objective, and a baseline or an own planner has the
        defaults of the campaign's methods of solve, or the default of METHODS[0] without any.
        """
        methods = self.methods or METHODS[:1]
        by_method: dict[str, list[str]]
        shared: list[str]
        if self.objectives is None:
            by_method = {
                method: [check_objective(method)] for method in methods if method in METHODS}
            shared = list(dict.fromkeys(chain(*by_method.values()))) or [
                check_objective(METHODS[0])]
        else:
            shared = self.objectives
            by_method = {'alternating': [name for name in shared if name == OBJECTIVES[0]]}
        return [(method, objective) for method in methods
                for objective in by_method.get(method, shared)]

    @property
    def size(self) -> int:
        """How many tasks there are: missions times schemes."""
        return math.prod(map(len, self.grid.values())) * self.samples * len(self.schemes)

    def tasks(self) -> Iterator[Task]:
        """Yield each mission's tasks; sample k has the same draws at all points of the grid."""
        settings: dict[str, Any] = {
            'time_limit': self.time_limit, 'bound_time_limit': self.bound_time_limit}
        # Keys are digests of settings: a field without a value is left out, so that campaigns
        # without this field keep their keys.
        if self.plans:
            settings['plans'] = True
        if self.assess is not None:
            settings['assess'] = self.assess
        for values in product(*self.grid.values()):
            for sample in range(self.samples):
                rng = np.random.default_rng([self.seed, sample])
                fields = dict(zip(self.grid, values)) | {
                    name: law.draw(rng) for name, law in self.laws.items()}
                mission = self._make_mission(fields)
                for method, objective in self.schemes:
                    yield make_task(mission, method, objective, settings, fields, sample)

    def _make_mission(self, fields: dict[str, Any]) -> dict[str, Any]:
        """Return the campaign's mission, as plain values, with the values of varied fields."""
        mission = copy.deepcopy(self._base)
        for name, value in fields.items():
            for owner, key in _resolve_field(mission, name):
                owner[key] = value
                if key == 'track' and value is not None:  # A track sets position and radius.
                    owner.pop('position', None)
                    owner.pop('error_radius', None)
        return mission


def load_campaign(source: Mapping[str, Any] | str | os.PathLike[str]) -> Campaign:
    """
    Return the campaign of a YAML or JSON file, given by its path, or of a mapping of fields.

    :raises OSError: when the file cannot be read.
    :raises OptionError: for a value of a mapping that is not plain.
    :raises MissionFileError: with all problems, each with its line in the file.
    """
    if isinstance(source, Mapping):
        path, document = 'campaign', Document(_make_plain(source), {})
    else:
        path, document = os.fspath(source), read_document(source)
    data, problems = document.data, [*document.problems]
    check_foreign(path, data, 'powers', 'ros__parameters')
    try:
        with yaml_notation():
            if isinstance(data, dict) and 'uavs' in data:
                raise ScenarioError('it is a mission; a campaign names one by its field mission')
            if isinstance(data, dict) and isinstance(data.get('mission'), str):
                data['mission'] = str(Path(path).parent / checked_text(data['mission']))
            campaign: Campaign = read_object(Campaign, data, describe_class(Campaign))
    except ScenarioError as error:
        problems += (FileProblem(document.line(item.place), str(item))
                     for item in (error, *error.further))
    if problems:
        raise make_file_error(path, problems)
    return campaign


def _make_plain(fields: Mapping[str, Any]) -> Any:
    """Return the fields of a campaign in Python as plain lists, numbers and text."""
    def convert(value: Any) -> Any:
        if isinstance(value, Scenario):
            return value.to_dict()
        if isinstance(value, (np.ndarray, np.generic)):
            return value.tolist()
        raise OptionError(f'campaign has the value {quote(value)}; its values must be numbers, '
                          'text, lists and mappings, and its mission may be a Scenario')
    return json.loads(json.dumps(dict(fields), default=convert))


def _resolve_field(owner: Any, name: str) -> Iterator[tuple[Any, Any]]:
    """Yield (list or mapping, key in it) of each field with a dotted name; `*` is every item."""
    part, _, rest = name.partition('.')
    keys: list[Any] = [part] if isinstance(owner, dict) and part in owner else []
    if isinstance(owner, list):
        keys = [key for key in range(len(owner)) if part in ('*', str(key))]
    for key in keys:
        if rest:
            yield from _resolve_field(owner[key], rest)
        else:
            yield owner, key
