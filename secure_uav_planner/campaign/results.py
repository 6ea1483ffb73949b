"""The rows of a campaign as tables and as a figure."""

from collections.abc import Sequence
import csv
import json
from pathlib import Path
from typing import Any

from .evaluation import COLUMNS
from ..files import atomic_file

Rows = Sequence[dict[str, Any]]


def save_tables(rows: Rows, folder: Path) -> list[Path]:
    """
    Write all rows as results.csv and, where PyArrow is installed, as results.parquet.

    Each varied field has a column of its name; values that are no numbers are JSON.

    :return: the files.
    """
    names = [*COLUMNS, *dict.fromkeys(name for row in rows for name in row['fields'])]
    flat = [{**row, **{name: value if isinstance(value, (int, float)) else json.dumps(value)
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

    Lines are medians, bands hold eight of ten missions; a line for each method and objective.
    """
    from matplotlib.figure import Figure
    import numpy as np
    good = [row for row in rows if row['outcome'] == 'ok']
    name = _numeric_field(good)
    figure = Figure(figsize=(7.0, 4.5), layout='constrained')
    axes = figure.add_subplot()
    for scheme in sorted({(row['method'], row['objective']) for row in good}):
        mine = [row for row in good if (row['method'], row['objective']) == scheme]
        rates = np.array([row[f'{scheme[1]}_rate'] for row in mine])
        label = f'{scheme[0]}, {scheme[1].replace("_", " ")}'
        if name is None:
            axes.hist(rates, bins=30, alpha=0.6, label=label)
            continue
        x = np.array([row['fields'][name] for row in mine], float)
        places = np.unique(x)
        low, middle, high = np.array([
            np.quantile(rates[x == place], (0.1, 0.5, 0.9)) for place in places]).T
        [line] = axes.plot(places, middle, marker='o', markersize=3, label=label)
        axes.fill_between(places, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    axes.set_xlabel('rate (bit/s/Hz)' if name is None else name)
    axes.set_ylabel('missions' if name is None else 'rate (bit/s/Hz)')
    if good:
        axes.legend()
    axes.grid(alpha=0.3)
    with atomic_file(path, binary=True) as file:
        figure.savefig(file, dpi=150, format='png')


def _numeric_field(rows: Rows) -> str | None:
    """Return the first field that has a few different numbers, each in several rows."""
    for name in rows[0]['fields'] if rows else ():
        values = {json.dumps(row['fields'][name]) for row in rows}
        if 1 < len(values) <= max(2, len(rows) // 2) and all(
                isinstance(row['fields'][name], (int, float)) for row in rows):
            return name
    return None
