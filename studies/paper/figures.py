"""The figures of the study, as pictures and as tables."""

from matplotlib.figure import Figure
import numpy as np
import pandas
from secure_uav_planner.apps.specification import BASELINES
from secure_uav_planner.assessment import assess
from secure_uav_planner.output.drawing import extent_of, style_axes, uav_color
from secure_uav_planner.output.picture import draw_map, name_of
from secure_uav_planner.plan.plan import Plan

from .experiments import PROPOSED

_MAP_WIDTH = 2.0  # In inches.
_SIZE = (9.0, 6.0)
_DOTS_PER_INCH = 200
_CONSTANT, _OPTIMISED = BASELINES
_STYLES = {_CONSTANT: ('#777777', 's'), _OPTIMISED: ('#E69F00', '^'),
           PROPOSED: (uav_color(0), 'o'), 'radius 0': ('#56B4E9', 'D'),
           'worst case': ('#009E73', 'v')}
_AXES = {
    'duration': 'mission duration T (s)',
    'radius': "radius of the eavesdropper's disc (m)",
    'snr': 'reference SNR, 1 W at 1 m (dB)',
    'jammers': 'number of jammers',
}
_SHOWN = (102.0, 104.0, 200.0)
_DRAWS = 2000
_MADE_FOR = {'planned for free space': ('#E69F00', -0.14),
             'planned for the model': ('#0072B2', 0.14)}


def write_figures(plans, folder):
    """
    Write every figure as PNG and CSV; return the paths of the files.

    :param plans: the result of study.plans_of.
    :param folder: where to write, a pathlib.Path.
    """
    written = []

    def write(name, figure, frame):
        written.extend(folder / f'{name}{suffix}' for suffix in ('.png', '.csv'))
        figure.savefig(written[-2], dpi=_DOTS_PER_INCH)
        frame.to_csv(written[-1], index=False, float_format='%.6g')

    rates = pandas.DataFrame([{
        'experiment': point.experiment, 'x': point.x, 'scheme': point.scheme,
        'error_radius_m': plan.scenario.eavesdroppers[0].error_radius,
        'objective': plan.objective, 'guaranteed_rate': plan.guaranteed_rate,
        'worst_case_rate': plan.worst_case_rate,
        'upper_bound': plan.bound.rate if plan.bound else np.nan, 'status': plan.status,
        'solve_time_s': plan.solve_time} for point, plan in plans.items()])
    rates[['experiment', 'kind']] = rates.experiment.str.partition(', ')[[0, 2]]
    for experiment, label in _AXES.items():
        chosen = rates[rates.experiment == experiment]
        table = chosen.assign(scheme=chosen.scheme.map(name_of)).sort_values(
            ['kind', 'scheme', 'x']).rename(columns={'x': experiment})
        write(f'rate_against_{experiment}', _curves(chosen, label),
              table.drop(columns=['experiment', 'kind']))
    shown = {point.x: plan for point, plan in plans.items() if point.experiment == 'duration'
             and point.scheme == PROPOSED and point.x in _SHOWN}
    write('trajectories', _trajectories(shown), pandas.concat(
        {duration: plan.to_dataframe() for duration, plan in shown.items()},
        names=['duration']).reset_index('duration'))
    found = found_in_environments(plans)
    write('environments', _environments(found), found)
    return written


def found_in_environments(plans):
    """
    Return what plans for free space and for the model are worth in each environment.

    Both see the same places and lines of sight.

    :param plans: the result of study.plans_of.
    :return: a DataFrame with a row for each environment and scheme: `planned_rate`, the guaranteed
        rate that the plan was made with; `guaranteed_rate`, that by the model of the environment,
        which counts with mean gains; `found_...`, mean and quantiles of the mission's secrecy
        rate, by assess; the mean `outage` of its slots; what is `delivered` in the mean.
    """
    chosen = [plan for point, plan in plans.items() if point.experiment == 'environment']
    rows = []
    for plan in chosen:
        there = Plan(plan.scenario, chosen[0].positions, chosen[0].powers)
        for scheme, made, flown in zip(_MADE_FOR, (chosen[0], plan), (there, plan)):
            answer = assess(flown, _DRAWS)
            rows.append({
                'environment': (plan.scenario.channel.los or 'free space').replace('_', ' '),
                'scheme': scheme, 'planned_rate': made.guaranteed_rate,
                'guaranteed_rate': answer.promised_rate, 'found_mean': answer.mean,
                'found_5': answer.quantile(0.05), 'found_50': answer.quantile(0.5),
                'found_95': answer.quantile(0.95), 'outage': answer.outages.mean(),
                'delivered': answer.delivered.mean(),
                'promised_delivery': answer.promised_delivery})
    return pandas.DataFrame(rows)


def _curves(rates, label):
    """Return the Figure of an experiment's rates, with the best scheme on top."""
    figure = Figure(figsize=_SIZE, layout='constrained')
    axes = figure.subplots()
    curves = sorted(rates.groupby(['kind', 'scheme'], sort=False),
                    key=lambda curve: -curve[1].guaranteed_rate.iloc[-1])
    for (kind, scheme), curve in curves:
        color, marker = _STYLES[kind or scheme]
        name = name_of(scheme) if scheme in BASELINES else (
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
    _legend_above(axes)
    return figure


def _trajectories(plans):
    """Return a Figure of the maps of plans by their durations, side by side, with one legend."""
    extent = extent_of(next(iter(plans.values())).scenario, plans.values())
    tall = _MAP_WIDTH * np.divide(*(extent[1] - extent[0])[::-1])
    figure = Figure(figsize=((_MAP_WIDTH + 0.4) * len(plans) + 2.7, tall + 1.4))
    width, height = figure.get_size_inches()
    for number, (duration, plan) in enumerate(plans.items()):
        left = 0.8 + (_MAP_WIDTH + 0.4) * number
        axes = figure.add_axes((
            left / width, 0.6 / height, _MAP_WIDTH / width, tall / height))
        draw_map(axes, plan, legend=number + 1 == len(plans), extent=extent)
        axes.set_title(f'T = {duration:g} s\nguaranteed {plan.guaranteed_rate:.3f},\n'
                       f'worst case {plan.worst_case_rate:.3f} bit/s/Hz', fontsize=9, loc='left')
        if number:
            axes.set_ylabel('')
            axes.tick_params(labelleft=False)
    return figure


def _environments(found):
    """Return a Figure of the rates planned, guaranteed and found."""
    figure = Figure(figsize=(_SIZE[0], 4.6), layout='constrained')
    axes = figure.subplots()
    names = found.environment.unique()
    for scheme, (color, aside) in _MADE_FOR.items():
        mine, x = found[found.scheme == scheme], np.arange(len(names)) + aside
        axes.bar(x, mine.found_mean, width=0.26, color=color, alpha=0.35,
                 label=f'{scheme}: found, mean')
        axes.errorbar(x, mine.found_mean, color=color, linestyle='none', capsize=4,
                      yerr=(mine.found_mean - mine.found_5, mine.found_95 - mine.found_mean),
                      label=f'{scheme}: found, 5% to 95%')
        for column, marker, text in (('guaranteed_rate', 's', 'by the model there'),
                                     ('planned_rate', 'x', 'planned')):
            axes.plot(x, mine[column], marker, color=color, markersize=7,
                      markerfacecolor='white', label=f'{scheme}: {text}')
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel('mean secrecy rate (bit/s/Hz)')
    style_axes(axes)
    _legend_above(axes)
    return figure


def _legend_above(axes):
    """Put the legend above the axes, where nothing is drawn."""
    axes.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8, frameon=False)
