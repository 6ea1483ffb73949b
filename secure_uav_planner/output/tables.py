"""Tables: rates as text and Markdown, and points of a plan as CSV and MAT."""

from collections.abc import Iterable, Sequence
import csv
import math
import os
from typing import Any

import numpy as np

from ..mission import OBJECTIVES
from ..mission.files import atomic_file
from ..mission.validation import rate_text

COLUMNS = ('uav', 'point', 'time', 'x', 'y', 'z', 'velocity_x', 'velocity_y', 'power',
           *(f'{objective}_rate' for objective in OBJECTIVES))
"""Columns of the points of a plan, in m, s, m/s, W and bit/s/Hz; list_columns adds the discs."""

_NAME, _RATE, _TIME = 26, 17, 9  # Widths of columns.


def rate_table(plans: Sequence[Any], bound: Any = None) -> str:
    """
    Return a text table with a line for each Plan, and one for a Bound if given.

    The rates are means over the promised slots, which a line names if not all are promised. If a
    Plan has a bound, a column has the largest share of the best rate that a Plan may miss. A line
    says if rates are not guaranteed. Energies follow in a table of their own.
    """
    channel = plans[0].scenario.channel
    names = (channel.rate_name(objective).removesuffix(f' {channel.promise}')
             for objective in OBJECTIVES)
    rows = [('scheme', *names, 'time', 'below the best'),
            ('', 'bit/s/Hz', 'bit/s/Hz', 's', 'at most')]
    rows += [(plan.method, rate_text(plan.promise.guaranteed_rate),
              rate_text(plan.promise.worst_case_rate), f'{plan.solve_time:.2f}', _gap_cell(plan))
             for plan in plans]
    if bound is not None:
        rates = {'guaranteed': '', 'worst_case': '', bound.objective: f'{bound.rate:.4f}'}
        rows.append(('bound of any plan', *rates.values(), f'{bound.solve_time:.2f}', ''))
    has_gaps = any(plan.bound is not None for plan in plans)
    text = align((_RATE, _RATE, _TIME, *([_RATE] if has_gaps else [])), rows)
    if not channel.is_guarantee:
        text += f'\n\nrates {channel.promise}, not guaranteed'
    if plans[0].promise.is_partial:
        text += f'\n\nrates are those of the promised slots; {plans[0].promise.text}'
    energies = [(plan.method, uav.name, *(f'{joules:.0f}' for joules in energy)) for plan in plans
                for uav, energy in zip(plan.scenario.uavs, plan.energies) if energy is not None]
    if energies:
        width = max(_TIME, *(len(name) + 2 for _, name, *_ in energies))
        text += '\n\n' + align((width, _RATE, _RATE, _RATE), (
            ('scheme', 'UAV', 'energy', 'hovering', 'flying'),
            ('by the model', '', 'J', 'J', 'J'), *energies))
    return text


def _gap_cell(plan: Any) -> str:
    """Return (bound - rate) / bound of a plan, such as '1.3%', or 'unknown' without a bound."""
    if plan.bound is None:
        return 'unknown'
    # A limit that is rounded up, to 0.1%, still holds.
    return f'{math.ceil(1000 * plan.bound.share_missing(plan)) / 10:.1f}%'


def align(widths: Sequence[int], rows: Iterable[Sequence[str]],
          name_width: int = _NAME) -> str:
    """Return rows as lines: a name, and as many right-aligned cells as there are widths."""
    return '\n'.join(
        (f'{name:<{name_width}}' + ''.join(
            f'{cell:>{width}}' for cell, width in zip(cells, widths))).rstrip()
        for name, *cells in rows)


def assessment_table(assessment: Any) -> str:
    """Return the results of an Assessment as a text table, beside the promises of its plan."""
    summary = assessment.summary
    rates = (summary['promised'], summary['mean'], summary['quantile_5'], summary['quantile_50'])
    delivered = (summary['promised_delivery'], summary['delivered'],
                 *np.quantile(assessment.delivered, (0.05, 0.5)))
    outages = assessment.outages.mean(), summary['outage']
    is_promise = assessment.plan.scenario.channel.is_guarantee
    text = align([_RATE] * 4, (
        (f'of {assessment.draws} draws', 'promised' if is_promise else 'planned', 'mean', '5%',
         '50%'),
        ('secrecy rate, bit/s/Hz', *map(rate_text, rates)),
        ('delivered, bit/Hz', *(f'{bits:.4f}' for bits in delivered)), ('',),
        ('of all slots', 'promised', 'mean', 'largest'),
        ('outage', assessment.promised_outage_text, *(f'{share:.4%}' for share in outages))))
    if assessment.outage > 0:
        text += f'\n\nlargest outage in {_name_slots(assessment)}'
    if not is_promise:
        text += f'\n\nplanned {assessment.plan.scenario.channel.promise}: no promise'
    promise = assessment.plan.promise.text
    return text + (promise and f'\n\n{promise}')


