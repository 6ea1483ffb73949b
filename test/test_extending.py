"""The programs of examples/extending plan with limits and channels that are not packaged."""

from dataclasses import replace
import re
import shutil

from examples.extending.limit import BASE, RangeLimit, REACH
import numpy as np
from processes import run_python
import pytest
from secure_uav_planner import fly_hover_fly, Scenario, solve
from secure_uav_planner.model import limits

pytestmark = pytest.mark.slow

needs_compiler = pytest.mark.skipif(shutil.which('c++') is None, reason='there is no C++ compiler')


def run(name):
    """Run a program; return the numbers that it prints, one for each line."""
    printed = run_python('-m', f'examples.extending.{name}').stdout
    return [float(number) for number in re.findall(r': \D*([\d.]+)', printed)]


def test_a_limit_in_a_file_of_its_own_holds_and_is_used_up():
    without, limited = run('limit')
    assert without > 200.0
    assert 149.0 < limited <= 150.0


def test_the_first_flights_keep_a_limit_in_a_file_of_its_own(monkeypatch):
    mission = Scenario.paper(120.0)
    mission = replace(mission, duration=60.0, slots=60, uavs=[
        replace(uav, start=(150.0, 100.0), goal=(150.0, -100.0)) for uav in mission.uavs])
    far = solve(mission)
    monkeypatch.setattr(limits, 'LIMITS', (*limits.LIMITS, RangeLimit))
    for plan in (fly_hover_fly(mission), solve(mission, time_limit=1e-3),
                 solve(replace(mission, duration=62.0), initial=far)):
        assert np.linalg.norm(plan.positions - BASE, axis=-1).max() <= REACH + 1e-6


@needs_compiler
def test_a_channel_in_two_files_has_the_same_gain_in_both_and_is_planned_for():
    *gains, free_space, own = run('channel')
    assert len(gains) == 3 and own > 1.02 * free_space > 0.0


def test_a_channel_in_python_alone_is_worth_planning_for():
    free_space, own = run('channel_in_python')
    assert own > 1.02 * free_space > 0.0
