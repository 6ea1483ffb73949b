"""
The numbers of the pages: each table between two comments is written by a run.

`python -m docs.tools.measured` computes those of the planner, takes those of study,
flights and benchmark from the folders in which these have left them, and writes all into the
pages. `make numbers` runs the three before.
"""

import argparse
from collections.abc import Callable, Sequence
import math
from pathlib import Path
import re
import sys

from secure_uav_planner.bound import upper_bound
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.mission import METHODS, OBJECTIVES
from secure_uav_planner.mission.scenario import Scenario
from secure_uav_planner.optimize import fly_hover_fly, solve
from secure_uav_planner.output.table import markdown_table

PAGES = ('README.md', 'docs/guarantees.md', 'docs/methods.md', 'docs/paper.md',
         'studies/flown.md', 'studies/numerics.md')
BLOCK = re.compile(r'(<!-- numbers: (\w+) -->\n).*?(<!-- end of numbers -->\n)', re.DOTALL)
"""A table in a page, with its name."""

_PROOF = 10.0  # The longest search for a bound in s.
_MISSIONS = ((102, 10), (102, 60), (120, 30), (120, 60), (200, 10), (200, 60))  # s, m


def main(argv: Sequence[str] | None = None) -> int:
    """Write tables into the pages; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m docs.tools.measured',
                                     description=__doc__)
    parser.add_argument('tables', nargs='*', metavar='TABLE',
                        help=f'tables to write, by default all: {", ".join(TABLES)}')
    options = parser.parse_args(argv)
    try:
        found = {name: TABLES[name]() for name in options.tables or TABLES}
        for page in map(Path, PAGES):
            text = page.read_text(encoding='utf-8')
            page.write_text(renewed(text, found), encoding='utf-8')
    except KeyError as error:
        print(f'numbers: there is no table {error}', file=sys.stderr)
        return 2
    except (OSError, PlanningError) as error:
        print(f'numbers: {error}', file=sys.stderr)
        return 1
    return 0


def renewed(text: str, tables: dict[str, str]) -> str:
    """Return the text of a page with tables in place of those of their names."""
    return BLOCK.sub(lambda block: f'{block[1]}\n{tables[block[2]]}\n\n{block[3]}'
                     if block[2] in tables else block[0], text)


def rates(proof: float = _PROOF) -> str:
    """Return the rates of the paper's mission; the bound is searched for so many s."""
    scenario = Scenario.paper()
    plans = {'fly-hover-fly, constant power': fly_hover_fly(scenario),
             'fly-hover-fly, optimised power': fly_hover_fly(scenario, 'optimised'),
             'this planner, `objective: guaranteed`': solve(scenario, objective='guaranteed'),
             'this planner': (plan := solve(scenario))}
    bound = upper_bound(scenario, plan=plan, time_limit=proof)
    return markdown_table(
        ('scheme', 'guaranteed rate (bit/s/Hz)', 'worst-case rate (bit/s/Hz)',
         f'below the best possible, at most (proof of {bound.solve_time:.0f} s)'),
        ((name, f'{plan.guaranteed_rate:.4f}', f'{plan.worst_case_rate:.4f}',
          f'{math.ceil(1000 * bound.share_missing(plan)) / 10:.1f}%')  # Rounded up: it is proven.
         for name, plan in plans.items()))


def objectives() -> str:
    """Return the worst-case rates that both objectives lead to."""
    return markdown_table(
        ('T (s), error radius (m)', 'worst-case rate of the (P2) plan', 'of the (P1) plan'),
        ((f'{duration}, {radius}', *(
            f'{solve(Scenario.paper(duration, radius), objective=one).worst_case_rate:.4f}'
            for one in OBJECTIVES)) for duration, radius in _MISSIONS))


def methods() -> str:
    """Return rates and times of both methods with the paper's objective."""
    plans = ((duration, solve(Scenario.paper(duration), method, objective='guaranteed'))
             for duration in (102.0, 200.0) for method in METHODS)
    return markdown_table(
        ('T', 'method', 'guaranteed rate', 'steps', 'time'),
        ((f'{duration:g} s', f'`{plan.method}`', f'{plan.guaranteed_rate:.4f}',
          len(plan.history) - 1, f'{plan.solve_time:.2g} s') for duration, plan in plans))


def _left_in(path: str, table: int | None = None) -> Callable[[], str]:
    """Return what reads a Markdown file that another program has left, or one of its tables."""
    def read() -> str:
        text = Path(path).read_text(encoding='utf-8').strip()
        return text if table is None else re.findall(
            r'(?:^\|.*\n?)+', text, re.MULTILINE)[table].strip()
    return read


TABLES: dict[str, Callable[[], str]] = {
    'rates': rates, 'objectives': objectives, 'methods': methods,
    'claims': _left_in('out/study/claims.md', 0), 'flown': _left_in('out/fly/fly.md', 0),
    'events': _left_in('out/fly/fly.md', 1), 'speed': _left_in('out/bench/speed.md')}
"""What computes each table, by its name."""

if __name__ == '__main__':
    sys.exit(main())
