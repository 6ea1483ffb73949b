"""The part `plan`: plan a mission, and write what a user needs of the plan."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import re
import signal
import sys
from typing import Any

from .folders import writable
from .missions import loaded
from .progress import ProgressLine
from .status import DONE, STOPPED
from ...bound import upper_bound
from ...errors import OptionError, PlanningError
from ...mission.scenario import Scenario
from ...mission.validation import told_apart
from ...mission.views import check_view
from ...optimize import fly_hover_fly, solve
from ...output.geodesy import Origin
from ...output.qgroundcontrol import save_mission
from ...output.spreadsheet import save_csv
from ...output.table import table
from ...plan.bound import Bound, Progress
from ...plan.plan import Iteration, Plan


def run(options: argparse.Namespace) -> int:
    """Plan a mission and write the results; return the exit status."""
    scenario = loaded(options.mission)
    origin = _origin(options.origin)
    if options.mcap:
        check_view('save_mcap')
    out = writable(Path(options.out))
    with _interruptible() as stop, ProgressLine() as line:
        plan = _planned(scenario, options, stop, line)
        bound = _bound(plan, options, stop, line)
        proven = plan.with_bound(bound)
        # Written first: whatever fails from here on, the plan is there.
        proven.save(out / 'plan.json')
        baselines = _baselines(scenario, options, stop, line)
    print(table([*baselines, plan], bound))
    print(f'\n{plan.message}' + (f'; {proven.claim}, which is proven' if bound else ''))
    written = [out / 'plan.json', *_write(proven, baselines, out, origin)]
    if options.mcap:
        proven.save_mcap(out / 'plan.mcap')
        written.append(out / 'plan.mcap')
    print(f'written: {", ".join(map(str, written))}')
    return STOPPED if stop else DONE


@contextmanager
def _interruptible() -> Iterator[list[int]]:
    """Give a list that is no longer empty once Ctrl-C was pressed; the second one ends it all."""
    pressed: list[int] = []

    def on_signal(number: int, frame: Any) -> None:
        pressed.append(number)
        signal.signal(number, signal.default_int_handler)

    before = {number: signal.signal(number, on_signal)
              for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield pressed
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _origin(values: list[float] | None) -> Origin | None:
    if values is None:
        return None
    if not 2 <= len(values) <= 3:
        raise OptionError(f'--origin has {len(values)} numbers; it must be LAT LON [ALT]')
    return Origin(*values)


def _planned(scenario: Scenario, options: argparse.Namespace, stop: list[int],
             line: ProgressLine) -> Plan:
    def on_iteration(iteration: Iteration) -> bool:
        line.say(f'planning: iteration {iteration.number} ({iteration.step}), {iteration.rate:.4f}'
                 f' bit/s/Hz, {iteration.elapsed:.1f} s')
        return bool(stop)

    line.say('planning ...', force=True)
    return solve(scenario, options.method, on_iteration, options.time_limit,
                 objective=options.objective)


def _bound(plan: Plan, options: argparse.Namespace, stop: list[int],
           line: ProgressLine) -> Bound | None:
    if stop or options.bound_time_limit is None:
        return None

    def on_progress(progress: Progress) -> bool:
        line.say(f'bound: no plan has more than {progress.rate:.4f} bit/s/Hz, '
                 f'{progress.elapsed:.1f} s')
        return bool(stop)

    line.say('bound ...', force=True)
    return upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                       time_limit=options.bound_time_limit, on_progress=on_progress)


def _baselines(scenario: Scenario, options: argparse.Namespace, stop: list[int],
               line: ProgressLine) -> list[Plan]:
    """Return fly-hover-fly with both powers, as far as the limits allow."""
    found: list[Plan] = []
    for power in ('constant', 'optimised'):
        if stop:
            break
        line.say(f'fly-hover-fly with {power} power ...', force=True)
        try:
            found.append(fly_hover_fly(scenario, power, lambda _: bool(stop), options.time_limit))
        except PlanningError as error:
            print(f'no fly-hover-fly with {power} power: {error}', file=sys.stderr)
    return found


def _write(plan: Plan, baselines: list[Plan], out: Path,
           origin: Origin | None) -> Iterator[Path]:
    """Write all but the plan itself, and yield each file that is there."""
    save_csv(plan, out / 'plan.csv')
    yield out / 'plan.csv'
    if origin is not None:
        names = told_apart([re.sub(r'[^\w.-]', '_', uav.name) for uav in plan.scenario.uavs])
        for number, name in enumerate(names):
            file = out / f'plan_{name}.plan'
            save_mission(plan, number, origin, file)
            yield file
    try:
        from ...output.picture import save_picture
        save_picture(plan, out / 'plan.png', baselines)
        yield out / 'plan.png'
        from ...output.page import save_page
        save_page(plan, out / 'plan.html')
        yield out / 'plan.html'
    except ModuleNotFoundError as error:
        print(f'{error.name} is not installed, so not everything is drawn; pip install '
              '"secure_uav_planner[view]"', file=sys.stderr)
