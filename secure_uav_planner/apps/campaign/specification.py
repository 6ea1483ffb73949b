"""What a campaign file asks for, and the tasks that it stands for."""

from collections.abc import Iterator
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
from ...assessment.monte_carlo import arguments
from ...errors import OptionError, shown, words_of_files
from ...mission import METHODS, OBJECTIVES
from ...mission.formats.documents import Document, Problem, read, refusal
from ...mission.propagation import Channel
from ...mission.scenario import Scenario
from ...optimize.solve import checked_objective

BASELINES = ('fly_hover_fly_constant', 'fly_hover_fly_optimised')
"""What `methods` may name beside the methods of solve."""

LAWS = {'uniform': 'the first at most the second', 'normal': 'the second at least 0'}
"""How a field can be drawn at random, and what its two numbers must be."""

MOST_TASKS = 10**6
"""The most missions of a campaign, which has a row for each in memory, and values of a field."""

_LEFT_OUT = {'channel': asdict(Channel()), 'colluding': False}
"""What Scenario.to_dict leaves out, and so do the missions of a campaign that does not vary it."""

_DEFAULTS: dict[str, Any] = {
    'vary': {}, 'samples': 1, 'seed': 0, 'methods': [METHODS[0]], 'objectives': None,
    'time_limit': None, 'bound_time_limit': None, 'plans': False, 'assess': None}


@dataclass(frozen=True)
class Campaign:
    """
    A base mission, the fields that change, and how each mission is planned.

    :param mission: the base, as plain values.
    :param grid: for each field that has several values, these.
    :param laws: for each field that is drawn at random, its law and the two numbers of it.
    :param samples: how often the random fields are drawn.
    :param seed: of the draws; sample k has the same draws at every place of the grid.
    :param schemes: pairs of a method and an objective.
    :param settings: 'time_limit' and 'bound_time_limit' in s, None for no limit and for no bound;
        'plans' if the plans are to be kept; 'assess' if they are to be assessed, and how.
    """

    mission: dict[str, Any]
    grid: dict[str, list[Any]]
    laws: dict[str, tuple[str, Any, Any]]
    samples: int
    seed: int
    schemes: list[tuple[str, str]]
    settings: dict[str, Any]

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
                mission = self.mission
                if fields:
                    mission = copy.deepcopy(mission)
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
    document = read(path)
    reader = _Reader(document, Path(path).parent)
    with words_of_files():
        campaign = reader.campaign()
    problems = [*document.problems, *reader.problems]
    if campaign is None or problems:
        raise refusal(path, problems)
    return campaign


def _plain(scenario: Scenario) -> Any:
    """Return a mission as JSON has it: with lists, whose members can be replaced."""
    return json.loads(json.dumps(scenario.to_dict()))


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


