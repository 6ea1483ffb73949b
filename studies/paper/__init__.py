"""The study of the paper's scenario: a campaign, its figures and what the paper claims."""

from .experiments import plans_of, Point, points, PROPOSED, run

__all__ = ['PROPOSED', 'Point', 'main', 'plans_of', 'points', 'run']


def main(argv=None):
    """Run the study as a program; return the exit status."""
    # Imported here, because the worker processes need neither figures nor claims.
    from .__main__ import main as run_study
    return run_study(argv)
