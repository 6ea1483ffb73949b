"""Simple polygons in the plane: their check, convex parts, offset, and the depth of points."""

from collections.abc import Sequence
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
import shapely

from .fields import check_items, checked_point, Point, refuse
from .validation import Array, is_sequence, read_only
from ..errors import quote, ScenarioError

Vertices: TypeAlias = tuple[Point, ...]

MAX_VERTICES = 256
"""Largest number of vertices of a polygon."""

# Distance [m] up to which the last vertex repeats the first: degrees are rounded to 1e-6 m.
_CLOSING = 1.5e-6
_THINNEST = 1e-9  # Ratio area / perimeter^2 up to which a polygon has no area.
_MITRE_LIMIT = 1.5  # Distance in margins at which a sharp corner of an offset is cut off.
_OFFSET_TOLERANCE = 1e-7  # Distance [m] by which an offset may miss its margin.
_ROUNDING = 1e-12  # Ratio 2 * triangle's area / polygon's size^2 that is rounding.


def checked_polygon(values: Any) -> Vertices:
    """
    Return the vertices of a simple polygon, in either order, as a tuple of points.

    A last vertex within _CLOSING of the first is left out: files close their rings.

    :raises ScenarioError: for fewer than 3 or over MAX_VERTICES vertices, a wrong coordinate, an
        outline that crosses or touches itself, or vertices on one line.
    """
    if not is_sequence(values):
        raise refuse(values, 'a list of vertices (x, y) in m')
    if len(values) > MAX_VERTICES + 1:
        raise _too_many(values)
    vertices = check_items(values, checked_point)
    while len(vertices) > 3 and math.dist(vertices[0], vertices[-1]) <= _CLOSING:
        vertices = vertices[:-1]
    if len(vertices) > MAX_VERTICES:
        raise _too_many(vertices)
    if len(set(vertices)) < 3:
        raise refuse(vertices, 'a list of at least three different vertices')
    ring = shapely.Polygon(vertices)
    if ring.convex_hull.area <= _THINNEST * ring.length**2:
        raise ScenarioError(f'is {quote(vertices)}, which has no area; its vertices must not lie '
                            'on one line', subject=())
    if not ring.is_valid:
        place = shapely.is_valid_reason(ring).partition('[')[2].rstrip(']').replace(' ', ', ')
        raise ScenarioError(f'is {quote(vertices)}, whose outline crosses or touches itself near '
                            f'({place}); it must not', subject=())
    return vertices


def _too_many(vertices: Sequence[Any]) -> ScenarioError:
    return ScenarioError(
        f'has {len(vertices)} vertices; it must have at most {MAX_VERTICES}', subject=())


def convex_parts(vertices: Vertices) -> tuple[Array, ...]:
    """
    Partition a simple polygon into convex ones, each (K, 2), counter-clockwise.

    The number of parts is at most four times the necessary one (Hertel and Mehlhorn, "Fast
    triangulation of simple polygons", 1983).
    """
    corners = _orient_corners(vertices)
    parts, diagonals = _cut_ears(corners)
    for first, second in diagonals:
        # The two parts with the diagonal as an edge, one on each side of the diagonal.
        left = next((part for part in parts if _has_edge(part, first, second)), None)
        right = next((part for part in parts if _has_edge(part, second, first)), None)
        if left is None or right is None:
            continue
        begin, end = left.index(second), right.index(first)
        merged = left[begin:] + left[:begin] + (right[end:] + right[:end])[1:-1]
        if _cross_products(corners[merged]).min() >= -_area_tolerance(corners):
            parts = [part for part in parts if part not in (left, right)] + [merged]
    return tuple(read_only(corners[part]) for part in parts)


def pockets(vertices: Vertices) -> tuple[Vertices, ...]:
    """Return the polygons between the outline of a polygon and its convex hull."""
    polygon = shapely.Polygon(vertices)
    return _outlines(polygon.convex_hull.difference(polygon))


