"""The picture of a plan: a map, and the powers and the rates over time."""

from functools import partial
from textwrap import wrap

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
import numpy as np

from .drawing import (
    add_legend, energy_label, map_extent, node_color, RATE, rate_label, scheme_dash, scheme_name,
    style_axes, uav_color)
from .figures import own_settings, Picture
from .map import (
    add_map_legend, add_plan_legend, draw_ends, draw_ground, draw_map, draw_paths, GREY,
    label_map, LEGEND_WIDTH, LINEAR_SHARE, set_up_map, wrap_name)
from .sheet import lay_out_map, lay_out_sheet, Part
from ..errors import OptionError, quote
from ..mission import OBJECTIVES

_WIDTH = 9.6  # Width of a picture that is not for a paper [inches].
_TITLE_SIZE = 11.0  # Font size of the title [points].
_DOTS_PER_INCH = 200
_STRIP = 0.12  # Height of the strip of shares, in heights of the rates.
_PAPER = {'font.family': 'serif', 'font.size': 8.0, 'legend.handlelength': 1.5,
          'legend.columnspacing': 1.0, 'legend.handletextpad': 0.4}
_LETTER = 0.58  # Mean width of a letter, in font sizes.


def save_picture(plan, path, baselines=()):
    """Draw a Plan and baselines of its mission into a file, whose suffix gives the format."""
    draw_plan(plan, baselines).savefig(path, dpi=_DOTS_PER_INCH)


def draw_plan(plan, baselines=(), axes=None, title=True, width=None) -> Picture:
    """
    Return a matplotlib Figure of a plan, as save_picture writes it.

    The parameters are explained at Plan.plot: `axes` to draw into, `width` [inches] for a paper.
    """
    lines = (f'{scheme_name(plan.method)}: {rate_label(plan)}', plan.claim) if title else ()
    if axes is not None:
        return _draw_parts(axes, plan, baselines, _wrap_title(lines, _WIDTH, _TITLE_SIZE))
    with own_settings():
        if width is None:
            return _draw_sheet(
                plan, baselines, _WIDTH, _wrap_title(lines, _WIDTH, _TITLE_SIZE), _TITLE_SIZE,
                fontsize=9)
        with rc_context(_PAPER):
            size = _PAPER['font.size']
            return _draw_sheet(plan, baselines, width, _wrap_title(lines, width, size), size,
                               has_energies=False, fontsize=size)


def _wrap_title(lines, width, font_size):
    """Return lines of text, wrapped for a figure of a width in inches."""
    letters = int(0.9 * width * 72.0 / (_LETTER * font_size))
    return [part for line in lines for part in wrap(line, letters)]


def checked_axes(axes) -> list[Axes] | None:
    """Return one to three Axes as a list, None for None, or raise OptionError for all else."""
    if axes is None:
        return None
    members = list(np.ravel(axes))
    if not 1 <= len(members) <= 3 or not all(isinstance(member, Axes) for member in members):
        raise OptionError(f'axes is {quote(axes)}; it must be Axes of Matplotlib, or a sequence '
                          'of one to three', ('axes',))
    return members


def _draw_parts(axes, plan, baselines, title):
    """Draw map, powers and rates, in this order, into one to three axes; return their figure."""
    draw_map(axes[0], plan, map_extent(plan.scenario, [plan, *baselines]), baselines)
    axes[0].set_title('\n'.join(title), fontsize=_TITLE_SIZE, loc='left')
    if len(axes) > 1:
        draw_powers(axes[1], plan)
    if len(axes) > 2:
        draw_rates(axes[2], plan, baselines)
    return axes[0].figure


def _draw_sheet(plan, baselines, width, title, title_size, has_energies=True, **legend):
    """Return a Figure `width` inches wide of map, powers and rates, placed by lay_out_sheet."""
    figure = Picture(figsize=(width, width))
    map_axes, power_axes, rate_axes = figure.subplots(3)
    draw_paths(map_axes, plan, map_extent(plan.scenario, [plan, *baselines]), baselines)
    draw_powers(power_axes, plan, has_energies)
    draw_rates(rate_axes, plan, baselines)
    power_axes.tick_params(labelbottom=False)
    lay_out_sheet(figure, (
        Part(map_axes, partial(add_plan_legend, map_axes, plan, **legend)),
        Part(power_axes, partial(add_legend, power_axes, **legend)),
        Part(rate_axes, partial(add_legend, rate_axes, **legend))), title, title_size)
    label_map(map_axes, plan.scenario, plan, baselines)
    return figure


