"""Where UAVs really were: flights as CSV files or bags."""

import csv
import math
import os
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ..errors import OptionError, shown
from ..mission.files import checked_path, read_text
from ..mission.scenario import Array
from ..mission.validation import checked_kind, RANGES
from ..plan.plan import Plan

COLUMNS = ('uav', 'time', 'x', 'y')
"""The columns that a file must have, in any order: a UAV's name, s from point 0, and m."""

_MOST_BYTES = 2**28
_Sample: TypeAlias = tuple[float, float, float]  # Time in s from point 0, x and y in m.


def read_flown(path: str | os.PathLike[str], plan: Plan) -> Array:
    """
    Return where the UAVs of a plan were at the times of its slots, (U, N, 2) in m.

    Between the lines of a UAV, whose times must increase, it flew straight.

    :param path: a CSV file with COLUMNS and perhaps others, such as plan.csv; or a bag, whose name
        ends with .mcap, with nav_msgs/Odometry on `<uav>/odom` in the plan's frame, by its stamps.
    :raises OSError: when it cannot be read, is no regular file, or is too large.
    :raises OptionError: naming the line and what is wrong.
    """
    names = [uav.name for uav in checked_kind('plan', plan, Plan).scenario.uavs]
    is_bag = Path(checked_path(path)).suffix == '.mcap'
    tracks = _of_bag(path, plan) if is_bag else _of_csv(path, names)
    times = plan.times[1:-1]
    found = []
    for name in names:
        if name not in tracks:
            raise OptionError(f'{path} has nothing of {name}')
        known, x, y = np.array(tracks[name]).T
        if known[0] > times[0] or known[-1] < times[-1]:
            raise OptionError(f'{path} has {name} from {known[0]:g} to {known[-1]:g} s; it must '
                              f'be from {times[0]:g} to {times[-1]:g} s or longer')
        found.append(np.stack([np.interp(times, known, x), np.interp(times, known, y)], axis=-1))
    return np.stack(found)


def _of_bag(path: str | os.PathLike[str], plan: Plan) -> dict[str, list[_Sample]]:
    """Return the samples of each UAV in an MCAP file."""
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ModuleNotFoundError as error:
        raise OptionError(f'{error.name} is not installed, which reads bags; pip install '
                          'mcap-ros2-support') from None
    if plan.start_ns is None:
        raise OptionError('the plan has no start_ns, so the times of a bag say nothing; it must '
                          'be one that was flown')
    tracks: dict[str, list[_Sample]] = {}
    with open(path, 'rb') as file:
        try:
            messages = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, odometry in messages.iter_decoded_messages():
                *_, name, topic = ['', *channel.topic.split('/')]
                if topic != 'odom':
                    continue
                stamp, place = odometry.header.stamp, odometry.pose.pose.position
                time = (stamp.sec * 10**9 + stamp.nanosec - plan.start_ns) * 1e-9
                track = tracks.setdefault(name, [])
                if not track or time > track[-1][0]:
                    track.append((time, place.x, place.y))
        except McapError as error:
            raise OptionError(f'{path} is no bag that can be read: {error}') from None
    return tracks


def _of_csv(path: str | os.PathLike[str], names: list[str]) -> dict[str, list[_Sample]]:
    """Return the samples of each UAV in a CSV file."""
    tracks: dict[str, list[_Sample]] = {}
    low, high = RANGES['coordinate']
    reader = csv.DictReader(read_text(path, _MOST_BYTES).splitlines())
    try:
        if missing := [name for name in COLUMNS if name not in (reader.fieldnames or ())]:
            raise OptionError(f'{path}:1: it lacks the columns {", ".join(missing)}')
        for row in reader:
            line, name, sample = f'{path}:{reader.line_num}', row['uav'], []
            for field in COLUMNS[1:]:
                try:
                    sample.append(float(row[field]))
                except (TypeError, ValueError):
                    sample.append(math.nan)
                if not low <= sample[-1] <= high:
                    raise OptionError(f'{line}: {field} is {shown(row[field])}; it must be a '
                                      f'number from {low:g} to {high:g}')
            if name not in names:
                raise OptionError(
                    f'{line}: uav is {shown(name)}; it must be one of {", ".join(names)}')
            track = tracks.setdefault(name, [])
            if track and sample[0] <= track[-1][0]:
                raise OptionError(f'{line}: time is {sample[0]:g} s; it must be after the last of '
                                  f'{name}, which is {track[-1][0]:g} s')
            track.append((sample[0], sample[1], sample[2]))
    except csv.Error as error:
        raise OptionError(f'{path}:{reader.line_num}: {error}') from None
    return tracks
