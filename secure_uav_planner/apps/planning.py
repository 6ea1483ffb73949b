"""Plans: `plan` makes and writes one, `show` draws one."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import signal
import sys
import time
from typing import Any

from .missions import choose_picture, load_input, locating_errors, make_folder, SHORTFALL_DRAWS
from ..assessment import assess
from ..bound import explain_refusal, shortest_duration, upper_bound
from ..errors import (
    describe_error, InfeasibleMissionError, name_missing_package, OptionError, PlanningError,
    StoppedError)
from ..mission.files import naming
from ..mission.scenario import Scenario
from ..optimize import fly_hover_fly, solve
from ..output.tables import rate_table, save_csv
from ..plan.plan import Iteration, Plan
from ..plan.results import Bound

_PICTURES = ('.png', '.svg', '.pdf')
_PAGE = '.html'
_MAP = '.geojson'
_ERASE = '\033[K'  # Erases the rest of a terminal's line.
_PERIOD = 0.1  # Least time between two texts of the progress line [s].


class _Progress:
    """
    Progress line on a terminal. The first Ctrl-C stops the search, the second aborts.

    If the body of its with statement fails, it prints the files that were written.

    :ivar is_stopped: True after the first Ctrl-C or SIGTERM.
    :ivar written: paths of the files that were written.
    """

    def __init__(self) -> None:
        self.is_stopped, self.written = False, list[Path]()
        self._last_shown = -_PERIOD

    def __enter__(self) -> '_Progress':
        self._handlers = {number: signal.signal(number, self._on_signal)
                          for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, error: object, *_: object) -> None:
        """Restore the handlers of signals, erase the line; after an error, print `written`."""
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self.show('', force=True)
        if error is not None and self.written:
            print(f'written: {", ".join(map(str, self.written))}', file=sys.stderr)

    def _on_signal(self, number: int, frame: Any) -> None:
        self.is_stopped = True
        signal.signal(number, signal.default_int_handler)

    def show(self, text: str, force: bool = False) -> bool:
        """Replace the terminal's line, at most once a _PERIOD unless forced; return is_stopped."""
        now = time.monotonic()
        if sys.stderr.isatty() and (force or now - self._last_shown >= _PERIOD):
            self._last_shown = now
            print(f'\r{_ERASE}{text}', end='', file=sys.stderr, flush=True)
        return self.is_stopped


@contextmanager
def drawing(file: Path) -> Iterator[None]:
    """Put a file's path into errors of drawing it; turn unexpected ones into a PlanningError."""
    try:
        with naming(file), name_missing_package():
            yield
    except (OSError, PlanningError, MemoryError):
        raise
    except Exception as error:  # Matplotlib raises many, for example for unreadable fonts.
        raise PlanningError(f'{file} cannot be drawn: {describe_error(error)}') from None


@contextmanager
def drawing_if_possible(file: Path) -> Iterator[None]:
    """Print the PlanningError of a file that cannot be drawn, instead of raising it."""
    try:
        with drawing(file):
            yield
    except PlanningError as error:
        print(error if str(file) in str(error) else f'{error}; {file.name} is not drawn',
              file=sys.stderr)


def make_plan(options: argparse.Namespace) -> None:
    """Plan a mission, write and print the results; after a stop, raise StoppedError at the end."""
    scenario = load_input(options.mission, Scenario.load)
    if options.mcap:
        with name_missing_package():
            from ..ros.recording import record
    out = make_folder(Path(options.out))
    mission, file = Path(options.mission), out / 'plan.json'
    if mission.exists() and file.exists() and mission.samefile(file):
        raise OptionError(f'the plan would replace the mission {mission}; choose another folder '
                          'by --out')
    with locating_errors(options.mission), _Progress() as progress:
        plan = _find_plan(scenario, options, progress)
        scenario = plan.scenario
        # The plan is saved before anything is printed or drawn: a later failure does not lose it.
        plan.save(out / 'plan.json')
        progress.written.append(out / 'plan.json')
        baselines = [] if options.no_baselines else _plan_baselines(scenario, options, progress)
        bound = _prove_bound(plan, options, progress)
        proven = plan.with_bound(bound)
        if bound:
            proven.save(out / 'plan.json')
        progress.show('drawing ...', force=True)
        progress.written.extend(_write_views(proven, baselines, out))
        if options.mcap:
            record(proven, out / 'plan.mcap')
            progress.written.append(out / 'plan.mcap')
    print(rate_table([*baselines, plan], bound))
    if not scenario.channel.is_guarantee:
        print(f'{plan.method}: {assess(plan, SHORTFALL_DRAWS).shortfall}')
    print(f'\n{plan.message}' + (f'; {proven.claim}' if bound else ''))
    if bound:
        print(_describe_proof(bound))
    if options.bound_time_limit and (refusal := explain_refusal(scenario)):
        print(f'no bound: {refusal}')
    if plan.clearance.is_close:
        print(f'warning: {plan.clearance.between_uavs_text}', file=sys.stderr)
    print(f'written: {", ".join(map(str, progress.written))}')
    if progress.is_stopped:
        raise StoppedError('stopped; what has been found is kept')


