"""The picture of a plan: a map, and the powers and the rates over time."""

from itertools import product
from textwrap import wrap

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
import numpy as np
import shapely

from .drawing import (
    add_legend, altitude_label, EAVESDROPPER, eavesdropper_color, energy_label, GEOFENCE,
    is_obstacle, label_position, list_tracks, map_extent, MARGIN, margin_rings, NO_FLY_ZONE,
    node_color, node_labels, RATE, rate_label, receiver_label, scheme_name, shown_discs,
    style_axes, uav_color)
from .figures import own_settings, Picture
from ..errors import OptionError, quote
from ..mission import OBJECTIVES

_MAP_SIZE = 5.95, 5.6  # Of the largest map, in inches as all lengths here.
_LEFT, _BOTTOM, _RIGHT = 1.0, 0.6, 2.05  # Beside axes: labels, and legends at the right.
_PLOT_WIDTH = 4.4  # Beside a map.
_TITLE_WIDTH = 96  # In characters.
_LEGEND_WIDTH, _NAME_LENGTH = 18, 36  # Likewise.
_DOTS_PER_INCH = 200
_LINEAR_SHARE = 1e-3  # Of the peak power, below which the scale of powers is linear.
_TIME_MARKS = MaxNLocator(12, steps=(1, 2, 5, 10))
_FONT_SIZE = 8.0  # In points, of texts on the map.
_GAPS = 5.0, 10.0  # In points, from a path to its labels.
_LABEL_ANGLES = np.radians((0, 180, 40, -40, 140, -140, 65, -65, 115, -115))
_STRIP = 0.12  # Height of the strip of shares, in heights of the rates.
_DASHES = ('--', ':', '-.')
_GREY = '0.45'
_ZONE = {'facecolor': '0.87', 'edgecolor': NO_FLY_ZONE, 'linewidth': 1.2}
_ZONE_OVERFLOWN = {**_ZONE, 'facecolor': 'none', 'linestyle': ':'}
_MARGIN = {'facecolor': MARGIN, 'edgecolor': 'none'}
_FENCE = {'fill': False, 'edgecolor': GEOFENCE, 'linestyle': (0, (6, 3)), 'linewidth': 1.2}
_HALO = [withStroke(linewidth=2.5, foreground='white')]  # Around texts on the map.
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
    if height > width:  # The plots are beside the map, otherwise below.
        left, half = 2 * _LEFT + width + _RIGHT, height / 2 - 0.15
        map_axes, power_axes, rate_axes = _make_axes(
            left + _PLOT_WIDTH + _RIGHT, height + _BOTTOM + top, (_LEFT, _BOTTOM, width, height),
            (left, _BOTTOM + height - half, _PLOT_WIDTH, half),
            (left, _BOTTOM, _PLOT_WIDTH, half))
    else:
        map_axes, power_axes, rate_axes = _make_axes(
            _LEFT + width + _RIGHT, height + 4.45 + top, (_LEFT, 4.45, width, height),
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
    _set_up_map(axes, extent)
    draw_ground(axes, scenario)
    for index, uav in enumerate(scenario.uavs):
        axes.annotate('', uav.goal, uav.start, zorder=3, arrowprops={
            'arrowstyle': '-', 'linestyle': (0, (2, 4)), 'color': uav_color(index)})
        _draw_ends(axes, index, uav.start, uav.goal)
    _add_map_legend(axes, scenario, {
        _uav_label(uav, f', {uav.altitude:g} m high'): Line2D(
            [], [], color=uav_color(index), linestyle=(0, (2, 4)))
        for index, uav in enumerate(scenario.uavs)})
    return axes.figure


def draw_map(axes, plan, extent, baselines=(), legend=True, **options):
    """
    Draw the paths, wide and dark where the power is high, the ground node, discs, zones and fence.

    Baselines are grey.

    :param extent: the result of map_extent.
    :param legend: False for no legend.
    :param options: of the legend, which is at the right of the map by default.
    """
    scenario = plan.scenario
    _set_up_map(axes, extent)
    baseline_paths = [path for baseline in baselines for path in baseline.positions]
    for path in baseline_paths:
        axes.plot(*path.T, color=_GREY, linewidth=0.9, zorder=1)
    draw_ground(axes, scenario)
    peak = max(uav.peak_power for uav in scenario.uavs)
    point = _point_size(axes)
    occupied = [*(shapely.Polygon(zone.vertices) for zone in scenario.no_fly_zones),
                *(shapely.Point(center).buffer(max(radius, 5 * point))
                  for discs in shown_discs(scenario) for _, center, radius in discs),
                *_disc_boxes(scenario, point),
                *(shapely.Point(node.position).buffer(5 * point)
                  for node in scenario.ground_nodes),
                *(shapely.LineString(path).buffer(3 * point) for path in plan.positions)]
    for index, (points, powers) in enumerate(zip(plan.positions, plan.powers)):
        # Power n holds from point n to point n + 1; before point 1 the power is zero.
        level = power_level(np.concatenate([[0.0], powers]), peak)
        axes.add_collection(LineCollection(
            np.stack([points[:-1], points[1:]], axis=1), colors=_power_colors(index)(level),
            linewidths=_line_width(level), capstyle='round', zorder=3), autolim=False)
        axes.plot(*points.T, color=uav_color(index), linewidth=0.8, zorder=4)
        _draw_ends(axes, index, points[0], points[-1])
        _label_times(axes, plan.times, points, uav_color(index), occupied,
                     [shapely.LineString(path) for path in baseline_paths])
    if legend:
        levels = np.linspace(0, 1, 9)
        _add_map_legend(axes, scenario, {
            _uav_label(uav, f', 0 to {peak:g} W'): tuple(
                Line2D([], [], color=_power_colors(index)(level), linewidth=_line_width(level),
                       solid_capstyle='butt') for level in levels)
            for index, uav in enumerate(scenario.uavs)}, bool(baselines), **options)


def _uav_label(uav, text):
    """Return the name of a UAV and a text, wrapped for the legend."""
    name = uav.name
    if len(name) > _NAME_LENGTH:  # Without its middle, as the ends of names tell them apart.
        name = f'{name[:_NAME_LENGTH // 2 - 2]}...{name[2 - _NAME_LENGTH // 2:]}'
    label = _escape('\n'.join(wrap(name + text, _LEGEND_WIDTH)))
    return f' {label}' if label.startswith('_') else label  # '_' would hide it.


def _escape(text):
    """Escape the dollar signs of a text, which Matplotlib takes for formulas."""
    return text.replace('$', r'\$')


def draw_ground(axes, scenario):
    """Draw zones, fence, eavesdroppers and the ground nodes."""
    _draw_airspace(axes, scenario)
    _draw_tracks(axes, scenario)
    for index, (eve, name, discs) in enumerate(zip(
            scenario.eavesdroppers, scenario.eavesdropper_names, shown_discs(scenario))):
        color = eavesdropper_color(index, eve)
        for time, center, radius in discs:
            axes.add_patch(Circle(center, radius, facecolor=color, alpha=0.25))
            axes.add_patch(Circle(center, radius, fill=False, edgecolor=color))
            axes.annotate(_disc_label(eve, name, time), center, (-_GAPS[1], 0),
                          textcoords='offset points', fontsize=_FONT_SIZE, ha='right',
                          va='center', color=color, zorder=8, path_effects=_HALO)
        axes.plot(*eve.position, 'X', **_marker_style(color, 8), zorder=6, label=_escape(name))
        axes.annotate(receiver_label(eve), eve.position, (7, 7), textcoords='offset points',
                      fontsize=8, color=color, zorder=8, path_effects=_HALO)
    for index, node in enumerate(scenario.ground_nodes):
        axes.plot(*node.position, '^', **_marker_style(node_color(scenario, index), 10), zorder=6,
                  label='ground node')


def _disc_label(eavesdropper, name, time):
    """Return the text of a disc at a time in s, empty for an eavesdropper that stands."""
    if eavesdropper.track is None:
        return ''
    return f'{time:g} s' if time else f'{_escape(name)}, 0 s'


def _disc_boxes(scenario, point):
    """Yield the boxes on the map of the texts of discs; `point` is a typographic one in m."""
    for eve, name, discs in zip(
            scenario.eavesdroppers, scenario.eavesdropper_names, shown_discs(scenario)):
        for time, (x, y), _ in discs:
            width, height = _text_size(_disc_label(eve, name, time), point)
            right = x - _GAPS[1] * point
            yield shapely.box(right - width, y - height / 2, right, y + height / 2)


def _text_size(text, point):
    """Return an estimate of width and height of a text on the map; see _disc_boxes."""
    return np.array([0.62 * len(text), 1.0]) * _FONT_SIZE * point


def _draw_tracks(axes, scenario):
    """Draw the tracks of receivers that move, with an arrow at the end."""
    for _, track, color in list_tracks(scenario, scenario.times):
        axes.plot(*track.T, color=color, linewidth=1.0, linestyle=(0, (4, 2)), zorder=2)
        moved = np.flatnonzero((track != track[-1]).any(axis=1))[-1]
        axes.annotate('', track[-1], track[moved], zorder=6,
                      arrowprops={'arrowstyle': '-|>', 'color': color})


def _draw_ends(axes, index, start, goal):
    """Draw start and goal of a UAV, with a size by index: several may be at one point."""
    for point, marker in ((start, 'o'), (goal, 's')):
        axes.plot(*point, marker, color='white', markeredgecolor=uav_color(index),
                  markeredgewidth=1.5, markersize=7 + 4 * index, zorder=5 - 0.1 * index)


def _draw_airspace(axes, scenario):
    """Draw fence and zones with their margins; zones at other altitudes are not filled."""
    for ring in margin_rings(scenario):
        axes.add_patch(Polygon(ring, **_MARGIN, zorder=0.4, label='margin'))
    if scenario.geofence is not None:
        axes.add_patch(Polygon(scenario.geofence, **_FENCE, zorder=1))
    for zone, name in zip(scenario.no_fly_zones, scenario.zone_names):
        style = _ZONE if is_obstacle(zone, scenario) else _ZONE_OVERFLOWN
        axes.add_patch(Polygon(zone.vertices, **style, zorder=1.5))
        text = '\n'.join(filter(None, (_escape(name), altitude_label(zone))))
        axes.annotate(text, label_position(zone), ha='center', va='center', fontsize=7.5,
                      color='0.25', zorder=8, annotation_clip=True, path_effects=_HALO)


def power_level(powers, peak):
    """
    Return powers on the scale of the picture, 0 for 0 W and 1 for the peak power.

    It is logarithmic, because in good plans the jamming power is a hundredth of that transmitted.
    """
    return np.arcsinh(np.maximum(powers, 0.0) / (_LINEAR_SHARE * peak)) / np.arcsinh(
        1 / _LINEAR_SHARE)


def draw_powers(axes, plan, **legend):
    """Draw the power of each slot, and the limits that all UAVs share; see add_legend."""
    for index, (uav, powers) in enumerate(zip(plan.scenario.uavs, plan.powers)):
        axes.stairs(powers, plan.times[1:], color=uav_color(index), linewidth=1.8,
                    linestyle='-' if index == 0 else (0, (5, index)),
                    label='\n'.join(filter(None, (
                        _uav_label(uav, ' (jams)' if index else ' (transmits)'),
                        energy_label(plan.energies[index])))))
    limits = {}
    for field, text in (('peak_power', 'peak'), ('average_power', 'average')):
        values = {getattr(uav, field) for uav in plan.scenario.uavs}
        if len(values) == 1:
            limits.setdefault(values.pop(), []).append(text)
    for limit, texts in limits.items():
        axes.axhline(limit, color=_GREY, linewidth=0.9, linestyle=':', zorder=0)
        axes.annotate(', '.join(texts), (0.0, limit), xycoords=('axes fraction', 'data'),
                      xytext=(4, 1), textcoords='offset points', va='bottom',
                      color=_GREY, fontsize=8)
    peak = max(uav.peak_power for uav in plan.scenario.uavs)
    axes.set_yscale('asinh', linear_width=_LINEAR_SHARE * peak)
    axes.set_ylim(0, 1.5 * peak)
    exponents = np.arange(*np.floor(np.log10([10 * _LINEAR_SHARE * peak, 10 * peak])))
    ticks = [0.0, *(10.0 ** exponents)]
    axes.set_yticks(ticks, [f'{tick:g}' for tick in ticks])
    axes.minorticks_off()
    _finish_time_axes(axes, plan, 'power (W)', legend)


def draw_rates(axes, plan, baselines=(), **legend):
    """Draw the guaranteed and the worst-case secrecy rate of each slot; see add_legend."""
    edges = plan.times[1:]
    guaranteed, worst = ('\n'.join(wrap(plan.scenario.channel.rate_name(name), _LEGEND_WIDTH))
                         for name in OBJECTIVES)
    axes.stairs(plan.worst_case_rates, edges, color=RATE, linewidth=1.3, linestyle='--',
                label=worst)
    axes.stairs(plan.guaranteed_rates, edges, fill=True, color=RATE, alpha=0.2)
    axes.stairs(plan.guaranteed_rates, edges, color=RATE, linewidth=1.8, label=guaranteed)
    for baseline, dash in zip(baselines, _DASHES):
        axes.stairs(baseline.guaranteed_rates, baseline.times[1:], color=_GREY, linewidth=1.1,
                    linestyle=dash, label=scheme_name(baseline.method).replace(', ', ',\n'))
    highest = max(drawn.worst_case_rates.max() for drawn in (plan, *baselines))
    highest = 1.08 * max(highest, 0.01)
    axes.set_ylim(0, highest)
    if len(plan.shares) > 1:
        _draw_shares(axes, plan, _STRIP * highest)
    axes.locator_params(axis='y', steps=[1, 2, 5, 10])  # For labels that fit at the left.
    axes.set_xlabel('time (s)')
    _finish_time_axes(axes, plan, 'secrecy rate\n(bit/s/Hz)', legend)


def _draw_shares(axes, plan, height):
    """Draw a strip below 0 of the shares of each slot in the colours of the ground nodes."""
    tops = -height * (1 - np.cumsum(plan.shares, axis=0))
    for index, (top, share) in enumerate(zip(tops, plan.shares)):
        axes.bar(plan.times[1:-1], height * share, plan.scenario.slot_duration,
                 top - height * share, align='edge', color=node_color(plan.scenario, index))
    axes.set_ylim(bottom=-height)


def _finish_time_axes(axes, plan, label, legend):
    axes.set_ylabel(label)
    axes.set_xlim(0, plan.times[-1])
    if plan.promise.is_partial:
        axes.axvline(plan.promised_until, color=_GREY, linewidth=1.2, linestyle='--',
                     label='promised until')
    style_axes(axes)
    add_legend(axes, **legend)


def _marker_style(color, size):
    return {'color': color, 'markersize': size, 'markeredgecolor': 'white', 'linestyle': 'none'}


def _power_colors(index):
    """Return a colour map from a light tint (0 W) to a dark shade (peak) of a UAV's colour."""
    color = np.array(to_rgb(uav_color(index)))
    return LinearSegmentedColormap.from_list(f'uav{index}', [0.2 * color + 0.8, 0.75 * color])


def _map_size(extent):
    """Return width and height of the map in inches."""
    sides = extent[1] - extent[0]
    return sides * (np.array(_MAP_SIZE) / sides).min()


def _line_width(level):
    return 1.5 + 5.5 * level


def _set_up_map(axes, extent):
    """Set the limits of a map, whose north is up."""
    axes.set(xlabel='east (m)', ylabel='north (m)', aspect='equal', anchor='W',
             xlim=extent[:, 0], ylim=extent[:, 1])
    style_axes(axes)


def _point_size(axes):
    """Return the length in m of a typographic point on a map."""
    return np.ptp(axes.get_xlim()) / axes.bbox.width * axes.figure.dpi / 72.0


def _label_times(axes, times, points, color, occupied, baseline_paths):
    """
    Mark round times along a path; where the UAV hovers, a label gives the interval.

    Labels are beside the path on the map, where they cover nothing occupied, a list to which they
    are added, and none of the baselines if possible.
    """
    marks = _TIME_MARKS.tick_values(0.0, times[-1])[1:]
    marks = marks[marks < times[-1] - marks[0] / 3]
    before, places, after = (np.stack([
        np.interp(marks + shift, times, points[:, axis]) for axis in (0, 1)], axis=-1)
        for shift in (-times[1], 0.0, times[1]))
    axes.plot(*places.T, 'o', color='white', markeredgecolor=color, markersize=3.5,
              linestyle='none', zorder=7)
    point = _point_size(axes)
    inside = shapely.box(*np.transpose([axes.get_xlim(), axes.get_ylim()]).ravel())
    groups, first = [], 0
    for last in range(len(marks)):
        if last + 1 == len(marks) or (
                np.hypot(*(places[last + 1] - places[first])) >= 17.0 * point):
            groups.append((first, last))
            first = last + 1
    for first, last in sorted(groups, key=lambda group: group[0] - group[1]):  # Longest first.
        middle = (first + last) // 2
        text = f'{marks[first]:g}' if first == last else f'{marks[first]:g}–{marks[last]:g}'
        size = _text_size(f'{text} s', point)
        x, y = after[middle] - before[middle]
        boxes = []
        for gap, angle in product(_GAPS, np.arctan2(x, -y) + _LABEL_ANGLES):
            aside = np.array([np.cos(angle), np.sin(angle)])
            center = places[middle] + aside * (gap * point + np.abs(aside) @ size / 2)
            box = shapely.box(*(center - size / 2), *(center + size / 2))
            if inside.contains(box) and not shapely.intersects(box, occupied).any():
                boxes.append(box)
        if boxes:
            box = min(boxes, key=lambda box: any(map(box.intersects, baseline_paths)))
            occupied.append(box)
            axes.annotate(f'{text} s', box.centroid.coords[0], ha='center', va='center',
                          color=color, fontsize=_FONT_SIZE, zorder=8, path_effects=_HALO)


def _add_map_legend(axes, scenario, uav_entries, has_baselines=False, **options):
    """Explain the symbols of the map after the entries, artists by label, of the UAVs."""
    standing = [eve for eve in scenario.eavesdroppers if eve.track is None]
    has_discs = any(eve.error_radius for eve in standing)
    entries = {
        **uav_entries,
        **{name: Line2D([], [], marker=marker, color='white', markeredgecolor='0.2')
           for name, marker in (('start', 'o'), ('goal', 's'))},
        **{_escape(name): Line2D(
            [], [], marker='^', **_marker_style(node_color(scenario, index), 10))
           for index, name in enumerate(node_labels(scenario))},
        **{_escape(name): Line2D([], [], marker='X', **{
            **_marker_style(eavesdropper_color(index, eve), 8), 'linestyle': (0, (4, 2))})
           for index, (name, eve) in enumerate(zip(
               scenario.eavesdropper_names, scenario.eavesdroppers)) if eve.track is not None}}
    if standing:
        entries['eavesdropper, disc' if has_discs else 'eavesdropper'] = Line2D(
            [], [], marker='X', **_marker_style(EAVESDROPPER, 8))
    if scenario.no_fly_zones:
        entries['no-fly zone'] = Patch(**_ZONE)
    if scenario.geofence is not None:
        entries['geofence'] = Line2D([], [], color=GEOFENCE, linewidth=1.2,
                                     linestyle=_FENCE['linestyle'])
    if scenario.tracking_margin:
        entries[f'margin of {scenario.tracking_margin:g} m'] = Patch(**_MARGIN)
    if has_baselines:
        entries['baseline'] = Line2D([], [], color=_GREY, linewidth=0.9)
    add_legend(axes, list(entries.values()), list(entries), **{
        'handlelength': 3, 'handler_map': {tuple: HandlerTuple(ndivide=None, pad=0)}, **options})
