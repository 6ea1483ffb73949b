"""The saved plan of the planner, which it publishes again after a restart."""

from collections.abc import Sequence
from pathlib import Path

from rclpy.impl.rcutils_logger import RcutilsLogger

from ..errors import brief, PlanFileError
from ..plan.plan import Plan


def load_plan(file: str, uavs: Sequence[str]) -> Plan | None:
    """
    Load a plan with a start for UAVs of these names, or return None without a file.

    :raises PlanFileError: for another plan, or as Plan.load does.
    """
    if not Path(file).exists():
        return None
    plan = Plan.load(file)
    if [uav.name for uav in plan.scenario.uavs] != [*uavs] or plan.start_ns is None:
        raise PlanFileError(f'{file} is not a plan for {", ".join(uavs)}')
    return plan


def save_plan(plan: Plan, file: str, log: RcutilsLogger) -> None:
    """Save a plan, or log why that fails."""
    try:
        plan.save(file)
    except (OSError, ValueError) as error:
        log.error(f'plan_file: {brief(error)}; the plan is published all the same')
