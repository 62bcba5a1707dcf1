"""From a GS-SDF to fragments: a flood from the peaks of the field (paper, section 5.2)."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.types import BadInput, FracturePattern, Volume

CAGE = 0.03
"""Depth [m] of the shell outside that the flood may use (the paper's epsilon)."""
BUCKETS = 1 << 16


def segment(volume: Volume, *, tolerance: float = 0.0, ratio: float = 0.5, crest: float = 1e9, min_voxels: int = 8):
    values = np.pad(volume.values, 1, constant_values=-np.inf)
    if np.isnan(volume.values).any():
        raise BadInput("x")
    order = _descending(values.reshape(-1), -CAGE)
    labels = np.zeros(values.size, np.int32)
    s = np.array(values.strides) // values.itemsize
    offs, lens = _neighbours(s)
    _flood(values.reshape(-1), order, offs, lens, labels, tolerance, ratio, crest * volume.grid.spacing, min_voxels)
    labels = labels.reshape(values.shape)[1:-1, 1:-1, 1:-1]
    return FracturePattern(volume.grid, labels, np.maximum(volume.values, 0))


def _neighbours(strides: np.ndarray):
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    steps = steps[np.abs(steps).sum(1) > 0]
    steps = steps[np.argsort(np.abs(steps).sum(1), kind="stable")]
    return steps @ strides, np.sqrt((steps**2).sum(1)).astype(np.float32)


@njit(cache=True)
def _descending(values, lowest):
    n = 0
    top = lowest
    for v in values:
        if v > lowest:
            n += 1
            top = max(top, v)
    order = np.empty(n, np.int64)
    if n == 0:
        return order
    scale = (BUCKETS - 1) / (top - lowest)
    start = np.zeros(BUCKETS + 1, np.int64)
    for v in values:
        if v > lowest:
            start[int((top - v) * scale) + 1] += 1
    for b in range(BUCKETS):
        start[b + 1] += start[b]
    for i in range(len(values)):
        v = values[i]
        if v > lowest:
            b = int((top - v) * scale)
            order[start[b]] = i
            start[b] += 1
    return order


@njit(cache=True, inline="always")
def _find(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def _flood(values, order, offs, lens, labels, tolerance, ratio, crest, min_voxels):
    n_max = len(order) + 1
    parent = np.zeros(n_max, np.int32)
    peak = np.zeros(n_max, np.float32)
    size = np.zeros(n_max, np.int32)
    count = 0
    for v in order:
        val = values[v]
        best = 0
        slope = np.float32(-1)
        for n in range(26):
            u = v + offs[n]
            if labels[u] > 0:
                g = (values[u] - val) / lens[n]
                if g > slope:
                    slope = g
                    best = labels[u]
        if best == 0:
            if val <= 0:
                continue
            count += 1
            parent[count] = count
            peak[count] = val
            best = count
        root = _find(parent, best)
        labels[v] = root
        if val > 0:
            size[root] += 1
        for n in range(6):
            u = v + offs[n]
            if labels[u] == 0:
                continue
            other = _find(parent, labels[u])
            if other == root:
                continue
            low, high = (root, other) if peak[root] < peak[other] else (other, root)
            saddle = 0.5 * (values[u] + val)
            if (
                saddle > crest
                or saddle > ratio * peak[low]
                or peak[low] - val < tolerance
                or size[low] < min_voxels
            ):
                parent[low] = high
                size[high] += size[low]
                root = high
    new = np.zeros(count + 1, np.int32)
    final = 0
    for v in order:
        if values[v] <= 0:
            labels[v] = 0
            continue
        root = _find(parent, labels[v])
        if new[root] == 0:
            final += 1
            new[root] = final
        labels[v] = new[root]
