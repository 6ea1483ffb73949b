"""The map of a plan: airspace, receivers, and paths by power and time."""

from textwrap import wrap

from matplotlib import rcParams
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MaxNLocator
import numpy as np
import shapely

from .drawing import (
    add_legend, altitude_label, distinct_paths, eavesdropper_color, GEOFENCE, is_obstacle,
    label_position, list_tracks, MARGIN, margin_rings, NO_FLY_ZONE, node_color, node_labels,
    receiver_label, scheme_dash, shown_discs, style_axes, uav_color)
from .labels import MapLabels, point_size

LEGEND_WIDTH = 18  # Letters in a line of a legend.
_NAME_LENGTH = 36  # Largest number of letters of a name in a legend.
LINEAR_SHARE = 1e-3  # Share of the peak power below which the scale of powers is linear.
_TIME_MARKS = MaxNLocator(12, steps=(1, 2, 5, 10))
_NEAR_MARKS = 17.0  # Distance [points] below which time marks share a label.
GREY = '0.45'
_ZONE = {'facecolor': '0.87', 'edgecolor': NO_FLY_ZONE, 'linewidth': 1.2, 'label': 'no-fly zone'}
_ZONE_OVERFLOWN = {**_ZONE, 'facecolor': 'none', 'linestyle': ':',
                   'label': 'no-fly zone at\nother altitudes'}
_TRACK = (0, (4, 2))
_FENCE = {'fill': False, 'edgecolor': GEOFENCE, 'linestyle': (0, (6, 3)), 'linewidth': 1.2}


def draw_map(axes, plan, extent, baselines=(), legend=True, **options):
    """
    Draw the map of a plan: paths, receivers, zones and fence.

    A path is wide and dark where the power is high. Baselines are grey.

    :param extent: the result of map_extent.
    :param legend: False for no legend.
    :param options: options of add_legend; by default the legend is at the right of the map.
    """
    draw_paths(axes, plan, extent, baselines)
    if legend:
        add_plan_legend(axes, plan, **options)
    label_map(axes, plan.scenario, plan, baselines)


def draw_paths(axes, plan, extent, baselines=()):
    """Draw the map of a plan without texts; label_map adds them when the map has its size."""
    scenario = plan.scenario
    set_up_map(axes, extent)
    draw_ground(axes, scenario)
    for baseline, name in distinct_paths(baselines):
        for path in baseline.positions:
            axes.plot(*path.T, color=GREY, linewidth=0.9, zorder=1, label=name,
                      linestyle=scheme_dash(baseline.method))
    peak = max(uav.peak_power for uav in scenario.uavs)
    for index, (points, powers) in enumerate(zip(plan.positions, plan.powers)):
        # Power n holds from point n to point n + 1; before point 1 the power is zero.
        level = power_level(np.concatenate([[0.0], powers]), peak)
        axes.add_collection(LineCollection(
            np.stack([points[:-1], points[1:]], axis=1), colors=_power_colors(index)(level),
            linewidths=_line_width(level), capstyle='round', zorder=3), autolim=False)
        axes.plot(*points.T, color=uav_color(index), linewidth=0.8, zorder=4)
        draw_ends(axes, index, points[0], points[-1])


def add_plan_legend(axes, plan, **options):
    """Add the legend of a plan's map; a UAV's entry has the line at nine powers, 0 W to peak."""
    levels, uavs = np.linspace(0, 1, 9), plan.scenario.uavs
    peak = max(uav.peak_power for uav in uavs)
    add_map_legend(axes, {
        wrap_name(uav.name, f', 0 to {peak:g} W'): tuple(
            Line2D([], [], color=_power_colors(index)(level), linewidth=_line_width(level),
                   solid_capstyle='butt') for level in levels)
        for index, uav in enumerate(uavs)}, **options)


