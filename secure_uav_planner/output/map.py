"""The map of a plan: airspace, receivers, and paths by power and time."""

from itertools import product
from textwrap import wrap

from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
import numpy as np
import shapely

from .drawing import (
    add_legend, altitude_label, eavesdropper_color, GEOFENCE, is_obstacle, label_position,
    list_tracks, MARGIN, margin_rings, NO_FLY_ZONE, node_color, node_labels, receiver_label,
    shown_discs, style_axes, uav_color)

LEGEND_WIDTH, _NAME_LENGTH = 18, 36  # In characters.
LINEAR_SHARE = 1e-3  # Of the peak power, below which the scale of powers is linear.
_TIME_MARKS = MaxNLocator(12, steps=(1, 2, 5, 10))
_FONT_SIZE = 8.0  # In points, of texts on the map.
_GAPS = 5.0, 10.0  # In points, from a path to its labels.
_LABEL_ANGLES = np.radians((0, 180, 40, -40, 140, -140, 65, -65, 115, -115))
GREY = '0.45'
_ZONE = {'facecolor': '0.87', 'edgecolor': NO_FLY_ZONE, 'linewidth': 1.2, 'label': 'no-fly zone'}
_ZONE_OVERFLOWN = {**_ZONE, 'facecolor': 'none', 'linestyle': ':',
                   'label': 'no-fly zone at\nother altitudes'}
_TRACK = (0, (4, 2))
_FENCE = {'fill': False, 'edgecolor': GEOFENCE, 'linestyle': (0, (6, 3)), 'linewidth': 1.2}
_HALO = [withStroke(linewidth=2.5, foreground='white')]  # Around texts on the map.


