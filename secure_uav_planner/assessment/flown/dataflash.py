"""Dataflash logs of ArduPilot (.BIN), read by pymavlink."""

import os
from typing import Any

import numpy as np

from .log import check_magic, describe_mode, VehicleLog
from ...errors import LogFileError
from ...mission.validation import Array

_ESTIMATES = ('XKF1', 'NKF1')  # The message of the newer estimator, then the older.
_GPS_EPOCH_S = 315964800  # UTC of the beginning of the GPS weeks.
_LEAP_S = 18  # GPS less UTC, since 2017.
_WEEK_S = 604800
_US = 1e-6
_WH = 3600.0  # One watt-hour in J.
_GUIDED = 4  # Mode number of a Copter.


def read_dataflash(path: str | os.PathLike[str]) -> VehicleLog:
    """Return the log of a vehicle by its estimator, as east, north and up."""
    from pymavlink.DFReader import DFReader_binary  # Here, since few need it.

    class Reader(DFReader_binary):  # type: ignore[misc]
        """A reader that refuses messages of no length, which pymavlink reads for ever."""

        def _parse_next(self) -> Any:
            """Return the next message; refuse one that does not advance the reader's offset."""
            begin = self.offset
            message = super()._parse_next()
            if message is not None and self.offset <= begin:
                raise LogFileError(f'the format of {message.get_type()} has a length below 3')
            return message

    check_magic(path, 0, [b'\xa3\x95'])
    reader = Reader(os.fspath(path))
    try:
        return _read(reader)
    finally:
        reader.close()


def _read_table(reader: Any) -> dict[str, Array]:
    """Return by message type the rows (time [s], `columns`), with 0 for a missing column."""
    columns = {
        **dict.fromkeys(_ESTIMATES, ('C', 'PE', 'PN', 'PD', 'VE', 'VN', 'VD')),
        'ORGN': ('Type', 'Lat', 'Lng'), 'GPS': ('GWk', 'GMS', 'Status'),
        'MODE': ('ModeNum',), 'BAT': ('EnrgTot', 'Inst'), 'PSCN': ('TPN',), 'PSCE': ('TPE',)}
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in columns}
    while (message := reader.recv_match(type=list(columns))) is not None:
        name = message.get_type()
        rows[name].append((message.TimeUS * _US, *(
            float(getattr(message, column, 0.0)) for column in columns[name])))
    return {name: np.array(values) for name, values in rows.items() if values}


def _read(reader: Any) -> VehicleLog:
    """Return the log of a DataFlash reader; raise a LogFileError without positions."""
    table = _read_table(reader)
    estimate = next((table[name] for name in _ESTIMATES if name in table), None)
    if estimate is None:
        raise LogFileError('it has no positions of an estimator (XKF1 or NKF1)')
    # Columns are time, C, PE, PN, PD, VE, VN, VD: the core's number, then east, north and down.
    estimate = estimate[estimate[:, 1] == estimate[0, 1]]
    down_to_up = np.array([1.0, 1.0, -1.0])
    battery = table.get('BAT')
    if battery is not None:
        battery = battery[battery[:, 2] == 0]  # The first battery; column 1 is the energy [Wh].
    setpoints = None
    if 'PSCN' in table and 'PSCE' in table:
        north, east = table['PSCN'], table['PSCE']
        setpoints = north[:, 0], np.stack(
            [np.interp(north[:, 0], *east.T), north[:, 1]], axis=-1)
    modes = table.get('MODE')
    if modes is not None:  # A mode lasts until the next one, the last one until the log ends.
        modes = np.append(modes, [[estimate[-1, 0], modes[-1, 1]]], axis=0)
    return VehicleLog(
        estimate[:, 0], estimate[:, 2:5] * down_to_up, estimate[:, 5:7], _find_utc_offset(table),
        _find_reference(table), battery=None if battery is None or not len(battery) else (
            battery[:, 0], battery[:, 1] * _WH), setpoints=setpoints,
        notes=() if modes is None else describe_mode(
            'GUIDED', modes[:, 0], modes[:, 1] == _GUIDED))


def _find_utc_offset(table: dict[str, Any]) -> float | None:
    """Return the median of UTC minus the log's time [s] over 3D fixes of GPS, None without one."""
    if 'GPS' not in table:
        return None
    # Columns are time [s], week, ms of the week, and status: 3 or more for a 3D fix.
    fixes = table['GPS'][(table['GPS'][:, 3] >= 3) & (table['GPS'][:, 1] > 0)]
    if not len(fixes):
        return None
    utc = _GPS_EPOCH_S - _LEAP_S + _WEEK_S * fixes[:, 1] + fixes[:, 2] * 1e-3
    return float(np.median(utc - fixes[:, 0]))


def _find_reference(table: dict[str, Any]) -> tuple[float, float] | None:
    """Return the origin of the estimator in degrees."""
    origins = table.get('ORGN', np.zeros((0, 4)))
    origins = origins[origins[:, 1] == 0]
    return (float(origins[-1, 2]), float(origins[-1, 3])) if len(origins) else None
