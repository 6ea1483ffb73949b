"""
The layout of a picture: places of map, charts and legends by their measured sizes, in inches.

Matplotlib's constrained layout is not used: it cuts off legends beside axes of equal aspect.
"""

from collections.abc import Callable
from typing import NamedTuple

from matplotlib.axes import Axes
import numpy as np

_EDGE, _GAP, _PART_GAP = 0.12, 0.08, 0.25
_MOST_HEIGHT = 9.0  # Largest height of a figure: the text of a page is as high.
_LEAST_BESIDE = 6.0  # Least width of a figure with charts beside the map.
_FLATTEST_BESIDE = 0.5  # Least height / width of a map with charts beside it.
_MOST_MAP = 0.5  # Largest height of a map beside charts, in widths of the figure.
_MAP_SHARE = 0.5  # Largest width of a map and its axis beside charts, in widths of the figure.
_LEGEND_SHARE = 0.28  # Room for the legend of a map beside charts, in widths of the figure.
_LEAST_CHART = 0.95  # Least height of a chart.
_CHART_SHARE = 0.15  # Height of a chart below a map, in widths of the figure.
_LEAST_MAP_SHARE = 0.75  # Least share of a map's width that is left beside a legend.
_SINGLE_MAP = 5.95, 5.6  # Largest width and height of a map without charts.


class Part(NamedTuple):
    """Axes, and a function that makes their legend from options such as `ncols`."""

    axes: Axes
    add_legend: Callable[..., None]

    def fit_legend(self, room):
        """Make the legend with 4 columns, or fewer to fit `room`; return its size [inches]."""
        for columns in (4, 3, 2, 1):
            self.add_legend(loc='upper left', borderaxespad=0, borderpad=0, ncols=columns)
            size = self._measure(self.axes.get_legend())
            if size[0] <= room:
                break
        return size

    def measure_margins(self):
        """Return the room of numbers and names at the axes: left, below, right, (3,) in inches."""
        (x0, y0), (x1, _) = self.axes.get_window_extent().get_points()
        boxes = [box for axis in (self.axes.xaxis, self.axes.yaxis)
                 if (box := axis.get_tightbbox()) is not None]
        return np.maximum(0.0, [
            x0 - min(box.x0 for box in boxes), y0 - min(box.y0 for box in boxes),
            max(box.x1 for box in boxes) - x1]) / self.axes.figure.dpi

    def settle(self, box, corner):
        """Put the axes into a box (x, y, width, height), the legend's upper left at `corner`."""
        figure = self.axes.figure
        self.axes.set_position(np.array(box) / np.tile(figure.get_size_inches(), 2))
        self.axes.get_legend().set_bbox_to_anchor(corner, figure.dpi_scale_trans)

    def _measure(self, artist):
        return np.array(artist.get_window_extent().size) / self.axes.figure.dpi


def lay_out_sheet(figure, parts, title, title_size):
    """
    Place a map and two charts with their legends in a figure, whose width stays.

    The charts are beside the map if the figure is wide enough and the map is not flat, else below.

    :param parts: the Part of the map, of the powers and of the rates.
    :param title: lines of text above the parts.
    :param title_size: font size of the title in points.
    """
    width = figure.get_figwidth()
    sides = _map_sides(parts[0].axes)
    top = _EDGE + 1.4 * title_size / 72.0 * len(title) + (_GAP if title else 0.0)
    is_beside = width >= _LEAST_BESIDE and sides[1] >= _FLATTEST_BESIDE * sides[0]
    place = _place_beside if is_beside else _place_below
    for _ in range(2):  # The numbers at axes change with the size of the axes.
        height, places = place(parts, width, sides, top)
        figure.set_figheight(height)
        for part, (box, corner) in zip(parts, places):
            part.settle(box, corner)
    if title:
        figure.text(_EDGE / width, 1 - _EDGE / height, '\n'.join(title), fontsize=title_size,
                    va='top')


def lay_out_map(part):
    """Place a map of at most _SINGLE_MAP with its legend at the right; fit the figure to both."""
    figure, sides = part.axes.figure, _map_sides(part.axes)
    width, height = sides * (np.array(_SINGLE_MAP) / sides).min()
    for _ in range(2):  # The numbers at the axes change with the size of the axes.
        left, bottom, _ = part.measure_margins()
        legend = part.fit_legend(0.0)
        total = _EDGE + max(height + bottom, legend[1]) + _EDGE
        figure.set_size_inches(_EDGE + left + width + 2 * _GAP + legend[0] + _EDGE, total)
        part.settle((_EDGE + left, total - _EDGE - height, width, height),
                    (_EDGE + left + width + 2 * _GAP, total - _EDGE - max(
                        0.0, (height - legend[1]) / 2)))


