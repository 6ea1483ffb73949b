"""The mission that a parameter file of the planner describes, without a node."""

from collections.abc import Mapping
import os
from pathlib import Path
from typing import Any

import yaml

from .parameters import eavesdropper_parameters, PLANNER, Spec, uav_from, uav_parameters
from .zone_parameters import airspace_from, zone_parameters
from ..errors import ParameterError, shown
from ..scenario import Eavesdropper, Point, Scenario


def scenario_of_file(path: str | os.PathLike[str], ground_node: Point,
                     places: Mapping[str, Point]) -> Scenario:
    """
    Return the Scenario that the planner makes of a parameter file and of these poses.

    :param path: a YAML file with the parameters of the node under `/**/planner`.
    :param ground_node: (x, y) in m.
    :param places: the estimated position (x, y) in m of every eavesdropper by name.
    :raises PlanningError: for an unknown parameter, a wrong value, or a missing place.
    :raises OSError: when the file cannot be read.
    """
    of = _values(path)
    missing = set(of['eavesdroppers']) - set(places)
    if missing:
        raise ParameterError(f'places lacks {", ".join(sorted(missing))}; it must have every one '
                             'of eavesdroppers')
    return Scenario(
        ground_node,
        tuple(Eavesdropper(places[name], of[f'{name}.error_radius'], name)
              for name in of['eavesdroppers']),
        tuple(uav_from(of, name) for name in of['uavs']), of['duration'], of['slots'],
        of['reference_snr_db'], **airspace_from(of))


def _values(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return all values of the planner's parameters, checked."""
    try:
        tree = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
        given = dict(_flat(tree['/**/planner']['ros__parameters']))
    except (yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ParameterError(f'{path} is not a parameter file of the planner: '
                             f'{shown(str(error))}') from None
    specs: dict[str, Spec] = dict(PLANNER)
    for index, name in enumerate(_names(given, 'uavs')):
        specs.update(uav_parameters(name, index))
    for name in _names(given, 'eavesdroppers'):
        specs.update(eavesdropper_parameters(name))
    for name in _names(given, 'no_fly_zones'):
        specs.update(zone_parameters(name))
    unknown = set(given) - set(specs)
    if unknown:
        raise ParameterError(f'{path}: there is no parameter {shown(sorted(unknown)[0])}')
    return {**{name: spec.default for name, spec in specs.items()},
            **{name: specs[name].checked(name, value) for name, value in given.items()}}


def _names(given: Mapping[str, Any], name: str) -> list[str]:
    return PLANNER[name].checked(name, given.get(name, PLANNER[name].default))


def _flat(tree: Mapping[str, Any], prefix: str = '') -> list[tuple[str, Any]]:
    """Return the parameters of a file's tree, their names joined by dots."""
    found = []
    for key, value in tree.items():
        found += _flat(value, f'{prefix}{key}.') if isinstance(value, Mapping) else [
            (f'{prefix}{key}', value)]
    return found
