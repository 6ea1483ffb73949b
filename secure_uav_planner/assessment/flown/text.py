"""Logs as text: CSV with a header, and TUM."""

from array import array
import csv
from operator import itemgetter
import os
from pathlib import Path

import numpy as np

from .log import VehicleLog
from ...errors import LogFileError

_NEEDED = ('time', 'x', 'y')
_READ = (*_NEEDED, 'z', 'vx', 'vy', 'power')
_EPOCH = 1e8  # Time [s] from which times are UTC; smaller times belong to the log's own clock.


def read_csv(path: str | os.PathLike[str], uavs: tuple[str, ...]) -> dict[str, VehicleLog]:
    """
    Return the logs by UAV of a file with columns time, uav, x, y and perhaps z, vx, vy, power.

    Units are s, m in the plan's frame, m/s and W. An empty field is NaN. The column uav may be
    missing if `uavs` has one name. UAVs of the file that are not in `uavs` are returned, too.
    """
    tables: dict[str, array[float]] = {}
    with Path(path).open(newline='', encoding='utf-8-sig') as file:
        reader = csv.reader(file, skipinitialspace=True)
        names = [name.strip() for name in next(reader, [])]
        needed = (*_NEEDED, 'uav') if len(uavs) > 1 else _NEEDED
        missing = [name for name in needed if name not in names]
        if missing:
            raise LogFileError(f'it has no column {missing[0]}')
        columns = [name for name in _READ if name in names]
        take = itemgetter(*map(names.index, columns))
        uav_index = names.index('uav') if 'uav' in names else None
        for row in reader:
            if not row:
                continue
            if len(row) != len(names):
                raise LogFileError(f'line {reader.line_num} has {len(row)} fields; it must have '
                                   f'{len(names)}')
            try:
                values = [float(field or 'nan') for field in take(row)]
            except ValueError as error:
                raise LogFileError(f'line {reader.line_num}: {error}') from None
            name = uavs[0] if uav_index is None else row[uav_index].strip()
            if name not in tables:
                tables[name] = array('d')
            tables[name].fromlist(values)
    return {name: _make_log(dict(zip(
        columns, np.frombuffer(table).reshape(-1, len(columns)).T, strict=True)))
        for name, table in tables.items()}


def read_tum(path: str | os.PathLike[str]) -> VehicleLog:
    """Return the log in lines `t x y z qx qy qz qw`: s, m in the plan's frame, q is ignored."""
    if not Path(path).stat().st_size:
        raise LogFileError('it is empty')
    try:
        table = np.loadtxt(path, ndmin=2, encoding='utf-8-sig')
    except UnicodeDecodeError:
        raise
    except ValueError as error:  # The second half of the error's text is advice on NumPy.
        raise LogFileError(str(error).partition(';')[0]) from None
    if table.shape[1] != 8:
        raise LogFileError(f'it has {table.shape[1]} numbers in a line; it must have 8')
    return _make_log(dict(zip(('time', 'x', 'y', 'z'), table.T[:4], strict=True)))


def _make_log(table: dict[str, np.ndarray]) -> VehicleLog:
    """Return the log of columns by name; NaN for no z. A median time above _EPOCH means UTC."""
    times = table['time']
    no_heights = np.full_like(times, np.nan)
    positions = np.stack([table['x'], table['y'], table.get('z', no_heights)], axis=-1)
    velocities = np.stack([table['vx'], table['vy']], axis=-1) if (
        'vx' in table and 'vy' in table) else None
    return VehicleLog(
        times, positions, velocities, 0.0 if np.nanmedian(times) > _EPOCH else None,
        powers=(times, table['power']) if 'power' in table else None)