def draw_map(axes, plan, extent, baselines=(), legend=True, **options):
    """
    Draw the paths, wide and dark where the power is high, the ground node, discs, zones and fence.

    Baselines are grey.

    :param extent: the result of map_extent.
    :param legend: False for no legend.
    :param options: of the legend, which is at the right of the map by default.
    """
    scenario = plan.scenario
    set_up_map(axes, extent)
    baseline_paths = [path for baseline in baselines for path in baseline.positions]
    draw_ground(axes, scenario)
    for path in baseline_paths:
        axes.plot(*path.T, color=GREY, linewidth=0.9, zorder=1, label='baseline')
    peak = max(uav.peak_power for uav in scenario.uavs)
    point = _point_size(axes)
    occupied = [*(shapely.Polygon(zone.vertices) for zone in scenario.no_fly_zones),
                *(shapely.Point(center).buffer(max(radius, 5 * point))
                  for discs in shown_discs(scenario) for _, center, radius in discs),
                *(_find_box(axes, text) for text in axes.texts if text.get_text()),
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
        draw_ends(axes, index, points[0], points[-1])
        _label_times(axes, plan.times, points, uav_color(index), occupied,
                     [shapely.LineString(path) for path in baseline_paths])
    if legend:
        levels = np.linspace(0, 1, 9)
        add_map_legend(axes, {
            uav_label(uav, f', 0 to {peak:g} W'): tuple(
                Line2D([], [], color=_power_colors(index)(level), linewidth=_line_width(level),
                       solid_capstyle='butt') for level in levels)
            for index, uav in enumerate(scenario.uavs)}, **options)


def uav_label(uav, text):
    """Return the name of a UAV and a text, wrapped for the legend."""
    name = uav.name
    if len(name) > _NAME_LENGTH:  # Without its middle, as the ends of names tell them apart.
        name = f'{name[:_NAME_LENGTH // 2 - 2]}...{name[2 - _NAME_LENGTH // 2:]}'
    return _escape('\n'.join(wrap(name + text, LEGEND_WIDTH)))


def _escape(text):
    """Escape the dollars of a text, which are formulas to Matplotlib, and a '_' that hides it."""
    text = text.replace('$', r'\$')
    return f' {text}' if text.startswith('_') else text


def draw_ground(axes, scenario):
    """Draw the ground nodes, eavesdroppers, zones and fence, with labels for the legend."""
    for index, (node, name) in enumerate(zip(scenario.ground_nodes, node_labels(scenario))):
        axes.plot(*node.position, '^', **_marker_style(node_color(scenario, index), 10), zorder=6,
                  label=_escape(name))
    _draw_tracks(axes, scenario)
    for index, (eve, name, discs) in enumerate(zip(
            scenario.eavesdroppers, scenario.eavesdropper_names, shown_discs(scenario))):
        color, name = eavesdropper_color(index, eve), _escape(name)
        for time, center, radius in discs:
            axes.add_patch(Circle(center, radius, facecolor=color, alpha=0.25))
            axes.add_patch(Circle(center, radius, fill=False, edgecolor=color))
            if eve.track is not None:
                axes.annotate(f'{time:g} s' if time else f'{name}, 0 s', center, (-10, 0),
                              textcoords='offset points', fontsize=_FONT_SIZE, ha='right',
                              va='center', color=color, zorder=8, path_effects=_HALO)
        style, label = _marker_style(color, 8), name
        if eve.track is None:
            label = 'eavesdropper, disc' if eve.error_radius else 'eavesdropper'
        else:
            style['linestyle'] = _TRACK  # In the legend.
        axes.plot(*eve.position, marker='X', **style, zorder=6, label=label)
        axes.annotate(receiver_label(eve), eve.position, (7, 7), textcoords='offset points',
                      fontsize=8, color=color, zorder=8, path_effects=_HALO)
    _draw_airspace(axes, scenario)


def _find_box(axes, text):
    """Return the box of a text on the map."""
    return shapely.box(*axes.transData.inverted().transform(text.get_window_extent()).ravel())


def _draw_tracks(axes, scenario):
    """Draw the tracks of receivers that move, with an arrow at the end."""
    for _, track, color in list_tracks(scenario, scenario.times):
        axes.plot(*track.T, color=color, linewidth=1.0, linestyle=_TRACK, zorder=2)
        moved = np.flatnonzero((track != track[-1]).any(axis=1))[-1]
        axes.annotate('', track[-1], track[moved], zorder=6,
                      arrowprops={'arrowstyle': '-|>', 'color': color})


def draw_ends(axes, index, start, goal):
    """Draw start and goal of a UAV, with a size by index: several may be at one point."""
    for point, marker in ((start, 'o'), (goal, 's')):
        axes.plot(*point, marker, color='white', markeredgecolor=uav_color(index),
                  markeredgewidth=1.5, markersize=7 + 4 * index, zorder=5 - 0.1 * index)


def _draw_airspace(axes, scenario):
    """Draw fence and zones with their margins; zones at other altitudes are not filled."""
    for ring in margin_rings(scenario):
        axes.add_patch(Polygon(ring, facecolor=MARGIN, edgecolor='none', zorder=0.4,
                               label=f'margin of {scenario.tracking_margin:g} m'))
    if scenario.geofence is not None:
        axes.add_patch(Polygon(scenario.geofence, **_FENCE, zorder=1, label='geofence'))
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
    groups = _group_marks(places, 17.0 * _point_size(axes))
    for first, last in sorted(groups, key=lambda group: group[0] - group[1]):  # Longest first.
        middle = (first + last) // 2
        text = f'{marks[first]:g} s' if first == last else f'{marks[first]:g}–{marks[last]:g} s'
        boxes = _list_free_boxes(
            axes, text, places[middle], after[middle] - before[middle], occupied)
        if boxes:
            box = min(boxes, key=lambda box: any(map(box.intersects, baseline_paths)))
            occupied.append(box)
            axes.annotate(text, box.centroid.coords[0], ha='center', va='center', color=color,
                          fontsize=_FONT_SIZE, zorder=8, path_effects=_HALO)


def _group_marks(places, least):
    """Return first and last index of successive places within a least distance of the first."""
    groups, first = [], 0
    for last in range(len(places)):
        if last + 1 == len(places) or np.hypot(*(places[last + 1] - places[first])) >= least:
            groups.append((first, last))
            first = last + 1
    return groups


def _list_free_boxes(axes, text, place, direction, occupied):
    """Return boxes of a text beside a place on a path, within the map and free, best first."""
    point = _point_size(axes)
    # An estimate, without drawing the text.
    size, (x, y) = np.array([0.62 * len(text), 1.0]) * _FONT_SIZE * point, direction
    inside = shapely.box(*np.transpose([axes.get_xlim(), axes.get_ylim()]).ravel())
    boxes = []
    for gap, angle in product(_GAPS, np.arctan2(x, -y) + _LABEL_ANGLES):
        aside = np.array([np.cos(angle), np.sin(angle)])
        center = place + aside * (gap * point + np.abs(aside) @ size / 2)
        box = shapely.box(*(center - size / 2), *(center + size / 2))
        if inside.contains(box) and not shapely.intersects(box, occupied).any():
            boxes.append(box)
    return boxes


def add_map_legend(axes, uav_entries, **options):
    """Explain the symbols of the map after the entries, artists by label, of the UAVs."""
    entries = {**uav_entries, **{
        name: Line2D([], [], marker=marker, color='white', markeredgecolor='0.2')
        for name, marker in (('start', 'o'), ('goal', 's'))}}
    for artist, label in zip(*axes.get_legend_handles_labels()):
        entries.setdefault(label, artist)
    add_legend(axes, list(entries.values()), list(entries), **{
        'handlelength': 3, 'handler_map': {tuple: HandlerTuple(ndivide=None, pad=0)}, **options})
