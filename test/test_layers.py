"""Imports run one way: from the rooms of the table in docs/contributing.md to those above."""

import ast
from graphlib import TopologicalSorter
import re

from processes import ROOT

PACKAGE = ROOT / 'secure_uav_planner'
TABLE = PACKAGE.parent / 'docs' / 'contributing.md'
MOST_ROOMS = 12
BELOW = ['mission/scenario.py imports output/picture.py']  # By Scenario.plot.
NO_ROOMS = {'__pycache__', 'py.typed'}  # PEP 561 wants the marker to lie there.


def rooms():
    """Return the rooms in the order of the table, each a module or a folder of the package."""
    return [name.rstrip('/') for name in re.findall(
        r'^\| `(\w+(?:\.py|/))` \|', TABLE.read_text(encoding='utf-8'), re.MULTILINE)]


def room_of(path):
    return path.relative_to(PACKAGE).parts[0]


def imported(path):
    """Give the files of the package that one imports, also for annotations and in functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = path.parents[node.level - 1].joinpath(*(node.module or '').split('.'))
            for name in [alias.name for alias in node.names]:
                found = [target for target in (
                    folder / f'{name}.py', folder / name / '__init__.py',
                    folder.with_suffix('.py'), folder / '__init__.py') if target.exists()]
                assert found, f'{path} imports {name} from {folder}, which is not there'
                yield found[0]


def test_imports_run_one_way_and_methods_do_not_know_each_other():
    files = [path for path in sorted(PACKAGE.rglob('*.py'))
             if path.parent != PACKAGE or path.name not in ('__init__.py', '__main__.py')]
    order = rooms()
    assert {room_of(path) for path in files} == set(order)
    assert len({path.name for path in PACKAGE.iterdir()} - NO_ROOMS) <= MOST_ROOMS
    graph = {path: [target for target in imported(path) if target != path] for path in files}
    assert sum(map(len, graph.values())) > 400
    back = [f'{path.relative_to(PACKAGE)} imports {target.relative_to(PACKAGE)}'
            for path, targets in graph.items() for target in targets
            if target in graph and order.index(room_of(target)) > order.index(room_of(path))]
    assert back == BELOW
    methods = [PACKAGE / 'optimize' / 'joint', PACKAGE / 'optimize' / 'alternating']
    of_methods = {path: method for path in files for method in methods
                  if path.is_relative_to(method) or path == method.with_suffix('.py')}
    assert {*of_methods.values()} == {*methods}
    assert not any(of_methods.get(target, method) != method
                   for path, method in of_methods.items() for target in graph[path])
    TopologicalSorter(graph).prepare()  # It raises an error that shows a circle.


def test_nothing_is_kept_in_a_cache_of_the_whole_process():
    """What such a cache keeps outlives the mission and the call that it belongs to."""
    cached = [f'{path}:{node.lineno}' for path in PACKAGE.rglob('*.py')
              for node in ast.parse(path.read_text(encoding='utf-8')).body
              if isinstance(node, ast.FunctionDef) and any(
                  'cache' in ast.unparse(decorator) for decorator in node.decorator_list)]
    assert not cached
