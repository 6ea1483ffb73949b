"""The claims of the paper's Section IV, checked against the data of the study."""

from typing import NamedTuple

import numpy as np

from ..campaign.specification import BASELINES
from ...output.table import markdown_table

SIMILAR = 0.10
"""Rates that differ by at most this share count as similar, and the gap between them as slight."""

CLOSE = 50.0
"""A hovering position at most this far away counts as close, in m: a quarter of the distance
between the ground node and the eavesdropper."""


class Claim(NamedTuple):
    """A claim of the paper, whether the data confirm it, and the evidence as a sentence."""

    text: str
    holds: bool
    numbers: str


def check_claims(plans):
    """
    Return all Claims, checked.

    :param plans: the result of study.plans_of.
    """
    curves = {}  # The Plans by T, in its order, by (radius 0 or not, scheme).
    for point, plan in sorted(plans.items(), key=lambda entry: entry[0].x):
        if point.experiment in ('duration', 'duration, radius 0'):
            key = point.experiment == 'duration', point.scheme
            curves.setdefault(key, {})[point.x] = plan
    constant, optimised = (curves.pop((True, scheme)) for scheme in BASELINES)
    (_, proposed), (_, perfect) = sorted(curves.items(), reverse=True)
    schemes = {'fly-hover-fly, constant power': constant,
               'fly-hover-fly, optimised power': optimised,
               'proposed, radius 10 m': proposed, 'proposed, radius 0': perfect}
    short, long = min(proposed), max(proposed)
    return [
        _grows(schemes),
        _similar_when_short(proposed[short], optimised[short], short),
        _better_when_long(proposed[long], optimised[long], constant[long], long),
        _gap_is_slight(proposed, perfect),
        *_hovering(proposed[long], long),
        _symmetric(proposed[long], long),
        *(_full_speed(proposed[duration], duration) for duration in (102, 104)
          if duration in proposed),
    ]


def write_claims(plans, path):
    """Write the Claims as a Markdown table; return the path."""
    table = markdown_table(('claim', 'holds', 'numbers'), (
        (claim.text, 'yes' if claim.holds else '**no**', claim.numbers)
        for claim in check_claims(plans)))
    path.write_text(
        '# The claims of the paper in the data\n\n'
        f'Similar and slight: within {SIMILAR:.0%}. Close: within {CLOSE:g} m. Rates are means '
        f'over slots in bit/s/Hz, guaranteed unless they say otherwise.\n\n{table}\n',
        encoding='utf-8')
    return path


def _grows(schemes):
    rises = {name: np.diff([(plan.guaranteed_rate, plan.worst_case_rate)
                            for plan in curve.values()], axis=0).min()
             for name, curve in schemes.items()}
    return Claim(
        'The rates of all four schemes increase with T', min(rises.values()) > 0,
        'smallest rise from one T to the next, guaranteed and worst case: ' + '; '.join(
            f'{name} {rise:+.4f}' for name, rise in rises.items()))


def _similar_when_short(proposed, optimised, duration):
    gain = proposed.guaranteed_rate / optimised.guaranteed_rate - 1
    return Claim(
        f'At T = {duration:g} s the proposed design is similar to fly-hover-fly with optimised '
        'power', abs(gain) <= SIMILAR,
        f'{proposed.guaranteed_rate:.3f} against {optimised.guaranteed_rate:.3f}, {gain:+.1%}; '
        f'worst case {proposed.worst_case_rate:.3f} against {optimised.worst_case_rate:.3f}')


def _better_when_long(proposed, optimised, constant, duration):
    gains = [proposed.guaranteed_rate / other.guaranteed_rate - 1
             for other in (optimised, constant)]
    return Claim(
        f'At T = {duration:g} s it significantly outperforms both fly-hover-fly schemes',
        min(gains) > SIMILAR,
        f'{proposed.guaranteed_rate:.3f} against {optimised.guaranteed_rate:.3f} with optimised '
        f'power, {gains[0]:+.1%}, and {constant.guaranteed_rate:.3f} with constant power, '
        f'{gains[1]:+.1%}')


def _gap_is_slight(proposed, perfect):
    gaps = {duration: 1 - plan.guaranteed_rate / perfect[duration].guaranteed_rate
            for duration, plan in proposed.items()}
    worst = max(gaps, key=gaps.get)
    last = max(gaps)
    return Claim(
        'There is only a slight gap between radius 0 and radius 10 m', gaps[worst] <= SIMILAR,
        f'radius 10 m loses {gaps[last]:.1%} at T = {last:g} s and at most {gaps[worst]:.1%}, at '
        f'T = {worst:g} s; in the worst case '
        f'{1 - proposed[last].worst_case_rate / perfect[last].worst_case_rate:.1%} and '
        f'{1 - proposed[worst].worst_case_rate / perfect[worst].worst_case_rate:.1%}')


def _hovering(plan, duration):
    scenario = plan.scenario
    steps = np.linalg.norm(np.diff(plan.positions, axis=1), axis=-1)
    targets = (('the GN', scenario.ground_node),
               ('the eavesdropper', scenario.eavesdroppers[0].position))
    for uav, path, moves, (name, target) in zip(scenario.uavs, plan.positions, steps, targets):
        # Even if the UAV circles slowly, the middle of its flight is at its hovering position.
        place = path[len(path) // 2]
        stay = np.count_nonzero(np.linalg.norm(path - place, axis=1) < 5) * (
            scenario.slot_duration)
        away = np.linalg.norm(place - target)
        yield Claim(
            f'At T = {duration:g} s {uav.name} hovers close to but slightly away from {name}',
            bool(1 < away <= CLOSE and stay > 0.2 * duration),
            f'{away:.1f} m away, at ({place[0]:.1f}, {place[1]:.1f}) m, within 5 m of there for '
            f'{stay:.0f} s')


def _symmetric(plan, duration):
    mirrored = plan.positions[:, ::-1] * [1, -1]
    apart = np.linalg.norm(plan.positions - mirrored, axis=-1).max()
    return Claim(f'At T = {duration:g} s the paths back and forth are symmetric arcs',
                 bool(apart < 10),
                 f'a path and its mirror image are at most {apart:.2f} m apart at any time')


def _full_speed(plan, duration):
    steps = np.linalg.norm(np.diff(plan.positions, axis=1), axis=-1)
    share = (steps >= 0.99 * plan.scenario.max_step[:, None]).mean(axis=1)
    return Claim(
        f'At T = {duration:g} s both UAVs fly at the maximum speed', bool(share.min() >= 0.95),
        '; '.join(f'{uav.name} flies {part:.0%} of its moves at 99% or more of it, its mean is '
                  f'{moves.mean() / most:.1%}' for uav, part, moves, most in zip(
                      plan.scenario.uavs, share, steps, plan.scenario.max_step)))
