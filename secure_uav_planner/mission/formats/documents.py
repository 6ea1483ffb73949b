"""YAML and JSON files as plain values, with the line of each value."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import json
import math
import os
from pathlib import Path
import re
from typing import Any, NamedTuple

import yaml

from ..files import read_text
from ...errors import FieldPath, MissionFileError, quote

MOST_BYTES = 2**20
"""Largest size in bytes of a file that is read; a mission with all lists full has a fifth."""

MOST_VALUES = 200_000
"""Largest number of values in a document: aliases of YAML can multiply them."""

_MOST_LEVELS = 20


class FileProblem(NamedTuple):
    """An error in a document; `line` counts from 1, and is None if it is not known."""

    line: int | None
    text: str


@dataclass(frozen=True)
class Document:
    """
    The content of a file.

    :param data: dictionaries, lists, strings, numbers, true, false and None.
    :param lines: line of each value by its path; values whose line is not known are missing.
    :param problems: errors of the file itself, such as a field that comes twice.
    """

    data: Any
    lines: Mapping[FieldPath, int]
    problems: tuple[FileProblem, ...] = ()

    def line(self, path: FieldPath) -> int | None:
        """Return the line of a value, or of the innermost block around it that has a line."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path)


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """Safe types with the scalars of YAML 1.2: `1e3` is a number, `1:30` and `yes` are text."""

    yaml_implicit_resolvers: dict[str, Any] = {}


for _tag in ('timestamp', 'binary', 'set', 'omap', 'pairs'):  # Types that JSON does not have.
    _Loader.add_constructor(f'tag:yaml.org,2002:{_tag}', yaml.SafeLoader.construct_undefined)


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Quotes strings that YAML 1.1 or 1.2 would read as another type."""


_SCALARS = (
    ('null', r'~|null|Null|NULL|', '~nN\0'),
    ('bool', 'true|True|TRUE|false|False|FALSE', 'tTfF'),
    ('int', r'[-+]?[0-9]+|0x[0-9a-fA-F]+|0o[0-7]+', '-+0123456789'),
    ('float', r'[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|'
     r'\.(nan|NaN|NAN)', '-+.0123456789'),
    ('merge', '<<', '<'),
)
for _kind, _text, _first in _SCALARS:
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(f'tag:yaml.org,2002:{_kind}', re.compile(f'^({_text})$'),
                                     ['' if letter == '\0' else letter for letter in _first])


def _construct_int(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node)
    return int(text, 0) if text[:2] in ('0x', '0o') else int(text)


_Loader.add_constructor('tag:yaml.org,2002:int', _construct_int)
_Loader.add_constructor('tag:yaml.org,2002:float', lambda loader, node: float(
    re.sub(r'\.(?=[iInN])', '', loader.construct_scalar(node))))
_Dumper.add_representer(tuple, _Dumper.represent_list)


def read_document(path: str | os.PathLike[str], text: str | None = None) -> Document:
    """
    Read a file: JSON if its name ends with .json, otherwise YAML.

    :param text: content that is read instead of the file; None to read the file.
    :raises OSError: when it cannot be read, is no regular file, or is larger than MOST_BYTES.
    :raises MissionFileError: for a wrong syntax, with the line if it is known, or too many levels
        or values, or bytes that are not UTF-8.
    """
    try:
        text = read_text(path, MOST_BYTES) if text is None else text
        return _parse_json(text) if is_json(path) else _parse_yaml(text)
    except json.JSONDecodeError as error:
        problem = FileProblem(error.lineno, f'{error.msg} at column {error.colno}')
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        words = ', '.join(filter(None, (error.context, error.problem)))
        problem = FileProblem(mark and mark.line + 1, words.replace('\n', ' '))
    except yaml.reader.ReaderError as error:
        problem = FileProblem(None, f'{error.reason} at character {error.position}')
    except RecursionError:
        problem = FileProblem(None, f'it must have at most {_MOST_LEVELS} levels')
    except UnicodeDecodeError as error:
        problem = FileProblem(None, f'it is not UTF-8 text: {error.reason} at byte {error.start}')
    except ValueError as error:  # such as a number of more digits than Python converts
        problem = FileProblem(None, str(error)[:200])
    raise make_file_error(path, [problem])


def make_file_error(path: str | os.PathLike[str], problems: Iterable[FileProblem]
                    ) -> MissionFileError:
    """Return the error of a file; its text has the first of `problems` by line."""
    problems = sorted(problems, key=lambda problem: problem.line or 0)
    line, text = problems[0]
    more = f' (and {len(problems) - 1} more)' if len(problems) > 1 else ''
    where = f'{path}' if line is None else f'{path}:{line}'
    error = MissionFileError(f'{where}: {text}{more}')
    error.problems = tuple(problems)
    return error


def format_document(path: str | os.PathLike[str], data: Any) -> str:
    """Return the text of a file with these data, in the notation that read_document expects."""
    if is_json(path):
        return json.dumps(data, indent=2, allow_nan=False) + '\n'
    # The default_flow_style None writes lists of numbers, such as places, on one line.
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None,
                     allow_unicode=True, width=95)


def format_value(value: Any) -> str:
    """Return a plain value as YAML in one line."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, default_flow_style=True,
                     allow_unicode=True, width=math.inf).removesuffix('...\n').rstrip('\n')