def _name_slots(assessment: Any) -> str:
    """Return text on the slots of the largest outage: the first and the last with their times."""
    slots = np.flatnonzero(assessment.outages == assessment.outage) + 1
    times = assessment.plan.times[slots]
    if len(slots) == 1:
        return f'slot {slots[0]}, at {times[0]:g} s'
    return (f'{len(slots)} slots, from slot {slots[0]} at {times[0]:g} s to slot {slots[-1]} at '
            f'{times[-1]:g} s')


def markdown_table(head: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return rows of cells as a table in Markdown."""
    lines = (head, ['---'] * len(head), *rows)
    return '\n'.join(f'| {" | ".join(map(str, line))} |' for line in lines)


def save_csv(plan: Any, path: str | os.PathLike[str]) -> None:
    """
    Write the point_rows of a plan under list_columns to a CSV file.

    :raises OSError: when the file cannot be written; an existing file is kept.
    """
    with atomic_file(path) as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(list_columns(plan))
        writer.writerows(point_rows(plan))


def to_dataframe(plan: Any) -> Any:
    """Return the rows of the CSV file as a pandas DataFrame."""
    from pandas import DataFrame  # Here, because it is optional and takes time to import.
    return DataFrame(point_rows(plan), columns=list_columns(plan))


def save_mat(plan: Any, path: str | os.PathLike[str]) -> None:
    """
    Write the arrays of a plan to a MAT file; see Plan.save_mat.

    :raises OSError: when the file cannot be written; an existing file is kept.
    """
    from scipy.io import savemat
    scenario = plan.scenario
    grounds, centres, radii = scenario.receivers_at(plan.times)
    nodes = {'ground_node': grounds[0]} if len(grounds) == 1 else {
        'ground_nodes': grounds, 'shares': plan.shares}
    with atomic_file(path, binary=True) as file:
        savemat(file, {
            'times': plan.times, 'positions': plan.positions, 'altitudes': scenario.altitudes,
            'powers': plan.powers, 'guaranteed_rates': plan.guaranteed_rates,
            'worst_case_rates': plan.worst_case_rates, **nodes, 'eavesdroppers': centres,
            'error_radii': radii,
            'uav_names': np.array([uav.name for uav in scenario.uavs], dtype=object),
            'eavesdropper_names': np.array(scenario.eavesdropper_names, dtype=object)},
                oned_as='column')


def list_columns(plan: Any) -> list[str]:
    """
    Return COLUMNS, then `<name>.x`, `<name>.y` and `<name>.radius` of each eavesdropper's disc.

    With several ground nodes, `<name>.share` of each node follows.
    """
    nodes = plan.scenario.ground_node_names
    return [*COLUMNS, *(f'{name}.{part}' for name in plan.scenario.eavesdropper_names
                        for part in ('x', 'y', 'radius')),
            *(f'{name}.share' for name in nodes if len(nodes) > 1)]


def point_rows(plan: Any) -> list[tuple[Any, ...]]:
    """
    Return a row of list_columns for each point of each UAV, with place and velocity by the plan.

    With an acceleration limit, a flight starts half a slot before point 0 and ends half a slot
    after the last point: the points -1 and N+2. Power, rates and shares hold in the slot that
    begins at the point; they are 0 if no slot begins there.
    """
    scenario, curve = plan.scenario, plan.curve
    times = np.unique([curve.begin, *plan.times, curve.end])
    ends = (len(times) - len(plan.times)) // 2  # 1 if points -1 and N+2 exist, otherwise 0.
    motion = curve.at(times)
    padding = (0, 0), (1 + ends, 1 + ends)
    powers = np.pad(plan.powers, padding)
    rates = np.pad([plan.guaranteed_rates, plan.worst_case_rates], padding)
    shares = np.pad(plan.shares if len(plan.shares) > 1 else plan.shares[:0], padding)
    _, centres, radii = scenario.receivers_at(times)
    discs = np.concatenate([centres, radii[..., np.newaxis]], axis=2).swapaxes(0, 1)
    common = np.column_stack([rates.T, discs.reshape(len(times), -1), shares.T]).tolist()
    return [
        (uav.name, point, time, x, y, uav.altitude, *velocity, power, *values)
        for uav, positions, velocities, watts in zip(
            scenario.uavs, motion.positions.tolist(), motion.velocities.tolist(),
            powers.tolist(), strict=True)
        for point, (time, (x, y), velocity, power, values) in enumerate(
            zip(times.tolist(), positions, velocities, watts, common, strict=True), -ends)]
