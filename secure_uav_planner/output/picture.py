"""The picture of a plan: a map, and the powers and the rates over time."""

from textwrap import wrap

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.text import Text
import numpy as np

from .drawing import (
    add_legend, energy_label, map_extent, node_color, RATE, rate_label, scheme_name, style_axes,
    uav_color)
from .figures import own_settings, Picture
from .map import (
    add_map_legend, draw_ends, draw_ground, draw_map, GREY, LEGEND_WIDTH, LINEAR_SHARE, set_up_map,
    uav_label)
from ..errors import OptionError, quote
from ..mission import OBJECTIVES

_MAP_SIZE = 5.95, 5.6  # Of the largest map, in inches as all lengths here.
_LEFT, _BOTTOM, _RIGHT = 1.0, 0.6, 2.05  # Beside axes: labels, and legends at the right.
_RIGHT_WITH_ENERGIES = 3.2
_PLOT_WIDTH = 4.4  # Beside a map.
_TITLE_WIDTH = 96  # In characters.
_DOTS_PER_INCH = 200
_STRIP = 0.12  # Height of the strip of shares, in heights of the rates.
_DASHES = ('--', ':', '-.')
_PAPER = {'font.family': 'serif', 'font.size': 8.0, 'legend.handlelength': 1.5,
          'legend.columnspacing': 1.0, 'legend.handletextpad': 0.4}
_PAPER_LEFT, _PAPER_BOTTOM, _PAPER_EDGE = 0.6, 0.4, 0.15  # Beside axes, in a column of a paper.
_PAPER_PLOT, _PAPER_LEGEND, _PAPER_LEGEND_WIDTH = 1.1, 0.5, 1.35


def save_picture(plan, path, baselines=()):
    """Draw a Plan into a file, beside Plans of the same mission; the suffix gives the format."""
    draw_plan(plan, baselines).savefig(path, dpi=_DOTS_PER_INCH)


def draw_plan(plan, baselines=(), axes=None, title=True, width=None) -> Picture:
    """
    Return a matplotlib Figure of a plan, as save_picture writes it.

    :param axes: see Plan.plot, as for the others.
    """
    text = '\n'.join(line for text in (
        f'{scheme_name(plan.method)}: {rate_label(plan)}', plan.claim)
        for line in wrap(text, _TITLE_WIDTH)) if title else ''
    if axes is not None:
        return _draw_parts(axes, plan, baselines, text)
    with own_settings():
        return _draw_figure(plan, baselines, text) if width is None else (
            _draw_for_paper(plan, baselines, text, width))


def checked_axes(axes) -> list[Axes] | None:
    """Return one to three Axes as a list, None for None, or raise OptionError for all else."""
    if axes is None:
        return None
    members = list(np.ravel(axes))
    if not 1 <= len(members) <= 3 or not all(isinstance(member, Axes) for member in members):
        raise OptionError(f'axes is {quote(axes)}; it must be Axes of Matplotlib, or a sequence '
                          'of one to three', ('axes',))
    return members


def _draw_parts(axes, plan, baselines, title, map_legend=None, legend=None):
    """Draw the map, the powers and the rates into as many axes as there are, with legends."""
    extent = map_extent(plan.scenario, [plan, *baselines])
    draw_map(axes[0], plan, extent, baselines, **map_legend or {})
    axes[0].set_title(title, fontsize=11, loc='left')
    if len(axes) > 1:
        draw_powers(axes[1], plan, **legend or {})
    if len(axes) > 2:
        draw_rates(axes[2], plan, baselines, **legend or {})
    return axes[0].figure


