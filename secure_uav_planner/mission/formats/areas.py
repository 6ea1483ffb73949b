"""Areas of airspace files: corners in degrees, checked, and fields of their JSON."""

from collections.abc import Mapping, Sequence
import json
import math
from typing import Any, NamedTuple

from ..validation import is_sequence, to_number
from ...errors import quote, ScenarioError


class Area(NamedTuple):
    """
    An area of a file.

    :param corners: (latitude, longitude) in degrees.
    :param floor: lowest height in m above the ground, not checked yet.
    :param ceiling: highest height in m above the ground, not checked yet; None for all heights.
    :param is_fence: True for a fence, inside which UAVs stay, False for a zone.
    """

    corners: Sequence[tuple[float, float]]
    floor: Any = 0.0
    ceiling: Any = None
    is_fence: bool = False


def checked_corners(corners: Any, latitude_index: int) -> list[tuple[float, float]]:
    """
    Return the corners of a polygon in degrees, latitude first, or raise ScenarioError.

    :param latitude_index: index of the latitude in each corner, 0 or 1. The third number of a
        corner, if there is one, is a height, which must be 0.
    """
    if not is_sequence(corners) or len(corners) < 3:
        raise ScenarioError(f'a polygon is {quote(corners)}; it must have at least three corners')
    return [checked_place('a corner', corner, latitude_index) for corner in corners]


def checked_place(noun: str, place: Any, latitude_index: int) -> tuple[float, float]:
    """Return a place in degrees, latitude first, or raise ScenarioError; see checked_corners."""
    numbers = [*map(to_number, place)] if is_sequence(place) else []
    if not 2 <= len(numbers) <= 3 or not all(map(math.isfinite, numbers)):
        raise ScenarioError(f'{noun} is {quote(place)}; it must be two numbers in degrees')
    if any(numbers[2:]):
        raise ScenarioError(f'{noun} has the altitude {numbers[2]:g} m, which is not above '
                            'the ground; give floor and ceiling')
    latitude, longitude = numbers[latitude_index], numbers[1 - latitude_index]
    if not (abs(latitude) <= 90 and abs(longitude) <= 180):
        raise ScenarioError(f'{noun} has the latitude {latitude:.10g} and the longitude '
                            f'{longitude:.10g}; they must be from -90 to 90 and -180 to 180 '
                            'degrees')
    return latitude, longitude


def checked_field(item: Any, name: str, kind: type[Any], noun: str) -> Any:
    """Return item[name] of the class `kind`; raise ScenarioError if it is missing or another."""
    value = item.get(name) if isinstance(item, Mapping) else None
    if not isinstance(value, kind):
        raise ScenarioError(f'{name} is {quote(value)}; it must be {noun}')
    return value


def parse_json(text: str) -> Any:
    """Return the value of a JSON text; raise ScenarioError where a name comes twice."""
    return json.loads(text, object_pairs_hook=_make_mapping)


def _make_mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the pairs of a JSON object as a dict; raise a ScenarioError for a name twice."""
    mapping: dict[str, Any] = {}
    for name, value in pairs:
        if name in mapping:
            raise ScenarioError(f'{quote(name)} comes twice in one object')
        mapping[name] = value
    return mapping
