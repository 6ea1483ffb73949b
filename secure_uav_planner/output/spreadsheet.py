"""A plan as a table: a CSV file for spreadsheets, and a DataFrame of pandas."""

import csv
import os
from typing import Any

import numpy as np

from ..mission.files import atomic_file
from ..plan.plan import Plan

COLUMNS = ('uav', 'point', 'time', 'x', 'y', 'z', 'velocity_x', 'velocity_y', 'power')
"""The names of the columns: positions in m, times in s, velocities in m/s, powers in W."""


def save_csv(plan: Plan, path: str | os.PathLike[str]) -> None:
    """
    Write a line for every point of every UAV, as rows_of gives them.

    :raises OSError: when the file cannot be written; an old one is left as it was.
    """
    with atomic_file(path) as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(COLUMNS)
        writer.writerows(rows_of(plan))


def to_dataframe(plan: Plan) -> Any:
    """Return the rows of the CSV file as a pandas DataFrame."""
    from pandas import DataFrame  # Here, because it is optional and takes time to import.
    return DataFrame(rows_of(plan), columns=list(COLUMNS))


def rows_of(plan: Plan) -> list[tuple[Any, ...]]:
    """
    Return a row for every point of every UAV: where it flies at the point's time, and how fast.

    With a limit of acceleration these are places of the flown curve, as in `<uav>/trajectory`,
    not the control points. That curve begins half a slot before point 0 and ends half a slot after
    the last point, at the start and the goal where the UAV rests there: these places are the
    points -1 and N+2. The power is that of the slot which begins at the point; it is 0 where none
    does.
    """
    scenario, curve = plan.scenario, plan.curve
    times = np.unique([curve.begin, *plan.times, curve.end])
    ends = (len(times) - len(plan.times)) // 2
    motion = curve.at(times)
    powers = np.pad(plan.powers, ((0, 0), (1 + ends, 1 + ends)))
    return [
        (uav.name, point, time, x, y, uav.altitude, *velocity, power)
        for uav, places, velocities, watts in zip(
            scenario.uavs, motion.positions.tolist(), motion.velocities.tolist(),
            powers.tolist(), strict=True)
        for point, (time, (x, y), velocity, power) in enumerate(
            zip(times.tolist(), places, velocities, watts, strict=True), -ends)]
