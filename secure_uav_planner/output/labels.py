"""Texts on a map, each beside the place that it names, without covering anything else."""

from itertools import product

from matplotlib.patheffects import withStroke
import numpy as np
import shapely

HALO = [withStroke(linewidth=2.5, foreground='white')]  # White rim of texts on the map.
FONT_SIZE = 8.0  # Font size of texts on the map [points].
_GAPS = 5.0, 10.0  # Gaps between a place and its text [points], best first.
_FAR_GAPS = 18.0, 28.0, 40.0, 60.0  # Gaps [points] of a needed text, with a line to its place.
_PADDING = 1.5  # Gap between two texts [points].
# Directions from a place to its text [rad], relative to the preferred direction, best first.
_ANGLES = np.radians((0, 180, 40, -40, 140, -140, 65, -65, 115, -115))


class MapLabels:
    """
    The texts of a map, whose size and limits are final.

    :ivar occupied: list of shapes of shapely in m that no text covers; each new text is added.
    """

    def __init__(self, axes, occupied):
        self._axes, self.occupied = axes, occupied
        self._point = point_size(axes)
        self._inside = shapely.box(*np.transpose([axes.get_xlim(), axes.get_ylim()]).ravel())

    def add(self, text, place, direction=0.0, avoid=(), is_needed=False, **style):
        """
        Write a text beside a place; without room in the map, only if `is_needed`.

        :param place: (2,) in m.
        :param direction: direction from the place that is tried first, in rad from the east.
        :param avoid: shapes that the text should not cover if possible.
        :param is_needed: True for a text that may be far away, with a line to its place, or lie
            above something else.
        """
        artist = self._write(text, place, **style)
        size = self._measure(artist)
        boxes = [box for box in self._list_boxes(size, place, direction, _GAPS)
                 if self._is_free(box)]
        is_far = not boxes and is_needed
        if is_far:
            candidates = list(self._list_boxes(size, place, direction, _GAPS + _FAR_GAPS))
            boxes = [box for box in candidates if self._is_free(box)][:1] or [
                min(candidates, key=self._measure_overlap)] if candidates else []
        if not boxes:
            if is_needed:  # The map is smaller than the text.
                self.keep_inside(artist)
            else:
                artist.remove()
            return
        self._settle(artist, min(boxes, key=lambda box: any(map(box.intersects, avoid))))
        if is_far:
            line = shapely.shortest_line(shapely.Point(place), self.occupied[-1])
            self._axes.plot(*line.xy, color=artist.get_color(), linewidth=0.6, zorder=7.5)

    def add_into(self, polygon, text, place, **style):
        """Write a text at a place (2,) if it fits into a polygon, otherwise beside the place."""
        artist = self._write(text, place, **style)
        half = self._measure(artist) / 2
        box = shapely.box(*(place - half), *(place + half))
        # A text fits if it is in the map and its box juts out of the polygon by at most 3 pt.
        if self._inside.contains(box) and polygon.buffer(3 * self._point).contains(box):
            self._settle(artist, box)
        else:
            artist.remove()
            self.add(text, place, np.pi / 2, is_needed=True, **style)

    def keep_inside(self, artist):
        """Move a text by the least distance that brings it into the map."""
        low, high = np.reshape(self._inside.bounds, (2, 2))
        half = np.minimum(self._measure(artist), high - low) / 2
        center = np.clip(artist.get_position(), low + half, high - half)
        self._settle(artist, shapely.box(*(center - half), *(center + half)))

    def _write(self, text, place, **style):
        return self._axes.text(*place, text, **{
            'ha': 'center', 'va': 'center', 'fontsize': FONT_SIZE, 'zorder': 8,
            'path_effects': HALO, **style})

    def _settle(self, artist, box):
        artist.set_position(box.centroid.coords[0])
        self.occupied.append(box.buffer(_PADDING * self._point, join_style='mitre'))

    def _measure(self, artist):
        """Return width and height of a text in m."""
        extent = artist.get_window_extent()
        return np.array(extent.size) / self._axes.figure.dpi * 72.0 * self._point

    def _list_boxes(self, size, place, direction, gaps):
        """Yield boxes of a size (2,) [m] in the map at gaps [points] from a place, best first."""
        for gap, angle in product(gaps, direction + _ANGLES):
            ray = np.array([np.cos(angle), np.sin(angle)])
            center = place + ray * (gap * self._point + np.abs(ray) @ size / 2)
            box = shapely.box(*(center - size / 2), *(center + size / 2))
            if self._inside.contains(box):
                yield box

    def _is_free(self, box):
        return not shapely.intersects(box, self.occupied).any()

    def _measure_overlap(self, box):
        return shapely.area(shapely.intersection(box, self.occupied)).sum()


def point_size(axes):
    """Return the length in m of a typographic point on a map."""
    return np.ptp(axes.get_xlim()) / axes.bbox.width * axes.figure.dpi / 72.0
