"""Processes of the tests that run in other folders."""

import os
from pathlib import Path
import subprocess
import sys

ROOT = Path(__file__).resolve().parents[1]


def environment(*folders, **variables):
    """Return the variables of a process elsewhere, which finds the package here and folders."""
    path = os.pathsep.join(filter(None, [*folders, str(ROOT), os.environ.get('PYTHONPATH')]))
    return {**os.environ, 'PYTHONPATH': path, **variables}


def run_python(*arguments, status=0, env=None):
    """Run Python; return what it printed once it has ended with the status that is expected."""
    done = subprocess.run([sys.executable, *map(str, arguments)], cwd=ROOT, capture_output=True,
                          text=True, timeout=900, env=env or environment())
    assert done.returncode == status, done.stdout + done.stderr
    return done
