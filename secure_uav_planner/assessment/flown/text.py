"""Logs as text: CSV with a header, and TUM."""

import csv
import os
from pathlib import Path

import numpy as np

from .log import VehicleLog
from ...errors import LogFileError

_NEEDED = ('time', 'x', 'y')
_EPOCH = 1e8  # s; times after it are UTC, times before it belong to the log's own clock.


def read_csv(path: str | os.PathLike[str], uavs: tuple[str, ...]) -> dict[str, VehicleLog]:
    """
    Return the logs by UAV of a file with columns time, uav, x, y and perhaps z, vx, vy, power.

    The column uav may be missing where there is one UAV. Positions are in the plan's frame, in m.
    """
    with Path(path).open(newline='', encoding='utf-8-sig') as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        names = reader.fieldnames or []
        missing = [name for name in _NEEDED if name not in names]
        if missing:
            raise LogFileError(f'it has no column {missing[0]}')
        if 'uav' not in names and len(uavs) > 1:
            raise LogFileError('it has no column uav')
        columns = [name for name in ('time', 'x', 'y', 'z', 'vx', 'vy', 'power') if name in names]
        rows: dict[str, list[list[float]]] = {}
        for row in reader:
            try:
                values = [float(row[name] or 'nan') for name in columns]
            except (TypeError, ValueError) as error:
                raise LogFileError(f'line {reader.line_num}: {error}') from None
            rows.setdefault((row.get('uav') or uavs[0]).strip(), []).append(values)
    logs = {}
    for uav, table in rows.items():
        logs[uav] = _make_log(dict(zip(columns, np.array(table).T, strict=True)))
    return logs


def read_tum(path: str | os.PathLike[str]) -> VehicleLog:
    """Return the log in lines `t x y z qx qy qz qw`, in s and in m in the plan's frame."""
    table = np.loadtxt(path, ndmin=2, encoding='utf-8-sig')
    if table.shape[1] != 8:
        raise LogFileError(f'it has {table.shape[1]} numbers in a line; it must have 8')
    return _make_log(dict(zip(('time', 'x', 'y', 'z'), table.T[:4], strict=True)))


def _make_log(table: dict[str, np.ndarray]) -> VehicleLog:
    """Return the log in a table of columns; without heights, z is 0 and a note says so."""
    times = table['time']
    zeros = np.zeros_like(times)
    positions = np.stack([table['x'], table['y'], table.get('z', np.full_like(zeros, np.nan))],
                         axis=-1)
    has_height = np.isfinite(positions[:, 2]).all()
    velocities = np.stack([table['vx'], table['vy'], zeros], axis=-1) if (
        'vx' in table and 'vy' in table) else None
    positions[:, 2] = positions[:, 2] if has_height else 0.0
    return VehicleLog(
        times, positions, velocities, 0.0 if np.nanmedian(times) > _EPOCH else None,
        powers=(times, table['power']) if 'power' in table else None,
        notes=() if has_height else ('heights are not in the log',))
