"""Tables of text: rates of plans and of assessments for a terminal, and Markdown."""

from collections.abc import Iterable, Iterator, Sequence
import math
from typing import Any

import numpy as np

_NAME, _RATE, _TIME = 26, 17, 9


def table(plans: Sequence[Any], bound: Any = None) -> str:
    """
    Return a text table with a line for each Plan and one for a Bound, if there is one.

    Where plans have bounds, a column has the largest share of the best rate that they may miss.
    Where UAVs have a propulsion, lines with what their flights take follow.
    """
    known = any(plan.bound is not None for plan in plans)
    lines = [f'{"scheme":<{_NAME}}{"guaranteed rate":>{_RATE}}{"worst-case rate":>{_RATE}}'
             f'{"time":>{_TIME}}' + f'{"below the best":>{_RATE}}' * known,
             f'{"":<{_NAME}}{"bit/s/Hz":>{_RATE}}{"bit/s/Hz":>{_RATE}}{"s":>{_TIME}}'
             + f'{"at most":>{_RATE}}' * known]
    lines += [f'{plan.method:<{_NAME}}{plan.guaranteed_rate:>{_RATE}.4f}'
              f'{plan.worst_case_rate:>{_RATE}.4f}{plan.solve_time:>{_TIME}.2f}'
              + f'{_missing(plan):>{_RATE}}' * known for plan in plans]
    if bound is not None:
        rates = {'guaranteed': '', 'worst_case': '', bound.objective: f'{bound.rate:.4f}'}
        lines.append(f'{"bound of any plan":<{_NAME}}{rates["guaranteed"]:>{_RATE}}'
                     f'{rates["worst_case"]:>{_RATE}}{bound.solve_time:>{_TIME}.2f}')
    lines += _energies(plans)
    return '\n'.join(lines)


def _energies(plans: Sequence[Any]) -> Iterator[str]:
    """Yield lines with the energy of each UAV that has a propulsion, if there are any."""
    known = [(plan, uav.name, energy) for plan in plans
             for uav, energy in zip(plan.scenario.uavs, plan.energies) if energy is not None]
    if known:
        width = max(_TIME, *(len(name) + 2 for _, name, _ in known))
        yield ''
        yield (f'{"scheme":<{_NAME}}{"UAV":>{width}}{"energy":>{_RATE}}{"hovering":>{_RATE}}'
               f'{"flying":>{_RATE}}')
        yield f'{"":<{_NAME + width}}' + f'{"J":>{_RATE}}' * 3
    for plan, name, energy in known:
        yield f'{plan.method:<{_NAME}}{name:>{width}}' + ''.join(
            f'{joules:>{_RATE}.0f}' for joules in energy)


def _missing(plan: Any) -> str:
    """Return the largest share of the best possible rate that a plan may miss."""
    if plan.bound is None:
        return 'unknown'
    # Rounded up, as all that is said to be proven.
    return f'{math.ceil(1000 * plan.bound.share_missing(plan)) / 10:.1f}%'


def assessment_table(assessment: Any) -> str:
    """Return a text table of what an Assessment found beside what its plan promised."""
    found = assessment.summary
    low, middle = np.quantile(assessment.delivered, (0.05, 0.5))
    return '\n'.join(
        (f'{name:<{_NAME}}' + ''.join(f'{cell:>{_RATE}{form}}' for cell in cells)).rstrip()
        for name, form, *cells in (
            (f'of {assessment.draws} draws', '', 'promised', 'mean', '5%', '50%'),
            ('secrecy rate, bit/s/Hz', '.4f', found['promised'], found['mean'],
             found['quantile_5'], found['quantile_50']),
            ('delivered, bit/Hz', '.4f', found['promised_delivery'], found['delivered'], low,
             middle),
            ('', ''),
            ('of all slots', '', 'promised', 'mean', 'largest'),
            ('outage', '.4%', found['promised_outage'], assessment.outages.mean(),
             found['outage'])))


def markdown_table(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return rows of cells as a table in Markdown."""
    lines = (head, ['---'] * len(head), *rows)
    return '\n'.join(f'| {" | ".join(map(str, line))} |' for line in lines)
