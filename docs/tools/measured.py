"""
The numbers and pictures of the pages, each written by a run.

`python -m docs.tools.measured` computes the tables of the planner, takes those of study, flights
and benchmark from the folders to which these write, and puts each table between its two comments
in a page. `make numbers` runs the three before. A picture carries, as its description, the table
of the same run.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from pathlib import Path
import re
import sys

from secure_uav_planner.bound import upper_bound
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.mission import METHODS, OBJECTIVES
from secure_uav_planner.mission.propagation import Channel
from secure_uav_planner.mission.scenario import Scenario
from secure_uav_planner.optimize import fly_hover_fly, solve
from secure_uav_planner.output.drawing import scheme_name
from secure_uav_planner.output.picture import draw_plan
from secure_uav_planner.output.tables import markdown_table

from .png import save_png

DOCS = Path(__file__).resolve().parents[1]
PAGES = (DOCS.parent / 'README.md', *sorted(DOCS.glob('*.md')),
         *sorted((DOCS.parent / 'studies').glob('*.md')))
BLOCK = re.compile(r'(<!-- numbers: (\w+) -->\n).*?(<!-- end of numbers -->\n)', re.DOTALL)
"""A table in a page, with its name."""

PICTURES = {'plan.png': 'rates', 'city.png': 'city', 'figure-2.png': 'claims',
            'figure-3.png': 'claims'}
"""The pictures in DOCS, each with the table of its run."""

_PROOF = 300.0  # The longest search for a bound in s; it ends by itself in about 6.
_MISSIONS = ((102, 10), (102, 60), (120, 30), (120, 60), (200, 10), (200, 60))  # s, m


def main(argv: Sequence[str] | None = None) -> int:
    """Write tables into the pages; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m docs.tools.measured',
                                     description=__doc__)
    parser.add_argument('tables', nargs='*', metavar='TABLE',
                        help=f'tables to write, by default all: {", ".join(TABLES)}')
    options = parser.parse_args(argv)
    try:
        tables = {name: TABLES[name](DOCS) for name in options.tables or TABLES}
        for page in PAGES:
            text = page.read_text(encoding='utf-8')
            page.write_text(replace_tables(text, tables), encoding='utf-8')
    except KeyError as error:
        print(f'numbers: there is no table {error}', file=sys.stderr)
        return 2
    except (OSError, PlanningError) as error:
        print(f'numbers: {error}', file=sys.stderr)
        return 1
    return 0


def replace_tables(text: str, tables: dict[str, str]) -> str:
    """Return the text of a page with its tables replaced by those of the same names."""
    return BLOCK.sub(lambda block: f'{block[1]}\n{tables[block[2]]}\n\n{block[3]}'
                     if block[2] in tables else block[0], text)


def measure_rates(folder: Path, proof: float = _PROOF) -> str:
    """Return the rates of the paper's mission with a bound of so many s; draw plan.png."""
    scenario = Scenario.paper()
    plan = solve(scenario)
    baselines = [fly_hover_fly(scenario, power) for power in ('constant', 'optimised')]
    plans = {'fly-hover-fly, constant power': baselines[0],
             'fly-hover-fly, optimised power': baselines[1],
             'this planner, `objective: guaranteed`': solve(scenario, objective='guaranteed'),
             'this planner': plan}
    bound = upper_bound(scenario, plan=plan, time_limit=proof)
    table = markdown_table(
        ('scheme', 'guaranteed rate (bit/s/Hz)', 'worst-case rate (bit/s/Hz)',
         'worst-case rate below the bound'),
        ((name, f'{plan.guaranteed_rate:.4f}', f'{plan.worst_case_rate:.4f}',
          f'{math.ceil(1000 * bound.share_missing(plan)) / 10:.1f}%')  # A bound: rounded up.
         for name, plan in plans.items()))
    draw_plan(plan.with_bound(bound), baselines).savefig(folder / 'plan.png', dpi=120)
    save_png(folder / 'plan.png', folder / 'plan.png', table)
    return table


def measure_city(folder: Path) -> str:
    """Return the rates of the mission over a city; draw city.png."""
    scenario = Scenario.load(DOCS.parent / 'config' / 'city.yaml')
    others = [fly_hover_fly(scenario, power) for power in ('constant', 'optimised')]
    free = solve(replace(scenario, channel=Channel()))
    others.append(replace(free, scenario=scenario, method='planned for free space'))
    plan = solve(scenario)
    table = markdown_table(
        ('scheme', 'guaranteed rate (bit/s/Hz)', 'worst-case rate (bit/s/Hz)'),
        ((name, f'{plan.guaranteed_rate:.4f}', f'{plan.worst_case_rate:.4f}')
         for name, plan in ((scheme_name(plan.method), plan) for plan in others)))
    table += f'\n| this planner | {plan.guaranteed_rate:.4f} | {plan.worst_case_rate:.4f} |'
    draw_plan(plan, others).savefig(folder / 'city.png', dpi=120)
    save_png(folder / 'city.png', folder / 'city.png', table)
    return table


def measure_objectives(_: Path) -> str:
    """Return the worst-case rates of the plans for both objectives."""
    return markdown_table(
        ('T (s), error radius (m)', 'worst-case rate of the (P2) plan', 'of the (P1) plan'),
        ((f'{duration}, {radius}', *(
            f'{solve(Scenario.paper(duration, radius), objective=name).worst_case_rate:.4f}'
            for name in OBJECTIVES)) for duration, radius in _MISSIONS))


def measure_methods(_: Path) -> str:
    """Return rates and times of both methods with the paper's objective."""
    plans = ((duration, solve(Scenario.paper(duration), method, objective='guaranteed'))
             for duration in (102.0, 200.0) for method in METHODS)
    return markdown_table(
        ('T', 'method', 'guaranteed rate', 'steps', 'time'),
        ((f'{duration:g} s', f'`{plan.method}`', f'{plan.guaranteed_rate:.4f}',
          len(plan.history) - 1, f'{plan.solve_time:.2g} s') for duration, plan in plans))


def copy_claims(folder: Path, study: Path = Path('out/study')) -> str:
    """Return the claims that the study has written; copy its Figures 2 and 3."""
    claims = _read_tables(study / 'claims.md')[0]
    for number in (2, 3):
        save_png(study / f'figure_{number}.png', folder / f'figure-{number}.png', claims)
    return claims


def _read_tables(path: Path) -> list[str]:
    return [table.strip() for table in re.findall(
        r'(?:^\|.*\n?)+', path.read_text(encoding='utf-8'), re.MULTILINE)]


TABLES: dict[str, Callable[[Path], str]] = {
    'rates': measure_rates, 'city': measure_city, 'objectives': measure_objectives,
    'methods': measure_methods, 'claims': copy_claims,
    'flown': lambda _: _read_tables(Path('out/fly/fly.md'))[0],
    'events': lambda _: _read_tables(Path('out/fly/fly.md'))[1],
    **{name: lambda _, name=name: Path(f'out/bench/{name}.md').read_text(encoding='utf-8').strip()
       for name in ('speed', 'users', 'throughput')}}
"""The function of each table by its name; its argument is the folder of its pictures."""

if __name__ == '__main__':
    sys.exit(main())
