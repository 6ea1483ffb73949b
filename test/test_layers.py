"""Modules import what the table in docs/contributing.md lets them, and all are in it."""

import ast
from pathlib import Path
import re

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / 'secure_uav_planner'
TABLE = PACKAGE.parent / 'docs' / 'contributing.md'
MODULES = sorted(path for path in PACKAGE.rglob('*.py') if path.parent != PACKAGE
                 or path.name not in ('__init__.py', '__main__.py'))


def part_of(path):
    """Return the part of the package that a module is in, as the table names it."""
    first, *rest = path.relative_to(PACKAGE).parts
    return f'{first}/' if rest else first


def layers():
    """Return the number of the row of the table for each part of the package."""
    rows = re.findall(r'^\| (`.*?) \|', TABLE.read_text(encoding='utf-8'), re.MULTILINE)
    found = {}
    for number, row in enumerate(rows[:rows.index('`make demo`')]):
        for name in re.findall(r'`([^`]+)`', row):
            found.setdefault(f'{name.partition("/")[0]}/' if '/' in name else name, number)
    return found


def imported(path):
    """Yield the parts of the package that a module imports when it is imported itself."""
    for node in ast.parse(path.read_text(encoding='utf-8')).body:
        if not isinstance(node, ast.ImportFrom) or not node.level:
            continue
        folder = path.parents[node.level - 1]
        for name in [node.module] if node.module else [alias.name for alias in node.names]:
            target = folder.joinpath(*name.split('.'))
            target = target / '__init__.py' if target.is_dir() else target.with_suffix('.py')
            if target.exists():  # And not a name that the package itself offers.
                yield part_of(target)


@pytest.mark.parametrize('path', MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_module_is_in_the_table_and_imports_only_what_is_above_it(path):
    rows = layers()
    below = {name for name in imported(path) if rows[name] > rows[part_of(path)]}
    assert not below


def test_rows_and_imports_are_found():
    rows = layers()
    assert rows['errors.py'] < rows['scenario.py'] < rows['plan.py'] < rows['ros/'] < rows['cli/']
    assert {'ros/', 'view/'} <= set(imported(PACKAGE / 'demo.py'))
    assert {'channel/', 'limits/'} <= set(imported(PACKAGE / 'plan.py'))
