"""A plan as a CSV file, for spreadsheets and pandas."""

import csv
import os

import numpy as np

from ..mission.files import atomic_file
from ..model.curve import Curve
from ..plan.plan import Plan

COLUMNS = ('uav', 'point', 'time', 'x', 'y', 'z', 'velocity_x', 'velocity_y', 'power')
"""The names of the columns: positions in m, times in s, velocities in m/s, powers in W."""


def save_csv(plan: Plan, path: str | os.PathLike[str]) -> None:
    """
    Write a line for every point of every UAV: where it flies at the point's time, and how fast.

    With a limit of acceleration these are places of the flown curve, as in `<uav>/trajectory`,
    not the control points. The power is that of the slot which begins at the point; it is 0 at
    the first and the last point.

    :raises OSError: when the file cannot be written; an old one is left as it was.
    """
    scenario = plan.scenario
    motion = Curve(scenario, plan.positions).at(plan.times)
    powers = np.pad(plan.powers, ((0, 0), (1, 1)))
    with atomic_file(path) as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(COLUMNS)
        for uav, places, velocities, watts in zip(
                scenario.uavs, motion.positions.tolist(), motion.velocities.tolist(),
                powers.tolist(), strict=True):
            writer.writerows(
                (uav.name, point, time, x, y, uav.altitude, *velocity, power)
                for point, (time, (x, y), velocity, power) in enumerate(
                    zip(plan.times.tolist(), places, velocities, watts, strict=True)))
