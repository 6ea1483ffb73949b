"""The annotations of the public layer hold, for the package and for who uses it."""

import subprocess
import sys

from processes import ROOT
import pytest

pytestmark = pytest.mark.slow

CONFIGURATION = ROOT / 'mypy.ini'

RIGHT = """
from secure_uav_planner import Eavesdropper, fly_hover_fly, Iteration, Plan, Scenario, solve, Uav


def on_iteration(iteration: Iteration) -> bool:
    return iteration.guaranteed_rate > 1.0


scenario: Scenario = Scenario(
    ground_node=(0.0, 0.0),
    eavesdroppers=(Eavesdropper(position=(200.0, 0.0), error_radius=10.0),),
    uavs=(Uav('sender', start=(100.0, 500.0), goal=(100.0, -500.0), altitude=100.0,
              max_speed=10.0, average_power=1.0, peak_power=4.0),),
    duration=120.0, slots=120, reference_snr_db=80.0)
step: float = Scenario.paper(duration=200.0).slot_duration
plan: Plan = solve(scenario, method='joint', on_iteration=on_iteration, time_limit=1.0)
again: Plan = solve(Scenario.paper(duration=200.0), initial=Plan.load('plan.json'))
baseline: Plan = fly_hover_fly(again.scenario, power='optimised')
rate: float = max(plan.guaranteed_rate, plan.worst_case_rate)
shapes: list[tuple[int, ...]] = [plan.positions.shape, plan.powers.shape]
plan.save('again.json')
"""
WRONG = "Scenario.paper(duration='long')\n"


def mypy(*arguments):
    """Run mypy with the project's configuration; return its exit status and what it says."""
    result = subprocess.run(
        [sys.executable, '-m', 'mypy', '--config-file', CONFIGURATION, *arguments],
        cwd=ROOT, capture_output=True, text=True, timeout=600)
    return result.returncode, result.stdout + result.stderr


def test_the_annotations_of_the_public_layer_hold():
    status, text = mypy()
    assert status == 0, text


def test_of_what_a_user_writes_only_the_wrong_line_is_told(tmp_path):
    (tmp_path / 'user.py').write_text(RIGHT + WRONG)
    status, text = mypy(str(tmp_path / 'user.py'))
    assert status == 1 and text.count('error: ') == 1 and 'arg-type' in text, text