@own_settings()
def draw_scenario(scenario) -> Picture:
    """Return a Figure with the map of a Scenario and a dotted line from each start to its goal."""
    axes = Picture().subplots()
    set_up_map(axes, map_extent(scenario))
    draw_ground(axes, scenario)
    for index, uav in enumerate(scenario.uavs):
        axes.annotate('', uav.goal, uav.start, zorder=3, arrowprops={
            'arrowstyle': '-', 'linestyle': (0, (2, 4)), 'color': uav_color(index)})
        draw_ends(axes, index, uav.start, uav.goal)
    lay_out_map(Part(axes, partial(add_map_legend, axes, {
        wrap_name(uav.name, f', {uav.altitude:g} m high'): Line2D(
            [], [], color=uav_color(index), linestyle=(0, (2, 4)))
        for index, uav in enumerate(scenario.uavs)})))
    label_map(axes, scenario)
    return axes.figure


def draw_powers(axes, plan, has_energies=True, **legend):
    """
    Draw the power of each slot, and the peak and average power if it is the same for all UAVs.

    :param has_energies: whether the legend has the energy of each UAV.
    :param legend: options of add_legend.
    """
    for index, (uav, powers) in enumerate(zip(plan.scenario.uavs, plan.powers)):
        axes.stairs(powers, plan.times[1:], color=uav_color(index), linewidth=1.8,
                    linestyle='-' if index == 0 else (0, (5, index)),
                    label='\n'.join(filter(None, (
                        wrap_name(uav.name, ' (jams)' if index else ' (transmits)', 26),
                        energy_label(plan.energies[index] if has_energies else None)))))
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
    axes.set_ylim(0, 2.5 * peak)  # Room above the peak is for the peak's label.
    exponents = np.arange(*np.floor(np.log10([10 * LINEAR_SHARE * peak, 10 * peak])))
    ticks = [0.0, *(10.0 ** exponents)]  # 0 W, and powers of ten in the logarithmic range.
    axes.set_yticks(ticks, [f'{tick:g}' for tick in ticks])
    axes.minorticks_off()
    _finish_time_axes(axes, plan, 'power (W)', legend)


def draw_rates(axes, plan, baselines=(), **legend):
    """Draw guaranteed and worst-case rates by slot, and baselines' guaranteed rates, in grey."""
    edges = plan.times[1:]
    guaranteed, worst = ('\n'.join(wrap(plan.scenario.channel.rate_name(name), LEGEND_WIDTH))
                         for name in OBJECTIVES)
    axes.stairs(plan.worst_case_rates, edges, color=RATE, linewidth=1.3, linestyle='--',
                label=worst)
    axes.stairs(plan.guaranteed_rates, edges, fill=True, color=RATE, alpha=0.2)
    axes.stairs(plan.guaranteed_rates, edges, color=RATE, linewidth=1.8, label=guaranteed)
    for baseline in baselines:
        axes.stairs(baseline.guaranteed_rates, baseline.times[1:], color=GREY, linewidth=1.1,
                    linestyle=scheme_dash(baseline.method),
                    label=scheme_name(baseline.method).replace(', ', ',\n'))
    highest = max(drawn.worst_case_rates.max() for drawn in (plan, *baselines))
    highest = 1.08 * max(highest, 0.01)
    axes.set_ylim(0, highest)
    if len(plan.shares) > 1:  # Shares are a strip below 0, in the ground nodes' colours.
        height = _STRIP * highest
        tops = -height * (1 - np.cumsum(plan.shares, axis=0))
        for index, (top, share) in enumerate(zip(tops, plan.shares)):
            axes.bar(edges[:-1], height * share, plan.scenario.slot_duration,
                     top - height * share, align='edge', color=node_color(plan.scenario, index))
        axes.set_ylim(bottom=-height)
    axes.locator_params(axis='y', steps=[1, 2, 5, 10])  # Short labels fit at the left.
    axes.set_xlabel('time (s)')
    _finish_time_axes(axes, plan, 'secrecy rate\n(bit/s/Hz)', legend)


def _finish_time_axes(axes, plan, label, legend):
    """Label and style axes over time, shade the intervals not promised, and add the legend."""
    axes.set_ylabel(label)
    axes.set_xlim(0, plan.times[-1])
    for number, (begin, end) in enumerate(plan.promise.gaps):
        axes.axvspan(begin, end, color=GREY, alpha=0.25, linewidth=0,
                     label='' if number else 'not promised')
    style_axes(axes)
    add_legend(axes, **legend)
