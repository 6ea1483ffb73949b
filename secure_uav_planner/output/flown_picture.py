"""Picture of a flight against its plan."""

from typing import Any

import numpy as np

from .drawing import add_legend, EAVESDROPPER, map_extent, RATE, style_axes, uav_color
from .figures import own_settings, Picture
from .map import draw_ground, set_up_map, wrap_name

_TALL = (10.0, 6.0), [['map', 'errors'], ['map', 'rates']]  # Size in inches, and places.
_WIDE = (9.0, 9.0), [['map'], ['errors'], ['rates']]
_LEAST_MARKED_M = 0.5  # Smaller errors are not marked on the map.
_DOTS_PER_INCH = 200


def save_comparison(comparison: Any, path: Any) -> None:
    """Draw a Comparison into a file; the suffix, such as .png, gives the format."""
    draw_comparison(comparison).savefig(path, dpi=_DOTS_PER_INCH)


@own_settings()
def draw_comparison(comparison: Any) -> Picture:
    """Return a matplotlib Figure: both paths, cross-track errors, rates planned and flown."""
    plan = comparison.plan
    extent = map_extent(plan.scenario, [plan])
    width, height = extent[1] - extent[0]
    size, places = _TALL if height > width else _WIDE
    figure = Picture(figsize=size, layout='constrained')
    axes = figure.subplot_mosaic(places, **(
        {'width_ratios': (1.0, 1.8)} if height > width else {'height_ratios': (2.5, 1.0, 1.0)}))
    area, errors, rates = (axes[name] for name in ('map', 'errors', 'rates'))
    _draw_paths(area, comparison, extent)
    _draw_errors(errors, comparison)
    _draw_rates(rates, comparison)
    for panel in (errors, rates):
        style_axes(panel)
        panel.legend(fontsize=8, frameon=False)
    # Zones, margins and discs have one entry for all.
    names = dict(zip(*reversed(area.get_legend_handles_labels())))
    entries = [*names.values()], [*names]
    if height > width:
        add_legend(area, *entries)
    else:  # The map takes all of the width.
        add_legend(area, *entries, loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=4)
    return figure


def _draw_paths(axes: Any, comparison: Any, extent: Any) -> None:
    """Draw planned and flown paths, with a cross at the largest error above _LEAST_MARKED_M."""
    flight, plan = comparison.flight, comparison.plan
    set_up_map(axes, extent)
    draw_ground(axes, plan.scenario)
    planned = flight.course.at(flight.times).positions
    for index, name in enumerate(comparison.uavs):
        color = uav_color(index)
        axes.plot(*planned[index].T, color=color, linewidth=0.8, linestyle='--')
        axes.plot(*flight.positions[index].T[:2], color=color, linewidth=1.6,
                  label=wrap_name(name))
    largest = np.nan_to_num([errors.error_max_m for errors in comparison.uavs.values()])
    index = int(largest.argmax())
    if largest[index] > _LEAST_MARKED_M:
        worst_time = list(comparison.uavs.values())[index].error_max_time_s
        place = flight.positions[index, int(np.argmin(np.abs(flight.times - worst_time))), :2]
        axes.plot(*place, 'x', color=EAVESDROPPER, markersize=8)
        axes.annotate(f'{largest[index]:.1f} m', place, textcoords='offset points', xytext=(6, 6),
                      fontsize=8)


def _draw_errors(axes: Any, comparison: Any) -> None:
    """Draw the distance of each UAV from its planned path over time, and the margin."""
    flight, plan = comparison.flight, comparison.plan
    for index, (name, errors) in enumerate(zip(comparison.uavs, comparison.errors, strict=True)):
        axes.plot(flight.times, errors, color=uav_color(index), linewidth=1.0,
                  label=wrap_name(name))
    if plan.scenario.tracking_margin:
        axes.axhline(plan.scenario.tracking_margin, color='black', linestyle='--', linewidth=1.0,
                     label='tracking margin')
    axes.set_xlim(flight.times[0], flight.times[-1])
    axes.set_ylim(bottom=0)
    axes.set_ylabel('cross-track\nerror (m)')


def _draw_rates(axes: Any, comparison: Any) -> None:
    """Draw the objective's rate of each slot as planned and as flown; mark broken slots."""
    plan = comparison.plan
    edges = plan.times[1:]
    planned, flown = (rates[plan.objective].sum(axis=0)
                      for rates in (comparison.planned, comparison.achieved))
    axes.stairs(planned, edges, baseline=None, color='black', linestyle='--', linewidth=1.0,
                label='planned')
    axes.stairs(np.where(comparison.covered, flown, np.nan), edges, baseline=None, color=RATE,
                linewidth=1.6, label='flown')
    if comparison.broken.any():
        axes.plot(edges[:-1][comparison.broken] + plan.scenario.slot_duration / 2,
                  flown[comparison.broken], 'x', color=EAVESDROPPER, label='broken')
    axes.set_xlim(comparison.flight.times[0], comparison.flight.times[-1])
    axes.set_ylim(bottom=0)
    axes.set_ylabel(f'{plan.scenario.channel.rate_name(plan.objective)}\n(bit/s/Hz)')
    axes.set_xlabel('time (s)')