def label_map(axes, scenario, plan=None, baselines=()):
    """Write the texts of a map whose size is final: zones, eavesdroppers, times along paths."""
    point = point_size(axes)
    paths = () if plan is None else plan.positions
    discs = [shapely.Point(center).buffer(max(radius, 5 * point))
             for discs in shown_discs(scenario) for _, center, radius in discs]
    labels = MapLabels(axes, [
        *(shapely.Polygon(zone.vertices) for zone in scenario.no_fly_zones),
        *(shapely.Point(place).buffer(6 * point)
          for ends in (scenario.starts, scenario.goals) for place in ends),
        *(shapely.Point(node.position).buffer(5 * point) for node in scenario.ground_nodes),
        *(shapely.LineString(path).buffer(3 * point) for path in paths),
        *(() if scenario.geofence is None else [shapely.LinearRing(scenario.geofence)])])
    for zone, name in zip(scenario.no_fly_zones, scenario.zone_names):
        text = '\n'.join(filter(None, (_escape(name), altitude_label(zone))))
        if text and _is_on_map(axes, label_position(zone)):
            labels.add_into(shapely.Polygon(zone.vertices), text, label_position(zone),
                            color='0.25')
    _label_eavesdroppers(labels, scenario)
    labels.occupied.extend(discs)  # The texts above may cover discs, later ones not.
    if plan is not None:
        _label_times(axes, labels, plan, [shapely.LineString(path) for baseline in baselines
                                          for path in baseline.positions])


def _label_eavesdroppers(labels, scenario):
    """
    Write the advantage of each eavesdropper's receiver, if it has one.

    At the discs of an eavesdropper that moves, write their times, and its name at time 0.
    """
    for index, (eve, name, discs) in enumerate(zip(
            scenario.eavesdroppers, scenario.eavesdropper_names, shown_discs(scenario))):
        color, advantage = eavesdropper_color(index, eve), receiver_label(eve)
        if eve.track is None:
            if advantage:
                labels.add(advantage, eve.position, np.pi / 4, is_needed=True, color=color)
            continue
        for time, center, _ in discs:
            text = f'{time:g} s' if time else ', '.join(
                filter(None, (wrap_name(name), advantage, '0 s')))
            labels.add(text, center, np.pi, is_needed=True, color=color)


def wrap_name(name, text='', width=LEGEND_WIDTH):
    """Return a name and a text, wrapped for a legend `width` letters wide."""
    if len(name) > _NAME_LENGTH:  # The middle is cut out: long names differ at their ends.
        name = f'{name[:_NAME_LENGTH // 2 - 2]}...{name[2 - _NAME_LENGTH // 2:]}'
    return _escape('\n'.join(wrap(name + text, width)))


def _escape(text):
    """Escape dollars, which Matplotlib reads as formulas, and a first '_', which hides a label."""
    text = text.replace('$', r'\$')
    return f' {text}' if text.startswith('_') else text


def draw_ground(axes, scenario):
    """Draw receivers, discs, tracks, zones and fence, with entries for the legend and no texts."""
    for index, (node, name) in enumerate(zip(scenario.ground_nodes, node_labels(scenario))):
        axes.plot(*node.position, '^', **_marker_style(node_color(scenario, index), 10), zorder=6,
                  label=wrap_name(name))
    _draw_tracks(axes, scenario)
    for index, (eve, name, discs) in enumerate(zip(
            scenario.eavesdroppers, scenario.eavesdropper_names, shown_discs(scenario))):
        color = eavesdropper_color(index, eve)
        for _, center, radius in discs:
            axes.add_patch(Circle(center, radius, facecolor=color, alpha=0.25))
            axes.add_patch(Circle(center, radius, fill=False, edgecolor=color))
        style, label = _marker_style(color, 8), wrap_name(name)
        if eve.track is None:
            label = 'eavesdropper, disc' if eve.error_radius else 'eavesdropper'
        else:
            style['linestyle'] = _TRACK  # The legend then shows the line of the track.
        axes.plot(*eve.position, marker='X', **style, zorder=6, label=label)
    _draw_airspace(axes, scenario)


def _draw_tracks(axes, scenario):
    """Draw the track of each receiver that moves, with an arrow at its end."""
    for _, track, color in list_tracks(scenario, scenario.times):
        axes.plot(*track.T, color=color, linewidth=1.0, linestyle=_TRACK, zorder=2)
        before_end = np.flatnonzero((track != track[-1]).any(axis=1))[-1]
        axes.annotate('', track[-1], track[before_end], zorder=6,
                      arrowprops={'arrowstyle': '-|>', 'color': color})


def draw_ends(axes, index, start, goal):
    """Draw a UAV's start (circle) and goal (square), larger and further behind by its index."""
    for point, marker in ((start, 'o'), (goal, 's')):
        axes.plot(*point, marker, color='white', markeredgecolor=uav_color(index),
                  markeredgewidth=1.5, markersize=(0.7 + 0.4 * index) * rcParams['font.size'],
                  zorder=5 - 0.1 * index)


