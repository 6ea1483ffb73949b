"""The figures of the study, as pictures and as tables."""

from matplotlib.figure import Figure
import numpy as np
import pandas
from secure_uav_planner.apps.campaign_file import BASELINES
from secure_uav_planner.assessment import assess
from secure_uav_planner.output.drawing import (
    map_extent, scheme_dash, scheme_name, style_axes, uav_color)
from secure_uav_planner.output.map import draw_map
from secure_uav_planner.plan.plan import Plan

from .experiments import PROPOSED

_MAP_WIDTH = 2.2  # In inches.
_SIZE = (9.0, 5.6)
_DOTS_PER_INCH = 110
_GREY, _BLUE, _GREEN, _SKY = '0.4', uav_color(0), '#009E73', '#3A9BD0'
_NAME_SIZE = 8.0  # Of the names at the ends of curves, in points.
_CURVES = {
    'duration': ('figure_3', 'mission duration T (s)'),
    'radius': ('rate_against_radius', "radius of the eavesdropper's disc (m)"),
    'snr': ('rate_against_snr', 'reference SNR, 1 W at 1 m (dB)'),
    'jammers': ('rate_against_jammers', 'number of jammers'),
}
_TRAJECTORIES = (102.0, 104.0, 200.0)
_DRAWS = 2000
_PLANNED_FOR = {'planned for free space': ('#E69F00', -0.14),
                'planned for the model': ('#0072B2', 0.14)}


def write_figures(plans, folder, claims):
    """
    Write each figure as PNG and CSV; return the paths of the files.

    :param plans: the result of load_plans.
    :param folder: of the files, a pathlib.Path.
    :param claims: the table of the claims, which the pictures carry as their description.
    """
    written = []

    def write(name, figure, frame):
        written.extend(folder / f'{name}{suffix}' for suffix in ('.png', '.csv'))
        figure.savefig(written[-2], dpi=_DOTS_PER_INCH, metadata={'Description': claims})
        frame.to_csv(written[-1], index=False, float_format='%.6g')

    shown = {point.x: plan for point, plan in plans.items() if point.experiment == 'duration'
             and point.scheme == PROPOSED and point.x in _TRAJECTORIES}
    write('figure_2', _draw_trajectories(shown), pandas.concat(
        {duration: plan.to_dataframe() for duration, plan in shown.items()},
        names=['duration']).reset_index('duration'))
    rates = pandas.DataFrame([{
        'experiment': point.experiment, 'x': point.x, 'scheme': point.scheme,
        'error_radius_m': plan.scenario.eavesdroppers[0].error_radius,
        'objective': plan.objective, 'guaranteed_rate': plan.guaranteed_rate,
        'worst_case_rate': plan.worst_case_rate,
        'upper_bound': plan.bound.rate if plan.bound else np.nan, 'status': plan.status,
        'solve_time_s': plan.solve_time} for point, plan in plans.items()])
    rates[['experiment', 'kind']] = rates.experiment.str.partition(', ')[[0, 2]]
    for experiment, (name, label) in _CURVES.items():
        chosen = rates[rates.experiment == experiment]
        table = chosen.assign(scheme=chosen.scheme.map(scheme_name)).sort_values(
            ['kind', 'scheme', 'x']).rename(columns={'x': experiment})
        write(name, draw_curves(chosen, label), table.drop(columns=['experiment', 'kind']))
    table = assess_environments(plans)
    write('environments', _draw_environments(table), table)
    return written


