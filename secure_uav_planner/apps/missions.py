"""Missions: `new`, `check` and `link-budget`, and the input and output files of all commands."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import sys
import tempfile
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..assessment import assess
from ..errors import InfeasibleMissionError, OptionError
from ..mission.files import atomic_file
from ..mission.formats.mission_file import EXAMPLE, EXAMPLES, locate_error
from ..mission.propagation import reference_snr_db
from ..mission.scenario import Scenario
from ..model.airspace.clearance import CLOSE_DISTANCE, find_unseparated_pair
from ..model.limits import lift_limits, measure_energies
from ..model.problem import Problem
from ..optimize import fly_hover_fly, solve
from ..output.autopilots import changes
from ..plan.results import explain_silence

SHORTFALL_DRAWS = 200
"""Draws of the assessment that estimates how often a slot has less than its planned rate."""

_LONG_TRACK = 100.0  # Duration of a track, in flights, beyond which its unit may be wrong.
_SHORT_TRACK = 1.0  # Extent of a track [m] up to which its unit may be wrong.
_DEGREE = 1.0  # Extent below which coordinates may be degrees: a mission in m is larger.
_FAR = 50.0  # Distance of a short track from all ends of flights, in _SHORT_TRACK.

_Content = TypeVar('_Content')


def load_input(path: str, load: Callable[[str], _Content]) -> _Content:
    """Return load(path); raise an OptionError if the file cannot be read."""
    try:
        return load(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise OptionError(f'{path} cannot be read: {reason}') from None


def choose_picture(options: argparse.Namespace, default_suffix: str,
                   suffixes: Sequence[str]) -> Path:
    """Return the file of --out or beside the plan; refuse a wrong suffix, an unwritable file."""
    file = Path(options.out) if options.out else Path(options.plan).with_suffix(default_suffix)
    if file.suffix.lower() not in suffixes:
        raise OptionError(f'{file} has the suffix {file.suffix!r}; it must be one of '
                          f'{", ".join(suffixes)}')
    with _refusing(f'{file} cannot be written', '; choose another file with --out'):
        if file.is_dir():
            raise IsADirectoryError('it is a folder')
        _check_link(file)
        with tempfile.TemporaryFile(dir=file.parent):
            return file


def make_folder(folder: Path) -> Path:
    """Make a folder if needed and return it; raise an OptionError unless it is writable."""
    with _refusing(f'{folder} cannot be written to', '; choose another folder with --out'):
        if folder.is_file():
            raise NotADirectoryError('it is a file')
        _check_link(folder)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder


def _check_link(path: Path) -> None:
    """Raise an OSError for a link to nothing, such as a disk that is not mounted."""
    if path.is_symlink() and not path.exists():
        raise FileNotFoundError(f'it is a link to {os.readlink(path)}, which is not there')


@contextmanager
def _refusing(text: str, advice: str = '') -> Iterator[None]:
    """Turn an OSError into an OptionError with its reason between a text and advice."""
    try:
        yield
    except OSError as error:
        raise OptionError(f'{text}: {error.strerror or error}{advice}') from None


def create_mission(options: argparse.Namespace) -> None:
    """Write the example mission that the options name, by default the one with all fields."""
    path = Path(options.mission)
    if path.is_dir():
        raise OptionError(
            f'{path} is a folder; name a file in it, such as {path / "mission.yaml"}')
    if path.exists() and not options.force:
        raise OptionError(f'{path} is there already; --force replaces it')
    if path.suffix.lower() == '.json':
        raise OptionError(f'{path} cannot have comments as JSON; name it .yaml')
    with _refusing(f'{path} cannot be written'):
        _check_link(path)
    with _refusing(f'{path} cannot be written'), atomic_file(path) as file:
        file.write(EXAMPLES.get(options.example, EXAMPLE).read_text(encoding='utf-8'))
    print(f'{path} is written; edit it, then: secure_uav_planner check {path}')


def check_mission(options: argparse.Namespace) -> None:
    """Print that a mission can be flown, and notes; raise MissionFileError if it cannot."""
    scenario = load_input(options.mission, Scenario.load)
    with locating_errors(options.mission):
        # Whether the limits of energy can be met, only `solve` finds out.
        plan = fly_hover_fly(lift_limits(scenario))
        if scenario.limits_energy:
            solve(scenario, objective='guaranteed')
    jammers = len(scenario.uavs) - 1
    print(f'{options.mission}: {scenario.uavs[0].name} transmits, {jammers} '
          f'jam{"s" if jammers == 1 else ""}, {len(scenario.eavesdroppers)} '
          f'listen{"s" if len(scenario.eavesdroppers) == 1 else ""}; {scenario.slots} slots of '
          f'{scenario.slot_duration:g} s. It can be flown.')
    if not scenario.channel.is_guarantee:
        print(f'rates are {scenario.channel.promise}, not guaranteed: with fly-hover-fly, '
              f'{assess(plan, SHORTFALL_DRAWS).shortfall}')
    for text in _describe_budgets(scenario):
        print(text)
    if (names := find_unseparated_pair(scenario)):
        print(f'warning: nothing keeps {names[0]} and {names[1]} {CLOSE_DISTANCE:g} m apart'
              f'{scenario.boundaries.margin_text}; set separation, or altitudes that differ',
              file=sys.stderr)
    if (reason := explain_silence(scenario)):
        print(f'note: the rate is 0: {reason}', file=sys.stderr)
    for note in (*_note_tracks(scenario), *_note_degrees(scenario)):
        print(f'note: {note}', file=sys.stderr)
    if options.autopilot:
        print(*_autopilot_advice(options.autopilot, scenario), sep='\n')


def _note_tracks(scenario: Scenario) -> Iterator[str]:
    """Yield notes on tracks that do not cover the flight, or whose units may be wrong."""
    names = *scenario.ground_node_names, *scenario.eavesdropper_names
    tracks = [(name, receiver.track) for name, receiver in zip(
        names, (*scenario.ground_nodes, *scenario.eavesdroppers), strict=True)]
    ends = np.concatenate([scenario.starts, scenario.goals])
    flight = scenario.times[-1]
    for name, track in tracks:
        if track is None:
            continue
        times, places = np.array(track)[:, 0], np.array(track)[:, 1:3]
        covered = max(0.0, min(flight, times[-1]) - max(0.0, times[0]))
        if covered < flight * (1 - 1e-9):
            yield (f'the track of {name} covers {covered:g} of {flight:g} s; before and after, '
                   'it stands')
        if np.ptp(times) > _LONG_TRACK * flight:
            yield (f'the track of {name} lasts {np.ptp(times):g} s, the flight {flight:g} s; are '
                   'its times in seconds?')
        distance = np.linalg.norm(ends[:, None] - places, axis=-1).min()
        if np.ptp(places, axis=0).max() <= _SHORT_TRACK < _FAR * _SHORT_TRACK < distance:
            yield (f'the places of the track of {name} are within {_SHORT_TRACK:g} m, and '
                   f'{distance:g} m from all starts and goals; are its positions in metres?')


def _note_degrees(scenario: Scenario) -> Iterator[str]:
    """Yield a note on each group of places [m] that may be degrees: < _DEGREE wide, all <= 180."""
    groups: list[tuple[str, ArrayLike]] = [('starts, goals and receivers', scenario.landmarks), *(
        (name, zone.vertices) for name, zone in zip(
            scenario.zone_names, scenario.no_fly_zones, strict=True))]
    if scenario.geofence is not None:
        groups.append(('the geofence', scenario.geofence))
    for name, places in groups:
        places = np.asarray(places)
        if np.ptp(places, axis=0).max() < _DEGREE and np.abs(places).max() <= 180.0:
            yield (f'{name}: all places are within {_DEGREE:g} m; are they degrees? Those are '
                   '{latitude: , longitude: }, and the mission has an origin')


def _describe_budgets(scenario: Scenario) -> Iterator[str]:
    """Yield, for each max_energy, the shares that hovering and the straight path take."""
    straight = measure_energies(scenario, Problem(scenario).grid.reference_flight)
    for uav, energy in zip(scenario.uavs, straight.tolist(), strict=True):
        if uav.max_energy is not None and uav.propulsion is not None:
            hovering = float(uav.propulsion.power(0.0)) * scenario.slot_duration * (
                scenario.slots + 2)  # max_energy needs max_acceleration: N + 2 slots of flight.
            yield (f'{uav.name}: by the model, hovering all the time takes '
                   f'{hovering / uav.max_energy:.0%} of max_energy, and the straight way '
                   f'{energy / uav.max_energy:.0%}')


@contextmanager
def locating_errors(path: str) -> Iterator[None]:
    """Turn an InfeasibleMissionError into a MissionFileError with lines of the mission file."""
    try:
        yield
    except InfeasibleMissionError as error:
        raise locate_error(path, error) from None


def _autopilot_advice(autopilot: str, scenario: Scenario) -> Iterator[str]:
    """Yield lines for each group of UAVs with equal limits: parameters to change, or why none."""
    groups: dict[tuple[float, float | None], list[str]] = {}
    for uav in scenario.uavs:
        groups.setdefault((uav.max_speed, uav.max_acceleration), []).append(uav.name)
    for (speed, acceleration), names in groups.items():
        uavs = f'{", ".join((autopilot, *names))} at {speed:g} m/s'
        if acceleration is None:
            yield f'{uavs}: no autopilot follows a plan without max_acceleration'
            continue
        uavs += f' and {acceleration:g} m/s^2'
        parameters = changes(autopilot, speed, acceleration)
        if not parameters:
            yield f'{uavs}: the defaults suffice'
        for parameter, value in parameters:
            text = f'set {parameter.name} to {value:g} {parameter.unit}'
            if (least := parameter.least(speed, acceleration)) > value:
                text = (f'{parameter.name} would have to be {least:.4g} {parameter.unit}; lower '
                        'max_speed or max_acceleration')
            yield f'{uavs}: {text} (default {parameter.default:g}, at most {parameter.most:g})'


def print_link_budget(options: argparse.Namespace) -> None:
    """Print the reference SNR."""
    snr = reference_snr_db(options.carrier_hz, options.bandwidth_hz, options.noise_figure_db,
                           options.transmit_gain_dbi, options.receive_gain_dbi)
    print(f'reference_snr_db: {snr:.2f}')