def is_json(path: str | os.PathLike[str]) -> bool:
    """Return True if the name of a file says that it is JSON."""
    return Path(path).suffix.lower() == '.json'


def _parse_yaml(text: str) -> Document:
    """Return the Document in a YAML text, with the line of each field."""
    loader = _Loader(text)
    try:
        reader = _Reader(loader)
        node = loader.get_single_node()
        data = None if node is None else reader.value(node, ())
        return Document(data, reader.lines, tuple(reader.problems))
    finally:
        loader.dispose()


def _parse_json(text: str) -> Document:
    """Return the Document in a JSON text; its lines are empty if YAML's reader refuses it."""
    data = json.loads(text)
    try:
        # JSON without tabs is YAML, whose reader gives lines; JSON has tabs only between values.
        as_yaml = _parse_yaml(text.replace('\t', ' '))
    except (yaml.YAMLError, ValueError):  # JSON may have characters that YAML does not allow.
        return Document(data, {})
    return Document(data, as_yaml.lines, as_yaml.problems)


class _Reader:
    """Converts YAML's nodes to plain values, and notes the line of each."""

    def __init__(self, loader: _Loader) -> None:
        self.lines: dict[FieldPath, int] = {}
        self.problems: list[FileProblem] = []
        self._loader = loader
        self._count = 0

    def value(self, node: yaml.Node, path: FieldPath) -> Any:
        """Return the node at `path` as plain values, and note the line of each of its fields."""
        self._count += 1
        if self._count > MOST_VALUES or len(path) > _MOST_LEVELS:
            raise yaml.MarkedYAMLError(
                problem=f'it must have at most {MOST_VALUES} values in {_MOST_LEVELS} levels',
                problem_mark=node.start_mark)
        self.lines.setdefault(path, node.start_mark.line + 1)
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item, (*path, number)) for number, item in enumerate(node.value)]
        try:
            return self._loader.construct_object(node)
        except (ValueError, OverflowError, KeyError, AttributeError) as error:
            raise yaml.MarkedYAMLError(problem=str(error)[:100],
                                       problem_mark=node.start_mark) from None

    def _mapping(self, node: yaml.MappingNode, path: FieldPath) -> dict[str, Any]:
        """
        Return the fields of a mapping and of `<<`, and note lines and problems.

        A field of the mapping overrides one of `<<`. Problems are a name that is no text, whose
        field is left out, and a name that comes twice.
        """
        values: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        for key, value in node.value:
            line = key.start_mark.line + 1
            if key.tag.endswith(':merge'):
                for mapping in self._merge_sources(value, path):
                    merged = {**mapping, **merged}
                continue
            name = self._loader.construct_object(key) if isinstance(key, yaml.ScalarNode) else None
            if not isinstance(name, str):
                self.problems.append(FileProblem(
                    line, f'the name of a field is {quote(name)}; it must be text'))
                continue
            if name in values:
                self.problems.append(FileProblem(line, f'{quote(name)} comes twice'))
            self.lines[(*path, name)] = line
            values[name] = self.value(value, (*path, name))
        return {**merged, **values}

    def _merge_sources(self, node: yaml.Node, path: FieldPath) -> list[dict[str, Any]]:
        """Return the mappings that YAML's merge key `<<` names: one, or a list of several."""
        sources = self.value(node, (*path, '<<'))
        sources = sources if isinstance(sources, list) else [sources]
        if not all(isinstance(source, dict) for source in sources):
            raise yaml.MarkedYAMLError(problem='<< must name a mapping',
                                       problem_mark=node.start_mark)
        return sources
