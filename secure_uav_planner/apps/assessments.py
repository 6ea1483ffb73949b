"""`assess`: a saved plan in other worlds, and a flight against its plan."""

import argparse
from collections.abc import Sequence
from dataclasses import fields, replace
import json
from pathlib import Path
import re
from typing import Any

from .cli import FAILED, UNCOVERED
from .missions import choose_picture
from .planning import drawing_if_possible
from ..assessment import assess, World
from ..assessment.flown import compare, Comparison, read_flight
from ..errors import OptionError, quote, ScenarioError
from ..mission.propagation import Channel
from ..output.tables import assessment_table
from ..plan.plan import Plan

_PICTURES, _PAGE = ('.png', '.svg', '.pdf'), '.html'


def assess_plan(options: argparse.Namespace) -> int | None:
    """Assess a plan, or compare a flight with it; return the exit status of a flight."""
    plan = Plan.load(options.plan)
    if options.flown:
        return compare_flight(plan, options)
    for name in ('at', 'shift', 'json'):
        if getattr(options, name):
            raise OptionError(f'--{name} is for a flight; give its logs with --flown, too')
    file = choose_picture(options, '.assess.png', _PICTURES)
    assessment = assess(plan, options.draws, options.seed, _parse_world(options, plan))
    print(assessment_table(assessment))
    with drawing_if_possible(file):
        from ..output.figures import save_assessment
        save_assessment(assessment, file)
        print(f'\nwritten: {file}')
    return None


def _parse_world(options: argparse.Namespace, plan: Plan) -> World:
    """Return the World of the options, with the plan's channel unless options change it."""
    # Options that are fields of World, and options that are fields of Channel.
    values, changes = ({
        field.name: value for field in fields(kind)
        if (value := getattr(options, field.name, None)) is not None} for kind in (World, Channel))
    if 'covariance' in values:
        xx, xy, yy = values['covariance']
        values['covariance'] = ((xx, xy), (xy, yy))
    if 'positions' in values:
        if len(values['positions']) % 2:
            raise OptionError(f'--positions has {len(values["positions"])} numbers; it must have '
                              'x and y of each eavesdropper')
        values['positions'] = tuple(zip(values['positions'][::2], values['positions'][1::2]))
    if options.speed_factor is not None and not any(
            eve.track for eve in plan.scenario.eavesdroppers):
        raise OptionError(f'--speed-factor is {options.speed_factor:g}; the plan must have an '
                          'eavesdropper with a track')
    if options.mean_gain:
        values['los_distance'] = None
    if changes:
        values['channel'] = _change_channel(plan.scenario.channel, changes)
    try:
        return World(**values)
    except OptionError as error:
        raise OptionError(f'--{str(error.place[0]).replace("_", "-")}: {error}') from None


def _change_channel(channel: Channel, changes: dict[str, Any]) -> Channel:
    """Return the channel with `changes`, in which los 'none' becomes None and outage is set."""
    if changes.get('los') == 'none':
        changes['los'] = None
    # A channel with fading needs an outage, which the draws do not use.
    fading = changes.get('rician_k_db', channel.rician_k_db)
    changes['outage'] = None if fading is None else 0.5
    try:
        return replace(channel, **changes)
    except ScenarioError as error:
        raise OptionError(str(error)) from None


def compare_flight(plan: Plan, options: argparse.Namespace) -> int | None:
    """Print and draw a comparison; return FAILED (a slot broke), UNCOVERED (gaps) or None."""
    flight = read_flight(_parse_logs(options.flown), plan, options.at,
                         _parse_shifts(options.shift or ()))
    comparison = compare(plan, flight)
    file = choose_picture(options, '.flown.png', (*_PICTURES, _PAGE)) if (
        options.out or not options.json) else None
    print(json.dumps(comparison.to_dict(), indent=2) if options.json else comparison.summary())
    if file is not None:
        with drawing_if_possible(file):
            _save_comparison(comparison, file)
            if not options.json:
                print(f'\nwritten: {file}')
    if comparison.broken.any():
        return FAILED
    return None if comparison.covered.all() else UNCOVERED


def _save_comparison(comparison: Comparison, file: Path) -> None:
    """Save a comparison as a page or as a picture, by the suffix of the file."""
    if file.suffix.lower() == _PAGE:
        from ..output.page import save_page
        save_page(comparison.plan, file, comparison=comparison)
    else:
        from ..output.flown_picture import save_comparison
        save_comparison(comparison, file)


def _parse_logs(words: Sequence[str]) -> Any:
    """Return the source of read_flight: one file of all UAVs, or a mapping from UAV to file."""
    if len(words) == 1 and '=' not in words[0]:
        return words[0]
    logs: dict[str, str] = {}
    for word in words:
        name, equals, path = word.partition('=')
        if not (equals and name and path) or name in logs:
            raise OptionError(f'--flown has {quote(word)}; it must be one file, or UAV=FILE once '
                              'for each UAV')
        logs[name] = path
    return logs


def _parse_shifts(words: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Return {UAV: (x, y) [m]} of words UAV=X,Y, or raise OptionError."""
    shifts: dict[str, tuple[float, ...]] = {}
    for word in words:
        match = re.fullmatch(r'(.+)=([^,]+),([^,]+)', word)
        try:
            name, *numbers = match.groups() if match else ()
            if name in shifts:
                raise ValueError
            shifts[name] = tuple(map(float, numbers))
        except ValueError:
            raise OptionError(f'--shift has {quote(word)}; it must be UAV=X,Y in m, once for each '
                              'UAV') from None
    return shifts
