"""The text of a mission that is edited: what is not changed keeps its comments and notation."""

from collections.abc import Iterator
from contextlib import suppress
import copy
from functools import reduce
import operator
import os
from pathlib import Path
from typing import Any

import yaml

from .editing import Mission, to_mission
from ..errors import FieldPath, MissionFileError, ScenarioError
from ..mission.files import read_text
from ..mission.formats.documents import (
    format_document, format_value, is_json, MOST_BYTES, read_document)
from ..mission.formats.mission_file import read_mission
from ..mission.scenario import Scenario

_YAML = 'mission.yaml'
_REMOVED = object()  # Stands in a change for the value that is removed.
_MOST_PASSES = 10
_AREAS = ('no_fly_zones', 'geofence')  # Fields that the file of an `airspace` sets.


class MissionText:
    """
    A mission file.

    :ivar name: name of the mission for people: the file's name without the suffix.
    :ivar scenario: Scenario of the file.
    :ivar text: content of the file as YAML.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """
        Read a mission file.

        :raises OSError: when it cannot be read.
        :raises MissionFileError: as Scenario.load does.
        """
        self.scenario = Scenario.load(path)
        self.name = Path(path).stem.replace('_', ' ')
        self.text = read_text(path, MOST_BYTES).removeprefix('\ufeff')
        data = read_document(path).data
        if is_json(path):  # The page shows all missions as YAML.
            self.text = format_document(_YAML, data)
        self._airspace = data.get('airspace')
        self._path = Path(path).with_name(_YAML)  # The path of an airspace starts at the folder.

    def read(self, text: str) -> Scenario:
        """
        Return the Scenario of another text, which may name the airspace of this file and no other.

        :raises MissionFileError: with the lines of all that is wrong.
        """
        return read_mission(self._path, Scenario, text, self._airspace)

    def change(self, text: str, before: Mission, after: Mission) -> str:
        """
        Return `text` with the edit from mission `before` to mission `after`.

        Values that stay keep their notation, such as degrees, and comments beside them stay. If
        no such text is found, the mission is written anew without comments.

        :param text: text of the mission `before`.
        :param before: mission before the edit, as to_mission returns it; `after` is like it.
        """
        for list_changes in (_list_changes, _list_fields):
            with suppress(MissionFileError, yaml.YAMLError, LookupError, TypeError):
                changed = _rewrite(text, before, after, list_changes)
                if changed is not None and self._is_text_of(changed, after):
                    return changed
        return format_document(_YAML, after)

    def _is_text_of(self, text: str, mission: Mission) -> bool:
        """Return whether a text gives this mission; True also if text or mission is invalid."""
        try:
            return to_mission(self.read(text)) == to_mission(Scenario.from_dict(mission))
        except ScenarioError:
            return True


def _rewrite(text: str, before: Mission, after: Mission, list_changes: Any) -> str | None:
    """
    Return a text with the changes from `before` to `after`, None if _MOST_PASSES do not suffice.

    :param list_changes: _list_changes for the smallest changes, or _list_fields for whole fields,
        if other values of the text refer to the changed ones.
    """
    wanted = read_document(_YAML, text).data
    changes = [*_list_changes(before, after)]
    # Areas that change are no longer read from the file of the airspace.
    if 'airspace' in wanted and any(path[0] in _AREAS for path, _ in changes):
        del wanted['airspace']
        wanted |= {name: after[name] for name in _AREAS}
        changes = [change for change in changes if change[0][0] not in _AREAS]
    for path, value in changes:
        _set_value(wanted, path, value)
    for _ in range(_MOST_PASSES):  # An edit of an anchor also changes values merged from it.
        changes = [*list_changes(read_document(_YAML, text).data, wanted)]
        if not changes:
            return text
        text = _apply_changes(text, changes, wanted)
    return None


def _list_changes(present: Any, wanted: Any, path: FieldPath = ()) -> Iterator[
        tuple[FieldPath, Any]]:
    """Yield (path, new value or _REMOVED) of the smallest changes from `present` to `wanted`."""
    if present == wanted:
        return
    if isinstance(present, dict) and isinstance(wanted, dict):
        for key in present.keys() | wanted.keys():
            if key not in wanted:
                yield (*path, key), _REMOVED
            elif key not in present:
                yield (*path, key), wanted[key]
            else:
                yield from _list_changes(present[key], wanted[key], (*path, key))
    elif isinstance(present, list) and isinstance(wanted, list):
        yield from _compare_lists(present, wanted, path)
    else:
        yield path, wanted


def _compare_lists(present: list[Any], wanted: list[Any], path: FieldPath) -> Iterator[
        tuple[FieldPath, Any]]:
    """
    Yield (path, new value or _REMOVED) of the changes from one list to another.

    If the lists have equal length and `wanted` holds lists or mappings, changes are inside items.
    Otherwise items are appended, one item is removed, or the whole list is replaced.
    """
    shared = min(len(present), len(wanted))
    changed = next((index for index in range(shared) if present[index] != wanted[index]), shared)
    if len(present) == len(wanted) and any(isinstance(item, (dict, list)) for item in wanted):
        for index, items in enumerate(zip(present, wanted)):
            yield from _list_changes(*items, (*path, index))
    elif changed == len(present):
        yield from (((*path, index), wanted[index]) for index in range(changed, len(wanted)))
    elif present[:changed] + present[changed + 1:] == wanted:
        yield (*path, changed), _REMOVED
    else:
        yield path, wanted


def _list_fields(present: Any, wanted: Any) -> Iterator[tuple[FieldPath, Any]]:
    """Yield the fields of a mission that differ, each as a whole."""
    for key in present.keys() | wanted.keys():
        if present.get(key, _REMOVED) != wanted.get(key, _REMOVED):
            yield (key,), wanted.get(key, _REMOVED)


def _set_value(data: Any, path: FieldPath, value: Any) -> None:
    """Set or remove the value at a path in `data`; add missing mappings, and items at the end."""
    *path_of_owner, last = path
    owner = reduce(lambda owner, key: owner.setdefault(key, {}) if isinstance(owner, dict)
                   else owner[key], path_of_owner, data)
    if value is _REMOVED:
        del owner[last]
    elif isinstance(owner, list) and last == len(owner):
        owner.append(copy.deepcopy(value))
    else:
        owner[last] = copy.deepcopy(value)


def _apply_changes(text: str, changes: list[tuple[FieldPath, Any]], wanted: Any) -> str:
    """Return a text with the changes (path, value or _REMOVED) whose edits do not overlap."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    edits = {_find_edit(text, root, path, value, wanted) for path, value in changes}
    reached = len(text)
    for start, end, words in sorted(edits, reverse=True):
        if end <= reached:  # An edit that overlaps another one follows at the next pass.
            text, reached = text[:start] + words + text[end:], start
    return text


