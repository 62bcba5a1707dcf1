"""Labels for every voxel that the body may touch, so that cells leave nothing of it out."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.carve.cutting.mesh_on_grid import Ground
from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import FracturePattern, Ints, Labels
from deepfracture.voxels import connected_labels


def cell_labels(ground: Ground, pattern: FracturePattern) -> tuple[Labels, Ints]:
    """The pattern's labels on the voxels that the ground needs, 0 elsewhere, int32, shape of its box; and the grid
    edges between two labels: flat index of the first voxel and axis, shape (q, 2).

    A pattern says little near the surface (a voxel whose centre is just outside has no label), and nothing about
    thin parts that run between voxel centres: there labels grow. A part that no label reaches becomes one.
    Where two voxels of a label meet only along an edge they are parted or joined, for a cell that touches itself
    along an edge has no manifold surface."""
    # Made here and not in a kernel: numpy asks for large pages, which halves the time of all that follows.
    labels = np.zeros(ground.inside.shape, np.int32)
    left = parallel_for(
        lambda first, last: _on_ground(pattern.labels, ground.spans, labels, first, last), len(ground.spans), least=512
    )  # fmt: skip
    empty = np.concatenate(left)
    before = -1
    while len(empty) != before:
        before = len(empty)
        empty = _grown(labels, empty)
    if len(empty):
        left = np.zeros(labels.shape, np.int32)
        left.flat[empty] = 1
        labels = np.where(left > 0, labels.max() + connected_labels(left), labels)
    found = parallel_for(lambda first, last: _edges(labels, ground.reach, first, last), len(ground.reach), least=1024)
    edges = np.concatenate(found)
    faulty = parallel_for(lambda first, last: _diagonals(labels, edges, first, last), len(edges), least=8192)
    changed = _join_diagonals(labels, edges, np.concatenate(faulty))
    if len(changed):
        edges = _renewed(labels, edges, changed, np.zeros(labels.size, np.bool_))
    return labels, edges


@njit(cache=True, nogil=True)
def _on_ground(source, spans, labels, first, last):
    """Write the labels of some spans of voxels; the flat indices of those that have none."""
    flat, grid = labels.reshape(-1), source.reshape(-1)
    empty = np.empty(spans[first:last, 1].sum(), np.int64)
    count = 0
    for n in range(first, last):
        start, length, on_grid = spans[n]
        for k in range(length if on_grid >= 0 else 0):
            flat[start + k] = max(grid[on_grid + k], 0)
        for k in range(length):
            empty[count] = start + k
            count += flat[start + k] == 0
    return empty[:count].copy()


def _grown(labels: Labels, empty: Ints) -> Ints:
    """Write the labels that empty voxels take over from their neighbours, all at once; those that are still empty."""
    found = np.zeros(len(empty), np.int32)
    parallel_for(lambda first, last: _grow(labels, empty, found, first, last), len(empty), least=2048)
    labels.reshape(-1)[empty] = found
    return empty[found == 0]


@njit(cache=True, nogil=True)
def _grow(labels, empty, found, first, last):
    """The label of each voxel of `empty`: that of the labelled ones across its faces if they agree, else that of most
    of its 26 neighbours, near ones counting more; 0 if all of them are empty."""
    flat, s1, s0 = labels.reshape(-1), labels.shape[2], labels.shape[1] * labels.shape[2]
    names, votes = np.empty(26, np.int32), np.empty(26)
    for e in range(first, last):
        # Most lie beside one label only.
        name = 0
        for step in (-1, 1, -s1, s1, -s0, s0):
            beside = flat[empty[e] + step]
            if beside != 0 and name >= 0:
                name = beside if name == 0 or name == beside else -1
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
def _edges(labels, reach, first, last):
    """The edges from voxels of some lines of the box to the next voxels along the axes that have another label.

    Most have none: so first a mark for each voxel, which takes no decisions, then those that are not zero."""
    lines, size = labels.shape[1], labels.shape[2]
    edges, marks, hits = np.empty((256, 2), np.int64), np.empty(size, np.uint8), np.empty(size, np.int64)
    made = 0
    for n in range(first, last):
        low, high = reach[n]
        if low == high:
            continue
        i, j = n // lines, n % lines  # the last plane, line and voxel need no label: there is always a next one
        _mark(labels[i, j], labels[i + 1, j], labels[i, j + 1], marks, low, high)
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
def _mark(line, below, beside, marks, low, high):
    """Bit 0, 1, 2 of some marks: whether that voxel of a line and its next one along the axis have two labels."""
    for k in range(low, high):
        own, x, y, z = line[k], below[k], beside[k], line[k + 1]
        one, two, three = (
            (x != own) & (x != 0) & (own != 0),
            (y != own) & (y != 0) & (own != 0),
            (z != own) & (z != 0) & (own != 0),
        )
        marks[k] = np.uint8(one | two << 1 | three << 2)


@njit(cache=True)
def _renewed(labels, edges, changed, dirty):
    """The edges, in the order of their voxels, after some have changed; `dirty`: scratch, all False."""
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    for v in changed:
        dirty[v] = True
    gone = np.zeros(len(edges), np.bool_)
    for v in changed:
        for first in (v, v - strides[0], v - strides[1], v - strides[2]):
            e = np.searchsorted(edges[:, 0], first)
            while e < len(edges) and edges[e, 0] == first:
                gone[e] = dirty[first] or dirty[first + strides[edges[e, 1]]]
                e += 1
    fresh = np.empty((len(edges) + 6 * len(changed), 2), np.int64)
    count = 0
    for e in range(len(edges)):
        fresh[count, 0], fresh[count, 1] = edges[e, 0], edges[e, 1]
        count += not gone[e]
    for v in changed:
        if not dirty[v]:
            continue
        dirty[v] = False  # its edges to voxels that are still dirty come with those
        for axis in range(3):
            for first in (v, v - strides[axis]):
                other = first + strides[axis]
                if flat[first] == 0 or flat[other] == 0 or flat[first] == flat[other] or dirty[first] or dirty[other]:
                    continue
                fresh[count, 0], fresh[count, 1] = first, axis
                count += 1
    return fresh[:count].copy()


@njit(cache=True, nogil=True)
def _diagonals(labels, edges, first, last):
    """Which of some edges have a square beside them in which a label holds two opposite corners only."""
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    found = np.empty(last - first, np.int64)
    count = 0
    for e in range(first, last):
        p = strides[edges[e, 1]]
        for q in strides:
            if q != p and _corners(flat, edges[e, 0], p, q) != 0:
                found[count] = e
                count += 1
                break
    return found[:count]


@njit(cache=True)
def _join_diagonals(labels, edges, faulty):
    """Mend every square of four voxels in which a label holds two opposite corners only; the voxels that change.

    The higher label gives way to the lower, so that this comes to an end; what a change spoils nearby is looked at
    next. So only the edges that have such a square at the start, `faulty`, need be visited. The border of the array
    is empty."""
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    changed = np.empty(64, np.int64)
    top, done = 0, 0
    for e in faulty:
        p = strides[edges[e, 1]]
        for q in strides:
            if q != p:
                top, changed = _mend(flat, edges[e, 0], p, q, changed, top)
        while done < top:
            u = changed[done]
            done += 1
            for axis in range(3):
                p, q = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
                for back in (0, p, q, p + q):
                    top, changed = _mend(flat, u - back, p, q, changed, top)
    return changed[:top].copy()


@njit(cache=True, inline="always")
def _mend(flat, v, p, q, changed, top):
    """Mend the square v, v + p, v + q, v + p + q, and add a changed voxel to the list."""
    which = _corners(flat, v, p, q)
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
def _corners(flat, v, p, q):
    """Which opposite corners of a square have one label, and the others another: 1 for v and v + p + q, 2 for the
    others, 0 for none."""
    a, b, c, d = flat[v], flat[v + p], flat[v + q], flat[v + p + q]
    if a in (b, c) or a == 0 or b == 0 or c == 0 or d == 0:
        return 0
    if a == d:
        return 1
    return 2 if b == c and b != d else 0
