"""The rows of a campaign as tables and as a figure."""

from collections.abc import Sequence
import csv
from dataclasses import fields
import json
from pathlib import Path
from textwrap import wrap
from typing import Any, TYPE_CHECKING

from .tasks import COLUMNS, Row
from ..errors import name_missing_package
from ..mission import OBJECTIVES
from ..mission.files import atomic_file
from ..mission.geography import Origin
from ..mission.participants import Eavesdropper, NoFlyZone, Propulsion, Uav
from ..mission.propagation import Channel, rate_name
from ..mission.scenario import Scenario

if TYPE_CHECKING:
    from pandas import DataFrame

_DASHES = ('-', '--', ':', '-.')
_UNITS = {field.name: field.metadata['unit']
          for kind in (Scenario, Uav, Propulsion, Eavesdropper, NoFlyZone, Channel, Origin)
          for field in fields(kind)}
_MOST_LINES = 6  # Of values of a second field, and panels of a third and a fourth.
_LATER = 'second', 'third', 'fourth'
_LABEL_WIDTH = 40  # In characters.


def save_tables(rows: Sequence[Row], folder: Path) -> list[Path]:
    """
    Write all rows as results.csv and, where PyArrow is installed, as results.parquet.

    Each varied field and each further result has a column of its name. Fields with values of
    several kinds, or that are neither numbers nor null, are JSON.

    :return: the files.
    """
    names = _column_names(rows)
    plain = {name for name in names if _is_plain([row['fields'].get(name) for row in rows])}
    flat = [{**row, **row.get('more', {}), **{
        name: value if name in plain or value is None else json.dumps(value)
        for name, value in row['fields'].items()}} for row in rows]
    files = [folder / 'results.csv']
    with atomic_file(files[0]) as file:
        writer = csv.DictWriter(file, names, extrasaction='ignore', lineterminator='\n')
        writer.writeheader()
        writer.writerows(flat)
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError:
        return files
    table = pyarrow.table({name: [row.get(name) for row in flat] for name in names})
    files.append(folder / 'results.parquet')
    with atomic_file(files[1], binary=True) as file:
        parquet.write_table(table, file)
    return files


def _column_names(rows: Sequence[Row]) -> list[str]:
    """Return COLUMNS and the names of further results and of varied fields."""
    return [*COLUMNS, *dict.fromkeys(
        name for part in ('more', 'fields') for row in rows for name in row.get(part, ()))]


def make_frame(rows: Sequence[Row]) -> 'DataFrame':
    """Return all rows as a pandas DataFrame with the columns of results.csv."""
    with name_missing_package():
        from pandas import DataFrame
    return DataFrame([{**row, **row.get('more', {}), **row['fields']} for row in rows],
                     columns=_column_names(rows))


def _is_plain(values: list[Any]) -> bool:
    """Return True if values, beside null, are a column of numbers or of booleans."""
    values = [value for value in values if value is not None]
    return all(isinstance(value, bool) for value in values) or all(
        isinstance(value, (int, float)) and not isinstance(value, bool)
        and abs(value) <= 2.0**53 for value in values)  # Beyond, floats are no whole numbers.


def save_figure(rows: Sequence[Row], path: Path) -> None:
    """Write the figure of the rows to a PNG file."""
    figure = draw_figure(rows)
    with atomic_file(path, binary=True) as file:
        figure.savefig(file, dpi=150, format='png')


def draw_figure(rows: Sequence[Row]) -> Any:
    """
    Return a Figure of the rates over the first field with several numbers, or histograms.

    Each maximised rate has axes of its own, with the rows that are compared by it: a line for each
    method and each value of a second field that has few. A third field has a column of axes for
    each value, a fourth a row. Lines are medians, bands hold eight of ten missions.
    """
    from ..output.figures import own_settings
    with own_settings():
        return _draw_figure([row for row in rows if row['outcome'] == 'ok'])


