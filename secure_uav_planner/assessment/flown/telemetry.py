"""Telemetry logs of MAVLink (.tlog), read by pymavlink."""

import os

import numpy as np

from .log import check_magic, VehicleLog
from ...errors import LogFileError

_TYPES = ('LOCAL_POSITION_NED', 'GPS_GLOBAL_ORIGIN', 'SYSTEM_TIME')


def read_telemetry(path: str | os.PathLike[str]) -> VehicleLog:
    """Return the log of a file's only vehicle, by time since boot, in east, north and up."""
    from pymavlink import mavutil  # Here, since few need it.
    check_magic(path, 8, [b'\xfd', b'\xfe'])  # MAVLink 2 and 1, after a time stamp.
    connection = mavutil.mavlogfile(os.fspath(path))
    states, utc_offsets, reference = list[tuple[float, ...]](), list[float](), None
    vehicles = set[int]()
    while (message := connection.recv_match(type=list(_TYPES))) is not None:
        kind = message.get_type()
        if kind == 'LOCAL_POSITION_NED':
            vehicles.add(message.get_srcSystem())
            states.append((message.time_boot_ms * 1e-3, message.y, message.x, -message.z,
                           message.vy, message.vx))
        elif kind == 'GPS_GLOBAL_ORIGIN':
            reference = message.latitude * 1e-7, message.longitude * 1e-7
        elif message.time_unix_usec:  # SYSTEM_TIME; 0 if UTC is not known.
            utc_offsets.append(message.time_unix_usec * 1e-6 - message.time_boot_ms * 1e-3)
    if not states:
        raise LogFileError('it has no message LOCAL_POSITION_NED')
    if len(vehicles) > 1:
        raise LogFileError(f'it has the vehicles {sorted(vehicles)}; it must have one')
    table = np.array(states)
    return VehicleLog(table[:, 0], table[:, 1:4], table[:, 4:6],
                      float(np.median(utc_offsets)) if utc_offsets else None, reference)
