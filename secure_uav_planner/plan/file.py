"""Plans as JSON files, of this version and of all earlier ones."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
import json
import math
import os
from typing import Any

from .results import Bound, check_bound, RatedFlight
from ..errors import PlanFileError, prefix_path, quote, yaml_notation
from ..mission.fields import check_items, read_object, refuse
from ..mission.files import atomic_file, checked_path, read_text
from ..mission.scenario import Scenario

_FORMAT = 'secure_uav_planner/plan'
_VERSION = 2  # Format of the files that this package writes; version 0.1.0 wrote 1 and 2.
_MOST_BYTES = 2**29
LONGEST_FRAME = 255
"""Most characters of the name of a frame of coordinates; each setpoint repeats the name."""

_PLAIN = ('method', 'status', 'solve_time', 'start_ns', 'objective', 'promised_until', 'gaps',
          'promise_delay', 'promise_speed', 'bits', 'too_short')
_COMPUTED = ('guaranteed_rate', 'worst_case_rate')  # Written for other programs, never read.


def write_plan(plan: Any, path: str | os.PathLike[str], evaluate: bool = True,
               frame_id: str | None = None) -> None:
    """Write a Plan to a file, with the name of its frame if there is one; see Plan.save."""
    with atomic_file(path) as file:
        json.dump(_make_document(plan, evaluate, frame_id), file, allow_nan=False)


def make_text(plan: Any, frame_id: str) -> str:
    """Return a Plan as JSON: the content of its file and its frame of coordinates."""
    return json.dumps(_make_document(plan, False, frame_id), allow_nan=False)


def _make_document(plan: Any, evaluate: bool, frame_id: str | None) -> dict[str, Any]:
    """Return a Plan as plain values for JSON; `evaluate` adds worst_case_rate, slow to compute."""
    return {
        **({} if frame_id is None else {'frame_id': frame_id}),
        'format': _FORMAT,
        'version': _VERSION,
        'scenario': plan.scenario.to_dict(),
        'positions': plan.positions.tolist(),
        'powers': plan.powers.tolist(),
        **{name: getattr(plan, name) for name in _PLAIN},
        'history': [asdict(iteration) for iteration in plan.history],
        'bound': None if plan.bound is None else plan.bound.to_dict(),
        **({'shares': plan.shares.tolist()} if (plan.shares != 1.0).any() else {}),
        'guaranteed_rate': _number(plan.promise.guaranteed_rate),
        **({'worst_case_rate': _number(plan.promise.worst_case_rate)} if evaluate else {}),
    }


def _number(rate: float) -> float | None:
    """Return a rate, or None for NaN, which JSON has no number for."""
    return None if math.isnan(rate) else rate


def read_plan(path: str | os.PathLike[str], kind: type[RatedFlight]) -> tuple[Any, Any]:
    """
    Return a plan, and the name of its frame of coordinates if the file has one, otherwise None.

    :param kind: the class Plan; see Plan.load for the errors.
    """
    checked_path(path)
    try:
        text = read_text(path, _MOST_BYTES)
    except OSError as error:
        raise PlanFileError(f'{path} cannot be read: {error.strerror or error}') from None
    except UnicodeDecodeError:
        raise PlanFileError(f'{path} is not a plan: it is not text in UTF-8') from None
    with _name_source(f'{path}'):
        document = json.loads(text)
        return _read_document(document, kind), document.get('frame_id')


def parse_text(text: str, kind: type[RatedFlight]) -> tuple[Any, str]:
    """
    Return the plan and the name of its frame of coordinates in a text of make_text.

    :raises PlanFileError: if the text contains no plan, no frame, or a plan without a start.
    """
    with _name_source('the message'):
        document = json.loads(text)
        plan, frame_id = _read_document(document, kind), document.get('frame_id')
        if not isinstance(frame_id, str) or len(frame_id) > LONGEST_FRAME:
            raise PlanFileError(f'frame_id is {quote(frame_id)}; it must be a string of at most '
                                f'{LONGEST_FRAME} characters')
        if plan.start_ns is None:
            raise PlanFileError('start_ns is null; it must be the time of point 0 in ns')
        return plan, frame_id


@contextmanager
def _name_source(name: str) -> Iterator[None]:
    """Turn a ValueError or RecursionError into a PlanFileError that names the source first."""
    try:
        with yaml_notation():
            yield
    except json.JSONDecodeError as error:
        raise PlanFileError(f'{name} is not a plan: line {error.lineno} is not JSON') from None
    except (ValueError, RecursionError) as error:
        raise PlanFileError(
            f'{name} is not a plan: {error}', getattr(error, 'place', ())) from None


def _read_document(document: object, kind: type[RatedFlight]) -> Any:
    """Return the Plan in plain values from JSON, of versions 1 to _VERSION, or raise an error."""
    if not isinstance(document, dict) or document.get('format') != _FORMAT:
        raise PlanFileError(f'it is not a {_FORMAT}')
    version = document.get('version')
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise PlanFileError(f'its version is {quote(version)}')
    if version > _VERSION:
        raise PlanFileError(
            f'it has format version {quote(version)}, which a newer secure_uav_planner wrote; '
            f'this one reads up to version {_VERSION}')
    values: dict[str, Any] = {name: value for name, value in document.items()
                              if name not in ('format', 'version', 'frame_id', *_COMPUTED)}
    if isinstance(values.get('history'), list):
        values['history'] = [*map(_rename_rate, values['history'])]
    for field in ('positions', 'powers', 'shares'):
        with prefix_path(field):
            if values.get(field) is not None:
                _check_numbers(values[field])
    with prefix_path('scenario'):
        values['scenario'] = Scenario.from_dict(values.get('scenario'))
    if values.get('bound') is not None:
        values['bound'] = Bound.from_dict(values['bound'], values['scenario'])
    plan = read_object(kind, values, 'plan')
    check_bound(plan, plan.bound)
    return plan


def _check_numbers(values: object) -> None:
    """Refuse anything but numbers in nested lists; NumPy would accept truth values."""
    if isinstance(values, list):
        check_items(values, _check_numbers)
    elif isinstance(values, bool) or not isinstance(values, (int, float)):
        raise refuse(values, 'a number')


def _rename_rate(entry: Any) -> Any:
    """Return an iteration with version 1's field guaranteed_rate under its present name, rate."""
    if not isinstance(entry, Mapping):
        return entry
    return {'rate' if name == 'guaranteed_rate' else name: value for name, value in entry.items()}
