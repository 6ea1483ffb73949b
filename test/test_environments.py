"""Targets of the Makefile have all that they import in their own environments; a wheel is new."""

import subprocess
from zipfile import ZipFile

from environments import build_wheel, make_environment, OUTSIDE
from processes import ROOT
import pytest

pytestmark = pytest.mark.slow

IMPORTS = """
import ast
from importlib import import_module
from pathlib import Path
import sys

for file in Path(sys.argv[1]).rglob('*.py'):
    import_module('.'.join(file.with_suffix('').parts))
folder, command = str(Path.cwd()), 'secure_uav_planner/apps'
for module in [*sys.modules.values()]:
    path = getattr(module, '__file__', None) or ''
    if (path.startswith(folder) and path.endswith('.py') and 'site-packages' not in path
            and command not in path):
        nodes = [ast.parse(Path(path).read_text())]
        for node in nodes:
            if not (isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.dump(node.test)):
                nodes += ast.iter_child_nodes(node)
            if isinstance(node, ast.Import):
                for alias in node.names:
                    import_module(alias.name)
            elif isinstance(node, ast.ImportFrom) and not node.level:
                import_module(node.module)
"""
"""
Imports all modules of a folder, and what these and all that they load import anywhere.

The command, which the package always loads, names itself what is missing for a subcommand.
"""


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    stale = ROOT / 'build' / 'lib' / 'secure_uav_planner' / 'stale.py'
    stale.parent.mkdir(parents=True, exist_ok=True)
    stale.touch()
    return build_wheel(tmp_path_factory.mktemp('wheel'))


@pytest.mark.parametrize('name, folder', [
    ('benchmarks', 'benchmarks'), ('examples', 'examples'), ('flown', 'studies/flown'),
    ('paper', 'studies/paper'), ('docs', 'docs/tools')])
def test_a_target_needs_no_package_of_another_target(name, folder, wheel, tmp_path):
    python = make_environment(name, wheel, tmp_path / 'venv')
    done = subprocess.run([python, '-c', IMPORTS, folder], cwd=ROOT, env=OUTSIDE, text=True,
                          capture_output=True, timeout=600)
    assert done.returncode == 0, done.stderr


def test_a_wheel_has_no_module_that_is_gone_since_the_last_build(wheel):
    with ZipFile(wheel) as file:
        names = file.namelist()
    assert 'secure_uav_planner/__init__.py' in names
    assert not [name for name in names if 'stale' in name]
