"""The rows of a campaign as tables."""

from collections.abc import Sequence
import csv
import json
from pathlib import Path
from typing import Any, TYPE_CHECKING

from .tasks import COLUMNS, Row
from ..errors import name_missing_package
from ..mission.files import atomic_file

if TYPE_CHECKING:
    from pandas import DataFrame


def save_tables(rows: Sequence[Row], folder: Path) -> list[Path]:
    """
    Write all rows as results.csv and, where PyArrow is installed, as results.parquet.

    Each varied field and each further result has a column of its name. A field is written as JSON
    unless its values, apart from null, are all numbers or all booleans.

    :return: the paths of the written files.
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
    """Return True if all values but null are booleans, or all are numbers from -2^53 to 2^53."""
    values = [value for value in values if value is not None]
    return all(isinstance(value, bool) for value in values) or all(
        isinstance(value, (int, float)) and not isinstance(value, bool)
        and abs(value) <= 2.0**53 for value in values)  # Floats above 2^53 skip integers.
