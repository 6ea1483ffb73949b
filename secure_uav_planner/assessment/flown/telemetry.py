"""Telemetry logs of MAVLink (.tlog), read by pymavlink."""

from collections import defaultdict
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
    # A sender is a system and its component: companion computers tell places and times, too.
    states = defaultdict[tuple[int, int], list[tuple[float, ...]]](list)
    utc_offsets = defaultdict[tuple[int, int], list[float]](list)
    references = dict[tuple[int, int], tuple[float, float]]()
    while (message := connection.recv_match(type=list(_TYPES))) is not None:
        kind, sender = message.get_type(), (message.get_srcSystem(), message.get_srcComponent())
        if kind == 'LOCAL_POSITION_NED':
            states[sender].append((
                message.time_boot_ms * 1e-3, message.y, message.x, -message.z, message.vy,
                message.vx))
        elif kind == 'GPS_GLOBAL_ORIGIN':
            references[sender] = message.latitude * 1e-7, message.longitude * 1e-7
        elif message.time_unix_usec:  # SYSTEM_TIME; 0 if UTC is not known.
            utc_offsets[sender].append(
                message.time_unix_usec * 1e-6 - message.time_boot_ms * 1e-3)
    systems = sorted({system for system, _ in states})
    if not states:
        raise LogFileError('it has no message LOCAL_POSITION_NED')
    if len(systems) > 1:
        raise LogFileError(f'it has the vehicles {systems}; it must have one')
    vehicle = min(states)  # The autopilot is component 1.
    table = np.array(states[vehicle])
    offsets = utc_offsets[vehicle]
    return VehicleLog(table[:, 0], table[:, 1:4], table[:, 4:6],
                      float(np.median(offsets)) if offsets else None, references.get(vehicle))