def offset_polygon(vertices: Vertices, margin: float) -> tuple[Vertices, ...]:
    """
    Offset a polygon outwards by a margin in m, or inwards by a negative one.

    An outward offset is one polygon with all places within the margin. Its corners are mitred: a
    corner of 90 degrees is 1.42 margins away from the polygon, and no corner more than 1.81.
    Holes that the offset encloses are filled. An inward offset keeps the margin from the outline;
    it may be several polygons, or none.
    """
    if abs(margin) <= _OFFSET_TOLERANCE:
        return (vertices,)  # Shapely's buffer is empty for widths below rounding.
    polygon, width = shapely.Polygon(vertices), margin
    while True:
        shape = polygon.buffer(width, join_style='mitre', mitre_limit=_MITRE_LIMIT)
        # Shapely's buffer leaves out small bends, and may be nearer than the margin there.
        missing = abs(margin) - shapely.distance(shape.boundary, polygon.boundary)
        if shape.is_empty or missing <= _OFFSET_TOLERANCE:
            break
        width += math.copysign(missing, margin)
    return _outlines(shape)


def _outlines(shape: Any) -> tuple[Vertices, ...]:
    """Return the outlines of a shape's polygons; polygons without an area are left out."""
    return tuple(
        tuple((x, y) for x, y in part.exterior.coords[:-1]) for part in shapely.get_parts(shape)
        if part.geom_type == 'Polygon' and part.area > _THINNEST * part.length**2)


def half_planes(vertices: Vertices) -> tuple[Array, Array]:
    """Return the convex hull as n.x <= b of K edges: outward unit normals n (K, 2), b (K,) [m]."""
    corners = _orient_corners(tuple(
        (x, y) for x, y in shapely.Polygon(vertices).convex_hull.exterior.coords[:-1]))
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return read_only(normals), read_only((normals * corners).sum(axis=1))


def depth(vertices: Vertices, points: ArrayLike) -> Array:
    """Return the distance in m of points (..., 2) from the outline, negative outside, (...)."""
    polygon, places = shapely.Polygon(vertices), shapely.points(points)
    distance = shapely.distance(polygon.exterior, places)
    return np.where(shapely.contains(polygon, places), distance, -distance)


def _orient_corners(vertices: Vertices) -> Array:
    """Return the vertices counter-clockwise, (K, 2), without vertices on a straight edge."""
    corners = np.array(vertices)
    x, y = (corners - corners[0]).T
    if x @ np.roll(y, -1) < y @ np.roll(x, -1):
        corners = corners[::-1]
    while len(corners) > 3:
        flat = np.abs(_cross_products(corners)) <= _area_tolerance(corners)
        if not flat.any():
            break
        corners = np.delete(corners, flat.argmax(), axis=0)
    return corners


def _cross_products(corners: Array) -> Array:
    """Return the cross product of the two edges at each vertex, positive where it is convex."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    return np.asarray(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])


def _area_tolerance(corners: Array) -> float:
    return float(_ROUNDING * np.ptp(corners, axis=0).max()**2)


def _cut_ears(corners: Array) -> tuple[list[list[int]], list[tuple[int, int]]]:
    """
    Return triangles of counter-clockwise corners (K, 2), and diagonals between them, as indices.

    An ear is a convex corner with both neighbours, if no reflex corner lies in this triangle. Ears
    are cut off one by one, each along a diagonal (corner before, corner after).
    """
    indices, tolerance = list(range(len(corners))), _area_tolerance(corners)
    triangles, diagonals = [], []
    while len(indices) > 3:
        products = _cross_products(corners[indices])
        reflex = corners[indices][products <= tolerance]
        for corner in np.flatnonzero(products > tolerance).tolist():
            ear = [indices[corner - 1], indices[corner], indices[(corner + 1) % len(indices)]]
            if not _contains_any(corners[ear], reflex, tolerance):
                triangles.append(ear)
                diagonals.append((ear[0], ear[2]))
                break
        else:  # Rounding hides every ear: the triangle of least area is left out.
            corner = int(np.abs(products).argmin())
        del indices[corner]
    return [*triangles, indices], diagonals


def _contains_any(triangle: Array, points: Array, tolerance: float) -> bool:
    """Return True if a point other than the corners is in or on a counter-clockwise triangle."""
    edges = np.roll(triangle, -1, axis=0) - triangle
    offsets = points[:, None] - triangle
    inside = (edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
              >= -tolerance).all(axis=1)
    corner = (offsets == 0).all(axis=2).any(axis=1)
    return bool((inside & ~corner).any())


def _has_edge(part: list[int], first: int, second: int) -> bool:
    """Return True if the second index follows the first in a part."""
    return first in part and part[(part.index(first) + 1) % len(part)] == second
