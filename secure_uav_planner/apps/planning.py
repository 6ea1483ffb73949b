"""Plans: `plan` makes one and writes what a user needs, `show` draws and `assess` assesses it."""

import argparse
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
import signal
import sys
import time
from typing import Any

from .cli import DONE
from .missions import lines_of, loaded, picture_file, SHORTFALL_DRAWS, writable
from ..assessment import assess, World
from ..bound import explain_refusal, upper_bound
from ..errors import (
    name_missing_package, OptionError, PlanningError, ScenarioError, StoppedError)
from ..mission import import_view
from ..mission.files import naming
from ..mission.propagation import Channel
from ..mission.scenario import Scenario
from ..optimize import fly_hover_fly, solve
from ..output.spreadsheet import save_csv
from ..output.table import assessment_table, table
from ..plan.plan import Plan
from ..plan.results import Bound

_SUFFIXES = ('.png', '.svg', '.pdf', '.html')  # The last one is no picture.
_ERASE = '\033[K'  # Of the rest of a terminal's line.
_PERIOD = 0.1  # In s, of the line that says how far the work has come.


class _Work:
    """
    Work that says how far it has come, and that Ctrl-C stops; the second one ends it all.

    It is a context. What it says is a line that is written over and over, and gone at the end;
    nothing where the output is no terminal. If it fails, it tells what is written.

    :ivar is_stopped: whether Ctrl-C was pressed.
    :ivar written: the files that are written.
    """

    def __init__(self) -> None:
        self.is_stopped, self.written = False, list[Path]()
        self._last = -_PERIOD

    def __enter__(self) -> '_Work':
        self._before = {number: signal.signal(number, self._on_signal)
                        for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, error: object, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self.say('', force=True)
        if error is not None and self.written:
            print(f'written: {", ".join(map(str, self.written))}', file=sys.stderr)

    def _on_signal(self, number: int, frame: Any) -> None:
        self.is_stopped = True
        signal.signal(number, signal.default_int_handler)

    def say(self, text: str, force: bool = False) -> bool:
        """Show a text in place of the last one, ten times a second; return whether to stop."""
        now = time.monotonic()
        if sys.stderr.isatty() and (force or now - self._last >= _PERIOD):
            self._last = now
            print(f'\r{_ERASE}{text}', end='', file=sys.stderr, flush=True)
        return self.is_stopped


def make_plan(options: argparse.Namespace) -> int:
    """Plan a mission and write the results; return the exit status."""
    scenario = loaded(options.mission)
    if options.mcap:
        import_view('save_mcap')
    out = writable(Path(options.out))
    with lines_of(options.mission), _Work() as work:
        work.say('planning ...', force=True)
        plan = solve(
            scenario, options.method, lambda iteration: work.say(
                f'planning: iteration {iteration.number} ({iteration.step}), {iteration.rate:.4f} '
                f'bit/s/Hz, {iteration.elapsed:.1f} s'),
            options.time_limit, objective=options.objective)
        # Written before anything is printed, which may have no reader, and the plan first:
        # whatever fails from here on, it is there.
        plan.save(out / 'plan.json')
        work.written.append(out / 'plan.json')
        baselines = [] if options.no_baselines else _baselines(scenario, options, work)
        bound = _bound(plan, options, work)
        proven = plan.with_bound(bound)
        if bound:
            proven.save(out / 'plan.json')
        work.say('drawing ...', force=True)
        work.written.extend(_write(proven, baselines, out))
        if options.mcap:
            proven.save_mcap(out / 'plan.mcap')
            work.written.append(out / 'plan.mcap')
    print(table([*baselines, plan], bound))
    if not scenario.channel.is_guarantee:
        print(f'{plan.method}: {assess(plan, SHORTFALL_DRAWS).shortfall}')
    print(f'\n{plan.message}' + (
        f'; {proven.claim}, which is proven, in {bound.solve_time:.1f} s' if bound else '') + (
        ', when it was stopped' if bound and bound.status == 'cancelled' else ''))
    if options.bound_time_limit and (refusal := explain_refusal(scenario)):
        print(f'no bound: {refusal}')
    if plan.clearance.is_close:
        print(f'warning: {plan.clearance.between_uavs_text}', file=sys.stderr)
    print(f'written: {", ".join(map(str, work.written))}')
    if work.is_stopped:
        raise StoppedError('stopped; what has been found is kept')
    return DONE


def _bound(plan: Plan, options: argparse.Namespace, work: _Work) -> Bound | None:
    if work.is_stopped or options.bound_time_limit is None or explain_refusal(plan.scenario):
        return None
    work.say('bound ...', force=True)
    return upper_bound(
        plan.scenario, objective=plan.objective, plan=plan, time_limit=options.bound_time_limit,
        on_progress=lambda progress: work.say(
            f'bound: no plan has more than {progress.rate:.4f} bit/s/Hz, '
            f'{progress.elapsed:.1f} s'))


def _baselines(scenario: Scenario, options: argparse.Namespace, work: _Work) -> list[Plan]:
    """Return fly-hover-fly with both powers, as far as the limits allow."""
    found: list[Plan] = []
    for power in ('constant', 'optimised'):
        if work.say(f'fly-hover-fly with {power} power ...', force=True):
            break
        try:
            found.append(fly_hover_fly(
                scenario, power, lambda _: work.is_stopped, options.time_limit))
        except PlanningError as error:
            print(f'no fly-hover-fly with {power} power: {error}', file=sys.stderr)
    return found


def _write(plan: Plan, baselines: list[Plan], out: Path) -> Iterator[Path]:
    """Write all but the plan itself, and yield each file that is there."""
    save_csv(plan, out / 'plan.csv')
    yield out / 'plan.csv'
    try:
        from ..output.picture import save_picture
        with naming(out / 'plan.png'):
            save_picture(plan, out / 'plan.png', baselines)
        yield out / 'plan.png'
        from ..output.page import save_page
        save_page(plan, out / 'plan.html')
        yield out / 'plan.html'
    except ModuleNotFoundError as error:
        print(f'{error.name} is not installed, so not everything is drawn; pip install '
              '"secure_uav_planner[view]"', file=sys.stderr)


def show(options: argparse.Namespace) -> int:
    """Draw a plan; return the exit status."""
    plan = Plan.load(options.plan)
    file = picture_file(options, '.png', _SUFFIXES)
    print(table([plan]))
    with name_missing_package():
        if file.suffix.lower() == '.html':
            from ..output.page import save_page as save
        else:
            from ..output.picture import save_picture as save
    with naming(file):
        save(plan, file)
    print(f'written: {file}')
    return DONE


def assess_plan(options: argparse.Namespace) -> int:
    """Assess a plan; return the exit status."""
    plan = Plan.load(options.plan)
    file = picture_file(options, '.assess.png', _SUFFIXES[:-1])
    found = assess(plan, options.draws, options.seed, _world(options, plan))
    print(assessment_table(found))
    try:
        from ..output.assessment_picture import save_assessment
    except ModuleNotFoundError as error:
        print(f'{error.name} is not installed, so nothing is drawn; pip install '
              '"secure_uav_planner[view]"', file=sys.stderr)
        return DONE
    with naming(file):
        save_assessment(found, file)
    print(f'\nwritten: {file}')
    return DONE


def _world(options: argparse.Namespace, plan: Plan) -> World:
    """Return the world that the options describe."""
    given = {field.name: getattr(options, field.name) for field in fields(World)
             if getattr(options, field.name, None) is not None}
    if 'covariance' in given:
        xx, xy, yy = given['covariance']
        given['covariance'] = ((xx, xy), (xy, yy))
    if 'positions' in given:
        if len(given['positions']) % 2:
            raise OptionError(f'--positions has {len(given["positions"])} numbers; it must have '
                              'x and y of each eavesdropper')
        given['positions'] = tuple(zip(given['positions'][::2], given['positions'][1::2]))
    if options.mean_gain:
        given['los_distance'] = None
    changes = {field.name: getattr(options, field.name) for field in fields(Channel)
               if getattr(options, field.name, None) is not None}
    if changes.get('los') == 'none':
        changes['los'] = None
    if changes:
        try:
            channel = plan.scenario.channel
            if 'rician_k_db' in changes and channel.outage is None:
                changes['outage'] = 0.5  # A channel with fading needs one; nothing here uses it.
            given['channel'] = replace(channel, **changes)
        except ScenarioError as error:
            raise OptionError(str(error)) from None
    try:
        return World(**given)
    except OptionError as error:
        raise OptionError(f'--{error.place[0].replace("_", "-")}: {error}') from None
