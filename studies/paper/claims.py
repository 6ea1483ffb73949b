"""The claims of the paper's Section IV, checked against the data of the study."""

from typing import NamedTuple

import numpy as np
from secure_uav_planner.apps.specification import BASELINES
from secure_uav_planner.output.table import markdown_table

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
    for point, plan in plans.items():
        if point.experiment in ('duration', 'duration, radius 0'):
            key = point.experiment == 'duration', point.scheme
            curves.setdefault(key, {})[point.x] = plan
    constant, optimised = (curves.pop((True, scheme)) for scheme in BASELINES)
    (_, proposed), (_, perfect) = sorted(curves.items(), reverse=True)
    schemes = {'fly-hover-fly, constant power': constant,
               'fly-hover-fly, optimised power': optimised,
               'proposed, radius 10 m': proposed, 'proposed, radius 0': perfect}
    long = max(proposed)
    return [*_of_rates(schemes, proposed, optimised, constant, perfect),
            *_of_the_long_flight(proposed[long], long),
            *(_full_speed(proposed[duration], duration) for duration in (102, 104))]


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


def _of_rates(schemes, proposed, optimised, constant, perfect):
    """Yield the Claims about rates; each argument has the Plans of a scheme by T."""
    rises = {name: np.diff([(plan.guaranteed_rate, plan.worst_case_rate)
                            for plan in curve.values()], axis=0).min()
             for name, curve in schemes.items()}
    yield Claim(
        'The rates of all four schemes increase with T', min(rises.values()) > 0,
        'smallest rise from one T to the next, guaranteed and worst case: ' + '; '.join(
            f'{name} {rise:+.4f}' for name, rise in rises.items()))

    short, long = min(proposed), max(proposed)
    ours, other = proposed[short], optimised[short]
    gain = ours.guaranteed_rate / other.guaranteed_rate - 1
    yield Claim(
        f'At T = {short:g} s the proposed design is similar to fly-hover-fly with optimised '
        'power', abs(gain) <= SIMILAR,
        f'{ours.guaranteed_rate:.3f} against {other.guaranteed_rate:.3f}, {gain:+.1%}; worst case '
        f'{ours.worst_case_rate:.3f} against {other.worst_case_rate:.3f}')

    ours, *others = (curve[long].guaranteed_rate for curve in (proposed, optimised, constant))
    gains = [ours / other - 1 for other in others]
    yield Claim(
        f'At T = {long:g} s it significantly outperforms both fly-hover-fly schemes',
        min(gains) > SIMILAR,
        f'{ours:.3f} against {others[0]:.3f} with optimised power, {gains[0]:+.1%}, and '
        f'{others[1]:.3f} with constant power, {gains[1]:+.1%}')

    gaps, worst_gaps = ({duration: 1 - getattr(plan, rate) / getattr(perfect[duration], rate)
                         for duration, plan in proposed.items()}
                        for rate in ('guaranteed_rate', 'worst_case_rate'))
    worst = max(gaps, key=gaps.get)
    yield Claim(
        'There is only a slight gap between radius 0 and radius 10 m', gaps[worst] <= SIMILAR,
        f'radius 10 m loses {gaps[long]:.1%} at T = {long:g} s and at most {gaps[worst]:.1%}, at '
        f'T = {worst:g} s; in the worst case {worst_gaps[long]:.1%} and {worst_gaps[worst]:.1%}')


def _of_the_long_flight(plan, duration):
    """Yield the Claims about where the UAVs hover, and how they fly there and back."""
    scenario = plan.scenario
    targets = (('the GN', scenario.ground_node),
               ('the eavesdropper', scenario.eavesdroppers[0].position))
    for uav, path, (name, target) in zip(scenario.uavs, plan.positions, targets):
        # Even if the UAV circles slowly, the middle of its flight is at its hovering position.
        place = path[len(path) // 2]
        stay = np.count_nonzero(np.linalg.norm(path - place, axis=1) < 5) * (
            scenario.slot_duration)
        away = np.linalg.norm(place - target)
        yield Claim(
            f'At T = {duration:g} s {uav.name} hovers close to but slightly away from {name}',
            1 < away <= CLOSE and stay > 0.2 * duration,
            f'{away:.1f} m away, at ({place[0]:.1f}, {place[1]:.1f}) m, within 5 m of there for '
            f'{stay:.0f} s')
    mirrored = plan.positions[:, ::-1] * [1, -1]
    apart = np.linalg.norm(plan.positions - mirrored, axis=-1).max()
    yield Claim(f'At T = {duration:g} s the paths back and forth are symmetric arcs', apart < 10,
                f'a path and its mirror image are at most {apart:.2f} m apart at any time')


def _full_speed(plan, duration):
    steps = np.linalg.norm(np.diff(plan.positions, axis=1), axis=-1)
    share = (steps >= 0.99 * plan.scenario.max_step[:, None]).mean(axis=1)
    return Claim(
        f'At T = {duration:g} s both UAVs fly at the maximum speed', share.min() >= 0.95,
        '; '.join(f'{uav.name} flies {part:.0%} of its moves at 99% or more of it, its mean is '
                  f'{moves.mean() / most:.1%}' for uav, part, moves, most in zip(
                      plan.scenario.uavs, share, steps, plan.scenario.max_step)))
