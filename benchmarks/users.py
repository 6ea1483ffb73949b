"""Compare the paper's mission typed in this package, CVXPY's DNLP with Uno, and OpenSCvx."""

import argparse
import datetime
import json
from pathlib import Path
import platform
import resource
import subprocess
import sys

import numpy as np
from secure_uav_planner import __version__
from secure_uav_planner.mission.scenario import Scenario
from secure_uav_planner.output.tables import markdown_table

from .opponents import compute_rate

TYPED = Path(__file__).with_name('typed')
SCRIPTS = {'this package': 'planner.py', 'CVXPY (DNLP) with Uno': 'dnlp.py',
           'OpenSCvx': 'scvx.py'}
PYTHON = Path('.venv-users/bin/python')
"""Python with the opponents, which `make bench-users` installs."""

GRACE = 120.0  # Time to load and compile beside the time limit of a solver [s].
_RUN = """
import json
import runpy
import sys
import numpy as np
sys.argv = sys.argv[1:]
values = runpy.run_path(sys.argv[0])
print(json.dumps({name: np.asarray(values[name]).tolist()
                  for name in ('positions', 'powers', 'status')}))
"""


def main(arguments=None):
    """Measure, print and write; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.users',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--out', type=Path, default=Path('out/bench'), help='output folder')
    parser.add_argument('--python', type=Path, default=PYTHON, help='Python with the opponents')
    parser.add_argument('--slots', type=int, default=60, help='number of slots')
    parser.add_argument('--time-limit', type=float, default=300.0, help='of each solver, in s')
    options = parser.parse_args(arguments)
    rows = [measure(name, options.slots, options.time_limit, options.python) for name in SCRIPTS]
    versions = subprocess.run(
        [options.python, '-c', 'from importlib.metadata import version\n'
         'print(*(f"{name} {version(name)}" for name in ("cvxpy", "unopy", "openscvx")), '
         'sep=", ")'], check=True, capture_output=True, text=True).stdout.strip()
    text = (f'Measured on {datetime.date.today().isoformat()} with version {__version__}, '
            f'{versions}, on one processor ({platform.machine()}), T = 120 s, N = '
            f'{options.slots}:\n\n') + markdown_table(
        ('typed in', 'lines', 'guaranteed rate (bit/s/Hz)', 'largest excess of a limit',
         'ended', 'processor time'), rows) + '\n'
    print(text)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / 'users.md').write_text(text, encoding='utf-8')
    return 0


def measure(name, slots, time_limit, python):
    """
    Return the row of a script, run in a process of its own.

    Its processor time [s] includes that to load and to compile. The rate is that of the final
    plan made feasible; the excess is that of the plan before, as a share of the limit.
    """
    script = TYPED / SCRIPTS[name]
    # A script has a docstring of one line, and no comments on lines of their own.
    lines = sum(bool(line.strip()) for line in script.read_text(encoding='utf-8').splitlines()) - 1
    before = _measure_children()
    try:
        process = subprocess.run(
            [sys.executable if name == 'this package' else python, '-c', _RUN, script,
             str(slots), str(time_limit)], check=True, capture_output=True, text=True,
            timeout=time_limit + GRACE)
    except subprocess.TimeoutExpired:
        return name, lines, '', '', 'no plan in time', f'{_measure_children() - before:.1f} s'
    answer = json.loads(process.stdout.splitlines()[-1])
    scenario = Scenario.paper(120.0, slots=slots)
    positions, powers = np.array(answer['positions']), np.array(answer['powers'])
    excess = compute_excess(scenario, positions, powers)
    positions[:, 0], positions[:, -1] = scenario.starts, scenario.goals
    return (name, lines, f'{compute_rate(scenario, positions, powers):.4f}', f'{excess:.0e}',
            answer['status'], f'{_measure_children() - before:.1f} s')


def compute_excess(scenario, positions, powers):
    """
    Return the largest excess of a plan over a limit, as a share of the limit; 0 without any.

    A start or a goal that is missed counts as a share of the longest step, and a negative power
    as one of the peak power.
    """
    def largest(vectors):
        return (np.linalg.norm(vectors, axis=-1).T / scenario.max_step).max()

    return max(0.0, largest(np.diff(positions, axis=1)) - 1,
               largest(positions[:, :1] - scenario.starts[:, None]),
               largest(positions[:, -1:] - scenario.goals[:, None]),
               (-powers.T / scenario.peak_powers).max(),
               (powers.T / scenario.peak_powers).max() - 1,
               (powers.mean(axis=1) / scenario.average_powers).max() - 1)


def _measure_children():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


if __name__ == '__main__':
    sys.exit(main())