def _draw_for_paper(plan, baselines, title, width):
    """Draw map, powers and rates below each other, as wide as a column, in the fonts of papers."""
    sides = np.ptp(map_extent(plan.scenario, [plan, *baselines]), axis=0)
    room = width - _PAPER_LEFT - _PAPER_EDGE
    bottom = 3 * _PAPER_BOTTOM + 2 * (_PAPER_PLOT + _PAPER_LEGEND)
    if sides[1] > sides[0]:  # The legend of the map is at its right, otherwise below.
        size = sides * min((room - _PAPER_LEGEND_WIDTH) / sides[0], 1.2 * width / sides[1])
        map_legend = {'handlelength': 1.5}
    else:
        size = sides * room / sides[0]
        map_legend = {'handlelength': 1.5, 'loc': 'upper left', 'ncols': 2,
                      'bbox_to_anchor': (0.0, -_PAPER_BOTTOM / size[1])}
        bottom += 2 * _PAPER_LEGEND + _PAPER_BOTTOM
    with rc_context(_PAPER):
        axes = _make_axes(
            width, bottom + size[1] + _PAPER_EDGE + 0.2 * len(title.splitlines()),
            (_PAPER_LEFT, bottom, *size),
            (_PAPER_LEFT, 2 * _PAPER_BOTTOM + _PAPER_PLOT + _PAPER_LEGEND, room, _PAPER_PLOT),
            (_PAPER_LEFT, _PAPER_BOTTOM, room, _PAPER_PLOT))
        figure = _draw_parts(axes, plan, baselines, title, map_legend, {
            'loc': 'lower left', 'bbox_to_anchor': (0.0, 1.0), 'ncols': 2})
        for text in figure.findobj(Text):
            text.set_fontsize(_PAPER['font.size'])
    return figure


def _draw_figure(plan, baselines, title):
    """Draw the map, and beside or below it powers and rates."""
    width, height = _map_size(map_extent(plan.scenario, [plan, *baselines]))
    top = 0.35 + 0.2 * title.count('\n')
    right = _RIGHT_WITH_ENERGIES if any(plan.energies) else _RIGHT
    if height > width:  # The plots are beside the map, otherwise below.
        left, half = 2 * _LEFT + width + _RIGHT, height / 2 - 0.15
        map_axes, power_axes, rate_axes = _make_axes(
            left + _PLOT_WIDTH + right, height + _BOTTOM + top, (_LEFT, _BOTTOM, width, height),
            (left, _BOTTOM + height - half, _PLOT_WIDTH, half),
            (left, _BOTTOM, _PLOT_WIDTH, half))
    else:
        map_axes, power_axes, rate_axes = _make_axes(
            _LEFT + width + right, height + 4.45 + top, (_LEFT, 4.45, width, height),
            (_LEFT, 2.45, width, 1.4), (_LEFT, _BOTTOM, width, 1.7))
    power_axes.tick_params(labelbottom=False)
    return _draw_parts((map_axes, power_axes, rate_axes), plan, baselines, title)


def _make_axes(width, height, *boxes):
    """
    Return axes of a new figure, each at a left and a bottom with a width and a height.

    They are placed in inches, because constrained layout cuts off legends beside axes of equal
    aspect.
    """
    figure = Picture(figsize=(width, height))
    return [figure.add_axes(np.array(box) / (width, height, width, height)) for box in boxes]


@own_settings()
def draw_scenario(scenario) -> Picture:
    """Return a matplotlib Figure with the map of a Scenario."""
    extent = map_extent(scenario)
    width, height = _map_size(extent)
    [axes] = _make_axes(_LEFT + width + _RIGHT, height + 0.8, (_LEFT, _BOTTOM, width, height))
    set_up_map(axes, extent)
    draw_ground(axes, scenario)
    for index, uav in enumerate(scenario.uavs):
        axes.annotate('', uav.goal, uav.start, zorder=3, arrowprops={
            'arrowstyle': '-', 'linestyle': (0, (2, 4)), 'color': uav_color(index)})
        draw_ends(axes, index, uav.start, uav.goal)
    add_map_legend(axes, {
        uav_label(uav, f', {uav.altitude:g} m high'): Line2D(
            [], [], color=uav_color(index), linestyle=(0, (2, 4)))
        for index, uav in enumerate(scenario.uavs)})
    return axes.figure


