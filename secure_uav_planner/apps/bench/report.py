"""Tables and a picture of the measurements."""

import csv
import statistics

from ...output.table import markdown_table

_FORMATS = {'time': '{:.3f}', 'build': '{:.3f}', 'solve': '{:.3f}', 'rate': '{:.4f}',
            'reference': '{:.4f}', 'ratio': '{:.2f}', 'memory': '{:.0f}'}

OPPONENTS = {'ipopt': '#D55E00', 'fatrop': '#009E73'}
"""The other solvers, each with its color in a picture."""


def text(column, value):
    """Return the text of a value in a table."""
    if value is None or value == '':
        return ''
    if isinstance(value, float):
        return _FORMATS.get(column, _FORMATS.get(column.split('_')[-1], '{:.2f}')).format(value)
    return str(value)


def columns_of(rows):
    """Return the columns of rows in the order of their first appearance."""
    return list(dict.fromkeys(column for row in rows for column in row))


def table_of(rows):
    """Return rows, dictionaries, as a Markdown table."""
    columns = columns_of(rows)
    return markdown_table(columns, ([text(column, row.get(column)) for column in columns]
                                    for row in rows)) + '\n'


def write_csv(path, tables):
    """Write all tables, rows by name, to one CSV file with a column for the name."""
    rows = [{'table': name, **row} for name, table in tables.items() for row in table]
    with open(path, 'w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, columns_of(rows))
        writer.writeheader()
        writer.writerows(rows)


def conclusions(tables):
    """Return the main results of the tables as sentences in a Markdown list."""
    lines = []
    for name, rows in tables.items():
        for other in OPPONENTS:
            compared = [row for row in rows if f'{other}_ratio' in row]
            if compared:
                lines += _comparison(name, other, compared)
        warm = [row for row in rows if 'warm_ratio' in row]
        if warm:
            ratio = statistics.median(row['warm_ratio'] for row in warm)
            gain = statistics.median(row['warm_rate'] - row['cold_rate'] for row in warm)
            lines.append(f'- {name}: a warm start takes {ratio:.0%} of the time of a cold one in '
                         f'the median; the rate differs by {gain:+.5f} bit/s/Hz in the median')
        both = [row for row in rows if 'objective_ratio' in row]
        if both:
            ratio = statistics.median(row['objective_ratio'] for row in both)
            gains = [row['p1_rate'] - row['p2_rate'] for row in both]
            lines.append(f'- {name}: the worst-case objective takes {ratio:.2f} times as long as '
                         f'the guaranteed one in the median; the worst-case rate gains '
                         f'{statistics.median(gains):.4f} bit/s/Hz in the median, '
                         f'{min(gains):.4f} at least')
    return '\n'.join(lines) + '\n'


def _comparison(table, other, rows):
    """Return the sentences on another solver in a table."""
    ratios = [row[f'{other}_ratio'] for row in rows]
    calls = [row[f'{other}_ratio_solve'] for row in rows]
    gains = [row['joint_rate'] - row[f'{other}_rate'] for row in rows]
    return [
        f'- {table}: joint is {statistics.median(ratios):.1f} times as fast as '
        f'{other.upper()} in the median (at least {min(ratios):.1f}), '
        f'{statistics.median(calls):.1f} times (at least {min(calls):.1f}) when building '
        'the problem is not counted',
        f'- {table}: its rate exceeds that of {other.upper()} by '
        f'{statistics.median(gains):.4f} bit/s/Hz in the median, by {min(gains):.4f} at least']


def plot_scaling(path, rows):
    """Draw the solve time against the number of slots."""
    import matplotlib
    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout='constrained')
    axes.loglog([row['slots'] for row in rows], [row['joint_time'] for row in rows], 'o-',
                color='#0072B2', label='joint, all starts')
    for other, color in OPPONENTS.items():
        with_other = [row for row in rows if f'{other}_solve' in row]
        if with_other:
            slots = [row['slots'] for row in with_other]
            axes.loglog(
                slots, [row[f'{other}_build'] + row[f'{other}_solve'] for row in with_other],
                's-', color=color, label=f'CasADi and {other.upper()}, one start')
            axes.loglog(slots, [row[f'{other}_solve'] for row in with_other], 's--',
                        color=color, label=f'{other.upper()} without building')
    axes.set_xticks([row['slots'] for row in rows], [str(row['slots']) for row in rows])
    axes.set_xticks([], minor=True)
    axes.set_xlabel('slots N')
    axes.set_ylabel('time in s')
    axes.set_title('Scenario of the paper, T = 200 s')
    axes.grid(True, which='both', alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=150)
    pyplot.close(figure)
