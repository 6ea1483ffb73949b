"""The figures of the study, as pictures and as tables."""

import csv

from matplotlib.figure import Figure
import numpy as np

from .environments import draw_environments, found_in_environments, HEADER
from ...output.drawing import uav_color
from ...output.picture import draw_map, extent_of, name_of

_SIZE = (9.0, 6.0)
_DOTS_PER_INCH = 200
_COLORS = {'fly_hover_fly_constant': '#777777', 'fly_hover_fly_optimised': '#E69F00'}
_MARKERS = {'fly_hover_fly_constant': 's', 'fly_hover_fly_optimised': '^'}
_RADIUS_ZERO = ('#56B4E9', 'D')
_WORST_CASE = '#009E73'
_AXES = {
    'duration': 'mission duration T (s)',
    'radius': "radius of the eavesdropper's disc (m)",
    'snr': 'reference SNR, 1 W at 1 m (dB)',
    'jammers': 'number of jammers',
}
_SHOWN = (102.0, 104.0, 200.0)


def write_figures(plans, folder):
    """
    Write every figure as PNG and CSV; return the paths of the files.

    :param plans: the result of study.plans_of.
    :param folder: where to write, a pathlib.Path.
    """
    written = []
    for experiment, label in _AXES.items():
        chosen = {point: plan for point, plan in plans.items()
                  if point.experiment.split(',')[0] == experiment}
        name = f'rate_against_{experiment}'
        rows = [(point.x, name_of(point.scheme), plan.scenario.eavesdroppers[0].error_radius,
                 plan.objective, plan.guaranteed_rate, plan.worst_case_rate,
                 plan.bound.rate if plan.bound else '', plan.status, plan.solve_time)
                for point, plan in sorted(chosen.items(), key=lambda entry: (
                    entry[0].experiment, entry[0].scheme, entry[0].x))]
        written += [_save(_curves(chosen, label), folder / f'{name}.png'),
                    _table(folder / f'{name}.csv', (
                        experiment, 'scheme', 'error_radius_m', 'objective', 'guaranteed_rate',
                        'worst_case_rate', 'upper_bound', 'status', 'solve_time_s'), rows)]
    shown = {point.x: plan for point, plan in sorted(
        plans.items(), key=lambda entry: entry[0].x)
        if point.experiment == 'duration' and point.scheme not in _COLORS and point.x in _SHOWN}
    written += [_save(_trajectories(shown), folder / 'trajectories.png'),
                _table(folder / 'trajectories.csv', (
                    'duration_s', 'uav', 'point', 'time_s', 'x_m', 'y_m', 'power_w'), [
                        row for duration, plan in shown.items()
                        for row in _trajectory_rows(duration, plan)])]
    found = found_in_environments(plans)
    written += [_save(draw_environments(found), folder / 'environments.png'),
                _table(folder / 'environments.csv', HEADER, [one.row for one in found])]
    runs = {point: plan for point, plan in plans.items() if point.experiment == 'convergence'}
    written += [_save(_convergence(runs), folder / 'convergence.png'),
                _table(folder / 'convergence.csv', (
                    'duration_s', 'method', 'iteration', 'step', 'elapsed_s', 'solver_time_s',
                    'guaranteed_rate'), [
                        (point.x, point.scheme, entry.number, entry.step, entry.elapsed,
                         entry.solver_time, entry.guaranteed_rate)
                        for point, plan in runs.items() for entry in plan.history])]
    return written