def assess_environments(plans):
    """
    Return the worth in each environment of plans for free space and for the model.

    Both are assessed with the same positions and lines of sight.

    :param plans: the result of load_plans.
    :return: a DataFrame with a row for each environment and scheme: `planned_rate`, the guaranteed
        rate of the plan when it was made; `guaranteed_rate`, that by the model of the environment,
        at mean gains; `found_...`, mean and quantiles of the mission's secrecy rate, by assess;
        the mean `outage` of its slots; and the mean of the bits `delivered`.
    """
    chosen = [plan for point, plan in plans.items() if point.experiment == 'environment']
    rows = []
    for plan in chosen:
        there = Plan(plan.scenario, chosen[0].positions, chosen[0].powers)
        for scheme, made, flown in zip(_PLANNED_FOR, (chosen[0], plan), (there, plan)):
            assessment = assess(flown, _DRAWS)
            rows.append({
                'environment': (plan.scenario.channel.los or 'free space').replace('_', ' '),
                'scheme': scheme, 'planned_rate': made.guaranteed_rate,
                'guaranteed_rate': assessment.promised_rate, 'found_mean': assessment.mean,
                'found_5': assessment.quantile(0.05), 'found_50': assessment.quantile(0.5),
                'found_95': assessment.quantile(0.95), 'outage': assessment.outages.mean(),
                'delivered': assessment.delivered.mean(),
                'promised_delivery': assessment.promised_delivery})
    return pandas.DataFrame(rows)


def _draw_trajectories(plans):
    """Return a Figure of the maps of plans by their durations, side by side above a legend."""
    extent = map_extent(next(iter(plans.values())).scenario, plans.values())
    map_height = _MAP_WIDTH * np.divide(*(extent[1] - extent[0])[::-1])
    width, height = (_MAP_WIDTH + 0.3) * len(plans) + 0.7, map_height + 1.9
    figure = Figure(figsize=(width, height))
    for number, (duration, plan) in enumerate(plans.items()):
        axes = figure.add_axes((
            (0.8 + (_MAP_WIDTH + 0.3) * number) / width, 1.1 / height, _MAP_WIDTH / width,
            map_height / height))
        draw_map(axes, plan, extent, legend=number + 1 == len(plans), loc='lower center',
                 bbox_to_anchor=(0.5, 0.0), bbox_transform=figure.transFigure, ncols=3)
        axes.set_title(f'T = {duration:g} s\nguaranteed {plan.guaranteed_rate:.3f},\n'
                       f'worst case {plan.worst_case_rate:.3f} bit/s/Hz', fontsize=9, loc='left')
        if number:
            axes.set_ylabel('')
            axes.tick_params(labelleft=False)
    return figure


def draw_curves(rates, label):
    """Return the Figure of an experiment's rates, and of what they miss against a bound."""
    bounds = rates.dropna(subset='upper_bound').set_index('x').upper_bound
    figure = Figure(figsize=(_SIZE[0], _SIZE[1] + 1.4 * bool(len(bounds))), layout='constrained')
    axes, *below = figure.subplots(
        2 if len(bounds) else 1, squeeze=False, sharex=True,
        height_ratios=(2.4, 1.0) if len(bounds) else None)[:, 0]
    curves = [curve for (kind, scheme), rows in rates.groupby(['kind', 'scheme'], sort=False)
              for curve in _list_curves(kind, scheme, rows.sort_values('x'))]
    if len(bounds):
        curves.append(('upper bound of any worst case', bounds, bounds, 'black', (0, (1, 1))))
    _draw_named(axes, [(name, values, color, dash) for name, values, _, color, dash in curves])
    axes.set_ylabel('mean secrecy rate (bit/s/Hz)')
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    if below:
        _draw_named(below[0], [
            (name, 100 * (1 - worst / bounds), color, dash)
            for name, _, worst, color, dash in curves if worst is not None][:-1])
        below[0].set(yscale='log', ylim=(0.1, 100),
                     ylabel='worst case, missing\nagainst the bound (%)')
        below[0].yaxis.set_major_formatter('{x:g}')
    for part in (axes, *below):
        style_axes(part)
    (below or [axes])[-1].set_xlabel(label)
    axes.locator_params(axis='x', integer=True)
    _name_ends(figure)
    return figure


