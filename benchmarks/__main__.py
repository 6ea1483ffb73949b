"""Run the benchmark: print the measurements, and write them and their summary."""

import argparse
import datetime
import os
from pathlib import Path
import platform
import sys

import casadi
import pandas
from secure_uav_planner import __version__
from secure_uav_planner.mission.scenario import Scenario
from secure_uav_planner.output.tables import markdown_table

from . import measuring
from .missions import random_mission

PAPER = ((102.0, 10.0, 1.3694), (104.0, 10.0, 1.5601), (120.0, 10.0, 1.9875),
         (150.0, 10.0, 2.5035), (200.0, 10.0, 3.0187), (200.0, 0.0, 3.1917))
TWO_SLOTS = 100  # Of the missions of two UAVs.
RANDOM = {'two UAVs': 'of two UAVs', 'random': 'with 1 to 3 jammers and eavesdroppers'}
"""Descriptions of the tables of random missions."""


def main(arguments=None):
    """Measure, print and write; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--quick', action='store_true', help='use fewer missions and slots')
    parser.add_argument('--out', type=Path, default=Path('out/bench'), help='output folder')
    parser.add_argument('--seed', type=int, default=0, help='seed of the first random mission')
    parser.add_argument('--missions', type=int, help='number of random missions')
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    count = options.missions or (4 if options.quick else 24)
    tables = {}
    for name, measurements in _measure_tables(
            range(options.seed, options.seed + count), options.quick):
        print(f'\n{name}')
        rows = []
        for row in measurements:
            rows.append(row)
            print('  ' + ', '.join(
                f'{column} {value:.4g}' if isinstance(value, float) else f'{column} {value}'
                for column, value in row.items()), flush=True)
        tables[name] = pandas.DataFrame(rows)
    summary = (f'Measured on {datetime.date.today().isoformat()} with version {__version__}, '
               f'CasADi {casadi.__version__} and Python {platform.python_version()}, on '
               f'{os.cpu_count()} processors ({platform.machine()}):\n\n{summarise(tables)}')
    print('\n' + summary)
    (options.out / 'speed.md').write_text(summary, encoding='utf-8')
    pandas.concat(tables, names=['table']).to_csv(options.out / 'bench.csv')
    print(f'written to {options.out}')
    return 0


def _measure_tables(seeds, quick):
    """Yield the name of each table, and an iterator that measures its rows."""
    repeats = 3 if quick else 7
    few = min(repeats, 3)
    yield 'paper', (
        measuring.measure(f'T = {duration:g} s, radius {radius:g} m',
                          Scenario.paper(duration, radius), repeats, alternating=True,
                          reference=reference) for duration, radius, reference in PAPER)
    yield 'slots', (
        {**measuring.measure(f'N = {slots}', Scenario.paper(200.0, 10.0, slots), repeats,
                             with_opponents=slots <= 2000),
         'peak_memory': measuring.measure_memory(slots)}
        for slots in ((200, 400) if quick else (200, 400, 1000, 2000, 5000)))
    named = [(f'seed {seed}', random_mission(seed)) for seed in seeds]
    yield 'random', (measuring.measure(*mission, few) for mission in named)
    yield 'two UAVs', (measuring.measure(
        f'seed {seed}', random_mission(seed, slots=TWO_SLOTS, jammers=1), few) for seed in seeds)
    radii = [(duration, radius) for duration in (102.0, 120.0, 200.0) for radius in (10.0, 60.0)]
    paper = [(f'T = {duration:g} s, radius {radius:g} m', Scenario.paper(duration, radius))
             for duration, radius in radii[:2 if quick else None]]
    yield 'warm', (measuring.measure_warm(*mission, few) for mission in (*paper, *named))
    yield 'objectives', (measuring.measure_objectives(*mission) for mission in (*paper, *named))


def summarise(tables):
    """Return the main results of the tables, DataFrames by name, as a table and a list."""
    lines = [_compare(f"the paper's, {name}", row, 'median') for table in ('paper', 'slots')
             for name, row in tables[table].groupby('name', sort=False)]
    for table, kind in RANDOM.items():
        rows = tables[table]
        lines += [_compare(f'{len(rows)} random ones {kind}, median', rows, 'median'),
                  _compare('the worst of them', rows, 'min')]
    names = [name.upper() for name in measuring.OPPONENTS]
    return markdown_table(
        ('missions', 'planner', *(f'against {name}' for name in names),
         *(f'rate above that of {name}' for name in names)),
        lines) + '\n\n' + '\n'.join(f'- {line}' for line in _list_results(tables)) + '\n'


def _compare(name, rows, choose):
    """Return a line of the summary: the median or worst time, ratios and gains of rows."""
    time = rows.joint_time.max() if choose == 'min' else rows.joint_time.median()
    ratios, gains = [], []
    for opponent in measuring.OPPONENTS:
        if rows[f'{opponent}_ratio'].isna().all():
            ratios.append('')
            gains.append('')
            continue
        whole, call = (_format_ratio(rows[f'{opponent}_{column}'].agg(choose))
                       for column in ('ratio', 'ratio_solve'))
        ratios.append(f'{whole} ({call})')
        gains.append(f"{(rows.joint_rate - rows[f'{opponent}_rate']).agg(choose):.4f}")
    return [name, f'{1000 * time:.0f} ms', *ratios, *gains]


def _format_ratio(value):
    return f'{value:.0f}' if value >= 9.95 else f'{value:.1f}'


def _list_results(tables):
    """Yield the results beside the comparison with other solvers, as sentences."""
    paper, slots, warm, both = (tables[name] for name in ('paper', 'slots', 'warm', 'objectives'))
    ratios = paper.alternating_time / paper.joint_time
    yield ("On the paper's missions, its alternating method takes "
           f'{ratios.min():.0f} to {ratios.max():.0f} times as long.')
    first, last = (slots.iloc[end] for end in (0, -1))
    yield (f'A process that plans {first.slots} slots takes {first.peak_memory:.0f} MB of '
           f'memory, one that plans {last.slots} takes {last.peak_memory:.0f} MB.')
    gains = warm.warm_rate - warm.cold_rate
    yield ("After the eavesdroppers' estimates have moved by 30 m, a solve that starts from the "
           f'last plan takes {warm.warm_ratio.median():.2f} times as long as one from scratch in '
           f'the median; its rate is higher by {gains.min():.5f} bit/s/Hz at least, by '
           f'{gains.max():.4f} at most.')
    gains = both.p1_rate - both.p2_rate
    yield (f'The worst-case objective takes {both.objective_ratio.median():.1f} times the '
           'processor time of the guaranteed one in the median; the worst-case rate gains '
           f'{gains.median():.4f} bit/s/Hz in the median, {gains.min():.4f} at least.')


if __name__ == '__main__':
    sys.exit(main())
