"""The rates of plans as a table of text, for a terminal."""

from collections.abc import Sequence
import math
from typing import Any

_NAME, _RATE, _TIME = 26, 17, 9


def table(plans: Sequence[Any], bound: Any = None) -> str:
    """
    Return a text table with a line for each Plan and one for a Bound, if there is one.

    Where plans have bounds, a column has the largest share of the best rate that they may miss.

    :param plans: Plans.
    :param bound: a Bound of their scenario.
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
    return '\n'.join(lines)


def _missing(plan: Any) -> str:
    """Return the largest share of the best possible rate that a plan may miss."""
    if plan.bound is None:
        return 'unknown'
    # Rounded up, as all that is said to be proven.
    return f'{math.ceil(1000 * plan.bound.share_missing(plan)) / 10:.1f}%'
