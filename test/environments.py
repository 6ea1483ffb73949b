"""Environments of the Makefile's targets, each with nothing else in it."""

from contextlib import contextmanager
import fcntl
import os
import subprocess
import sys

from processes import ROOT

# Neither this project's nor ROS's own variables have a meaning in another environment.
OUTSIDE = {name: value for name, value in os.environ.items() if name not in (
    'AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'MAKEFLAGS', 'MAKELEVEL', 'PYTHONPATH',
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE')}


@contextmanager
def _alone():
    """Keep other processes of the tests from the folder `build` in the meantime."""
    with open(ROOT / 'setup.py') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def build_wheel(folder):
    """Build a wheel of the package in a folder; return its path."""
    with _alone():
        _run(sys.executable, '-m', 'pip', 'wheel', '--quiet', '--no-deps', '--wheel-dir', folder,
             ROOT)
    [wheel] = folder.glob('*.whl')
    return wheel


def make_environment(name, wheel, folder):
    """Make the environment of a stamp in the Makefile in a folder; return its Python."""
    _run('make', f'PYTHON={sys.executable}', f'VENV={folder}', f'PACKAGE={wheel}',
         f'{folder}/.{name}')
    return folder / 'bin' / 'python'


def _run(*command):
    subprocess.run(command, cwd=ROOT, check=True, timeout=3600, env=OUTSIDE)
