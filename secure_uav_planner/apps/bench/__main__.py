"""Run the benchmark: print tables, and write Markdown, CSV and a picture to a folder."""

import argparse
import datetime
import os
from pathlib import Path
import platform
import sys

from . import measuring, report
from .fatrop import TOLERANCE
from .missions import random_mission
from ... import __version__
from ...mission.scenario import Scenario

PAPER = ((102.0, 10.0, 1.3694), (104.0, 10.0, 1.5601), (120.0, 10.0, 1.9875),
         (150.0, 10.0, 2.5035), (200.0, 10.0, 3.0187), (200.0, 0.0, 3.1917))
TWO_SLOTS = 100  # Of the missions of two UAVs.


def main(arguments=None):
    """Measure, print and write; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m secure_uav_planner.apps.bench',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--quick', action='store_true', help='use fewer missions and slots')
    parser.add_argument('--out', type=Path, default=Path('out/bench'), help='output folder')
    parser.add_argument('--seed', type=int, default=0, help='seed of the first random mission')
    parser.add_argument('--missions', type=int, help='number of random missions')
    options = parser.parse_args(arguments)
    try:
        import casadi
    except ImportError:
        print('the benchmark compares with CasADi: pip install casadi', file=sys.stderr)
        return 1
    options.out.mkdir(parents=True, exist_ok=True)
    repeats = 3 if options.quick else 7
    count = options.missions or (4 if options.quick else 24)
    seeds = range(options.seed, options.seed + count)
    tables = {}

    def table(name, rows):
        print(f'\n{name}')
        tables[name] = []
        for row in rows:
            tables[name].append(row)
            print('  ' + ', '.join(f'{column} {report.text(column, value)}'
                                   for column, value in row.items()
                                   if value is not None), flush=True)

    table('paper', (
        measuring.measure(f'T = {duration:g} s, radius {radius:g} m',
                          Scenario.paper(duration, radius), repeats,
                          alternating=not options.quick, reference=reference)
        for duration, radius, reference in PAPER))
    sizes = (200, 400) if options.quick else (200, 400, 1000, 2000, 5000)
    table('slots', (
        {**measuring.measure(f'N = {slots}', Scenario.paper(200.0, 10.0, slots), repeats,
                             ipopt=slots <= 2000, fatrop=slots <= 2000),
         'peak_memory': measuring.peak_memory(slots)} for slots in sizes))
    table('random', (measuring.measure(f'seed {seed}', random_mission(seed), min(repeats, 3))
                     for seed in seeds))
    table('two UAVs', (measuring.measure(
        f'seed {seed}', random_mission(seed, slots=TWO_SLOTS, jammers=1), min(repeats, 3))
        for seed in seeds))
    warm = [('paper', Scenario.paper(duration), 0) for duration in (102.0, 120.0, 200.0)]
    warm += [(f'seed {seed}', random_mission(seed), seed) for seed in seeds]
    table('warm', (measuring.measure_warm(name, scenario, seed, min(repeats, 3))
                   for name, scenario, seed in warm))

    radii = [(duration, radius) for duration in (102.0, 120.0, 200.0) for radius in (10.0, 60.0)]
    objectives = [(f'T = {duration:g} s, radius {radius:g} m', Scenario.paper(duration, radius))
                  for duration, radius in radii[:2 if options.quick else None]]
    objectives += [(f'seed {seed}', random_mission(seed)) for seed in seeds]
    table('objectives', (measuring.measure_objectives(*mission) for mission in objectives))

    today, machine = datetime.date.today().isoformat(), platform.machine()
    summary = (f'Measured on {today} with version {__version__}, on {os.cpu_count()} processors '
               f'({machine}):\n\n' + report.summary(tables))
    print('\n' + summary)
    document = (
        f'# Benchmark of {today}\n\n'
        f'`python -m secure_uav_planner.apps.bench {" ".join(arguments or sys.argv[1:])}`, '
        f'Python {platform.python_version()}, CasADi {casadi.__version__}, '
        f'{machine}. Times are medians in s, rates in bit/s/Hz, memory in MB. IPOPT '
        'and FATROP start from fly-hover-fly with constant power, with exact derivatives. IPOPT '
        f'has its default options, and FATROP a tolerance of {TOLERANCE:g} and otherwise its '
        'own; it finds the stages by itself, with the powers used before as a state. With '
        'several eavesdroppers the largest leak is an epigraph variable, and the kinks at d = 0 '
        'and d = eps are left to them (the first rounded by 1 cm): they have no smoother fair '
        'form.\n\n' + summary)
    for name, rows in tables.items():
        document += f'\n## {name}\n\n{report.table_of(rows)}'
    (options.out / 'speed.md').write_text(summary, encoding='utf-8')
    (options.out / 'bench.md').write_text(document, encoding='utf-8')
    report.write_csv(options.out / 'bench.csv', tables)
    report.plot_scaling(options.out / 'time_against_slots.png', tables['slots'])
    print(f'written to {options.out}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
