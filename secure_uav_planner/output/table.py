"""Tables of text: rates of plans and of assessments for a terminal, and Markdown."""

from collections.abc import Iterable, Sequence
import math
from typing import Any

import numpy as np

from ..mission import OBJECTIVES

_NAME, _RATE, _TIME = 26, 17, 9  # Widths of columns.


def table(plans: Sequence[Any], bound: Any = None) -> str:
    """
    Return a text table with a line for each Plan and one for a Bound, if there is one.

    Where plans have bounds, a column has the largest share of the best rate that they may miss.
    Where rates are not guaranteed, a line says so. Where UAVs have a propulsion, lines with what
    their flights take follow.
    """
    channel = plans[0].scenario.channel
    names = (channel.rate_name(objective).removesuffix(f' {channel.promise}')
             for objective in OBJECTIVES)
    rows = [('scheme', *names, 'time', 'below the best'),
            ('', 'bit/s/Hz', 'bit/s/Hz', 's', 'at most')]
    rows += [(plan.method, f'{plan.guaranteed_rate:.4f}', f'{plan.worst_case_rate:.4f}',
              f'{plan.solve_time:.2f}', _missing(plan)) for plan in plans]
    if bound is not None:
        rates = {'guaranteed': '', 'worst_case': '', bound.objective: f'{bound.rate:.4f}'}
        rows.append(('bound of any plan', *rates.values(), f'{bound.solve_time:.2f}', ''))
    known = any(plan.bound is not None for plan in plans)
    text = _aligned(rows, (_RATE, _RATE, _TIME, *[_RATE] * known))
    if not channel.is_guarantee:
        text += f'\n\nrates {channel.promise}, not guaranteed'
    energies = [(plan.method, uav.name, *(f'{joules:.0f}' for joules in energy)) for plan in plans
                for uav, energy in zip(plan.scenario.uavs, plan.energies) if energy is not None]
    if energies:
        width = max(_TIME, *(len(name) + 2 for _, name, *_ in energies))
        text += '\n\n' + _aligned(
            (('scheme', 'UAV', 'energy', 'hovering', 'flying'), ('', '', 'J', 'J', 'J'),
             *energies), (width, _RATE, _RATE, _RATE))
    return text


def _aligned(rows: Iterable[Sequence[str]], widths: Sequence[int]) -> str:
    """Return rows as lines: a name, and as many right-aligned cells as there are widths."""
    return '\n'.join(
        (f'{name:<{_NAME}}' + ''.join(f'{cell:>{width}}' for cell, width in zip(cells, widths)))
        .rstrip() for name, *cells in rows)


def _missing(plan: Any) -> str:
    """Return the largest share of the best possible rate that a plan may miss."""
    if plan.bound is None:
        return 'unknown'
    # Rounded up, as all that is said to be proven.
    return f'{math.ceil(1000 * plan.bound.share_missing(plan)) / 10:.1f}%'


def assessment_table(assessment: Any) -> str:
    """Return a text table of what an Assessment found beside what its plan promised, or said."""
    found = assessment.summary
    rates = (found['promised'], found['mean'], found['quantile_5'], found['quantile_50'])
    delivered = (found['promised_delivery'], found['delivered'],
                 *np.quantile(assessment.delivered, (0.05, 0.5)))
    outages = assessment.outages.mean(), found['outage']
    is_promise = assessment.plan.scenario.channel.is_guarantee
    name = 'promised' if is_promise else 'planned'
    text = _aligned((
        (f'of {assessment.draws} draws', name, 'mean', '5%', '50%'),
        ('secrecy rate, bit/s/Hz', *(f'{rate:.4f}' for rate in rates)),
        ('delivered, bit/Hz', *(f'{bits:.4f}' for bits in delivered)), ('',),
        ('of all slots', 'promised', 'mean', 'largest'),
        ('outage', assessment.promised_outage_text, *(f'{share:.4%}' for share in outages))),
        [_RATE] * 4)
    return text if is_promise else f'{text}\n\nplanned {assessment.claim}: no promise'


def markdown_table(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return rows of cells as a table in Markdown."""
    lines = (head, ['---'] * len(head), *rows)
    return '\n'.join(f'| {" | ".join(map(str, line))} |' for line in lines)
