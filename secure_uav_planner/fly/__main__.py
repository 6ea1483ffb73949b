"""Fly the missions in physics: print a table, and write it and pictures to a folder."""

import argparse
from importlib.util import find_spec
from pathlib import Path
import sys
import time

from .missions import city_missions, paper_missions, random_missions
from ..errors import PlanningError
from ..optimize import solve
from ..plan import Plan
from ..ros.graph import isolated


def main(arguments=None):
    """Plan, fly, print and write; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m secure_uav_planner.fly',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--out', type=Path, default=Path('out/fly'), help='output folder')
    parser.add_argument('--random', type=_number, default=5, help='number of random missions')
    parser.add_argument('--plans', type=Path, nargs='*', help='saved plans to fly instead')
    options = parser.parse_args(arguments)
    if find_spec('rotorpy') is None:
        print("fly: rotorpy is missing: pip install '.[ros,fly]'", file=sys.stderr)
        return 1
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        with isolated(options.out):
            _fly_all(options)
    except (PlanningError, OSError) as error:
        print(f'fly: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def _number(text):
    """Return the number of random missions, of which there are as many as anybody wants."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(
            f'{text!r} is no number of missions; it must be a whole number, at least 0')
    return int(text)


def _plans(options):
    """Yield names and Plans."""
    for path in options.plans or ():
        yield path.stem, Plan.load(path)
    if options.plans is None:
        for name, scenario in (*paper_missions(), *city_missions(),
                               *random_missions(options.random)):
            yield name, solve(scenario)


def _fly_all(options):
    from .flight import fly
    from .picture import save_flight
    from .report import report, table
    reports = []
    for number, (name, plan) in enumerate(_plans(options)):
        began = time.monotonic()
        flight = fly(plan, seed=number)
        reports.append(report(name, flight))
        save_flight(name, flight, options.out / f'flight_{number + 1}.png')
        print(f'{table(reports[-1:]).splitlines()[-1]} {time.monotonic() - began:.0f} s',
              flush=True)
    text = table(reports)
    (options.out / 'fly.md').write_text(f'# Flown in physics\n\n{text}\n', encoding='utf-8')
    print(f'\n{text}\n\nwritten to {options.out}')


if __name__ == '__main__':
    sys.exit(main())
