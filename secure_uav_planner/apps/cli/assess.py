"""The part `assess`: what a plan is worth when the world differs."""

import argparse
from dataclasses import fields, replace
import sys

from .main import DONE
from .missions import loaded, picture_file
from ...assessment import assess, World
from ...assessment.flown import read_flown
from ...errors import OptionError, PlanFileError, ScenarioError
from ...mission.propagation import Channel
from ...output.table import assessment_table
from ...plan.plan import Plan

_SUFFIXES = ('.png', '.svg', '.pdf')


def assess_plan(options: argparse.Namespace) -> int:
    """Assess a plan; return the exit status."""
    plan = loaded(options.plan, Plan.load, PlanFileError)
    file = picture_file(options, '.assess.png', _SUFFIXES)
    flown = None
    if options.flown is not None:
        try:
            flown = read_flown(options.flown, plan)
        except (OSError, UnicodeDecodeError) as error:
            raise OptionError(f'{options.flown} cannot be read: '
                              f'{getattr(error, "strerror", None) or error}') from None
    found = assess(plan, options.draws, options.seed, _world(options, plan), flown)
    print(assessment_table(found))
    try:
        from ...output.assessment_picture import save_assessment
    except ModuleNotFoundError as error:
        print(f'{error.name} is not installed, so nothing is drawn; pip install '
              '"secure_uav_planner[view]"', file=sys.stderr)
        return DONE
    save_assessment(found, file)
    print(f'\nwritten: {file}')
    return DONE


def _world(options: argparse.Namespace, plan: Plan) -> World:
    """Return the world that the options describe."""
    given = {field.name: getattr(options, field.name) for field in fields(World)
             if getattr(options, field.name, None) is not None}
    if 'covariance' in given:
        xx, xy, yy = given['covariance']
        given['covariance'] = ((xx, xy), (xy, yy))
    if 'positions' in given:
        if len(given['positions']) % 2:
            raise OptionError(f'--positions has {len(given["positions"])} numbers; it must have '
                              'x and y of each eavesdropper')
        given['positions'] = tuple(zip(given['positions'][::2], given['positions'][1::2]))
    if options.mean_gain:
        given['los_distance'] = None
    changes = {field.name: getattr(options, field.name) for field in fields(Channel)
               if getattr(options, field.name, None) is not None}
    if changes.get('los') == 'none':
        changes['los'] = None
    if changes:
        try:
            channel = plan.scenario.channel
            if 'rician_k_db' in changes and channel.outage is None:
                changes['outage'] = 0.5  # A channel with fading needs one; nothing here uses it.
            given['channel'] = replace(channel, **changes)
        except ScenarioError as error:
            raise OptionError(str(error)) from None
    return World(**given)