def _draw_airspace(axes, scenario):
    """Draw fence and zones with their margins; zones at other altitudes are not filled."""
    for ring in margin_rings(scenario):
        axes.add_patch(Polygon(ring, facecolor=MARGIN, edgecolor='none', zorder=0.4,
                               label=f'margin of {scenario.tracking_margin:g} m'))
    if scenario.geofence is not None:
        axes.add_patch(Polygon(scenario.geofence, **_FENCE, zorder=1, label='geofence'))
    for zone in scenario.no_fly_zones:
        style = _ZONE if is_obstacle(zone, scenario) else _ZONE_OVERFLOWN
        axes.add_patch(Polygon(zone.vertices, **style, zorder=1.5))


def power_level(powers, peak):
    """
    Return powers on the scale of the picture, 0 for 0 W and 1 for the peak power.

    The scale is logarithmic above LINEAR_SHARE of the peak power, because good plans jam with a
    hundredth of the transmit power.
    """
    return np.arcsinh(np.maximum(powers, 0.0) / (LINEAR_SHARE * peak)) / np.arcsinh(
        1 / LINEAR_SHARE)


def _marker_style(color, size):
    return {'color': color, 'markersize': size, 'markeredgecolor': 'white', 'linestyle': 'none'}


def _power_colors(index):
    """Return a colour map from a light tint (0 W) to a dark shade (peak) of a UAV's colour."""
    color = np.array(to_rgb(uav_color(index)))
    return LinearSegmentedColormap.from_list(f'uav{index}', [0.2 * color + 0.8, 0.75 * color])


def _line_width(level):
    return 1.5 + 5.5 * level


def set_up_map(axes, extent):
    """Set limits, labels and equal scales of a map with north up."""
    axes.set(xlabel='east (m)', ylabel='north (m)', aspect='equal', anchor='W',
             xlim=extent[:, 0], ylim=extent[:, 1])
    style_axes(axes)


def _is_on_map(axes, place):
    return all(low <= value <= high for value, (low, high) in zip(
        place, (axes.get_xlim(), axes.get_ylim())))


def _label_times(axes, labels, plan, baseline_paths):
    """
    Mark round times along the UAVs' paths, and write the times beside them.

    Marks nearer than _NEAR_MARKS to the first mark of a group share the label 'first–last s',
    which is always written. A label of a single time is left out if there is no free room. Labels
    cover `baseline_paths` only if no other room is free.
    """
    times = plan.times
    marks = _TIME_MARKS.tick_values(0.0, times[-1])[1:]
    marks = marks[marks < times[-1] - marks[0] / 3]  # A later mark would be beside the goal.
    intervals = []
    for index, points in enumerate(plan.positions):
        # Places (M, 2) of the marks, and the places one slot before and after each mark.
        before, places, after = (np.stack([
            np.interp(marks + shift, times, points[:, axis]) for axis in (0, 1)], axis=-1)
            for shift in (-times[1], 0.0, times[1]))
        axes.plot(*places.T, 'o', color='white', markeredgecolor=uav_color(index), markersize=3.5,
                  linestyle='none', zorder=7)
        for first, last in _group_marks(places, _NEAR_MARKS * point_size(axes)):
            middle = (first + last) // 2
            x, y = after[middle] - before[middle]
            left = np.arctan2(x, -y)  # Direction to the left of the motion [rad].
            intervals.append(
                (last - first, index, marks[first], marks[last], places[middle], left))
    intervals.sort(key=lambda interval: -interval[0])  # The longest is written first.
    for length, index, begin, end, place, left in intervals:
        labels.add(f'{begin:g}–{end:g} s' if length else f'{begin:g} s', place, left,
                   baseline_paths, is_needed=length > 0, color=uav_color(index))


def _group_marks(places, distance):
    """Return (first, last) index of each run of places nearer than `distance` to its first one."""
    groups, first = [], 0
    for last in range(len(places)):
        if last + 1 == len(places) or np.hypot(*(places[last + 1] - places[first])) >= distance:
            groups.append((first, last))
            first = last + 1
    return groups


def add_map_legend(axes, uav_entries, **options):
    """Draw a map's legend: `uav_entries` (artists by label), start, goal, labelled artists."""
    entries = {**uav_entries, **{
        name: Line2D([], [], marker=marker, color='white', markeredgecolor='0.2')
        for name, marker in (('start', 'o'), ('goal', 's'))}}
    for artist, label in zip(*axes.get_legend_handles_labels()):
        entries.setdefault(label, artist)
    add_legend(axes, list(entries.values()), list(entries), **{
        'handlelength': 3, 'handler_map': {tuple: HandlerTuple(ndivide=None, pad=0)}, **options})
