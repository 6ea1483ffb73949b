"""The figure of a campaign: rates over the fields that vary, and what could not be flown."""

from collections.abc import Sequence
from dataclasses import fields
import json
from pathlib import Path
from textwrap import wrap
from typing import Any

from .campaign_file import BASELINES
from .tasks import ERROR, FAULT, Row, WORKER_LOST
from ..mission import OBJECTIVES
from ..mission.files import atomic_file
from ..mission.geography import Origin
from ..mission.participants import Eavesdropper, NoFlyZone, Propulsion, Uav
from ..mission.propagation import Channel, rate_name
from ..mission.scenario import Scenario

_DASHES = ('-', (0, (6, 1)), (0, (4, 1, 1, 1)))  # Line styles of methods of solve, in turn.
_GREY = '0.45'  # Colour of baselines.
_UNITS = {field.name: field.metadata['unit']
          for kind in (Scenario, Uav, Propulsion, Eavesdropper, NoFlyZone, Channel, Origin)
          for field in fields(kind)}
_OWNERS = {'uavs': 'UAV', 'eavesdroppers': 'eavesdropper', 'ground_nodes': 'ground node',
           'no_fly_zones': 'zone'}
_WORDS = {'reference_snr_db': 'SNR at 1 m and 1 W', 'los': 'lines of sight',
          'exponent': 'path loss exponent', 'rician_k_db': 'Rician factor',
          'receiver_advantage_db': 'receiver advantage'}
# Names of the last index of a place, and of a knot of a track.
_COORDINATES = {**dict.fromkeys(
    ('start', 'goal', 'position', 'ground_node', 'vertices', 'geofence', 'start_velocity',
     'goal_velocity'), ('east', 'north')), 'track': ('time', 'east', 'north', 'radius')}
_MOST_LINES = 6  # Largest number of values of the second, third and fourth field.
_MOST_PLACES = 3  # Largest number of places named at which missions could not be flown.
_LATER = 'second', 'third', 'fourth'  # Columns with the values of the fields after x.
_LABEL_WIDTH = 40  # Letters in a line of a label.
_QUANTILES = 0.1, 0.5, 0.9
_EMPTY_POINT = 'x'  # Marker of points whose missions could not be flown.


def save_figure(rows: Sequence[Row], path: Path) -> None:
    """Write the figure of the rows to a PNG file."""
    figure = draw_figure(rows)
    with atomic_file(path, binary=True) as file:
        figure.savefig(file, dpi=150, format='png')


def draw_figure(rows: Sequence[Row]) -> Any:
    """
    Return a Figure of the rates over a varied field x, or histograms if no field varies.

    Each objective has axes of its own, with a line for each method and each value of a second
    field. A third field has a column of axes for each value, and a fourth field a row. Lines are
    medians, and thin lines are the quantiles 0.1 and 0.9. At a hollow point, some missions could
    not be flown; at a cross, none could. Rows with infrastructure failures or faults are left out.
    """
    from ..output.figures import own_settings
    with own_settings():
        return _draw_figure([
            row for row in rows if row['outcome'] not in (ERROR, FAULT, WORKER_LOST)])


def name_field(field: str) -> str:
    """Return the words of a varied field: 'peak power of all UAVs' for 'uavs.*.peak_power'."""
    owner, *parts = field.split('.')
    index = parts.pop(0) if owner in _OWNERS and parts else None
    if not parts or parts[0].isdigit():
        parts = [owner, *parts]
    names = [part for part in parts if not part.isdigit() and part != '*']
    numbers = [str(int(part) + 1) for part in parts if part.isdigit()]
    if numbers and (coordinate := _name_coordinate(parts)):
        numbers[-1] = coordinate
    words = ' '.join([*(_WORDS.get(name, name.replace('_', ' ')) for name in names), *numbers])
    return words if index is None else f'{words} of ' + (
        f'all {_OWNERS[owner]}s' if index == '*' else f'{_OWNERS[owner]} {int(index) + 1}')


