"""Nearest points of small convex hulls and convex polygons, for many at once."""

import numpy as np

from ..scenario import Array


def dot(one: Array, other: Array) -> Array:
    """Return the products of vectors (..., 2), faster than a sum over so short an axis."""
    found: Array = one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1]
    return found


def nearest_of_hulls(places: Array) -> Array:
    """
    Return the point of each convex hull that is nearest to the origin, (..., 2).

    A triangle that contains the origin has the nearest one of its boundary instead.

    :param places: the vertices of lines or triangles, (..., K, 2), K 2 or 3.
    """
    begin = places[..., [0] if places.shape[-2] == 2 else [0, 1, 2], :]
    end = places[..., [1] if places.shape[-2] == 2 else [1, 2, 0], :]
    along = end - begin
    square = np.maximum(dot(along, along), 1e-300)
    share = np.clip(-dot(begin, along) / square, 0.0, 1.0)
    found = begin + share[..., None] * along
    best = dot(found, found).argmin(axis=-1)
    nearest: Array = np.take_along_axis(found, best[..., None, None], axis=-2)[..., 0, :]
    return nearest


def separating_lines(places: Array, polygons: Array) -> tuple[Array, Array]:
    """
    Return a line between each convex hull and its convex polygon, normal . place = offset.

    It touches the polygon, and of all lines that do it leaves the hull farthest on the other
    side: the normal is that between the nearest points. Where they overlap, it is the line
    beyond which the hull must be moved least.

    :param places: the vertices of the hulls, lines or triangles, (M, K, 2), K 2 or 3.
    :param polygons: their vertices, counter-clockwise, (M, V, 2); the last may be repeated.
    :return: normals, unit vectors away from the polygons, (M, 2), and offsets, (M,).
    """
    to_edges = _to_edges(places, polygons)
    from_edges = -_to_edges(polygons, places if places.shape[1] == 3 else places[:, :2])
    found = np.concatenate([to_edges, from_edges], axis=1)
    square = dot(found, found)
    best = square.argmin(axis=1)
    rows = np.arange(len(found))
    normals = found[rows, best] / np.sqrt(np.maximum(square[rows, best], 1e-300))[:, None]
    offsets = _support(polygons, normals)
    least = (places @ normals[..., None])[..., 0].min(axis=1) - offsets
    near = np.flatnonzero(~(least > _TOUCHING))
    if len(near):
        normals[near], offsets[near] = _least_shift(places[near], polygons[near])
    return normals, offsets


_TOUCHING = 1e-9  # In units; nearer than this, a difference of places has no direction.


def _to_edges(places: Array, polygons: Array) -> Array:
    """Return the vectors from all edges of polygons to all places, (M, V * K, 2)."""
    begin = polygons[:, :, None]
    along = np.roll(polygons, -1, axis=1)[:, :, None] - begin
    to = places[:, None] - begin
    square = np.maximum(dot(along, along), 1e-300)
    share = np.clip(dot(to, along) / square, 0.0, 1.0)
    found = to - share[..., None] * along
    return found.reshape(len(places), polygons.shape[1] * places.shape[1], 2)


def _support(polygons: Array, normals: Array) -> Array:
    """Return how far polygons reach in directions (M, 2), (M,)."""
    found: Array = (polygons @ normals[..., None])[..., 0].max(axis=1)
    return found


def _least_shift(places: Array, polygons: Array) -> tuple[Array, Array]:
    """Return the best of the lines along edges of the polygons and hulls, as above."""
    candidates = [np.roll(polygons, -1, axis=1) - polygons]
    edges = np.roll(places, -1, axis=1) - places
    candidates += [edges, -edges]
    along = np.concatenate(candidates, axis=1)
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1) / np.maximum(length, 1e-300)
    offsets = np.einsum('mvc,mec->mev', polygons, normals).max(axis=-1)
    least = np.einsum('mkc,mec->mek', places, normals).min(axis=-1) - offsets
    least[length[..., 0] <= 1e-12] = -np.inf
    best = least.argmax(axis=1)
    rows = np.arange(len(best))
    return normals[rows, best], offsets[rows, best]
