"""The figures of the study, as pictures and as tables."""

from matplotlib.figure import Figure
import numpy as np
import pandas
from secure_uav_planner.apps.campaign_file import BASELINES
from secure_uav_planner.assessment import assess
from secure_uav_planner.output.drawing import map_extent, style_axes, uav_color
from secure_uav_planner.output.drawing import scheme_name
from secure_uav_planner.output.map import draw_map
from secure_uav_planner.plan.plan import Plan

from .experiments import PROPOSED

_MAP_WIDTH = 2.2  # In inches.
_SIZE = (9.0, 5.6)
_DOTS_PER_INCH = 110
_CONSTANT, _OPTIMISED = BASELINES
_STYLES = {_CONSTANT: ('#777777', 's'), _OPTIMISED: ('#E69F00', '^'),
           PROPOSED: (uav_color(0), 'o'), 'radius 0': ('#56B4E9', 'D'),
           'worst case': ('#009E73', 'v')}
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
        write(name, _draw_curves(chosen, label), table.drop(columns=['experiment', 'kind']))
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


def _draw_curves(rates, label):
    """Return the Figure of an experiment's rates, with the best scheme on top."""
    figure = Figure(figsize=_SIZE, layout='constrained')
    axes = figure.subplots()
    curves = sorted(rates.groupby(['kind', 'scheme'], sort=False),
                    key=lambda curve: -curve[1].guaranteed_rate.iloc[-1])
    for (kind, scheme), curve in curves:
        color, marker = _STYLES[kind or scheme]
        name = scheme_name(scheme) if scheme in BASELINES else (
            f'proposed, {scheme} for the guaranteed rate')
        if rates.kind.any():
            name += f', disc of {curve.error_radius_m.iloc[0]:g} m'
        full = {'color': color, 'marker': marker, 'markersize': 6}
        dashed = {**full, 'linestyle': '--', 'markerfacecolor': 'white', 'linewidth': 1.1}
        if kind == 'worst case':
            axes.plot(curve.x, curve.worst_case_rate, **dashed,
                      label=f'{scheme} for the worst-case rate, disc of 10 m: worst case')
            axes.plot(curve.x, curve.upper_bound, color='black', marker='_', markersize=8,
                      linestyle=':', linewidth=1.1,
                      label='upper bound of any plan, disc of 10 m: worst case')
        elif kind == 'radius 0':  # Both rates are equal.
            axes.plot(curve.x, curve.guaranteed_rate, **full, label=f'{name}: both rates')
        else:
            axes.plot(curve.x, curve.guaranteed_rate, **full, label=f'{name}: guaranteed')
            axes.plot(curve.x, curve.worst_case_rate, **dashed, label=f'{name}: worst case')
    axes.locator_params(axis='x', integer=True)
    axes.set(xlabel=label, ylabel='mean secrecy rate (bit/s/Hz)')
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    style_axes(axes)
    _add_legend_above(axes)
    return figure


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
