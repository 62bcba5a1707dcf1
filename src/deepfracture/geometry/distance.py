"""Signed distance from a closed mesh, on lattices and at points: + inside, - outside. Exact.

Distances are to the nearest triangle, found in a box tree whose search starts from the
neighbouring voxel's answer. Signs count signed crossings of a ray along z with rules by which
triangles that share an edge agree about it, so rays through edges and vertices need no care.
Overlapping parts count as inside (winding number above zero)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from deepfracture.geometry.aabb_tree import (
    STACK,
    AABBTree,
    build_tree,
    nearest_triangle,
    offset_from_triangle,
    segment_height,
    slice_triangle,
    winding_number,
)
from deepfracture.types import BadInput, Floats, Floats32, Grid, Ints, Mesh

Mask = NDArray[np.bool_]


class ClosestPoints(NamedTuple):
    """The points of a mesh's surface nearest to queries."""

    points: Floats
    """Shape (n, 3)."""
    faces: Ints
    """The triangle each lies in, shape (n,)."""
    distance: Floats
    """Unsigned distance [m], shape (n,)."""


@njit(cache=True, parallel=True)
def _fill_distances(
    tree: AABBTree, origin: Floats, step: Floats, inside: Mask, limit: float, outside: float, values: Floats32
):  # pragma: no cover
    """Distances up to `limit` where `inside`, up to `outside` elsewhere."""
    nx, ny, nz = values.shape
    for i in prange(nx):
        stack = np.empty(STACK, np.int64)
        guess = 0
        for j in range(ny):
            for n in range(nz):
                # Back and forth, so that the last voxel is always a neighbour of this one.
                k = n if j % 2 == 0 else nz - 1 - n
                x, y, z = origin[0] + i * step[0], origin[1] + j * step[1], origin[2] + k * step[2]
                most = limit if inside[i, j, k] else outside
                guess, square = nearest_triangle(x, y, z, tree, guess, most * most, stack)
                values[i, j, k] = np.sqrt(square)


@njit(cache=True)
def _fill_winding(triangles: Floats, origin: Floats, step: Floats, turns):  # pragma: no cover
    """Winding number of each lattice point, from all crossings of each column along z."""
    nx, ny, nz = turns.shape
    for t in range(len(triangles)):
        low, high = np.inf, -np.inf
        for corner in range(3):
            low, high = min(low, triangles[t, corner, 1]), max(high, triangles[t, corner, 1])
        first = max(0, int(np.floor((low - origin[1]) / step[1])) - 1)
        last = min(ny - 1, int(np.ceil((high - origin[1]) / step[1])) + 1)
        for j in range(first, last + 1):
            there, x0, z0, x1, z1 = slice_triangle(triangles[t], origin[1] + j * step[1])
            if not there:
                continue
            left = max(0, int(np.floor((min(x0, x1) - origin[0]) / step[0])) - 1)
            right = min(nx - 1, int(np.ceil((max(x0, x1) - origin[0]) / step[0])) + 1)
            for i in range(left, right + 1):
                x = origin[0] + i * step[0]
                if (x0 < x) == (x1 < x):
                    continue
                z = segment_height(x0, z0, x1, z1, x)
                k = min(nz - 1, int(np.floor((z - origin[2]) / step[2])) + 1)
                while k >= 0 and origin[2] + k * step[2] >= z:
                    k -= 1
                if k >= 0:
                    turns[i, j, k] += 1 if x1 < x else -1
    for i in range(nx):
        for j in range(ny):
            for k in range(nz - 2, -1, -1):
                turns[i, j, k] += turns[i, j, k + 1]