def _name_coordinate(parts: Sequence[str]) -> str:
    """Return the name of the coordinate that the last part is the index of, '' for none."""
    name = next((part for part in reversed(parts) if part in _COORDINATES), '')
    # The index of a zone's corner or of a knot stands before the index of the coordinate.
    indices = parts[parts.index(name) + 1:] if name else []
    is_coordinate = len(indices) == 1 + (name in ('track', 'vertices', 'geofence'))
    return (dict(enumerate(_COORDINATES[name])).get(int(indices[-1]), '')
            if is_coordinate and indices[-1].isdigit() else '')


def _draw_figure(rows: Sequence[Row]) -> Any:
    """Return a Figure: axes for each objective and value of the third and the fourth field."""
    from ..output.drawing import style_axes
    from ..output.figures import Picture
    name, *later = _choose_fields(rows)
    frame = _make_frame(rows, name, later)
    has_third = later[1] is not None
    objectives = [objective for objective in OBJECTIVES if objective in set(frame.objective)]
    thirds, fourths = (frame[column].drop_duplicates().tolist() or [''] for column in _LATER[1:])
    panels = [(objective, third, fourth)
              for fourth in fourths for objective in objectives for third in thirds]
    # Without a third field, the objectives are side by side. One or two panels in a row are large.
    column_count = max(1, len(thirds) if has_third else len(objectives))
    row_count = max(1, len(panels) // column_count)
    figure = Picture(figsize=(2.0 + 4.5 * column_count if column_count < 3 else 3.2 * column_count,
                              4.8 if row_count == 1 else 3.2 * row_count), layout='constrained')
    grid = figure.subplots(row_count, column_count, sharey=name is not None, sharex=has_third,
                           squeeze=False)
    for axes, (objective, third, fourth) in zip(grid.flat, panels):
        group = frame[(frame.objective == objective) & (frame.third == third)
                      & (frame.fourth == fourth)]
        _draw_panel(axes, frame, group, objective, name)
        if has_third:
            axes.set_title('\n'.join(
                f'{name_field(field)}: {value}' for field, value in zip(later[1:], (third, fourth))
                if field is not None), fontsize=9, loc='left')
            axes.label_outer()
        style_axes(axes)
    if objectives:
        _add_legend(figure, grid, frame, rows, (name, *later))
    return figure


def _draw_panel(axes: Any, frame: Any, group: Any, objective: str,
                name: str | None) -> None:
    """
    Draw the rates of a group over a field, or a histogram of the rates if the field is None.

    :param frame: DataFrame of all missions of the figure.
    :param group: rows of the frame that are drawn into `axes`; all have the objective.
    :param name: name of the field x.
    """
    promises = frame[frame.objective == objective].promise.dropna()
    names = dict.fromkeys(rate_name(objective, promise) for promise in promises)
    label = '\n'.join(wrap(f'{" or ".join(names)} (bit/s/Hz)', _LABEL_WIDTH))
    if name is not None:
        _draw_rates(axes, frame, group)
        axes.set_xlabel(_label_field(name))
        axes.set_ylabel(label)
        return
    axes.yaxis.get_major_locator().set_params(integer=True)
    for method, chosen in group.dropna(subset='rate').groupby('method', sort=False):
        axes.hist(chosen.rate, bins=30, alpha=0.6, label=method)
    axes.set_xlabel(label)
    axes.set_ylabel('missions')


def _make_frame(rows: Sequence[Row], name: str | None, later: Sequence[str | None]) -> Any:
    """
    Return a DataFrame with a line for each row: objective, rate, promise, method, x and _LATER.

    The rate of the row's objective is missing (NaN) if the mission could not be flown. If promises
    differ, `method` is the method, ', ' and the promise, so that each promise has its own line.

    :param name: name of the field x; `later` names the second, the third and the fourth field.
    """
    from pandas import DataFrame
    frame = DataFrame([{
        'objective': row['objective'], 'rate': row[f'{row["objective"]}_rate'] if (
            row['outcome'] == 'ok') else None,
        'promise': row.get('promise') or ('guaranteed' if row['outcome'] == 'ok' else None),
        'method': row['method'], 'x': row['fields'].get(name),
        **{column: _label_value(row, field) for column, field in zip(_LATER, later)}}
        for row in rows], columns=['objective', 'rate', 'promise', 'method', 'x', *_LATER])
    # A mission that was not flown has no promise, and takes the promise of its line.
    frame.promise = frame.groupby(['method', *_LATER], dropna=False).promise.transform(
        lambda group: group.ffill().bfill())
    if frame.promise.nunique() > 1:
        frame.method += (', ' + frame.promise).fillna('')
    return frame.astype({'rate': float})


def _draw_rates(axes: Any, frame: Any, group: Any) -> None:
    """
    Draw median rates over the field x, a line for each method and value of the second field.

    Two thin lines of the same style show the quantiles 0.1 and 0.9.

    :param frame: DataFrame of all missions of the figure, which fixes colours and dashes.
    :param group: rows of the frame that are drawn into `axes`.
    """
    for (method, second), chosen in group.groupby(['method', 'second'], sort=False):
        color, dash, label = _style_line(frame, method, second)
        by_x = chosen.groupby('x').rate
        rates = by_x.quantile(_QUANTILES).unstack()  # A row for each x, a column for each share.
        axes.plot(rates.index, rates[0.5], linestyle=dash, color=color, linewidth=1.8,
                  label=label)
        for share in (_QUANTILES[0], _QUANTILES[-1]):
            axes.plot(rates.index, rates[share], linestyle=dash, color=color, linewidth=0.6,
                      alpha=0.7)
        _draw_points(axes, rates[0.5], by_x.count(), by_x.size(), color)


def _style_line(frame: Any, method: str, second: str) -> tuple[str, Any, str]:
    """
    Return colour, dash and label of the line of a method and a value of the second field.

    Each method has a dash. With a second field, each `second` value has a colour. Without a second
    field, `second` is '', baselines are grey, and each other method has a colour.
    """
    from ..output.drawing import scheme_dash, scheme_name, uav_color
    methods = frame.method.unique().tolist()
    # The frame may add ', ' and the promise to the name of a method.
    scheme, *promise = method.split(', ', maxsplit=1)
    solvers = [name for name in methods if name.partition(', ')[0] not in BASELINES]
    is_baseline = method not in solvers
    if second:
        color = uav_color(frame.second.unique().tolist().index(second))
    else:
        color = _GREY if is_baseline else uav_color(solvers.index(method))
    dash = scheme_dash(scheme) if is_baseline else (
        _DASHES[solvers.index(method) % len(_DASHES)])
    words = [second] if second else []
    if len(methods) > 1 or not second:
        words += scheme_name(scheme), *promise
    return color, dash, ', '.join(words)


def _draw_points(axes: Any, medians: Any, flown: Any, asked: Any, color: str) -> None:
    """
    Draw a point at the median rate of each x; `flown` and `asked` are numbers of missions by x.

    A point is hollow, with the number of flown missions, if some missions could not be flown. If
    none could be flown, a cross is drawn at 2% of the height of the axes.
    """
    for x, median in medians.items():
        style = {'color': color, 'markersize': 5, 'clip_on': False, 'markerfacecolor': (
            color if flown[x] == asked[x] else 'white')}
        if not flown[x]:
            axes.plot(x, 0.02, _EMPTY_POINT, transform=axes.get_xaxis_transform(), **style)
            continue
        axes.plot(x, median, 'o', **style)
        if flown[x] < asked[x]:
            axes.annotate(f'n = {flown[x]}', (x, median), (5, -9), color=color,
                          textcoords='offset points', fontsize=7.5)


def _add_legend(figure: Any, grid: Any, frame: Any, rows: Sequence[Row],
                chosen: Sequence[str | None]) -> None:
    """Add a legend with notes above all axes, and height for it; `chosen`: by _choose_fields."""
    handles = {label: handle for axes in grid.flat
               for handle, label in zip(*axes.get_legend_handles_labels())}
    name, second, *_ = chosen
    notes = []
    if name is not None:
        rest = [name_field(field) for field in rows[0]['fields'] if field not in chosen]
        counts = frame.groupby(['objective', 'method', 'x', *_LATER]).size()
        count = f'{counts.min()}' if counts.min() == counts.max() else (
            f'{counts.min()} to {counts.max()}')
        notes.append(f'medians, thin: 10% and 90%, of n = {count} missions at each point' + (
            f', over {", ".join(rest)}' if rest else ''))
    notes.extend(_list_failures(frame, name))
    if second is not None:
        notes.append(f'{name_field(second)}:')
    title = '\n'.join(line for note in notes for line in wrap(
        note, int(11 * figure.get_figwidth())))
    widest = max(map(len, handles), default=0)  # Letters, each about 0.08 inches wide.
    figure.legend(handles.values(), handles.keys(), loc='outside upper left', fontsize=9,
                  frameon=False, title=title, title_fontsize=9, alignment='left',
                  ncols=max(1, int(figure.get_figwidth() // (0.6 + 0.08 * widest))))
    figure.set_figheight(
        figure.get_figheight() + 0.17 * (len(handles) + title.count('\n')))


def _list_failures(frame: Any, name: str | None) -> list[str]:
    """Return [one line on how many missions could not be flown, at which x], [] if all could."""
    failed = frame.rate.isna()
    if not failed.any():
        return []
    if name is None:
        return [f'{failed.sum()} of {len(frame)} missions could not be flown']
    counts = frame.assign(failed=failed).groupby('x').failed.agg(['sum', 'size'])
    places = [f'{row["sum"]} of {row["size"]} could not be flown at {x:g} {_unit(name)}'.rstrip()
              for x, row in counts[counts['sum'] > 0].iterrows()]
    more = sum(counts['sum'] > 0) - _MOST_PLACES
    return ['; '.join(places[:_MOST_PLACES] + ([f'and at {more} more'] if more > 0 else []))
            + ' (hollow: some, cross: all)']


def _label_field(field: str) -> str:
    return f'{name_field(field)} ({_unit(field)})'.removesuffix(' ()')


def _label_value(row: Row, field: str | None) -> str:
    """Return the value of a row's field with its unit, 'none' for null, '' for no field."""
    if field is None:
        return ''
    value = row['fields'][field]
    text = f'{value:.15g}' if isinstance(value, float) else (
        'none' if value is None else json.dumps(value).strip('"').replace('_', ' '))
    text = text.replace('$', r'\$')
    return f'{text} {_unit(field)}'.rstrip() if value is not None else text


def _unit(field: str) -> str:
    parts = field.split('.')
    if coordinate := _name_coordinate(parts):
        return 's' if coordinate == 'time' else _UNITS.get(parts[-2], 'm') or 'm'
    return next((_UNITS[part] for part in reversed(parts) if part in _UNITS), '')


def _choose_fields(rows: Sequence[Row]) -> list[str | None]:
    """
    Return the names of the field x, the second, third and fourth field; None for no such field.

    x is the first varying field whose values are all numbers, not booleans, with at most
    max(2, R // 2) different values in R rows. The other fields vary and have at most
    min(_MOST_LINES, R // 2) different values. Without a field x, all four are None.
    """
    samples = len({row['sample'] for row in rows})
    value_counts = {}
    for name in rows[0]['fields'] if rows else ():
        values = [json.dumps(row['fields'][name]) for row in rows]
        # A field varies if a sample has several of its values; a drawn field has one value.
        if len({*zip((row['sample'] for row in rows), values)}) > samples:
            value_counts[name] = len({*values})
    first = next((name for name, count in value_counts.items() if count <= max(2, len(rows) // 2)
                  and all(type(row['fields'][name]) in (int, float) for row in rows)), None)
    later = [name for name, count in value_counts.items() if name != first and first is not None
             and count <= min(_MOST_LINES, len(rows) // 2)]
    return [first, *later[:3], *[None] * (3 - len(later))]