def _list_curves(kind, scheme, rows):
    """
    Return the curves of a scheme: name, rates by x, worst-case rates by x, colour and dash.

    The worst-case rates are None where there is no bound for them.
    """
    rows = rows.set_index('x')
    guaranteed, worst = rows.guaranteed_rate, rows.worst_case_rate
    if kind == 'worst case':
        return [('proposed, for the worst case', worst, worst, _GREEN, '-')]
    if kind == 'radius 0':  # Both rates are equal.
        return [('proposed, place of eavesdropper known', guaranteed, None, _SKY, '-')]
    if scheme in BASELINES:
        return [(scheme_name(scheme), guaranteed, worst, _GREY, scheme_dash(scheme))]
    return [('proposed, for the guarantee: worst case', worst, worst, _BLUE, '--'),
            ('proposed, for the guarantee: guaranteed', guaranteed, None, _BLUE, '-')]


def _draw_named(axes, curves):
    """Draw curves, each a name, values by x, colour and dash."""
    for name, values, color, dash in curves:
        axes.plot(values.index, values, color=color, linestyle=dash, label=name, linewidth=1.5,
                  marker='o', markersize=2.5)


def _name_ends(figure):
    """Write the names of all curves beside their ends, as near as they do not touch."""
    for axes in figure.axes:
        lines = sorted(axes.lines, key=lambda line: line.get_ydata()[-1])
        axes.annotate(  # Room for the names, which constrained layout measures.
            max((line.get_label() for line in lines), key=len), (1, 0.5), (12, 0),
            xycoords='axes fraction', textcoords='offset points', fontsize=_NAME_SIZE, alpha=0)
    figure.draw_without_rendering()
    figure.set_layout_engine('none')
    for axes in figure.axes:
        lines = sorted(axes.lines, key=lambda line: line.get_ydata()[-1])
        ends = [axes.transData.transform(line.get_xydata()[-1])[1] for line in lines]
        right = axes.bbox.x1 + 0.12 * figure.dpi
        for line, end, place in zip(lines, ends, _spread(
                ends, 1.25 * _NAME_SIZE * figure.dpi / 72.0, axes.bbox.y0,
                axes.bbox.y1 - _NAME_SIZE / 2)):
            axes.annotate(
                line.get_label(), line.get_xydata()[-1],
                axes.transAxes.inverted().transform((right, place)), textcoords='axes fraction',
                va='center', fontsize=_NAME_SIZE, color=line.get_color(), arrowprops={
                    'arrowstyle': '-', 'color': line.get_color(), 'linewidth': 0.5,
                    'shrinkA': 0, 'shrinkB': 2, 'relpos': (0, 0.5)})


def _spread(places, least, low, high):
    """Return ascending places moved apart by a least distance, between a low and a high one."""
    moved = np.clip(places, low, high)
    for _ in range(100):  # Each pass halves what neighbours lack.
        lack = np.maximum(0.0, least - np.diff(moved)) / 2
        moved[:-1] -= lack
        moved[1:] += lack
        moved = np.clip(moved, low, high)
    return moved


def _draw_environments(table):
    """Return a Figure of the rates planned, guaranteed and found."""
    figure = Figure(figsize=(_SIZE[0], 4.6), layout='constrained')
    axes = figure.subplots()
    names = table.environment.unique()
    for scheme, (color, offset) in _PLANNED_FOR.items():
        rows, x = table[table.scheme == scheme], np.arange(len(names)) + offset
        axes.bar(x, rows.found_mean, width=0.26, color=color, alpha=0.35,
                 label=f'{scheme}: found, mean')
        axes.errorbar(x, rows.found_mean, color=color, linestyle='none', capsize=4,
                      yerr=(rows.found_mean - rows.found_5, rows.found_95 - rows.found_mean),
                      label=f'{scheme}: found, 5% to 95%')
        for column, marker, text in (('guaranteed_rate', 's', 'by the model there'),
                                     ('planned_rate', 'x', 'planned')):
            axes.plot(x, rows[column], marker, color=color, markersize=7,
                      markerfacecolor='white', label=f'{scheme}: {text}')
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel('mean secrecy rate (bit/s/Hz)')
    style_axes(axes)
    _add_legend_above(axes)
    return figure


def _add_legend_above(axes):
    axes.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8, frameon=False)
