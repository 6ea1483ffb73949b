"""All that is wrong with the values of a mission at once, not only the first."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from .documents import Document, Problem
from ..participants import Eavesdropper, NoFlyZone, Uav
from ..propagation import Channel
from ..validation import misfits, needed_fields, RANGES
from ...errors import path_of, Place, ScenarioError, shown

UNITS = {
    'ground_node': 'm', 'position': 'm', 'start': 'm', 'goal': 'm', 'vertices': 'm',
    'geofence': 'm', 'error_radius': 'm', 'altitude': 'm', 'separation': 'm', 'floor': 'm',
    'ceiling': 'm', 'tracking_margin': 'm', 'max_speed': 'm/s', 'start_velocity': 'm/s',
    'goal_velocity': 'm/s', 'max_acceleration': 'm/s^2', 'average_power': 'W',
    'peak_power': 'W', 'duration': 's', 'reference_snr_db': 'dB', 'receiver_advantage_db': 'dB',
    'blade_power': 'W', 'induced_power': 'W', 'tip_speed': 'm/s', 'induced_velocity': 'm/s',
    'air_density': 'kg/m^3', 'disc_area': 'm^2',
    'rician_k_db': 'dB',
}
"""The unit of every field that has one."""

_NEUTRAL = {
    'eavesdroppers': Eavesdropper((0.0, 0.0)),
    'uavs': Uav('uav', (0.0, 0.0), (0.0, 0.0), RANGES['altitude'][0], RANGES['max_speed'][1],
                RANGES['average_power'][0], RANGES['peak_power'][1], None, None, None),
    'no_fly_zones': NoFlyZone(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))}
"""For each list of a scenario a member with limits so wide that any right value fits."""


def diagnosed(document: Document, kind: type[Any]) -> tuple[Any, list[Problem]]:
    """
    Return the Scenario, or `rest` of an error, and what is wrong.

    :param kind: the class Scenario, which imports this module.
    """
    work = _Diagnosis(document)
    scenario = work.scenario(kind)
    return scenario, [*document.problems, *work.problems]


class _Diagnosis:
    """Goes through a document, and keeps what is wrong."""

    def __init__(self, document: Document) -> None:
        self.problems: list[Problem] = []
        self._document = document

    def scenario(self, kind: type[Any]) -> Any:
        """Return the Scenario, with wide limits in place of what is wrong, or None."""
        neutral = kind((0.0, 0.0), (_NEUTRAL['eavesdroppers'],), (_NEUTRAL['uavs'],),
                       RANGES['duration'][1], slots=1)
        data = self._document.data
        if data is None:
            self._add((), 'the file is empty; it must have the fields of a mission')
            return None
        known = self._known_fields(kind, data, (), '')
        plain = {name: value for name, value in known.items()
                 if name not in _NEUTRAL and name != 'channel'}
        _, wrong = self._built(neutral, plain, ())
        values = {name: value for name, value in plain.items() if name not in wrong}
        numbers: dict[str | int, list[int]] = {}
        for name in [name for name in known if name in _NEUTRAL]:
            found = self._members(name, known[name])
            if found or known[name] == []:
                numbers[name] = [*found]
                values[name] = tuple(found.values())
        if 'channel' in known:
            channel = self._object(Channel(), known['channel'], ('channel',))
            if channel is not None:
                values['channel'] = channel
        try:
            missing = {*known, *needed_fields(kind)} - values.keys()
            scenario = kind(**values, **{name: getattr(neutral, name) for name in missing})
        except ScenarioError as error:
            for one in (error, *error.others):
                field, *inner = one.place
                if inner and field in numbers:
                    inner[0] = numbers[field][int(inner[0])]
                if field in values:  # Otherwise a neutral value is to blame.
                    self._add((field, *inner), str(one))
            return None
        # Without the flights' time, or a UAV, others may be refused that could be flown.
        is_whole = {'duration', 'slots', 'uavs'} <= values.keys() and (
            len(values['uavs']) == len(known['uavs']))
        return scenario if is_whole else None

    def _add(self, place: Place, text: str) -> None:
        self.problems.append(Problem(self._document.line(place), text))

    def _known_fields(self, kind: type[Any], data: Any, place: Place,
                      owner: str) -> dict[str, Any]:
        """Return the fields that there are; note the others, and those that are missing."""
        for error in misfits(kind, data):
            self._add((*place, *error.place), f'{owner}{error}')
        names = {field.name for field in fields(kind)}
        given = data if isinstance(data, dict) else {}
        return {name: value for name, value in given.items() if name in names}

    def _members(self, field: str, values: Any) -> dict[int, Any]:
        """Return the members of a list with which the mission can be judged, by their numbers."""
        if not isinstance(values, list):
            self._add((field,), f'{field} is {shown(values)}; it must be a list')
            return {}
        found = {number: self._object(_NEUTRAL[field], data, (field, number))
                 for number, data in enumerate(values)}
        return {number: member for number, member in found.items() if member is not None}

    def _object(self, neutral: Any, data: Any, place: Place) -> Any:
        """Return an object, or None if what is wrong with it could hide other things."""
        before = len(self.problems)
        known = self._known_fields(type(neutral), data, place, f'{path_of(place)}: ')
        found, wrong = self._built(neutral, known, place)
        # Of a UAV that has its places, altitude and speed, the rest can be neutral.
        is_judged = place[0] == 'uavs' and {*needed_fields(Uav)} <= known.keys() - wrong
        return found if is_judged or len(self.problems) == before else None

    def _built(self, neutral: Any, known: Mapping[str, Any], place: Place) -> tuple[Any, set[str]]:
        """
        Return an object of the class of another, which stands in for what is wrong or missing.

        It is None where these do not fit to the rest. What is wrong is noted.

        :return: the object, and the names of the fields that are wrong.
        """
        wrong: set[str] = set()
        missing = {*needed_fields(type(neutral))} - known.keys()
        values = {**known, **{name: getattr(neutral, name) for name in missing}}
        while True:
            try:
                return type(neutral)(**values), wrong
            except ScenarioError as error:
                field, inner = str(error.place[0]), error.place[1:]
                if field in wrong or field in missing:
                    return None, wrong
                value = values.get(field)
                unit = _unit(error.place, value, str(error))
                self._add((*place, *error.place), f'{error}{unit}')
                if isinstance(value, dict) and inner and inner[0] in value:
                    # The block may have more that is wrong.
                    value = {name: one for name, one in value.items() if name != inner[0]}
                else:
                    wrong.add(field)
                    value = getattr(neutral, field)
                values[field] = value


def _unit(place: Place, value: Any, message: str) -> str:
    """Return what to add to a message about a wrong value of a field, or of one in its block."""
    for part in place[1:]:
        value = value.get(part) if isinstance(value, dict) else value
    unit = UNITS.get(str(place[-1] if isinstance(place[-1], str) else place[0]))
    if unit and message.endswith(f' {unit}'):
        return ''
    if isinstance(value, str):
        is_number = 'must be a number' in message
        return f', in {unit}, without its unit' if unit else ', without a unit' * is_number
    return f' {unit}' if unit and isinstance(value, (int, float)) else ''
