"""A flight against its plan as a page of text."""

import math
from typing import Any

import numpy as np

from .tables import align
from ..mission.validation import find_runs

_UAV_ROWS = (
    ('time behind the plan', 's', 'delay_s', 2), ('error, RMS', 'm', 'error_rms_m', 2),
    ('error, largest', 'm', 'error_max_m', 2), ('  at', 's', 'error_max_time_s', 1),
    ('distance from the way, RMS', 'm', 'cross_track_rms_m', 2),
    ('  95% below', 'm', 'cross_track_95_m', 2), ('  largest', 'm', 'cross_track_max_m', 2),
    ('  at', 's', 'cross_track_max_time_s', 1),
    ('  mean, to the left', 'm', 'cross_track_mean_m', 2),
    ('height error, largest', 'm', 'height_error_max_m', 2),
    ('speed, largest', 'm/s', 'speed_max_m_s', 2),
    ('acceleration, largest', 'm/s^2', 'acceleration_max_m_s2', 2),
    ('gap of the log, longest', 's', 'gap_max_s', 1),
    ('setpoints from the plan, RMS', 'm', 'setpoint_error_rms_m', 2),
    ('energy by the model', 'J', 'energy_j', 0), ('  planned', 'J', 'planned_energy_j', 0),
    ('energy from the battery', 'Wh', 'battery_wh', 1),
    ('  by the model', '', 'battery_factor', 2))


def comparison_table(comparison: Any) -> str:
    """Return the results of a Comparison as text: errors by UAV, distances, rates and advice."""
    flight, plan = comparison.flight, comparison.plan
    names = list(comparison.uavs)
    width = max(12, *(len(name) + 2 for name in names))
    rows: list[tuple[str, ...]] = [('of each UAV', '', *names)]
    for label, unit, key, digits in _UAV_ROWS:
        values = [getattr(errors, key) for errors in comparison.uavs.values()]
        if any(map(math.isfinite, values)):
            rows.append((label, unit, *(f'{value:.{digits}f}' if math.isfinite(value) else '-'
                                        for value in values)))
    for label, values in (('largest speed allowed', plan.scenario.max_speeds),
                          ('largest acceleration allowed', plan.scenario.max_accelerations)):
        if np.isfinite(values).any():
            rows.append((label, 'm/s' if 'speed' in label else 'm/s^2', *(
                f'{value:.2f}' for value in values)))
    lines = [_describe_time(flight), '\n'.join(flight.notes),
             align((8, *[width] * len(names)), rows)]
    limits = {'separation': f'{plan.scenario.separation:g} m were asked for',
              'zones': f'tracking_margin is {plan.scenario.tracking_margin:g} m',
              'fence': f'tracking_margin is {plan.scenario.tracking_margin:g} m'}
    labels = {'separation': 'smallest distance of', 'zones': 'smallest distance of',
              'fence': 'smallest distance to the geofence of'}
    lines += ['\n'.join(
        f'{labels[kind]} {closest.names}: {closest.distance:.2f} m at {closest.time:.1f} s '
        f'({limits[kind]})' for kind in limits
        if (closest := getattr(comparison, kind)) is not None)]
    lines.append(_describe_rates(comparison))
    if comparison.advice:
        lines.append('\n  '.join(['what to type next:', *comparison.advice]))
    return '\n\n'.join(filter(None, lines))


def _describe_time(flight: Any) -> str:
    """Return the source of a flight's times, and each finite shift: log time less plan time."""
    shifts = ', '.join(
        f'{name} {shift.seconds:.2f} s (+-{shift.uncertainty:.2f} s)'
        for name, shift in flight.shifts.items() if math.isfinite(shift.seconds))
    return f'time from {flight.time_from}' + (f'; log less plan: {shifts}' if shifts else '')


def _describe_rates(comparison: Any) -> str:
    """Return as text: rates and deliveries, broken and uncovered slots, the source of powers."""
    plan = comparison.plan
    rows = [('over covered slots', '', 'planned', 'flown')]
    rows += [(f'{plan.scenario.channel.rate_name(kind)}', 'bit/s/Hz',
              f'{comparison.rate(kind, True):.4f}', f'{comparison.rate(kind):.4f}')
             for kind in comparison.achieved]
    planned, flown = comparison.delivered(True), comparison.delivered()
    rows += [(f'delivered in secret to {name}', 'bit/Hz', f'{bits:.2f}', f'{flown_bits:.2f}')
             for name, bits, flown_bits in zip(
                 plan.scenario.ground_node_names, planned, flown, strict=True)]
    text = align((10, 12, 12), rows, 40)
    broken, shortfalls = np.flatnonzero(comparison.broken), comparison.shortfalls
    text += (f'\n\n{comparison.coverage:.0%} of {plan.scenario.slots} slots covered, '
             f'{comparison.promised.sum()} promised, {len(broken)} of these broken')
    if len(broken):
        worst = broken[np.argmax(shortfalls[broken])]
        numbers = ', '.join(str(slot + 1) for slot in broken[:10])
        text += (f': {numbers}{", ..." if len(broken) > 10 else ""}; the worst, slot '
                 f'{worst + 1}, had {shortfalls[worst]:.4f} bit/s/Hz less than planned')
    if not comparison.covered.all():
        text += '\nnot covered: slots ' + ', '.join(
            f'{first + 1}' if first == end - 1 else f'{first + 1} to {end}'
            for first, end in find_runs(~comparison.covered).tolist())
    source = 'set, by the log' if comparison.flight.powers is not None else "the plan's"
    return f'{text}\npowers: {source}'