def _place_beside(parts, width, sides, top):
    """
    Return a figure's height, and (box, legend's corner) of each part, charts beside the map.

    The legend of the map is below the map. A box is (x, y, width, height) of axes, a corner the
    (x, y) of a legend's upper left, both from the lower left of the figure.

    :param width: width of the figure; all lengths are in inches.
    :param sides: width and height of the map in m.
    :param top: height of the title and the edge above the parts.
    """
    map_part, *charts = parts
    left, bottom, right = map_part.measure_margins()
    chart_left, chart_bottom, chart_right = _join_margins(charts)
    map_size = _fit_map(sides, _MAP_SHARE * width - left, _MOST_MAP * width)
    legend = map_part.fit_legend(max(left + map_size[0], _LEGEND_SHARE * width))
    chart_x = _EDGE + max(left + map_size[0] + right, legend[0]) + _PART_GAP + chart_left
    chart_width = width - chart_x - chart_right - _EDGE
    legends = [part.fit_legend(chart_width) for part in charts]
    # Height of the right column without its two charts, and height of the higher column.
    without_charts = sum(size[1] for size in legends) + 3 * _GAP + chart_bottom
    body_height = max(map_size[1] + bottom + _GAP + legend[1], 2 * _LEAST_CHART + without_charts)
    height = top + body_height + _EDGE
    map_y = height - top - map_size[1]
    places = [((_EDGE + left, map_y, *map_size), (_EDGE, map_y - bottom - _GAP))]
    return height, places + _stack_charts(
        legends, chart_x, height - top, chart_width, (body_height - without_charts) / 2)


def _place_below(parts, width, sides, top):
    """
    Return a figure's height, and (box, legend's corner) of each part, charts below the map.

    The legend of the map is at its right if that leaves the map wide enough, otherwise below it. A
    box is (x, y, width, height) of axes, a corner the (x, y) of a legend's upper left, both from
    the lower left of the figure.

    :param width: width of the figure; all lengths are in inches.
    :param sides: width and height of the map in m.
    :param top: height of the title and the edge above the parts.
    """
    map_part, *charts = parts
    left, _, right = _join_margins(parts)
    bottom, chart_bottom = map_part.measure_margins()[1], charts[-1].measure_margins()[1]
    room = width - 2 * _EDGE - left - right
    chart_height = max(_LEAST_CHART, _CHART_SHARE * width)
    legends = [part.fit_legend(room) for part in charts]
    charts_height = (_PART_GAP + sum(size[1] for size in legends) + 3 * _GAP + 2 * chart_height
                     + chart_bottom)
    most_height = min(0.97 * width, _MOST_HEIGHT - top - bottom - charts_height - _EDGE)
    legend = map_part.fit_legend(0.0)
    map_room = room - 2 * _GAP - legend[0]
    if map_room >= _LEAST_MAP_SHARE * min(room, most_height * sides[0] / sides[1]):
        map_size = _fit_map(sides, map_room, most_height)
        map_height = max(map_size[1] + bottom, legend[1])
        # Offset of the legend's corner: from _EDGE to the right, and down from the top of the map.
        offset = left + map_size[0] + 2 * _GAP, max(0.0, (map_size[1] - legend[1]) / 2)
    else:
        legend = map_part.fit_legend(left + room)
        map_size = _fit_map(sides, room, min(
            most_height, _MOST_HEIGHT - top - bottom - charts_height - 2 * _GAP - legend[1]))
        map_height = map_size[1] + bottom + _GAP + legend[1]
        offset = 0.0, map_size[1] + bottom + _GAP
    map_top = map_height + charts_height + _EDGE
    places = [((_EDGE + left, map_top - map_size[1], *map_size),
               (_EDGE + offset[0], map_top - offset[1]))]
    return top + map_top, places + _stack_charts(
        legends, _EDGE + left, map_top - map_height - _PART_GAP, room, chart_height)


def _fit_map(sides, width, height):
    """Return the largest (width, height) of a map with given sides in m, within both limits."""
    map_width = min(width, height * sides[0] / sides[1])
    return map_width, map_width * sides[1] / sides[0]


def _stack_charts(legends, x, y, width, height):
    """Return (box, legend's corner) of charts stacked down from (x, y), each under its legend."""
    places = []
    for size in legends:
        corner = x, y
        y -= size[1] + _GAP + height
        places.append(((x, y, width, height), corner))
        y -= _GAP
    return places


def _join_margins(parts):
    return np.max([part.measure_margins() for part in parts], axis=0)


def _map_sides(axes):
    return np.ptp([axes.get_xlim(), axes.get_ylim()], axis=1)
