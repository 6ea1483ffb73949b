"""
Fly missions and events in simulation; print tables, and write them and pictures to a folder.

The exit status is 1 if setpoints jumped.
"""

import argparse
from pathlib import Path
import sys

from examples.isolation import isolated
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.mission.scenario import Scenario
from secure_uav_planner.optimize import solve
from secure_uav_planner.plan.plan import Plan

from .flight import fly_event, fly_plan
from .flight_picture import save_flight
from .missions import event_mission, EVENTS, paper_missions, random_missions
from .report import event_report, flight_report, report_table

_CITY = Path(__file__).parents[2] / 'config' / 'city.yaml'


def main(arguments=None):
    """Plan, fly, print and write; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m studies.flown',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--out', type=Path, default=Path('out/fly'), help='output folder')
    parser.add_argument('--random', type=int, default=5, help='number of random missions')
    parser.add_argument('--plans', type=Path, nargs='*', help='saved plans to fly instead')
    parser.add_argument('--events', nargs='*', choices=EVENTS, metavar='EVENT',
                        help=f'events to fly, of {", ".join(EVENTS)}; by default all, or '
                        'none with --plans')
    options = parser.parse_args(arguments)
    if options.events is None:
        options.events = [] if options.plans else EVENTS
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        with isolated(options.out):
            return 0 if _fly(options) else 1
    except (PlanningError, OSError) as error:
        print(f'fly: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def _yield_plans(options):
    """Yield names and Plans."""
    for path in options.plans or ():
        yield path.stem, Plan.load(path)
    if options.plans is None:
        for name, scenario in (*paper_missions(), ('city', Scenario.load(_CITY)),
                               *random_missions(options.random)):
            yield name, solve(scenario)


def _fly(options):
    """Fly, print and write; return True if no setpoint jumped."""
    reports, event_reports = [], []
    for number, (name, plan) in enumerate(_yield_plans(options)):
        flight = fly_plan(name, plan, seed=number)
        reports.append(flight_report(plan, flight))
        print(report_table(reports).splitlines()[-1], flush=True)
        save_flight(flight, options.out / f'flight_{number + 1}.png')
    for name in options.events:
        flight = fly_event(EVENTS[name], event_mission())
        event_reports.append(event_report(flight))
        print(report_table(event_reports).splitlines()[-1], flush=True)
        save_flight(flight, options.out / f'event_{name}.png')
    text = '\n\n'.join(
        report_table(kind) for kind in (reports, event_reports) if kind)
    (options.out / 'fly.md').write_text(f'# Flown in physics\n\n{text}\n', encoding='utf-8')
    print(f'\n{text}\n\nwritten to {options.out}')
    jumped = [report.event for report in event_reports if not report.is_smooth]
    if jumped:
        print(f'fly: setpoints jumped: {", ".join(jumped)}', file=sys.stderr)
    return not jumped


if __name__ == '__main__':
    sys.exit(main())
