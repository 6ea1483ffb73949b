"""The rows of a campaign as tables and as a figure."""

from collections.abc import Sequence
import csv
import json
from pathlib import Path
from typing import Any

from .evaluation import COLUMNS
from ...mission.choices import OBJECTIVES
from ...mission.files import atomic_file

Rows = Sequence[dict[str, Any]]


def save_tables(rows: Rows, folder: Path) -> list[Path]:
    """
    Write all rows as results.csv and, where PyArrow is installed, as results.parquet.

    Each varied field and each further result has a column of its name; values of fields that are
    no numbers are JSON.

    :return: the files.
    """
    names = [*COLUMNS, *dict.fromkeys(
        name for part in ('more', 'fields') for row in rows for name in row.get(part, ()))]
    flat = [{**row, **row.get('more', {}), **{
        name: value if isinstance(value, (int, float)) else json.dumps(value)
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


def save_figure(rows: Rows, path: Path) -> None:
    """
    Draw the rates over the first field with several numbers, or else how often each comes.

    There is an axis for each rate that some row maximises. Lines are medians, bands hold eight of
    ten missions; each method and objective has a line in all of them.
    """
    from matplotlib.figure import Figure
    good = [row for row in rows if row['outcome'] == 'ok']
    name = _numeric_field(good)
    shown = [one for one in OBJECTIVES if any(row['objective'] == one for row in good)]
    figure = Figure(figsize=(6.5 * max(1, len(shown)), 4.5), layout='constrained')
    grid = figure.subplots(1, max(1, len(shown)), sharey=name is not None, squeeze=False)[0]
    for axes, rate in zip(grid, shown):
        _draw(axes, good, name, f'{rate}_rate')
        label = f'{_words(rate)} rate (bit/s/Hz)'
        axes.set_xlabel(label if name is None else name)
        axes.set_ylabel('missions' if name is None else label)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    with atomic_file(path, binary=True) as file:
        figure.savefig(file, dpi=150, format='png')


def _draw(axes: Any, rows: Rows, name: str | None, rate: str) -> None:
    """Draw one of the rates for each method and objective."""
    import numpy as np
    for scheme in sorted({(row['method'], row['objective']) for row in rows}):
        mine = [row for row in rows if (row['method'], row['objective']) == scheme]
        rates = np.array([row[rate] for row in mine])
        label = f'{scheme[0]}, objective {_words(scheme[1])} rate'
        if name is None:
            axes.hist(rates, bins=30, alpha=0.6, label=label)
            continue
        x = np.array([row['fields'][name] for row in mine], float)
        places = np.unique(x)
        low, middle, high = np.array([
            np.quantile(rates[x == place], (0.1, 0.5, 0.9)) for place in places]).T
        [line] = axes.plot(places, middle, marker='o', markersize=3, label=label)
        axes.fill_between(places, low, high, color=line.get_color(), alpha=0.2, linewidth=0)


def _words(objective: str) -> str:
    return objective.replace('_', '-')


def _numeric_field(rows: Rows) -> str | None:
    """Return the first field that has a few different numbers, each in several rows."""
    for name in rows[0]['fields'] if rows else ():
        values = {json.dumps(row['fields'][name]) for row in rows}
        if 1 < len(values) <= max(2, len(rows) // 2) and all(
                isinstance(row['fields'][name], (int, float)) for row in rows):
            return name
    return None
