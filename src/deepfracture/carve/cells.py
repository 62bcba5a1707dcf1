"""Labels for every voxel that the body may touch, so that cells leave nothing of it out."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.carve.ground import Ground
from deepfracture.carve.parts import connected_labels
from deepfracture.types import FracturePattern, Labels


def cell_labels(ground: Ground, pattern: FracturePattern) -> Labels:
    """The pattern's labels on the voxels that the ground needs, 0 elsewhere, int32, shape of its box.

    A pattern says little near the surface (a voxel whose centre is just outside has no label), and nothing about
    thin parts that run between voxel centres: there labels grow. A part that no label reaches becomes one.
    Where two voxels of a label meet only along an edge they are parted or joined, for a cell that touches itself
    along an edge has no manifold surface."""
    labels, empty = _on_ground(pattern.labels, ground.low, ground.needed)
    before = -1
    while len(empty) != before:
        before = len(empty)
        empty = _grow(labels, empty)
    if len(empty):
        left = np.zeros(labels.shape, np.int32)
        left.flat[empty] = 1
        labels = np.where(left > 0, labels.max() + connected_labels(left), labels)
    _join_diagonals(labels)
    return labels


@njit(cache=True)
def _on_ground(source, low, needed):
    """Labels of the needed voxels, and the flat indices of those that have none."""
    n0, n1, n2 = needed.shape
    r = source.shape[0]
    labels = np.zeros(needed.shape, np.int32)
    empty = np.empty(16, np.int64)
    count = 0
    for i in range(n0):
        for j in range(n1):
            x, y = i + low[0], j + low[1]
            on_grid = 0 <= x < r and 0 <= y < r
            for k in range(n2):
                if not needed[i, j, k]:
                    continue
                z = k + low[2]
                label = source[x, y, z] if on_grid and 0 <= z < r else 0
                if label > 0:
                    labels[i, j, k] = label
                    continue
                if count == len(empty):
                    empty = np.concatenate((empty, np.empty_like(empty)))
                empty[count] = (i * n1 + j) * n2 + k
                count += 1
    return labels, empty[:count].copy()


@njit(cache=True)
def _grow(labels, empty):
    """Label each voxel of `empty` beside labelled ones as most of its 26 neighbours, near ones counting more.
    Returns those that are still empty."""
    flat, s1, s0 = labels.reshape(-1), labels.shape[2], labels.shape[1] * labels.shape[2]
    found = np.zeros(len(empty), np.int32)
    names, votes = np.empty(26, np.int32), np.empty(26)
    for e in range(len(empty)):
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
    left = 0
    for e in range(len(empty)):
        flat[empty[e]] = found[e]
        if found[e] == 0:
            empty[left] = empty[e]
            left += 1
    return empty[:left]


@njit(cache=True)
def _join_diagonals(labels):
    """Mend every square of four voxels in which a label holds two opposite corners only.

    The higher label gives way to the lower, so that this comes to an end; what a change spoils nearby is looked at
    next. The border of the array is empty."""
    flat = labels.reshape(-1)
    strides = (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    changed = np.empty(64, np.int64)
    top = 0
    for v in range(flat.size - strides[0] - strides[1]):
        if flat[v] == 0:
            continue
        for axis in range(3):
            top, changed = _mend(flat, v, strides[(axis + 1) % 3], strides[(axis + 2) % 3], changed, top)
        while top > 0:
            top -= 1
            u = changed[top]
            for axis in range(3):
                p, q = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
                for back in (0, p, q, p + q):
                    top, changed = _mend(flat, u - back, p, q, changed, top)


@njit(cache=True, inline="always")
def _mend(flat, v, p, q, changed, top):
    """Mend the square v, v + p, v + q, v + p + q, and add a changed voxel to the stack."""
    a, b, c, d = flat[v], flat[v + p], flat[v + q], flat[v + p + q]
    if a == b or a == c or a == 0 or b == 0 or c == 0 or d == 0:
        return top, changed
    if a == d:
        one, two, left, right = v, v + p + q, v + p, v + q
    elif b == c and b != d:
        one, two, left, right = v + p, v + q, v, v + p + q
    else:
        return top, changed
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
