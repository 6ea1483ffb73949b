"""Missions: `new`, `check` and `link-budget`, and how all parts read and write files."""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
import tempfile
from typing import TypeVar

from .main import DONE
from ...errors import OptionError, PlanningError, ScenarioError
from ...mission.files import atomic_file
from ...mission.formats.example import EXAMPLE
from ...mission.link_budget import RANGES, reference_snr_db
from ...mission.scenario import Scenario
from ...output.autopilot_limits import changes

_Content = TypeVar('_Content')


def loaded(path: str, load: Callable[[str], _Content] = Scenario.load,
           kind: type[PlanningError] = ScenarioError) -> _Content:
    """
    Return what a file holds.

    :param load: what reads it.
    :param kind: of the error for a file that cannot be read.
    """
    try:
        return load(path)
    except OSError as error:
        raise kind(f'{path} cannot be read: {error.strerror or error}') from None


def writable(folder: Path) -> Path:
    """
    Return a folder after it has been made and tried; the work before would be in vain.

    :raises OptionError: when it cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise OptionError(
            f'{folder} cannot be written to: {error.strerror or error}; choose another folder '
            'with --out') from None


def new(options: argparse.Namespace) -> int:
    """Write the example; return the exit status."""
    path = Path(options.mission)
    if path.exists() and not options.force:
        raise OptionError(f'{path} is there already; --force replaces it')
    if path.suffix.lower() == '.json':
        raise OptionError(f'{path} cannot have comments as JSON; name it .yaml')
    try:
        with atomic_file(path) as file:
            file.write(EXAMPLE)
    except OSError as error:
        raise OptionError(f'{path} cannot be written: {error.strerror or error}') from None
    print(f'{path} is written; edit it, then: secure_uav_planner check {path}')
    return DONE


def check(options: argparse.Namespace) -> int:
    """Check a mission; return the exit status."""
    scenario = loaded(options.mission)
    jammers = len(scenario.uavs) - 1
    print(f'{options.mission}: {scenario.uavs[0].name} transmits, {jammers} '
          f'jam{"s" if jammers == 1 else ""}, {len(scenario.eavesdroppers)} '
          f'listen{"s" if len(scenario.eavesdroppers) == 1 else ""}; {scenario.slots} slots of '
          f'{scenario.slot_duration:g} s. It can be flown.')
    if options.autopilot:
        print(*_advice(options.autopilot, scenario), sep='\n')
    return DONE


def _advice(autopilot: str, scenario: Scenario) -> Iterator[str]:
    """Yield in words what an autopilot needs to follow each UAV's plan."""
    alike: dict[tuple[float, float | None], list[str]] = {}
    for uav in scenario.uavs:
        alike.setdefault((uav.max_speed, uav.max_acceleration), []).append(uav.name)
    for (speed, acceleration), names in alike.items():
        uavs = f'{", ".join((autopilot, *names))} at {speed:g} m/s'
        if acceleration is None:
            yield f'{uavs}: no autopilot follows a plan without max_acceleration'
            continue
        uavs += f' and {acceleration:g} m/s^2'
        found = changes(autopilot, speed, acceleration)
        if not found:
            yield f'{uavs}: the defaults suffice'
        for parameter, value in found:
            text = f'set {parameter.name} to {value:g} {parameter.unit}'
            if (least := parameter.least(speed, acceleration)) > value:
                text = (f'{parameter.name} would have to be {least:.0f} {parameter.unit}; lower '
                        'max_speed or max_acceleration')
            yield f'{uavs}: {text} (default {parameter.default:g}, at most {parameter.most:g})'


def link_budget(options: argparse.Namespace) -> int:
    """Print the reference SNR; return the exit status."""
    snr = reference_snr_db(**{name: getattr(options, name) for name in RANGES})
    print(f'reference_snr_db: {snr:.2f}')
    return DONE
