"""Distances to surfaces that are known by oriented points, as cracks are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from deepfracture.types import BadInput, Floats32, Grid

FAR = 4.0
"""Distance [m] that stands for "no surface at all": beyond the diagonal of the grid's box."""
SPACING_SAMPLES = 4096
"""Points whose nearest neighbour is looked up to learn how densely the surface is sampled."""


def distance_to_oriented_points(grid: Grid, points: ArrayLike, normals: ArrayLike) -> Floats32:
    """Unsigned distance [m] of every voxel centre to a surface sampled by oriented points, shape (r, r, r).

    The nearest point is found by vector propagation (Danielsson 1980, two rounds over 26 neighbours);
    the distance is then taken to the tangent disc of that point, whose radius is the sample spacing.
    Near the surface this is the distance to its plane, smooth and without the bias of the samples;
    past the rim of the surface it is the distance to the rim. FAR where there are no points.

    Args:
        grid: Voxels to fill.
        points: On the surface [m], body frame, shape (n, 3).
        normals: Unit normals at the points, either side, shape (n, 3).

    Raises:
        BadInput: points and normals are not both of shape (n, 3) and finite.
    """
    points, normals = np.ascontiguousarray(points, float), np.ascontiguousarray(normals, float)
    if points.ndim != 2 or points.shape[1] != 3 or points.shape != normals.shape:
        raise BadInput(f"points and normals must both be (n, 3), got {points.shape} and {normals.shape}")
    if not (np.isfinite(points).all() and np.isfinite(normals).all()):
        raise BadInput("points and normals must be finite, got NaN or infinite values")
    distance = np.full(grid.shape, FAR, np.float32)
    if len(points) == 0:
        return distance
    nearest = np.full(grid.shape, -1, np.int32)
    index = grid.to_index(points)
    _scatter(index, nearest)
    for _ in range(2):
        _propagate(index, nearest)
    radius = _spacing(points) / grid.spacing
    _disc_distance(index, normals, nearest, radius, grid.spacing, distance)
    return distance


def _spacing(points: np.ndarray) -> float:
    """Twice the median distance between neighbouring points: the radius that closes the gaps."""
    if len(points) == 1:
        return 0.0
    some = points[:: max(1, len(points) // SPACING_SAMPLES)]
    nearest, _ = KDTree(points).query(some, k=2)
    return 2 * float(np.median(nearest[:, 1]))


@njit(cache=True)
def _scatter(index: np.ndarray, nearest: np.ndarray) -> None:
    """Give every voxel around a point the point if it is the nearest so far."""
    r = nearest.shape[0]
    for p in range(len(index)):
        base = np.empty(3, np.int64)
        for a in range(3):
            base[a] = min(max(int(np.rint(index[p, a])), 0), r - 1)
        for i in range(max(base[0] - 1, 0), min(base[0] + 2, r)):
            for j in range(max(base[1] - 1, 0), min(base[1] + 2, r)):
                for k in range(max(base[2] - 1, 0), min(base[2] + 2, r)):
                    _update(index, nearest, i, j, k, p)


@njit(cache=True, inline="always")
def _squared(index: np.ndarray, p: int, i: int, j: int, k: int) -> float:
    return (index[p, 0] - i) ** 2 + (index[p, 1] - j) ** 2 + (index[p, 2] - k) ** 2


@njit(cache=True, inline="always")
def _update(index: np.ndarray, nearest: np.ndarray, i: int, j: int, k: int, p: int) -> None:
    have = nearest[i, j, k]
    if have < 0 or (have != p and _squared(index, p, i, j, k) < _squared(index, have, i, j, k)):
        nearest[i, j, k] = p


@njit(cache=True)
def _propagate(index: np.ndarray, nearest: np.ndarray) -> None:
    """One raster pass forward and one backward: each voxel asks the 13 neighbours already seen."""
    r = nearest.shape[0]
    # A border of voxels that know nothing spares the bounds checks; neighbours are offsets in the flat array.
    side = r + 2
    known = np.full((side, side, side), -1, np.int32)
    known[1:-1, 1:-1, 1:-1] = nearest
    near: Any = known.ravel()
    squared = np.full(near.size, np.inf, np.float32)
    steps = np.empty(13, np.int64)
    for n in range(13):
        steps[n] = ((n // 9 - 1) * side + n // 3 % 3 - 1) * side + n % 3 - 1
    for step in (1, -1):
        start = 0 if step == 1 else r - 1
        for ii in range(r):
            i = start + step * ii
            for jj in range(r):
                j = start + step * jj
                for kk in range(r):
                    k = start + step * kk
                    here = ((i + 1) * side + j + 1) * side + k + 1
                    best = near[here]
                    least = squared[here]
                    if best >= 0 and least == np.inf:
                        least = _squared(index, best, i, j, k)
                    tried = best
                    for n in range(13):
                        p = near[here + step * steps[n]]
                        if p in (tried, best) or p < 0:  # nothing to learn where one point is nearest
                            continue
                        tried = p
                        away = _squared(index, p, i, j, k)
                        if away < least:
                            best, least = p, away
                    near[here] = best
                    squared[here] = least
    nearest[:] = known[1:-1, 1:-1, 1:-1]


@njit(cache=True)
def _disc_distance(
    index: np.ndarray,
    normals: np.ndarray,
    nearest: np.ndarray,
    radius: float,
    spacing: float,
    out: np.ndarray,
) -> None:
    r = nearest.shape[0]
    for i in range(r):
        for j in range(r):
            for k in range(r):
                p = nearest[i, j, k]
                x, y, z = i - index[p, 0], j - index[p, 1], k - index[p, 2]
                along = x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2]
                across = np.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
                out[i, j, k] = spacing * np.sqrt(along * along + max(across - radius, 0.0) ** 2)
