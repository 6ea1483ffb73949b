"""The style of ROS 2 Python packages; run on the source tree, not on what is installed."""


from ament_flake8.main import main_with_errors
from ament_pep257.main import main
from processes import ROOT
import pytest

SOURCES = [str(ROOT / name) for name in (
    'benchmarks', 'docs', 'examples', 'launch', 'secure_uav_planner', 'setup.py', 'studies',
    'test')]


@pytest.mark.linter
def test_flake8_finds_nothing():
    count, errors = main_with_errors(argv=SOURCES)
    assert count == 0, '\n'.join(errors)


@pytest.mark.linter
def test_pep257_finds_nothing():
    assert main(argv=SOURCES) == 0