def _curves(plans, label):
    figure = Figure(figsize=_SIZE, layout='constrained')
    axes = figure.subplots()
    lines = {}
    for point, plan in sorted(plans.items(), key=lambda entry: entry[0].x):
        lines.setdefault((point.experiment, point.scheme), []).append(
            (point.x, plan.guaranteed_rate, plan.worst_case_rate,
             plan.bound.rate if plan.bound else np.nan))
    # The best scheme is on top, both in the figure and in the legend.
    discs = any(',' in experiment for experiment, _ in lines)
    for (experiment, scheme), values in sorted(lines.items(), key=lambda entry: -entry[1][-1][1]):
        x, guaranteed, worst, bound = zip(*values)
        if experiment.endswith('worst case'):
            axes.plot(x, worst, color=_WORST_CASE, marker='v', markersize=6, linestyle='--',
                      markerfacecolor='white', linewidth=1.1,
                      label=f'{scheme} for the worst-case rate, disc of 10 m: worst case')
            axes.plot(x, bound, color='black', marker='_', markersize=8, linestyle=':',
                      linewidth=1.1, label='upper bound of any plan, disc of 10 m: worst case')
            continue
        perfect = experiment.endswith('radius 0')
        color, marker = _RADIUS_ZERO if perfect else (
            _COLORS.get(scheme, uav_color(0)), _MARKERS.get(scheme, 'o'))
        name = _name(scheme)
        if discs:
            name += ', disc of 0 m' if perfect else ', disc of 10 m'
        axes.plot(x, guaranteed, color=color, marker=marker, markersize=6,
                  label=f'{name}: {"both rates" if perfect else "guaranteed"}')
        # For a radius of zero, the guaranteed and the worst-case rates are equal.
        if not perfect:
            axes.plot(x, worst, color=color, marker=marker, markersize=6, linestyle='--',
                      markerfacecolor='white', linewidth=1.1, label=f'{name}: worst case')
    if all(value == int(value) and value < 10 for line in lines.values() for value, *_ in line):
        axes.set_xticks(sorted({value for line in lines.values() for value, *_ in line}))
    _finish(axes, label, 'mean secrecy rate (bit/s/Hz)')
    # Above the axes, where no curve can be.
    axes.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8, frameon=False)
    return figure


def _name(scheme):
    """Return the name of a scheme, and for which rate it plans."""
    return name_of(scheme) if scheme in _COLORS else (
        f'proposed, {scheme} for the guaranteed rate')


def _convergence(runs):
    figure = Figure(figsize=(_SIZE[0], 4.2), layout='constrained')
    durations = sorted({point.x for point in runs})
    grid = figure.subplots(1, len(durations), squeeze=False)[0]
    for axes, duration in zip(grid, durations):
        for index, (point, plan) in enumerate(
                entry for entry in runs.items() if entry[0].x == duration):
            axes.step([entry.elapsed for entry in plan.history],
                      [entry.guaranteed_rate for entry in plan.history], where='post',
                      color=uav_color(index), marker='o^s'[index % 3], markersize=4,
                      label=f'{point.scheme}: {plan.guaranteed_rate:.4f} bit/s/Hz guaranteed in '
                            f'{plan.solve_time:.2f} s')
        axes.set_xscale('log')
        axes.set_title(f'T = {duration:g} s', fontsize=10)
        _finish(axes, 'time (s)', 'guaranteed rate (bit/s/Hz)')
        axes.legend(loc='lower right', fontsize=8)
    return figure


def _trajectories(plans):
    figure = Figure(figsize=(_SIZE[0], 2.9 * len(plans)))
    # Leave room for the legend beside the first map, as in the picture of a plan.
    grid = figure.subplots(len(plans), 1, squeeze=False, gridspec_kw={
        'left': 0.085, 'right': 0.77, 'bottom': 0.06, 'top': 0.96, 'hspace': 0.35})[:, 0]
    extent = extent_of(next(iter(plans.values())).scenario, plans.values())
    for axes, (duration, plan) in zip(grid, plans.items()):
        draw_map(axes, plan, legend=axes is grid[0], extent=extent)
        axes.set_title(
            f'T = {duration:g} s, planned for the {plan.objective.replace("_", "-")} rate: '
            f'{plan.guaranteed_rate:.3f} bit/s/Hz guaranteed, {plan.worst_case_rate:.3f} in the '
            'worst case', fontsize=10, loc='left')
    return figure


def _trajectory_rows(duration, plan):
    for uav, path, powers in zip(plan.scenario.uavs, plan.positions, plan.powers):
        for point, (time, (x, y)) in enumerate(zip(plan.times, path)):
            power = powers[point - 1] if 1 <= point <= len(powers) else 0.0
            yield duration, uav.name, point, time, x, y, power


def _finish(axes, xlabel, ylabel):
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.grid(color='0.9', linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)


def _save(figure, path):
    figure.savefig(path, dpi=_DOTS_PER_INCH)
    return path


def _table(path, header, rows):
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([
            f'{value:.6g}' if isinstance(value, float) else value for value in row]
            for row in rows)
    return path