def _describe_proof(bound: Bound) -> str:
    """Return how long a proof took, and whether a time limit or a cancel ended it early."""
    text = f'proven in {bound.solve_time:.1f} s'
    if bound.status == 'time_limit':
        text += ', when its time limit was over; a larger --bound-time-limit may prove more'
    return f'{text}, when it was stopped' if bound.status == 'cancelled' else text


def _find_plan(scenario: Scenario, options: argparse.Namespace, progress: _Progress) -> Plan:
    """Return the plan with the best rate found, or with --deliver the shortest plan for BITS."""
    def show(iteration: Iteration) -> bool:
        rate = f'{iteration.rate:.4f} bit/s/Hz' if iteration.rate else 'nothing yet'
        return progress.show(f'planning: iteration {iteration.number} ({iteration.step}), {rate}, '
                             f'{iteration.elapsed:.1f} s')

    progress.show('planning ...', force=True)
    if options.deliver is None:
        return solve(scenario, options.method, show, options.time_limit,
                     objective=options.objective)
    if options.method != 'joint':
        raise OptionError(f'--deliver is for the method joint, and --method is {options.method}')
    try:
        return shortest_duration(scenario, options.deliver, objective=options.objective,
                                 time_limit=options.time_limit, on_progress=show)
    except InfeasibleMissionError as error:
        if error.place != ('bits',):
            raise
        raise OptionError(f'--deliver: {error}') from None


def _plan_baselines(scenario: Scenario, options: argparse.Namespace, progress: _Progress
                    ) -> list[Plan]:
    """Return fly-hover-fly at constant and optimised power, until a stop; print failures."""
    plans: list[Plan] = []
    for power in ('constant', 'optimised'):
        if progress.show(f'fly-hover-fly with {power} power ...', force=True):
            break
        try:
            plans.append(fly_hover_fly(
                scenario, power, lambda _: progress.is_stopped, options.time_limit))
        except PlanningError as error:
            print(f'no fly-hover-fly with {power} power: {error}', file=sys.stderr)
    return plans


def _prove_bound(plan: Plan, options: argparse.Namespace, progress: _Progress) -> Bound | None:
    """Return a plan's upper bound, or None after a stop, for a time limit of 0 or a refusal."""
    if progress.is_stopped or not options.bound_time_limit or explain_refusal(plan.scenario):
        return None
    progress.show('bound ...', force=True)
    return upper_bound(
        plan.scenario, objective=plan.objective, plan=plan, time_limit=options.bound_time_limit,
        on_progress=lambda state: progress.show(
            f'bound: no plan has more than {state.rate:.4f} bit/s/Hz, {state.elapsed:.1f} s'))


def _write_views(plan: Plan, baselines: list[Plan], out: Path) -> Iterator[Path]:
    """Write CSV, map (with an origin), picture and page, and yield each file that is written."""
    save_csv(plan, out / 'plan.csv')
    yield out / 'plan.csv'
    maps = [] if plan.scenario.origin is None else [out / f'plan{_MAP}']
    for file in (*maps, out / 'plan.png', out / 'plan.html'):
        with drawing_if_possible(file):
            _save_view(plan, file, baselines)
            yield file


def _save_view(plan: Plan, file: Path, baselines: list[Plan]) -> None:
    """Write the picture, the page or the GeoJSON map of a plan, by the suffix of the file."""
    if file.suffix.lower() == _MAP:
        plan.to_geojson(file)
    elif file.suffix.lower() == _PAGE:
        from ..output.page import save_page
        save_page(plan, file, baselines)
    else:
        from ..output.picture import save_picture
        save_picture(plan, file, baselines)


def show_plan(options: argparse.Namespace) -> None:
    """Print the rates of a saved plan, and write it as a picture, a page or a map."""
    plan = Plan.load(options.plan)
    file = choose_picture(options, _PICTURES[0], (*_PICTURES, _PAGE, _MAP))
    if file.suffix.lower() == _MAP and plan.scenario.origin is None:
        raise OptionError(f'{options.plan} has no places in degrees; give its mission an origin: '
                          '{latitude: , longitude: }, and plan it again')
    print(rate_table([plan]))
    with drawing(file):
        _save_view(plan, file, [])
    print(f'written: {file}')