def _draw_figure(rows: Sequence[Row]) -> Any:
    from pandas import DataFrame
    from ..output.figures import Picture
    name, *later = _choose_fields(rows)
    is_split = later[1] is not None
    rates = [rate for rate in OBJECTIVES if any(row['objective'] == rate for row in rows)]
    frame = DataFrame([{
        'objective': row['objective'], 'rate': row[f'{row["objective"]}_rate'],
        'promise': row.get('promise') or 'guaranteed',  # Which rows of version 0.1.0 lack.
        'method': row['method'], 'x': row['fields'].get(name),
        **{part: _label_value(row, field) for part, field in zip(_LATER, later)}}
        for row in rows], columns=['objective', 'rate', 'promise', 'method', 'x', *_LATER])
    if frame.promise.nunique() > 1:
        frame.method += ', ' + frame.promise
    columns, lines = (frame[part].drop_duplicates().tolist() or [''] for part in _LATER[1:])
    # Few panels are large; rates without a third field are beside each other.
    places = [(rate, line, column) for line in lines for rate in rates for column in columns]
    width = max(1, len(columns) if is_split else len(rates))
    height = max(1, len(places) // width)
    figure = Picture(figsize=(2.0 + 4.5 * width if width < 3 else 3.2 * width,
                              4.8 if height == 1 else 3.2 * height), layout='constrained')
    grid = figure.subplots(height, width, sharey=name is not None, sharex=is_split,
                           squeeze=False)
    for axes, (rate, line, column) in zip(grid.flat, places):
        group = frame[(frame.objective == rate) & (frame.third == column)
                      & (frame.fourth == line)]
        names = dict.fromkeys(rate_name(rate, promise) for promise in group.promise)
        label = '\n'.join(wrap(f'{" or ".join(names)} (bit/s/Hz)', _LABEL_WIDTH))
        if name is None:
            axes.yaxis.get_major_locator().set_params(integer=True)
            for method, chosen in group.groupby('method', sort=False):
                axes.hist(chosen.rate, bins=30, alpha=0.6, label=method)
        else:
            _draw_lines(axes, frame, group)
        axes.set_xlabel(label if name is None else f'{name} ({_unit(name)})'.removesuffix(' ()'))
        axes.set_ylabel('missions' if name is None else label)
        if is_split:
            axes.set_title('\n'.join(filter(None, (column, line))), fontsize=9)
            axes.label_outer()
        axes.grid(alpha=0.3)
    if rates:  # A legend for all axes, above them, where it covers nothing.
        handles = {label: handle for axes in grid.flat
                   for handle, label in zip(*axes.get_legend_handles_labels())}
        rest = [field for field in rows[0]['fields'] if field not in (name, *later)]
        bands = 'lines: medians; bands: from 10 to 90% of the missions' + (
            f', over {", ".join(rest)}' if rest else '')
        figure.legend(handles.values(), handles.keys(), loc='outside upper left', fontsize=8,
                      frameon=False, title=None if name is None else bands, title_fontsize=8,
                      alignment='left')
        figure.set_figheight(figure.get_figheight() + 0.17 * len(handles))
    return figure


def _draw_lines(axes: Any, frame: Any, group: Any) -> None:
    """Draw the rates of a group over x: a colour for each second value, a dash for each method."""
    methods, values = frame.method.unique().tolist(), frame.second.unique().tolist()
    for (method, value), chosen in group.groupby(['method', 'second'], sort=False):
        band = chosen.groupby('x').rate.quantile([0.1, 0.5, 0.9]).unstack()
        number = values.index(value) if value else methods.index(method)
        dash = _DASHES[methods.index(method) % len(_DASHES)] if value else '-'
        [line] = axes.plot(band.index, band[0.5], dash, color=f'C{number % 10}', marker='o',
                           markersize=3, label=f'{value}, {method}' if value else method)
        axes.fill_between(band.index, band[0.1], band[0.9], color=line.get_color(), alpha=0.2,
                          linewidth=0)


def _label_value(row: Row, field: str | None) -> str:
    return '' if field is None else (
        f'{field} {json.dumps(row["fields"][field])} {_unit(field)}'.rstrip())


def _unit(field: str) -> str:
    return _UNITS.get(field.rpartition('.')[2], '')


def _choose_fields(rows: Sequence[Row]) -> list[str | None]:
    """Return the first field of the grid with numbers, and three later with few values."""
    samples = len({row['sample'] for row in rows})
    counts = {}
    for name in rows[0]['fields'] if rows else ():
        values = [json.dumps(row['fields'][name]) for row in rows]
        # A random field has one value in each sample.
        if len({*zip((row['sample'] for row in rows), values)}) > samples:
            counts[name] = len({*values})
    first = next((name for name, count in counts.items() if count <= max(2, len(rows) // 2)
                  and all(isinstance(row['fields'][name], (int, float)) for row in rows)), None)
    later = [name for name, count in counts.items() if name != first and first is not None
             and count <= min(_MOST_LINES, len(rows) // 2)]
    return [first, *later[:3], *[None] * (3 - len(later))]
