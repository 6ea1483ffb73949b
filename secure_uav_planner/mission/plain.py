"""Scenarios as plain values of JSON and YAML, and back, with the errors of all fields."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
import math
from typing import Any, TYPE_CHECKING

from .fields import Block, ErrorList, find_field_errors, raise_all, read_object
from .geography import convert_points, Origin
from ..errors import quote, ScenarioError

if TYPE_CHECKING:
    from .scenario import Scenario


def to_plain(scenario: 'Scenario') -> dict[str, Any]:
    """Return the plain values of a Scenario; see Scenario.to_dict."""
    data = asdict(scenario)
    for field in ('channel', 'colluding', 'ground_node_track', 'head_starts', 'origin'):
        if getattr(scenario, field) == getattr(type(scenario), field):
            del data[field]
    # A ground_node is also the only one of the ground_nodes.
    del data['ground_nodes' if scenario.ground_node is not None else 'ground_node']
    if 'ground_node_track' in data:
        data['ground_node'] = {'track': data.pop('ground_node_track')}
    for receiver in (*data['eavesdroppers'], *data.get('ground_nodes', ())):
        for field in ('track',) if receiver['track'] is None else ('position', 'error_radius'):
            receiver.pop(field, None)
    for zone in data['no_fly_zones']:
        if math.isinf(zone['ceiling']):
            zone['ceiling'] = None
    return data


def from_plain(kind: 'type[Scenario]', data: Any) -> 'Scenario':
    """
    Return the Scenario of plain values; missing fields take their defaults.

    :param kind: the class Scenario, which imports this module.
    :raises ScenarioError: the first error; `further` are those of all fields, or, if these are
        right, all inconsistencies between them.
    """
    if not isinstance(data, Mapping):
        raise_all(find_field_errors(kind, data))
    values, errors = dict(data), ErrorList()
    with suppress(ScenarioError):  # A wrong origin is reported with the other fields.
        values = convert_points(values, Block(Origin)('', 'origin', values.get('origin')))
    with errors.collecting():
        values |= _split_ground_node(values.get('ground_node'))
    with errors.collecting():
        scenario = read_object(kind, values)
    raise_all(errors)
    return scenario  # type: ignore[no-any-return]


def _split_ground_node(node: Any) -> dict[str, Any]:
    """
    Return a ground node's place and track as two fields.

    :param node: a place, or a mapping of position and track.
    :raises ScenarioError: for such a mapping with other fields, or without both.
    """
    if not isinstance(node, Mapping) or 'latitude' in node:
        return {}
    for name in node:
        if name not in ('position', 'track'):
            raise ScenarioError(f'ground_node has no field {quote(name)}; it has position, track',
                                ('ground_node', name))
    if node.get('position') is None and node.get('track') is None:
        raise ScenarioError('ground_node lacks position, or a track', ('ground_node',))
    return {'ground_node': node.get('position'), 'ground_node_track': node.get('track')}
