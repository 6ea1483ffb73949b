"""The files of a flight: a log of each UAV, or one file of all."""

from collections.abc import Mapping
import os
from pathlib import Path
from typing import NamedTuple

from .bag import read_bag
from .course import Course
from .dataflash import read_dataflash
from .log import refuse_damage, silence, VehicleLog
from .telemetry import read_telemetry
from .text import read_csv, read_tum
from .ulog import read_ulog
from ...errors import LogFileError, OptionError, quote
from ...mission.files import checked_path
from ...plan.plan import Plan

_READERS = {'.ulg': read_ulog, '.bin': read_dataflash, '.tlog': read_telemetry, '.tum': read_tum,
            '.txt': read_tum}
_BAGS = ('.mcap', '.db3')

PathLike = str | os.PathLike[str]


class Recording(NamedTuple):
    """
    Logs of a flight.

    :ivar logs: the log of each UAV, by name in the order of the plan.
    :ivar files: the file of each log, by name.
    :ivar course: the plans that the flight was to fly.
    :ivar is_shared: whether all logs are in one file, on one clock.
    """

    logs: dict[str, VehicleLog]
    files: dict[str, Path]
    course: Course
    is_shared: bool


def read_recording(source: PathLike | Mapping[str, PathLike], plan: Plan) -> Recording:
    """
    Read the logs of a flight of a plan.

    :param source: as for read_flight.
    :raises OptionError: for a source that does not fit the plan.
    :raises LogFileError: for a file that is no log of this flight.
    """
    names = tuple(uav.name for uav in plan.scenario.uavs)
    if not isinstance(source, Mapping):
        if not isinstance(source, (str, os.PathLike)):
            raise OptionError(f'source is {quote(source)}; it must be a path, or a mapping of '
                              'paths', ('source',))
        path = Path(source)
        if path.is_dir() or path.suffix.lower() in (*_BAGS, '.csv'):
            return _read_common_file(path, plan, names)
        if len(names) > 1:
            raise OptionError(
                f'source is {quote(str(path))}; for several UAVs it must be a bag, a .csv, or '
                f'a log of each, such as {names[0]}=a.ulg {names[1]}=b.ulg')
        source = {names[0]: path}
    if {*source} != {*names}:
        raise OptionError(f'source has logs of {", ".join(map(str, source))}; it must have one of '
                          f'each of {", ".join(names)}')
    files = {name: Path(checked_path(source[name])) for name in names}
    return Recording({name: _read_log(path, name) for name, path in files.items()}, files,
                     Course((plan,)), len(names) == 1)


def _read_common_file(path: Path, plan: Plan, names: tuple[str, ...]) -> Recording:
    """Return the recording of all UAVs in one bag or CSV file."""
    with refuse_damage(path), silence():
        path.stat()  # Raises an error if there is no such file.
        if path.suffix.lower() == '.csv':
            logs, course = read_csv(path, names), Course((plan,))
        else:
            logs, course = read_bag(path, names, plan).follow(plan)
        missing = [name for name in names if name not in logs]
        if missing:
            raise LogFileError(f'it has no positions of {missing[0]}; it has '
                               f'{", ".join(logs) or "none"}')
    return Recording({name: logs[name] for name in names}, dict.fromkeys(names, path), course,
                     True)


def _read_log(path: Path, name: str) -> VehicleLog:
    """Return the log of the UAV `name`, by the reader for the file's ending."""
    kind = path.suffix.lower()
    if kind not in (*_READERS, '.csv'):
        raise LogFileError(f'{path} has the ending {quote(path.suffix)}; it must be one of '
                           f'{", ".join((*_READERS, ".csv"))}')
    with refuse_damage(path), silence():
        if path.is_dir():
            raise LogFileError('it is a folder')
        path.stat()  # Raises an error if there is no such file.
        if kind == '.csv':
            logs = read_csv(path, (name,))
            if name not in logs:
                raise LogFileError(f'it has no rows of {name}')
            return logs[name]
        return _READERS[kind](path)
