"""Measure how many missions a core plans in a second, by `solve` and by `sweep`."""

import argparse
import datetime
import os
from pathlib import Path
import platform
import resource
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from secure_uav_planner import __version__, Scenario, solve
from secure_uav_planner.apps.campaign_file import load_campaign
import yaml

CAMPAIGN = {'mission': Scenario.paper(120.0).to_dict(), 'vary': {
    'eavesdroppers.0.position': {'uniform': [[100.0, -200.0], [300.0, 200.0]]}}}  # m
FEW = 10  # Missions of a sweep whose time, mostly that to load its processes, is taken off.


def main(arguments=None):
    """Measure, print and write; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.throughput',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--out', type=Path, default=Path('out/bench'), help='output folder')
    parser.add_argument('--missions', type=int, default=200,
                        help=f'number of missions, more than {FEW}')
    options = parser.parse_args(arguments)
    alone, swept = measure(options.missions)
    text = (f'Measured on {datetime.date.today().isoformat()} with version {__version__} '
            f'({platform.machine()}, {os.cpu_count()} processors), {options.missions} missions: '
            f'{1 / alone:.0f} in a second of processor time by `solve`, one at a time, and '
            f'{1 / swept:.0f} by `sweep` on all cores, of whose processor time `solve` alone is '
            f'{alone / swept:.0%}.\n')
    print(text)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / 'throughput.md').write_text(text, encoding='utf-8')
    return 0


def measure(missions):
    """Return processor times [s] of a mission by `solve` and by `sweep` without its start."""
    scenarios = [Scenario.from_dict(task['mission']) for task in load_campaign(
        {**CAMPAIGN, 'samples': missions}).tasks()]
    started = time.process_time()
    for scenario in scenarios:
        solve(scenario)
    alone = (time.process_time() - started) / missions
    with TemporaryDirectory() as folder:
        few, all_of_them = (_measure_sweep(Path(folder), count) for count in (FEW, missions))
    return alone, (all_of_them - few) / (missions - FEW)


def _measure_sweep(folder, count):
    """Return the processor time of a sweep and of its workers, in s."""
    file = folder / f'{count}.yaml'
    file.write_text(yaml.safe_dump({**CAMPAIGN, 'samples': count}), encoding='utf-8')
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, '-m', 'secure_uav_planner', 'sweep', file, '--out',
                    folder / str(count)], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


if __name__ == '__main__':
    sys.exit(main())