@njit(cache=True, parallel=True)
def _fill_closest(tree: AABBTree, points: Floats, out: Floats, faces: Ints, distance: Floats):  # pragma: no cover
    chunk = 256
    for c in prange((len(points) + chunk - 1) // chunk):
        stack = np.empty(STACK, np.int64)
        guess = 0
        for n in range(c * chunk, min(len(points), (c + 1) * chunk)):
            x, y, z = points[n]
            guess, square = nearest_triangle(x, y, z, tree, guess, np.inf, stack)
            dx, dy, dz = offset_from_triangle(x, y, z, tree.corners[guess])
            out[n, 0], out[n, 1], out[n, 2] = x - dx, y - dy, z - dz
            faces[n], distance[n] = tree.order[guess], np.sqrt(square)


@njit(cache=True, parallel=True)
def _winding_numbers(tree: AABBTree, points: Floats, turns: Ints):  # pragma: no cover
    chunk = 256
    for c in prange((len(points) + chunk - 1) // chunk):
        stack = np.empty(STACK, np.int64)
        for n in range(c * chunk, min(len(points), (c + 1) * chunk)):
            turns[n] = winding_number(points[n, 0], points[n, 1], points[n, 2], tree, stack)


def _tree(mesh: Mesh) -> AABBTree:
    if not len(mesh.faces):
        raise BadInput("the mesh has no triangles, so nothing has a distance to it")
    return build_tree(mesh.triangles)


def _lattice(origin: ArrayLike, spacing: ArrayLike) -> tuple[Floats, Floats]:
    step = np.broadcast_to(np.asarray(spacing, float), (3,)).copy()
    if not (step > 0).all():
        raise BadInput(f"spacing must be positive, got {spacing}")
    return np.array(origin, float).reshape(3), step


def winding_lattice(mesh: Mesh, origin: ArrayLike, spacing: ArrayLike, shape: tuple[int, int, int]) -> Ints:
    """Winding number of a closed mesh at lattice points: 1 inside, 0 outside, other where parts
    overlap or are inside out. Arguments as in `signed_distance_lattice`."""
    start, step = _lattice(origin, spacing)
    turns = np.zeros(shape, np.int64)
    _fill_winding(np.array(mesh.triangles), start, step, turns)
    return turns


def distance_lattice(
    mesh: Mesh,
    origin: ArrayLike,
    spacing: ArrayLike,
    shape: tuple[int, int, int],
    *,
    limit: float = np.inf,
) -> Floats32:
    """Unsigned distance at lattice points; the mesh may be open. As `signed_distance_lattice`."""
    return _distances(mesh, origin, spacing, np.ones(shape, np.bool_), limit, limit)


def _distances(
    mesh: Mesh, origin: ArrayLike, spacing: ArrayLike, inside: Mask, limit: float, outside: float
) -> Floats32:
    start, step = _lattice(origin, spacing)
    values = np.empty(inside.shape, np.float32)
    _fill_distances(_tree(mesh), start, step, inside, float(limit), float(outside), values)
    return values


def signed_distance_lattice(
    mesh: Mesh,
    origin: ArrayLike,
    spacing: ArrayLike,
    shape: tuple[int, int, int],
    *,
    limit: float = np.inf,
    outside: float = np.inf,
) -> Floats32:
    """Exact signed distance [m] of a closed mesh at origin + index * spacing, + inside.

    origin: position of index (0, 0, 0), shape (3,), in the mesh's frame. spacing: one length or three.
    limit: larger distances are cut off at it, which saves most of the time when it is small.
    outside: the same for points outside alone.
    Returns float32 of `shape`. Raises BadInput for a mesh without triangles or a spacing <= 0."""
    inside = winding_lattice(mesh, origin, spacing, shape) > 0
    values = _distances(mesh, origin, spacing, inside, limit, min(limit, outside))
    np.negative(values, out=values, where=~inside)
    return values


def voxels_inside(mesh: Mesh, grid: Grid) -> Mask:
    """Whether each voxel centre lies in a closed mesh, shape (r, r, r); distances take fifty times as long.

    Centres exactly on the surface count by rules that give each to one of two bodies that share it there."""
    return winding_lattice(mesh, grid.to_world([0, 0, 0]), grid.spacing, grid.shape) > 0


def signed_distance(mesh: Mesh, grid: Grid) -> Floats32:
    """Exact signed distance [m] of a closed mesh at the voxel centres, + inside, float32 (r, r, r)."""
    return signed_distance_lattice(mesh, grid.to_world([0, 0, 0]), grid.spacing, grid.shape)


def _points(points: ArrayLike) -> Floats:
    array = np.array(points, float)
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise BadInput(f"points must be finite and of shape (n, 3), got shape {array.shape}")
    return array


def closest_points(mesh: Mesh, points: ArrayLike) -> ClosestPoints:
    """Nearest point of the surface, its triangle and its distance, for points of shape (n, 3)."""
    array = _points(points)
    result = ClosestPoints(np.empty_like(array), np.empty(len(array), np.int64), np.empty(len(array)))
    _fill_closest(_tree(mesh), array, *result)
    return result


def signed_distance_points(mesh: Mesh, points: ArrayLike) -> Floats:
    """Exact signed distance [m] of a closed mesh at points (n, 3), + inside, shape (n,)."""
    array = _points(points)
    tree = _tree(mesh)
    result = ClosestPoints(np.empty_like(array), np.empty(len(array), np.int64), np.empty(len(array)))
    _fill_closest(tree, array, *result)
    turns = np.empty(len(array), np.int64)
    _winding_numbers(tree, array, turns)
    return np.where(turns > 0, result.distance, -result.distance)
