"""Labels for every voxel that the body may touch, so that cells leave nothing of it out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.carve.parts import connected_labels
from deepfracture.types import FracturePattern, Mesh

MARGIN = 4
"""Voxels added on every side of the grid: bodies touch its border, cells must reach past them."""
DUST_VOXELS = 8
"""A part of a label with fewer voxels joins its neighbours: too small to have a shape."""


@dataclass(frozen=True, eq=False)
class CellField:
    """Labelled voxels around a body, on a padded copy of the pattern's grid."""

    labels: np.ndarray
    """Cell 1..n of each voxel, 0 far outside, int32, shape (m, m, m) with m = r + 2 MARGIN."""
    distance: np.ndarray
    """Distance to the cracks [voxels], negative where unknown, float32, same shape."""
    count: int
    """Number of cells n."""


def cell_field(mesh: Mesh, pattern: FracturePattern) -> CellField:
    """Extend the pattern's labels to all voxels that `mesh` touches or encloses and one voxel beyond.

    The labels say little near the surface (a voxel whose centre is just outside has none), and nothing
    about thin parts that run between voxel centres. Filled up like this, the cells hold the whole body
    whatever the pattern says. Every cell is one face-connected part of one label.
    """
    index = pattern.grid.to_index(mesh.triangles) + MARGIN
    labels = np.pad(pattern.labels, MARGIN)
    distance = np.pad(pattern.distance, MARGIN) / np.float32(pattern.grid.spacing)
    distance = np.where((labels > 0) & (distance > 0), distance, np.float32(-1))
    body = np.zeros(labels.shape, np.bool_)
    _mark_surface(index, body)
    _mark_enclosed(body)
    labels[~body] = 0
    labels = _fill(labels, body)
    labels = _without_dust(labels, body)
    _grow(labels, _rim(labels))
    labels = connected_labels(labels)
    while _join_diagonals(labels):
        pass
    labels = connected_labels(labels)
    return CellField(labels, distance.astype(np.float32), int(labels.max()))


def _fill(labels: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Grow labels over the body; a part that no label reaches becomes a label of its own."""
    empty, before = np.argwhere(body & (labels == 0)), -1
    while len(empty) != before:
        before = len(empty)
        empty = _grow(labels, empty)
    if len(empty):
        left = np.zeros(labels.shape, np.int32)
        left[tuple(empty.T)] = 1
        labels = np.where(left > 0, labels.max() + connected_labels(left), labels)
    return labels


def _without_dust(labels: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Hand the voxels of tiny parts to their neighbours; the largest part stays in any case."""
    parts = connected_labels(labels)
    sizes = np.bincount(parts.ravel())
    small = sizes < DUST_VOXELS
    small[0] = False
    if sizes[1:].max(initial=0) < DUST_VOXELS:
        small[1 + np.argmax(sizes[1:])] = False
    dust = small[parts]
    if not dust.any():
        return labels
    return _fill(np.where(dust, 0, labels), body)


@njit(cache=True)
def _mark_surface(triangles: np.ndarray, mark: np.ndarray) -> None:
    """Mark every voxel cube that a triangle may touch: its box, less what its plane misses.

    `triangles` in fractional voxel indices, shape (n, 3, 3).
    """
    slack = 0.5 + 1e-6
    low, high, normal = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3)
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        for x in range(3):
            low[x] = max(int(np.ceil(min(a[x], b[x], c[x]) - slack)), 0)
            high[x] = min(int(np.floor(max(a[x], b[x], c[x]) + slack)), mark.shape[x] - 1)
            y, z = (x + 1) % 3, (x + 2) % 3
            normal[x] = (b[y] - a[y]) * (c[z] - a[z]) - (b[z] - a[z]) * (c[y] - a[y])
        reach = slack * np.abs(normal).sum()
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    off = (i - a[0]) * normal[0] + (j - a[1]) * normal[1] + (k - a[2]) * normal[2]
                    if abs(off) <= reach:
                        mark[i, j, k] = True


