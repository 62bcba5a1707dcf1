"""Cell labels: the pattern extended to every voxel that the body may touch, so that the cells cover the body."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.carve.cutting.mesh_on_grid import MeshOnGrid
from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import FracturePattern, Ints, Labels
from deepfracture.voxels import connected_labels


def cell_labels(on_grid: MeshOnGrid, pattern: FracturePattern) -> tuple[Labels, Ints]:
    """Labels of the voxels that need one (`MeshOnGrid.spans`), 0 elsewhere, int32, shape of the box; and the grid edges
    between two labels: flat index of the first voxel and axis, shape (q, 2).

    A pattern has no labels just outside the surface, nor in thin parts between voxel centres: there its labels grow
    outward. A component that no label reaches becomes a cell of its own. Where two voxels of a label meet only along an
    edge they are separated or joined, because a cell that touches itself along an edge has a non-manifold surface."""
    # Allocated by numpy, which asks for large pages: that halves the time of all that follows.
    labels = np.zeros(on_grid.inside.shape, np.int32)
    left = parallel_for(
        lambda first, last: _read_pattern(pattern.labels, on_grid.spans, labels, first, last),
        len(on_grid.spans), least=512,
    )  # fmt: skip
    empty = np.concatenate(left)
    previous = -1
    while len(empty) != previous:
        previous = len(empty)
        empty = _grow_once(labels, empty)
    if len(empty):
        left = np.zeros(labels.shape, np.int32)
        left.flat[empty] = 1
        labels = np.where(left > 0, labels.max() + connected_labels(left), labels)
    found = parallel_for(
        lambda first, last: _label_edges(labels, on_grid.line_bounds, first, last), len(on_grid.line_bounds), least=1024
    )
    edges = np.concatenate(found)
    diagonal = parallel_for(lambda first, last: _diagonal_squares(labels, edges, first, last), len(edges), least=8192)
    changed = _repair_squares(labels, edges, np.concatenate(diagonal))
    if len(changed):
        edges = _updated_edges(labels, edges, changed, np.zeros(labels.size, np.bool_))
    return labels, edges


@njit(cache=True, nogil=True)
def _read_pattern(pattern, spans, labels, first, last):
    """Copy the labels of some spans of voxels; returns the flat indices of the voxels without one."""
    flat, grid = labels.reshape(-1), pattern.reshape(-1)
    empty = np.empty(spans[first:last, 1].sum(), np.int64)
    count = 0
    for n in range(first, last):
        start, length, grid_index = spans[n]
        for k in range(length if grid_index >= 0 else 0):
            flat[start + k] = max(grid[grid_index + k], 0)
        for k in range(length):
            empty[count] = start + k
            count += flat[start + k] == 0
    return empty[:count].copy()


def _grow_once(labels: Labels, empty: Ints) -> Ints:
    """Label empty voxels from their neighbours, all at once; returns the voxels that are still empty."""
    found = np.zeros(len(empty), np.int32)
    parallel_for(lambda first, last: _vote(labels, empty, found, first, last), len(empty), least=2048)
    labels.reshape(-1)[empty] = found
    return empty[found == 0]


@njit(cache=True, nogil=True)
def _vote(labels, empty, found, first, last):
    """The label of each voxel of `empty`: that of the voxels across its faces if they agree, else the majority of its
    26 neighbours, weighted by the inverse squared distance; 0 if all of them are empty."""
    flat, s1, s0 = labels.reshape(-1), labels.shape[2], labels.shape[1] * labels.shape[2]
    names, votes = np.empty(26, np.int32), np.empty(26)
    for e in range(first, last):
        # Most voxels have neighbours of one label only.
        name = 0
        for step in (-1, 1, -s1, s1, -s0, s0):
            adjacent = flat[empty[e] + step]
            if adjacent != 0 and name >= 0:
                name = adjacent if name == 0 or name == adjacent else -1
        if name > 0:
            found[e] = name
            continue
        used = 0
        for n in range(27):
            x, y, z = n // 9 - 1, n // 3 % 3 - 1, n % 3 - 1
            name = flat[empty[e] + x * s0 + y * s1 + z]
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


@njit(cache=True, nogil=True)
def _label_edges(labels, line_bounds, first, last):
    """The edges from voxels of some lines of the box to the next voxels along the axes, where the label changes.

    Most voxels have none, so a branch-free pass marks all voxels and a second one visits those marked."""
    lines, size = labels.shape[1], labels.shape[2]
    edges, marks, hits = np.empty((256, 2), np.int64), np.empty(size, np.uint8), np.empty(size, np.int64)
    made = 0
    for n in range(first, last):
        low, high = line_bounds[n]
        if low == high:
            continue
        i, j = n // lines, n % lines  # there is always a next one: the border needs no labels
        _mark_changes(labels[i, j], labels[i + 1, j], labels[i, j + 1], marks, low, high)
        found = 0
        for k in range(low, high):
            hits[found] = k
            found += marks[k] != 0
        while made + 3 * found + 3 > len(edges):
            edges = np.concatenate((edges, np.empty_like(edges)))
        for h in range(found):
            for axis in range(3):
                edges[made, 0], edges[made, 1] = n * size + hits[h], axis
                made += marks[hits[h]] >> axis & 1
    return edges[:made].copy()


@njit(cache=True, nogil=True)
def _mark_changes(line, below, adjacent, marks, low, high):
    """Set bit `axis` of some marks where the voxel of a line and the next one along that axis have different labels."""
    for k in range(low, high):
        own, x, y, z = line[k], below[k], adjacent[k], line[k + 1]
        one, two, three = (
            (x != own) & (x != 0) & (own != 0),
            (y != own) & (y != 0) & (own != 0),
            (z != own) & (z != 0) & (own != 0),
        )
        marks[k] = np.uint8(one | two << 1 | three << 2)


@njit(cache=True)
def _updated_edges(labels, edges, changed, dirty):
    """The edges, in the order of their voxels, after some voxels have `changed`; `dirty`: scratch, all False."""
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    for v in changed:
        dirty[v] = True
    removed = np.zeros(len(edges), np.bool_)
    for v in changed:
        for first in (v, v - strides[0], v - strides[1], v - strides[2]):
            e = np.searchsorted(edges[:, 0], first)
            while e < len(edges) and edges[e, 0] == first:
                removed[e] = dirty[first] or dirty[first + strides[edges[e, 1]]]
                e += 1
    updated = np.empty((len(edges) + 6 * len(changed), 2), np.int64)
    count = 0
    for e in range(len(edges)):
        updated[count, 0], updated[count, 1] = edges[e, 0], edges[e, 1]
        count += not removed[e]
    for v in changed:
        if not dirty[v]:
            continue
        dirty[v] = False  # its edges to voxels that are still dirty are added with those
        for axis in range(3):
            for first in (v, v - strides[axis]):
                other = first + strides[axis]
                if flat[first] == 0 or flat[other] == 0 or flat[first] == flat[other] or dirty[first] or dirty[other]:
                    continue
                updated[count, 0], updated[count, 1] = first, axis
                count += 1
    return updated[:count].copy()


@njit(cache=True, nogil=True)
def _diagonal_squares(labels, edges, first, last):
    """Which of some edges belong to a square in which a label holds two opposite corners only."""
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    found = np.empty(last - first, np.int64)
    count = 0
    for e in range(first, last):
        p = strides[edges[e, 1]]
        for q in strides:
            if q != p and _diagonal(flat, edges[e, 0], p, q) != 0:
                found[count] = e
                count += 1
                break
    return found[:count]


@njit(cache=True)
def _repair_squares(labels, edges, diagonal):
    """Relabel a voxel of every 2 x 2 square in which a label holds two opposite corners only; returns those voxels.

    The higher label gives way to the lower one, so the process terminates. Only edges of such squares (`diagonal`) are
    visited, then all squares around each voxel that has changed. The border of the array is empty."""
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    changed = np.empty(64, np.int64)
    top, done = 0, 0
    for e in diagonal:
        p = strides[edges[e, 1]]
        for q in strides:
            if q != p:
                top, changed = _repair_square(flat, edges[e, 0], p, q, changed, top)
        while done < top:
            u = changed[done]
            done += 1
            for axis in range(3):
                p, q = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
                for back in (0, p, q, p + q):
                    top, changed = _repair_square(flat, u - back, p, q, changed, top)
    return changed[:top].copy()


@njit(cache=True, inline="always")
def _repair_square(flat, v, p, q, changed, top):
    """Repair the square v, v + p, v + q, v + p + q if need be, and append the voxel that changes to the list."""
    which = _diagonal(flat, v, p, q)
    if which == 0:
        return top, changed
    one, two, left, right = v, v + p + q, v + p, v + q
    if which == 2:
        one, two, left, right = left, right, one, two
    if flat[left] > flat[right]:
        left, right = right, left
    if top == len(changed):
        changed = np.concatenate((changed, np.empty_like(changed)))
    if flat[right] > flat[one]:
        flat[right] = flat[one]
        changed[top] = right
    else:
        flat[two] = flat[left]
        changed[top] = two
    return top + 1, changed


@njit(cache=True, inline="always")
def _diagonal(flat, v, p, q):
    """Which opposite corners of a square alone share a label: 1 for v and v + p + q, 2 for the others, 0 for none."""
    a, b, c, d = flat[v], flat[v + p], flat[v + q], flat[v + p + q]
    if a in (b, c) or a == 0 or b == 0 or c == 0 or d == 0:
        return 0
    if a == d:
        return 1
    return 2 if b == c and b != d else 0
