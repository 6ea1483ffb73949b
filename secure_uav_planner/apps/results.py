"""The rows of a campaign as tables and as a figure."""

from collections.abc import Sequence
import csv
from dataclasses import fields
import json
from pathlib import Path
from typing import Any

from .tasks import COLUMNS, Row
from ..mission import OBJECTIVES
from ..mission.files import atomic_file
from ..mission.geography import Origin
from ..mission.participants import Eavesdropper, NoFlyZone, Propulsion, Uav
from ..mission.propagation import Channel, rate_name
from ..mission.scenario import Scenario

_DASHES = ('-', '--', ':', '-.')
_UNITS = {field.name: field.metadata['unit']
          for kind in (Scenario, Uav, Propulsion, Eavesdropper, NoFlyZone, Channel, Origin)
          for field in fields(kind)}
_MOST_LINES = 6  # Of values of a second field.


def save_tables(rows: Sequence[Row], folder: Path) -> list[Path]:
    """
    Write all rows as results.csv and, where PyArrow is installed, as results.parquet.

    Each varied field and each further result has a column of its name. Fields with values of
    several kinds, or that are neither numbers nor null, are JSON.

    :return: the files.
    """
    names = [*COLUMNS, *dict.fromkeys(
        name for part in ('more', 'fields') for row in rows for name in row.get(part, ()))]
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

    Each maximised rate has axes, with a line for each method, objective and value of a second
    field that has few. Lines are medians, bands hold eight of ten missions.
    """
    from ..output.figures import own_settings
    with own_settings():
        return _draw_figure(rows)


def _draw_figure(rows: Sequence[Row]) -> Any:
    from pandas import DataFrame
    from ..output.figures import Picture
    rows = [row for row in rows if row['outcome'] == 'ok']
    name, second = _choose_fields(rows)
    rates = [rate for rate in OBJECTIVES if any(row['objective'] == rate for row in rows)]
    figure = Picture(figsize=(6.5 * max(1, len(rates)), 4.8), layout='constrained')
    grid = figure.subplots(1, max(1, len(rates)), sharey=name is not None, squeeze=False)[0]
    frame = DataFrame([{
        **{f'{rate}_rate': row[f'{rate}_rate'] for rate in OBJECTIVES},
        'scheme': _scheme_label(row), 'x': row['fields'].get(name),
        'second': '' if second is None else _value_label(row, second)} for row in rows])
    for axes, rate in zip(grid, rates):
        names = dict.fromkeys(rate_name(rate, _promise(row)) for row in rows)
        label = f'{" or ".join(names)} (bit/s/Hz)'
        if name is None:
            axes.yaxis.get_major_locator().set_params(integer=True)
            for scheme, group in frame.groupby('scheme', sort=False):
                axes.hist(group[f'{rate}_rate'], bins=30, alpha=0.6, label=scheme)
        else:
            _draw_lines(axes, frame, f'{rate}_rate')
        axes.set_xlabel(label if name is None else f'{name} ({_unit(name)})'.removesuffix(' ()'))
        axes.set_ylabel('missions' if name is None else label)
        axes.grid(alpha=0.3)
    if rates:  # A legend for all axes, above them, where it covers nothing.
        legend = grid[0].legend(
            loc='lower left', bbox_to_anchor=(0.0, 1.0), fontsize=8, frameon=False)
        figure.set_figheight(4.6 + 0.17 * len(legend.get_texts()))
    if name is not None:
        rest = [field for field in rows[0]['fields'] if field not in (name, second)]
        figure.suptitle('lines: medians; bands: from 10 to 90% of the missions'
                        + (f', over {", ".join(rest)}' if rest else ''), fontsize=9)
    return figure


def _draw_lines(axes: Any, frame: Any, rate: str) -> None:
    """Draw a rate over x: a colour for each value of the second field, a dash for each scheme."""
    schemes, values = frame.scheme.unique().tolist(), frame.second.unique().tolist()
    for (scheme, value), group in frame.groupby(['scheme', 'second'], sort=False):
        band = group.groupby('x')[rate].quantile([0.1, 0.5, 0.9]).unstack()
        number = values.index(value) if value else schemes.index(scheme)
        dash = _DASHES[schemes.index(scheme) % len(_DASHES)] if value else '-'
        [line] = axes.plot(band.index, band[0.5], dash, color=f'C{number % 10}', marker='o',
                           markersize=3, label=f'{value}, {scheme}' if value else scheme)
        axes.fill_between(band.index, band[0.1], band[0.9], color=line.get_color(), alpha=0.2,
                          linewidth=0)


def _scheme_label(row: Row) -> str:
    return f'{row["method"]}, objective {rate_name(row["objective"], _promise(row))}'


def _promise(row: Row) -> str:
    """Return the promise of the channel; rows of version 0.1.0 lack it and are guarantees."""
    return row.get('promise') or 'guaranteed'


def _value_label(row: Row, field: str) -> str:
    return f'{field} {json.dumps(row["fields"][field])} {_unit(field)}'.rstrip()


def _unit(field: str) -> str:
    return _UNITS.get(field.rpartition('.')[2], '')


def _choose_fields(rows: Sequence[Row]) -> tuple[str | None, str | None]:
    """Return the first field with a few different numbers, and another with very few values."""
    fields = rows[0]['fields'] if rows else ()
    counts = {name: len({json.dumps(row['fields'][name]) for row in rows}) for name in fields}
    first = next((name for name, count in counts.items() if 1 < count <= max(2, len(rows) // 2)
                  and all(isinstance(row['fields'][name], (int, float)) for row in rows)), None)
    second = next((name for name, count in counts.items() if name != first
                   and 1 < count <= min(_MOST_LINES, len(rows) // 2)), None)
    return first, first and second