@njit(cache=True)
def _mark_enclosed(mark: np.ndarray) -> None:
    """Mark also what the marked voxels shut off from the border of the array."""
    n0, n1, n2 = mark.shape
    outside = np.zeros(mark.shape, np.bool_)
    stack = np.empty((mark.size, 3), np.int32)
    stack[0] = 0
    outside[0, 0, 0] = True
    top = 1
    while top > 0:
        top -= 1
        i, j, k = stack[top]
        for n in range(6):
            step = 1 - 2 * (n % 2)
            x, y, z = i, j, k
            if n < 2:
                x += step
            elif n < 4:
                y += step
            else:
                z += step
            if 0 <= x < n0 and 0 <= y < n1 and 0 <= z < n2 and not mark[x, y, z] and not outside[x, y, z]:
                outside[x, y, z] = True
                stack[top, 0], stack[top, 1], stack[top, 2] = x, y, z
                top += 1
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                mark[i, j, k] = not outside[i, j, k]


@njit(cache=True)
def _rim(labels: np.ndarray) -> np.ndarray:
    """The empty voxels among the 26 neighbours of labelled ones, shape (n, 3)."""
    n0, n1, n2 = labels.shape
    seen = np.zeros(labels.shape, np.bool_)
    for i in range(1, n0 - 1):
        for j in range(1, n1 - 1):
            for k in range(1, n2 - 1):
                if labels[i, j, k] == 0:
                    continue
                for x in range(i - 1, i + 2):
                    for y in range(j - 1, j + 2):
                        for z in range(k - 1, k + 2):
                            if labels[x, y, z] == 0:
                                seen[x, y, z] = True
    return np.argwhere(seen)


@njit(cache=True)
def _grow(labels: np.ndarray, empty: np.ndarray) -> np.ndarray:
    """Label each voxel of `empty` (n, 3) beside labelled ones as most of its 26 neighbours, near ones
    counting more. Returns those that are still empty."""
    found = np.zeros(len(empty), np.int32)
    names, votes = np.empty(26, np.int32), np.empty(26)
    for e in range(len(empty)):
        used = 0
        for n in range(27):
            x, y, z = n // 9 - 1, n // 3 % 3 - 1, n % 3 - 1
            name = labels[empty[e, 0] + x, empty[e, 1] + y, empty[e, 2] + z]
            if name == 0:
                continue
            vote = 1.0 / (x * x + y * y + z * z)
            for u in range(used):
                if names[u] == name:
                    votes[u] += vote
                    break
            else:
                names[used], votes[used] = name, vote
                used += 1
        if used:
            found[e] = names[np.argmax(votes[:used])]
    for e in range(len(empty)):
        if found[e] != 0:
            labels[empty[e, 0], empty[e, 1], empty[e, 2]] = found[e]
    return empty[found == 0]


@njit(cache=True)
def _join_diagonals(labels: np.ndarray) -> int:
    """Where two voxels of a label meet only along an edge, change one of the four voxels there.

    A cell that touches itself along an edge has four faces there, so no manifold surface. The higher
    label gives way to the lower, and the outside to all, so that repeating comes to an end. Changes a
    contiguous array whose border is empty in place and returns the number of changes."""
    changes = 0
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    last = flat.size - strides[0] - strides[1]
    for axis in range(3):
        p, q = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
        for v in range(last):
            # The four voxels a b / c d of a square across this axis.
            a, b, c = flat[v], flat[v + p], flat[v + q]
            if a in (b, c):
                continue
            d = flat[v + p + q]
            if a == d and a != 0:
                _give_way(flat, v, v + p + q, v + p, v + q)
                changes += 1
            elif b == c and b != 0 and b != d:
                _give_way(flat, v + p, v + q, v, v + p + q)
                changes += 1
    return changes


@njit(cache=True, inline="always")
def _give_way(flat: np.ndarray, one: int, two: int, left: int, right: int) -> None:
    """Part or join the voxels `one` and `two` of one label across the voxels `left` and `right`."""
    if flat[left] == 0 or (flat[right] != 0 and flat[left] > flat[right]):
        left, right = right, left
    if flat[right] == 0 or flat[right] > flat[one]:
        flat[right] = flat[one]
    else:
        flat[two] = flat[left]