def draw_powers(axes, plan, **legend):
    """Draw the power of each slot, and the limits that all UAVs share; see add_legend."""
    for index, (uav, powers) in enumerate(zip(plan.scenario.uavs, plan.powers)):
        axes.stairs(powers, plan.times[1:], color=uav_color(index), linewidth=1.8,
                    linestyle='-' if index == 0 else (0, (5, index)),
                    label='\n'.join(filter(None, (
                        uav_label(uav, ' (jams)' if index else ' (transmits)'),
                        energy_label(plan.energies[index])))))
    limits = {}
    for field, text in (('peak_power', 'peak'), ('average_power', 'average')):
        values = {getattr(uav, field) for uav in plan.scenario.uavs}
        if len(values) == 1:
            limits.setdefault(values.pop(), []).append(text)
    for limit, texts in limits.items():
        axes.axhline(limit, color=GREY, linewidth=0.9, linestyle=':', zorder=0)
        axes.annotate(', '.join(texts), (0.0, limit), xycoords=('axes fraction', 'data'),
                      xytext=(4, 1), textcoords='offset points', va='bottom',
                      color=GREY, fontsize=8)
    peak = max(uav.peak_power for uav in plan.scenario.uavs)
    axes.set_yscale('asinh', linear_width=LINEAR_SHARE * peak)
    axes.set_ylim(0, 1.5 * peak)
    exponents = np.arange(*np.floor(np.log10([10 * LINEAR_SHARE * peak, 10 * peak])))
    ticks = [0.0, *(10.0 ** exponents)]
    axes.set_yticks(ticks, [f'{tick:g}' for tick in ticks])
    axes.minorticks_off()
    _finish_time_axes(axes, plan, 'power (W)', legend)


def draw_rates(axes, plan, baselines=(), **legend):
    """Draw the guaranteed and the worst-case secrecy rate of each slot; see add_legend."""
    edges = plan.times[1:]
    guaranteed, worst = ('\n'.join(wrap(plan.scenario.channel.rate_name(name), LEGEND_WIDTH))
                         for name in OBJECTIVES)
    axes.stairs(plan.worst_case_rates, edges, color=RATE, linewidth=1.3, linestyle='--',
                label=worst)
    axes.stairs(plan.guaranteed_rates, edges, fill=True, color=RATE, alpha=0.2)
    axes.stairs(plan.guaranteed_rates, edges, color=RATE, linewidth=1.8, label=guaranteed)
    for baseline, dash in zip(baselines, _DASHES):
        axes.stairs(baseline.guaranteed_rates, baseline.times[1:], color=GREY, linewidth=1.1,
                    linestyle=dash, label=scheme_name(baseline.method).replace(', ', ',\n'))
    highest = max(drawn.worst_case_rates.max() for drawn in (plan, *baselines))
    highest = 1.08 * max(highest, 0.01)
    axes.set_ylim(0, highest)
    if len(plan.shares) > 1:  # A strip below 0, in the colours of the ground nodes.
        height = _STRIP * highest
        tops = -height * (1 - np.cumsum(plan.shares, axis=0))
        for index, (top, share) in enumerate(zip(tops, plan.shares)):
            axes.bar(edges[:-1], height * share, plan.scenario.slot_duration,
                     top - height * share, align='edge', color=node_color(plan.scenario, index))
        axes.set_ylim(bottom=-height)
    axes.locator_params(axis='y', steps=[1, 2, 5, 10])  # For labels that fit at the left.
    axes.set_xlabel('time (s)')
    _finish_time_axes(axes, plan, 'secrecy rate\n(bit/s/Hz)', legend)


def _finish_time_axes(axes, plan, label, legend):
    axes.set_ylabel(label)
    axes.set_xlim(0, plan.times[-1])
    if plan.promise.is_partial:
        axes.axvline(plan.promised_until, color=GREY, linewidth=1.2, linestyle='--',
                     label='promised until')
    style_axes(axes)
    add_legend(axes, **legend)


def _map_size(extent):
    """Return width and height of the map in inches."""
    sides = extent[1] - extent[0]
    return sides * (np.array(_MAP_SIZE) / sides).min()
