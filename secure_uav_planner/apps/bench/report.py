"""Tables and a picture of the measurements."""

import csv
import statistics

from ...output.table import markdown_table

_FORMATS = {'time': '{:.3f}', 'build': '{:.3f}', 'solve': '{:.3f}', 'rate': '{:.4f}',
            'reference': '{:.4f}', 'ratio': '{:.2f}', 'memory': '{:.0f}'}

OPPONENTS = {'ipopt': '#D55E00', 'fatrop': '#009E73'}
"""The other solvers, each with its color in a picture."""

RANDOM = {'two UAVs': 'of two UAVs', 'random': 'with 1 to 3 jammers and eavesdroppers'}
"""The tables of random missions, and what these are."""


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


def summary(tables):
    """Return the main results of the tables, rows by name, as a Markdown table and a list."""
    found = [(name, [row]) for table in ('paper', 'slots') for name, row in (
        (f"the paper's, {row['name']}", row) for row in tables[table])]
    lines = [_compared(name, rows, statistics.median) for name, rows in found]
    for table, of in RANDOM.items():
        rows = tables[table]
        lines += [_compared(f'{len(rows)} random ones {of}, median', rows, statistics.median),
                  _compared('the worst of them', rows, min)]
    return markdown_table(
        ('missions', 'planner', *(f'against {other.upper()}' for other in OPPONENTS),
         *(f'rate above that of {other.upper()}' for other in OPPONENTS)),
        lines) + '\n\n' + '\n'.join(f'- {line}' for line in _facts(tables)) + '\n'


def _compared(name, rows, choose):
    """Return a line of the summary: the chosen time, ratios and gains of some rows."""
    times = [row['joint_time'] for row in rows]
    cells = [name, f'{1000 * (max if choose is min else choose)(times):.0f} ms']
    ratios, gains = [], []
    for other in OPPONENTS:
        compared = [row for row in rows if f'{other}_ratio' in row]
        both = [choose(row[f'{other}_{what}'] for row in compared)
                for what in ('ratio', 'ratio_solve') if compared]
        ratios.append('{} ({})'.format(*map(_ratio, both)) if both else '')
        gains.append(f"{choose(row['joint_rate'] - row[f'{other}_rate'] for row in compared):.4f}"
                     if compared else '')
    return [*cells, *ratios, *gains]


def _ratio(value):
    return f'{value:.0f}' if value >= 9.95 else f'{value:.1f}'


def _facts(tables):
    """Return what the tables say beside the comparison with other solvers, in sentences."""
    paper = [row for row in tables['paper'] if 'alternating_time' in row]
    if paper:
        ratios = [row['alternating_time'] / row['joint_time'] for row in paper]
        yield ("On the paper's missions, its alternating method takes "
               f'{min(ratios):.0f} to {max(ratios):.0f} times as long.')
    first, *_, last = tables['slots']
    yield (f"A process that plans {first['slots']} slots takes {first['peak_memory']:.0f} MB of "
           f"memory, one that plans {last['slots']} takes {last['peak_memory']:.0f} MB.")
    ratio, gain = (statistics.median(values) for values in zip(*(
        (row['warm_ratio'], row['warm_rate'] - row['cold_rate']) for row in tables['warm'])))
    yield (f"After the eavesdroppers' estimates have moved by 5 m, a solve that starts from the "
           f'last plan takes {ratio:.0%} of the time of a first one in the median; the rate '
           f'differs by {gain:+.5f} bit/s/Hz in the median.')
    ratio = statistics.median(row['objective_ratio'] for row in tables['objectives'])
    gains = [row['p1_rate'] - row['p2_rate'] for row in tables['objectives']]
    yield (f'The worst-case objective takes {ratio:.1f} times the processor time of the '
           f'guaranteed one in the median; the worst-case rate gains '
           f'{statistics.median(gains):.4f} bit/s/Hz in the median, {min(gains):.4f} at least.')


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
