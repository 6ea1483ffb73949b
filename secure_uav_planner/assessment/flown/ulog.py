"""Logs of PX4 (.ulg), read by pyulog."""

import os
from typing import Any

import numpy as np

from .log import describe_mode, VehicleLog
from ...errors import LogFileError, OptionError
from ...mission.geography import Origin
from ...mission.scenario import Array

_TOPICS = ['vehicle_local_position', 'trajectory_setpoint', 'vehicle_status', 'battery_status',
           'vehicle_gps_position', 'sensor_gps']
_OFFBOARD = 14  # vehicle_status.nav_state in OFFBOARD.
_US = 1e-6


def read_ulog(path: str | os.PathLike[str]) -> VehicleLog:
    """Return the log of a PX4 vehicle with valid positions; all is east, north and up."""
    from pyulog import ULog  # Here, since few need it.
    topics: dict[str, Any] = {}
    for dataset in ULog(os.fspath(path), _TOPICS, disable_str_exceptions=True).data_list:
        # A topic may have several instances, such as two batteries; the first one counts.
        if dataset.multi_id == 0 or dataset.name not in topics:
            topics[dataset.name] = dataset.data
    if 'vehicle_local_position' not in topics:
        raise LogFileError('it has no topic vehicle_local_position')
    local = topics['vehicle_local_position']
    times = local['timestamp'] * _US
    valid = np.ones(len(times), bool)
    for name in ('xy_valid', 'z_valid'):
        valid &= np.asarray(local.get(name, valid), bool)
    velocities = _to_enu(local, 'vx', 'vy', 'vz')[valid, :2] if 'vx' in local else None
    told = _to_enu(local, 'x', 'y', 'z')
    positions, reference = _join_frames(local, told)
    setpoints = topics.get('trajectory_setpoint')
    # Older versions of PX4 have the columns x, y, z instead of position.
    if setpoints is not None and 'x' not in setpoints:
        setpoints = {**setpoints, **{
            name: setpoints[f'position[{index}]'] for index, name in enumerate('xyz')}}
    targets = None
    if setpoints is not None:  # A setpoint is in the frame of the last position before it.
        asked = setpoints['timestamp'] * _US
        last = np.maximum(np.searchsorted(times, asked, 'right') - 1, 0)
        targets = asked, (_to_enu(setpoints, 'x', 'y', 'z') + (positions - told)[last])[:, :2]
    return VehicleLog(
        times[valid], positions[valid], velocities, _find_utc_offset(topics), reference,
        _find_jumps(local, times),
        battery=_integrate_battery(topics.get('battery_status')),
        setpoints=targets,
        notes=_describe_offboard(topics.get('vehicle_status')))


def _to_enu(data: Any, *names: str) -> Array:
    """Return columns named north, east and down as east, north and up, (K, 3)."""
    north, east, down = (np.asarray(data[name], float) for name in names)
    return np.stack([east, north, -down], axis=-1)


def _join_frames(local: Any, positions: Array) -> tuple[Array, tuple[float, float] | None]:
    """
    Return positions (K, 3) [m], moved into the first frame with a valid reference.

    The second result is the reference of this frame, (latitude, longitude) in degrees. Without a
    valid reference it is None, and nothing is moved.
    """
    if 'ref_lat' not in local:
        return positions, None
    positions = positions.copy()
    references = np.stack([local['ref_lat'], local['ref_lon']], axis=-1).astype(float)
    valid = np.isfinite(references).all(axis=1) & (np.asarray(local['ref_timestamp']) > 0)
    if not valid.any():
        return positions, None
    latitude, longitude = references[valid][0].tolist()
    for reference in np.unique(references[valid], axis=0):
        same = valid & (references == reference).all(axis=1)
        try:
            east, north = Origin(latitude, longitude).to_local(*reference)
        except OptionError as error:
            raise LogFileError(f'ref_lat, ref_lon: {error}') from None
        positions[same, :2] += [float(east), float(north)]
    return positions, (latitude, longitude)


def _find_jumps(local: Any, times: Array) -> tuple[float, ...]:
    """Return times in s of the last samples before the frame changes."""
    changes = [np.flatnonzero(np.diff(np.asarray(local.get(name, ()), np.int64)))
               for name in ('ref_timestamp', 'xy_reset_counter')]
    return tuple(times[np.unique(np.concatenate(changes))].tolist())


def _find_utc_offset(topics: dict[str, Any]) -> float | None:
    """Return the median of UTC minus the log's clock [s] by a GPS receiver, or None without it."""
    for name in ('vehicle_gps_position', 'sensor_gps'):
        data = topics.get(name, {})
        utc = np.asarray(data.get('time_utc_usec', ()), float)
        valid = np.flatnonzero(utc > 0)
        if len(valid):
            return float(np.median((utc[valid] - data['timestamp'][valid]) * _US))
    return None


def _integrate_battery(data: Any) -> tuple[Array, Array] | None:
    """Return times [s] and energy drawn [J], the integral of U max(I, 0); None without U, I."""
    if data is None:
        return None
    names = [('voltage_v', 'current_a'), ('voltage_filtered_v', 'current_filtered_a')]
    for voltage, current in names:
        if voltage in data and current in data:
            times = data['timestamp'] * _US
            power = np.asarray(data[voltage], float) * np.maximum(data[current], 0.0)
            steps = np.diff(times) * (power[1:] + power[:-1]) / 2
            return times, np.append(0.0, np.cumsum(steps))
    return None


def _describe_offboard(status: Any) -> tuple[str, ...]:
    """Return a note of the times [s] in OFFBOARD, none if the log does not tell the mode."""
    if status is None or 'nav_state' not in status:
        return ()
    return describe_mode('OFFBOARD', status['timestamp'] * _US,
                         np.asarray(status['nav_state']) == _OFFBOARD)
