"""The file that keeps the last plan of a planner over a restart."""

import hashlib
from pathlib import Path
import socket

from rclpy.impl.rcutils_logger import RcutilsLogger

from .settings import PlannerSettings
from ...errors import brief, ParameterError, PlanFileError, quote
from ...plan.file import read_plan, write_plan
from ...plan.plan import Plan


def check_plan_file(file: str) -> None:
    """Raise a ParameterError if the folder of the plan_file is not there."""
    if file and not Path(file).parent.is_dir():
        meaning = '; ~ does not stand for a folder here' if file.startswith('~') else ''
        raise ParameterError(
            f'parameter plan_file: {brief(file)} must be in a folder that is there{meaning}',
            ('plan_file',))


def reserve_plan_file(file: str) -> socket.socket | None:
    """
    Return a socket that reserves a plan file until it is closed; None if the file is reserved.

    The name of an abstract socket is free again when its process ends, in any way.
    """
    reservation = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    name = hashlib.sha256(str(Path(file).resolve()).encode()).hexdigest()
    try:
        reservation.bind(f'\0secure_uav_planner {name}')
    except OSError:
        reservation.close()
        return None
    return reservation


def load_plan(file: str, settings: PlannerSettings) -> Plan | None:
    """
    Return the plan in a file, or None if the file does not exist.

    :raises PlanFileError: as by Plan.load; if the plan has no start time; or if its UAVs, ground
        nodes and eavesdroppers, in this order, or its frame differ from the settings. A plan that
        Plan.save wrote has no frame.
    """
    if not Path(file).exists():
        return None
    plan, frame_id = read_plan(file, Plan)
    scenario, names = plan.scenario, [
        [*settings.uavs], [*settings.ground_nodes], [*settings.eavesdroppers]]
    if plan.start_ns is None or names != [
            [uav.name for uav in scenario.uavs], [*scenario.ground_node_names],
            [*scenario.eavesdropper_names]]:
        raise PlanFileError(f'{file} is not a plan for {", ".join(sum(names, []))}')
    if frame_id not in (None, settings.frame_id):
        raise PlanFileError(f'{file} is in frame {quote(frame_id)} and the parameter frame_id is '
                            f'{quote(settings.frame_id)}')
    return plan


def save_plan(plan: Plan, file: str, frame_id: str, log: RcutilsLogger) -> None:
    """Save a plan and the name of its frame, or log why that fails."""
    try:
        write_plan(plan, file, frame_id=frame_id)
    except (OSError, ValueError) as error:
        log.error(f'plan_file: {brief(error)}; the plan is published all the same')
