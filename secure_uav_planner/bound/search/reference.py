"""The plan from which a search begins."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from ..proof.conjugate import Array
from ..proof.stages import MOST_STAGES
from ...errors import PlanningError
from ...mission.scenario import Scenario
from ...optimize import solve
from ...plan.plan import Plan


def start(scenario: Scenario, time_left: float, objective: str,
          plan: Plan | None) -> tuple[Array, Array]:
    """Return positions (U, N + 2, 2) in m and powers (U, N) in W: a plan's, or straight lines."""
    if plan is not None:
        return plan.positions, plan.powers
    slots = min(scenario.slots, MOST_STAGES)
    try:
        plan = solve(replace(scenario, slots=slots), objective=objective,  # type: ignore[arg-type]
                     time_limit=None if math.isinf(time_left) else max(time_left / 2, 1e-3))
        positions, powers = plan.positions, plan.powers
    except PlanningError:
        # A mission that cannot be flown in so few slots, or not be planned in so little time.
        start = np.array([[uav.start] for uav in scenario.uavs])
        goal = np.array([[uav.goal] for uav in scenario.uavs])
        positions = start + (goal - start) * np.linspace(0, 1, slots + 2)[:, None]
        powers = np.array([[uav.average_power] * slots for uav in scenario.uavs])
    point = np.round(np.linspace(0, slots + 1, scenario.slots + 2)).astype(int)
    return positions[:, point], powers[:, np.clip(point[1:-1] - 1, 0, slots - 1)]