class _Reader:
    """Makes a Campaign of a document, and notes what is wrong."""

    def __init__(self, document: Document, folder: Path) -> None:
        self.problems: list[Problem] = []
        self._document, self._folder = document, folder

    def campaign(self) -> Campaign | None:
        """Return the campaign, or None if something is wrong."""
        data = self._document.data
        if not isinstance(data, dict):
            self._add((), 'it must be a mapping with a mission and the fields to vary')
            return None
        if 'uavs' in data:
            self._add((), 'it is a mission; a campaign names one by its field mission')
            return None
        known = ('mission', *_DEFAULTS)
        for name in data:
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                hint = f'did you mean {near[0]}?' if near else f'it has {", ".join(known)}'
                self._add((name,), f'a campaign has no field {shown(name)}; {hint}')
        mission = self._mission(data.get('mission'))
        values = {**_DEFAULTS, **data}
        grid, laws = self._varied(values['vary'], mission)
        self._check_numbers(values)
        self._check_assess(values['assess'])
        schemes = self._schemes(values)
        if self.problems or mission is None:
            return None
        settings = {name: values[name] for name in ('time_limit', 'bound_time_limit')}
        if values['plans']:  # Without, rows are those of a campaign that has no such field.
            settings['plans'] = True
        if values['assess'] is not None:
            settings['assess'] = values['assess']
        campaign = Campaign(
            mission, grid, laws, values['samples'], values['seed'], schemes, settings)
        if not 1 <= campaign.size <= MOST_TASKS:
            self._add((), f'it has {shown(campaign.size)} missions; it must have 1 to '
                      f'{MOST_TASKS}')
        return campaign

    def _add(self, place: tuple[Any, ...], text: str) -> None:
        self.problems.append(Problem(self._document.line(place), text))

    def _mission(self, given: Any) -> dict[str, Any] | None:
        """Return the base mission, which is in the campaign itself or in a file beside it."""
        if isinstance(given, str):
            try:
                return _plain(Scenario.load(self._folder / given))
            except OSError as error:
                self._add(('mission',), f'the mission {self._folder / given} cannot be read: '
                          f'{error.strerror or error}')
            except ValueError as error:
                self._add(('mission',), f'the mission cannot be used: {error}')
        elif isinstance(given, dict):
            try:
                return _plain(Scenario.from_dict(given))
            except ValueError as error:
                self._add(('mission',), f'the mission cannot be used: {error}')
        else:
            self._add(('mission',), f'mission is {shown(given)}; it must be the name of a mission '
                      'file, or the fields of a mission')
        return None

    def _varied(self, vary: Any, mission: Any) -> tuple[dict[str, list[Any]], dict[str, Any]]:
        grid: dict[str, list[Any]] = {}
        laws: dict[str, Any] = {}
        if not isinstance(vary, dict):
            self._add(('vary',), f'vary is {shown(vary)}; it must be a mapping of fields')
            return grid, laws
        for name, value in vary.items():
            place = ('vary', name)
            if mission is not None:
                try:
                    if (field := name.partition('.')[0]) in _LEFT_OUT:
                        mission.setdefault(field, copy.deepcopy(_LEFT_OUT[field]))
                    _targets(mission, name)
                except LookupError:
                    self._add(place, f'the mission has no field {shown(name)}; name it as '
                              'duration, uavs.0.max_speed or eavesdroppers.*.error_radius')
                    continue
            if isinstance(value, list) and value:
                grid[name] = value
                if not _is_json(value):
                    self._add(place, f'{name} is {shown(value)}; its numbers must be finite, and '
                              'null stands for no limit')
            elif isinstance(value, dict) and set(value) == {'from', 'to', 'count'}:
                try:
                    if value['count'] > MOST_TASKS:
                        raise ValueError
                    with np.errstate(all='ignore'):
                        grid[name] = np.linspace(
                            value['from'], value['to'], value['count']).tolist()
                except (TypeError, ValueError):
                    grid[name] = []
                if not grid[name] or not _is_json(grid[name]):
                    self._add(place, f'{name} is {shown(value)}; from and to must be numbers, '
                              f'count a whole number from 1 to {MOST_TASKS}')
            elif isinstance(value, dict) and len(value) == 1 and set(value) <= set(LAWS):
                [(law, numbers)] = value.items()
                try:
                    first, second = numbers
                    drawn = getattr(np.random.default_rng(0), law)(first, second)
                    if not np.isfinite(drawn).all():
                        raise ValueError
                    laws[name] = law, first, second
                except (TypeError, ValueError, OverflowError):
                    self._add(place, f'{name} is {shown(value)}; {law} must have two numbers, or '
                              f'two places; they must be finite, and {LAWS[law]}')
            else:
                self._add(place, f'{name} is {shown(value)}; it must be a list of values, {{from, '
                          'to, count}, {uniform: [low, high]} or {normal: [mean, deviation]}')
        return grid, laws

    def _check_numbers(self, values: dict[str, Any]) -> None:
        for name, least in (('samples', 1), ('seed', 0)):
            value = values[name]
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                self._add((name,), f'{name} is {shown(value)}; it must be a whole number, at '
                          f'least {least}')
        for name in ('time_limit', 'bound_time_limit'):
            value = values[name]
            if value is not None and (isinstance(value, bool) or not isinstance(
                    value, (int, float)) or not value > 0):
                self._add((name,), f'{name} is {shown(value)}; it must be above 0 s, or null')
        if not isinstance(values['plans'], bool):
            self._add(('plans',), f'plans is {shown(values["plans"])}; it must be true or false')

    def _check_assess(self, given: Any) -> None:
        if given is not None:
            try:
                arguments(given)
            except OptionError as error:
                self._add(('assess', *error.place), f'assess: {error}')

    def _schemes(self, values: dict[str, Any]) -> list[tuple[str, str]]:
        """Return the pairs of a method and an objective that exist."""
        own = values['objectives'] is None
        for name, allowed in (('methods', (*METHODS, *BASELINES)), ('objectives', OBJECTIVES)):
            given = values[name]
            if name == 'objectives' and own:
                continue
            if not isinstance(given, list) or not given or not all(
                    one in allowed for one in given):
                self._add((name,), f'{name} is {shown(given)}; it must be a list of '
                          f'{", ".join(allowed)}')
                return []
        if own:
            return [(method, OBJECTIVES[0] if method in BASELINES else checked_objective(method))
                    for method in values['methods']]
        pairs = [(method, objective) for method in values['methods']
                 for objective in values['objectives']
                 if method == METHODS[0] or objective == OBJECTIVES[0]]
        if not pairs:
            self._add(('methods',), f'only the method {METHODS[0]} has the objective '
                      f'{OBJECTIVES[1]}')
        return pairs
