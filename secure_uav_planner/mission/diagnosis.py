"""All that is wrong with the values of a mission at once, not only the first."""

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

from .documents import Document, Place, Problem
from .schema import Schema, UNITS
from ..errors import InfeasibleMissionError, ScenarioError, shown
from ..fields import checked_fields


def diagnosed(document: Document, schema: Schema) -> tuple[Any, list[Problem]]:
    """
    Return the scenario that a document describes, and what is wrong with it.

    :return: a Scenario, or None where there are problems; and these in the order of the lines.
    """
    work = _Diagnosis(document, schema)
    scenario = work.scenario()
    found = [*document.problems, *work.problems]
    # Each once: a limit of the whole mission is found anew with every UAV.
    unique = list(dict.fromkeys(found))
    return (None if unique else scenario), sorted(unique, key=lambda one: one.line or 0)


class _Diagnosis:
    """Goes through a document, and keeps what is wrong."""

    def __init__(self, document: Document, schema: Schema) -> None:
        self.problems: list[Problem] = []
        self._document = document
        self._schema = schema

    def scenario(self) -> Any:
        """Return the Scenario, or None if something is wrong."""
        neutral, data = self._schema.scenario, self._document.data
        if data is None:
            self._add((), 'the file is empty; it must have the fields of a mission')
            return None
        known = self._known_fields(neutral, data, (), '')
        values: dict[str, Any] = {}
        for name, value in known.items():
            if name in self._schema.members:
                values[name] = self._members(name, value)
            elif self._is_right(neutral, name, value, (name,)):
                values[name] = value
        self._check_each_uav(values)
        if self.problems:
            return None
        try:
            return replace(neutral, **values)
        except ScenarioError as error:
            self._add(self._place_of(error), str(error))
            return None

    def _add(self, place: Place, text: str) -> None:
        self.problems.append(Problem(self._document.line(place), text))

    def _known_fields(self, neutral: Any, data: Any, place: Place, owner: str) -> dict[str, Any]:
        """Return the fields that there are; note the others, and those that are missing."""
        kind = type(neutral)
        names = {field.name for field in fields(kind)}
        if not isinstance(data, dict):
            self._add(place, f'{owner}{_error(lambda: checked_fields(kind, data))}')
            return {}
        known = {name: value for name, value in data.items() if name in names}
        for name in data.keys() - names:
            text = _error(lambda name=name: checked_fields(kind, {name: None}))
            self._add((*place, name), f'{owner}{text}')
        if (lacking := _error(lambda: checked_fields(kind, known))):
            self._add(place, f'{owner}{lacking}')
        return known

    def _members(self, field: str, values: Any) -> tuple[Any, ...]:
        """Return those members of a list that are right."""
        if not isinstance(values, list):
            self._add((field,), f'{field} is {shown(values)}; it must be a list')
            return ()
        return tuple(member for number, data in enumerate(values)
                     for member in self._member(field, number, data))

    def _member(self, field: str, number: int, data: Any) -> Iterator[Any]:
        """Yield a member of a list, unless something is wrong with it."""
        neutral, place = self._schema.members[field], (field, number)
        before = len(self.problems)
        known = self._known_fields(neutral, data, place, f'{field}[{number}]: ')
        if 'name' in known and self._is_right(neutral, 'name', known['name'], (*place, 'name')):
            neutral = replace(neutral, name=known['name'])
        values = {name: value for name, value in known.items() if name != 'name'
                  and self._is_right(neutral, name, value, (*place, name))}
        try:
            member = replace(neutral, **values)
        except ScenarioError as error:
            self._add((*place, *_field_of(error, values)), str(error))
        if len(self.problems) == before:
            yield member

    def _is_right(self, neutral: Any, field: str, value: Any, place: Place) -> bool:
        """Return whether a field may have a value whatever the others are; note why not."""
        try:
            replace(neutral, **{field: value})
        except ScenarioError as error:
            # Otherwise the value does not fit to the neutral ones, which says nothing.
            if _field_of(error, (field,)):
                self._add(place, f'{error}{_unit(field, value)}')
                return False
        return True

    def _check_each_uav(self, values: dict[str, Any]) -> None:
        """Note what keeps single UAVs from flying, with what is right of the mission."""
        right = {name: value for name, value in values.items() if value != ()}
        for uav in right.pop('uavs', ()):
            try:
                replace(self._schema.scenario, **{**right, 'uavs': (uav,)})
            except ScenarioError as error:
                self._add(self._place_of(error, uav), str(error))

    def _place_of(self, error: ScenarioError, uav: Any = None) -> Place:
        """Return where the value is that an error of a whole mission names."""
        if isinstance(error, InfeasibleMissionError):
            return ('duration',)
        members = self._document.data.get('uavs', ())
        for number, member in enumerate(members):
            if uav is not None and isinstance(member, dict) and (
                    member.get('name') == uav.name) and (field := _field_of(error, member)):
                return ('uavs', number, *field)
        return _field_of(error, self._document.data)


def _error(check: Any) -> str:
    """Return the text of the ScenarioError that a function raises, '' if it does not."""
    try:
        check()
    except ScenarioError as error:
        return str(error)
    return ''


def _field_of(error: ScenarioError, names: Any) -> tuple[str, ...]:
    """Return which of the names an error begins with, behind its owner, as a place."""
    subject = str(error).partition(' is ')[0].partition(' are ')[0]
    found = [name for name in names if isinstance(name, str) and name in subject]
    return (max(found, key=len),) if found else ()


def _unit(field: str, value: Any) -> str:
    """Return what to add to a message about a wrong value of a field."""
    if field not in UNITS:
        return ''
    if isinstance(value, str):
        return f', in {UNITS[field]}, without its unit'
    return '' if isinstance(value, list) else f' {UNITS[field]}'