def _find_edit(text: str, root: yaml.Node, path: FieldPath, value: Any, wanted: Any) -> tuple[
        int, int, str]:
    """
    Return (start, end, words): words in place of text[start:end] set or remove a value.

    If the text lacks a key of the path, the wanted value of this key is added as a whole.

    :param root: node of the text's whole document.
    :param wanted: plain values of the whole mission after all changes.
    """
    # The nodes along the path, until the text lacks one.
    nodes = [root]
    for key in path:
        child = _find_child(nodes[-1], key)
        if child is None:
            return _find_insertion(text, nodes[-1], path[:len(nodes)], wanted)
        nodes.append(child)
    owner, node = nodes[-2:]
    if value is not _REMOVED:
        return node.start_mark.index, _find_end(text, node), format_value(value)
    if not owner.flow_style:
        return _find_removal(text, owner, path[-1])
    # A list or mapping in one line is written anew.
    return (owner.start_mark.index, owner.end_mark.index,
            format_value(reduce(operator.getitem, path[:-1], wanted)))


def _find_insertion(text: str, node: yaml.Node, path: FieldPath, wanted: Any) -> tuple[
        int, int, str]:
    """
    Return the edit (start, end, words) that appends the wanted value at a path to its owner.

    :param node: node of the owner: the mapping or the list that lacks the last key of the path.
    :param wanted: plain values of the whole mission after all changes.
    """
    words = format_value(reduce(operator.getitem, path, wanted))
    if isinstance(node, yaml.MappingNode):
        words = f'{path[-1]}: {words}'
    if node.flow_style:
        end = node.end_mark.index - 1
        return end, end, f', {words}' if node.value else words
    end = _find_line_end(text, _find_end(text, node))
    mark = '- ' if isinstance(node, yaml.SequenceNode) else ''
    return end, end, f'\n{" " * _find_column(node)}{mark}{words}'


def _find_child(node: yaml.Node, key: Any) -> yaml.Node | None:
    """Return the node at a key of a mapping or an index of a sequence, or None."""
    if isinstance(node, yaml.MappingNode):
        return next((value for name, value in node.value if name.value == key), None)
    if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
        return node.value[key]
    return None


def _find_column(node: yaml.Node) -> int:
    """Return the column at which the lines of a block begin, without an anchor before it."""
    first = node.value[0][0] if isinstance(node, yaml.MappingNode) else node
    return first.start_mark.column


def _find_end(text: str, node: yaml.Node) -> int:
    """Return the index in the text at which a node's last value ends, before a comment there."""
    if isinstance(node, yaml.ScalarNode) or node.flow_style:
        return node.end_mark.index
    ends = [node.start_mark.index]
    for item in node.value:
        key, value = item if isinstance(item, tuple) else (item, item)
        # An alias (*name) has the marks of the value that it repeats, which stands before its key.
        is_alias = value.start_mark.index < key.start_mark.index
        ends.append(_find_line_end(text, key.end_mark.index) if is_alias
                    else _find_end(text, value))
    return max(ends)


def _find_line_end(text: str, place: int) -> int:
    end = text.find('\n', place)
    return len(text) if end < 0 else end


def _find_removal(text: str, owner: yaml.Node, key: Any) -> tuple[int, int, str]:
    """Return the edit (start, end, '') that removes an item's lines from a block-style owner."""
    if isinstance(owner, yaml.MappingNode):
        node, value = next(item for item in owner.value if item[0].value == key)
    else:
        node = value = owner.value[key]
    start = text.rfind('\n', 0, node.start_mark.index) + 1
    return start, min(len(text), _find_line_end(text, _find_end(text, value)) + 1), ''
