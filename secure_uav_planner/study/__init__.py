"""The study of the paper's scenario; `python -m secure_uav_planner.study` runs it."""

from .experiments import BASELINES, code_version, Point, points, PROPOSED
from .plans import compute, run

__all__ = ['BASELINES', 'PROPOSED', 'Point', 'code_version', 'compute', 'main', 'points', 'run']


def main(argv=None):
    """Run the study as a program; return the exit status."""
    # Imported here, because the worker processes need neither figures nor claims.
    from .__main__ import main as run_study
    return run_study(argv)
