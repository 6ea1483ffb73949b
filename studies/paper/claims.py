"""The claims of the paper's Section IV, checked against the data of the study."""

from typing import NamedTuple

import numpy as np
from secure_uav_planner.apps.campaign_file import BASELINES
from secure_uav_planner.output.tables import markdown_table

SIMILAR = 0.10
"""Rates that differ by at most this share count as similar, and the gap between them as slight."""

CLOSE = 50.0
"""A hovering position at most this far away counts as close, in m: a quarter of the distance
between the ground node and the eavesdropper."""


class Claim(NamedTuple):
    """A claim of the paper, its figure, whether the data confirm it, and the evidence."""

    text: str
    figure: int
    holds: bool
    numbers: str


def check_claims(plans):
    """
    Return all Claims, checked.

    :param plans: the result of load_plans.
    """
    curves = {}  # The Plans by T, in its order, by (radius 0 or not, scheme).
    for point, plan in plans.items():
        if point.experiment in ('duration', 'duration, radius 0'):
            key = point.experiment == 'duration', point.scheme
            curves.setdefault(key, {})[point.x] = plan
    constant, optimised = (curves.pop((True, scheme)) for scheme in BASELINES)
    (_, proposed), (_, perfect) = sorted(curves.items(), reverse=True)
    longest = max(proposed)
    return [*_check_hovering(proposed[longest], longest),
            *(_check_speed(proposed[duration], duration) for duration in (102, 104)),
            *_check_rates(proposed, optimised, constant, perfect)]


def write_claims(plans, path):
    """Write the Claims as Markdown; return the path and the table."""
    table = markdown_table(('claim', 'figure', 'holds', 'numbers'), (
        (claim.text, claim.figure, 'yes' if claim.holds else '**no**', claim.numbers)
        for claim in check_claims(plans)))
    path.write_text(
        '# The claims of the paper in the data\n\n'
        f'Similar and slight: within {SIMILAR:.0%}. Close: within {CLOSE:g} m. Rates are means '
        f'over slots in bit/s/Hz, guaranteed unless they say otherwise.\n\n{table}\n',
        encoding='utf-8')
    return path, table


def _check_rates(proposed, optimised, constant, perfect):
    """Yield the Claims about rates; each argument has the Plans of a scheme by T."""
    schemes = {'fly-hover-fly, constant power': constant,
               'fly-hover-fly, optimised power': optimised,
               'proposed, radius 10 m': proposed, 'proposed, radius 0': perfect}
    rises = {name: np.diff([(plan.guaranteed_rate, plan.worst_case_rate)
                            for plan in curve.values()], axis=0).min()
             for name, curve in schemes.items()}
    yield Claim(
        'The rates of all four schemes increase with T', 3, min(rises.values()) > 0,
        'smallest rise from one T to the next, guaranteed and worst case: ' + '; '.join(
            f'{name} {rise:+.4f}' for name, rise in rises.items()))

    short, long = min(proposed), max(proposed)
    plan, baseline = proposed[short], optimised[short]
    gain = plan.guaranteed_rate / baseline.guaranteed_rate - 1
    yield Claim(
        f'At T = {short:g} s the proposed design is similar to fly-hover-fly with optimised '
        'power', 3, abs(gain) <= SIMILAR,
        f'{plan.guaranteed_rate:.3f} against {baseline.guaranteed_rate:.3f}, {gain:+.1%}; worst '
        f'case {plan.worst_case_rate:.3f} against {baseline.worst_case_rate:.3f}')

    rate, *baselines = (curve[long].guaranteed_rate for curve in (proposed, optimised, constant))
    gains = [rate / baseline - 1 for baseline in baselines]
    yield Claim(
        f'At T = {long:g} s it significantly outperforms both fly-hover-fly schemes', 3,
        min(gains) > SIMILAR,
        f'{rate:.3f} against {baselines[0]:.3f} with optimised power, {gains[0]:+.1%}, and '
        f'{baselines[1]:.3f} with constant power, {gains[1]:+.1%}')

    gaps, worst_gaps = ({duration: 1 - getattr(plan, rate) / getattr(perfect[duration], rate)
                         for duration, plan in proposed.items()}
                        for rate in ('guaranteed_rate', 'worst_case_rate'))
    widest = max(gaps, key=gaps.get)
    yield Claim(
        'There is only a slight gap between radius 0 and radius 10 m', 3,
        gaps[widest] <= SIMILAR,
        f'radius 10 m loses {gaps[long]:.1%} at T = {long:g} s and at most {gaps[widest]:.1%}, at '
        f'T = {widest:g} s; in the worst case {worst_gaps[long]:.1%} and {worst_gaps[widest]:.1%}')


def _check_hovering(plan, duration):
    """Yield the Claims about the hovering positions, and the paths there and back."""
    scenario = plan.scenario
    targets = (('the GN', scenario.ground_node),
               ('the eavesdropper', scenario.eavesdroppers[0].position))
    for uav, path, (name, target) in zip(scenario.uavs, plan.positions, targets):
        # Even if the UAV circles slowly, the middle of its flight is at its hovering position.
        hover = path[len(path) // 2]
        stay = np.count_nonzero(np.linalg.norm(path - hover, axis=1) < 5) * (
            scenario.slot_duration)
        distance = np.linalg.norm(hover - target)
        yield Claim(
            f'At T = {duration:g} s {uav.name} hovers close to but slightly away from {name}', 2,
            1 < distance <= CLOSE and stay > 0.2 * duration,
            f'{distance:.1f} m away, at ({hover[0]:.1f}, {hover[1]:.1f}) m, within 5 m of there '
            f'for {stay:.0f} s')
    mirrored = plan.positions[:, ::-1] * [1, -1]
    distance = np.linalg.norm(plan.positions - mirrored, axis=-1).max()
    yield Claim(f'At T = {duration:g} s the paths back and forth are symmetric arcs', 2,
                distance < 10,
                f'a path and its mirror image are at most {distance:.2f} m apart at any time')


def _check_speed(plan, duration):
    steps = np.linalg.norm(np.diff(plan.positions, axis=1), axis=-1)
    share = (steps >= 0.99 * plan.scenario.max_step[:, None]).mean(axis=1)
    return Claim(
        f'At T = {duration:g} s both UAVs fly at the maximum speed', 2, share.min() >= 0.95,
        '; '.join(f'{uav.name} flies {part:.0%} of its moves at 99% or more of it, its mean is '
                  f'{moves.mean() / most:.1%}' for uav, part, moves, most in zip(
                      plan.scenario.uavs, share, steps, plan.scenario.max_step)))
