"""The study of the paper: its Figures 2 and 3, further figures, and a check of its claims."""

from .experiments import load_plans, make_points, plan_points, Point, PROPOSED

__all__ = ['PROPOSED', 'Point', 'load_plans', 'main', 'make_points', 'plan_points']


def main(argv=None):
    """Run the study as a program; return the exit status."""
    # Imported here, because the worker processes need neither figures nor claims.
    from .__main__ import main as run_study
    return run_study(argv)
