"""Processes of the tests that run in other folders."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def environment(**variables):
    """Return the variables of a process elsewhere, which finds the package here all the same."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
    return {**os.environ, 'PYTHONPATH': path, **variables}
