"""Voxels that no crack parts, as regions: all that is left of the flood when the cuts are known."""

from __future__ import annotations

from itertools import product

import numpy as np
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from deepfracture.types import Ints, Labels


@njit(cache=True, inline="always")
def root(parent: np.ndarray, region: int) -> int:
    """The name of a region in a union-find forest, with path halving."""
    while parent[region] != region:
        parent[region] = parent[parent[region]]
        region = parent[region]
    return region


@njit(cache=True, inline="always")
def unite(parent: np.ndarray, one: int, other: int) -> None:
    """Make one region of two: the lower name stays."""
    if parent[one] != parent[other]:
        a, b = root(parent, one), root(parent, other)
        if a != b:
            parent[max(a, b)] = min(a, b)


def joined(values: np.ndarray, cuts: np.ndarray, smallest: int) -> Labels:
    """Regions 1..n of the voxels of positive value that hang together across faces that are not cut, 0 elsewhere,
    int32.

    One of fewer than `smallest` voxels joins the region that it touches most, at faces, edges or corners: where a
    body is thinner than a voxel, its voxels touch at their edges only. Regions are numbered in the order of their
    first voxels.

    Args:
        values: Shape (r, r, r).
        cuts: As in `Volume`, the same shape.
    """
    lines, spans = _spans(values, cuts)
    names = _regions(lines, spans, cuts)
    labels = np.zeros(values.shape, np.int32)
    _paint(labels, lines, spans, names)
    while (into := _destinations(labels, lines, spans, names, smallest)) is not None:
        names = _renamed(names, into)
        _paint(labels, lines, spans, names)
    return labels


@njit(cache=True)
def _spans(values, cuts):
    """Voxels of positive value that follow each other along the last axis without a cut.

    Returns the first span of each line, and the end, shape (r^2 + 1,), and their first and end, shape (n, 2)."""
    n0, n1, n2 = values.shape
    lines = np.zeros(n0 * n1 + 1, np.int64)
    spans = np.empty((values.size, 2), np.int16)  # where it is not written to it costs nothing
    count = 0
    for i in range(n0):
        for j in range(n1):
            line, bits = values[i, j], cuts[i, j]
            k = 0
            while k < n2:
                if not line[k] > 0:
                    k += 1
                    continue
                first = k
                while k + 1 < n2 and line[k + 1] > 0 and not bits[k] & 4:
                    k += 1
                k += 1
                spans[count, 0], spans[count, 1] = first, k
                count += 1
            lines[i * n1 + j + 1] = count
    return lines, spans[:count].copy()


@njit(cache=True)
def _regions(lines, spans, cuts):
    """The region 1..n of each span."""
    n0, n1, _ = cuts.shape
    parent = np.arange(len(spans)).astype(np.int32)
    for i in range(n0):
        for j in range(n1):
            line = i * n1 + j
            if i > 0:
                _connect(parent, lines, spans, line - n1, line, cuts[i - 1, j], 1)
            if j > 0:
                _connect(parent, lines, spans, line - 1, line, cuts[i, j - 1], 2)
    names = np.zeros(len(spans), np.int32)
    count = 0
    for n in range(len(spans)):
        if parent[n] == n:
            count += 1
            names[n] = count
        else:
            names[n] = names[root(parent, n)]
    return names


@njit(cache=True)
def _connect(parent, lines, spans, behind, here, bits, bit):
    """Join the spans of two neighbouring lines where the `bits` of the one behind have a voxel that is not cut."""
    m, n = lines[behind], lines[here]
    while m < lines[behind + 1] and n < lines[here + 1]:
        end = min(spans[m, 1], spans[n, 1])
        for k in range(max(spans[m, 0], spans[n, 0]), end):
            if not bits[k] & bit:
                unite(parent, m, n)
                break
        if spans[m, 1] == end:
            m += 1
        else:
            n += 1


@njit(cache=True)
def _paint(labels, lines, spans, names):
    n1 = labels.shape[1]
    for line in range(len(lines) - 1):
        row = labels[line // n1, line % n1]
        for n in range(lines[line], lines[line + 1]):
            row[spans[n, 0] : spans[n, 1]] = names[n]


def _renamed(names: Labels, into: Labels) -> Labels:
    """Regions that have gone `into` others, by new names 1..n in the same order."""
    found, first = np.unique(into[names], return_index=True)
    renamed = np.zeros(len(into), np.int32)
    renamed[found[np.argsort(first)]] = np.arange(1, len(found) + 1)
    return renamed[into[names]]


def _destinations(labels: Labels, lines: Ints, spans: np.ndarray, names: Labels, smallest: int) -> Labels | None:
    """Where each region goes, itself or a neighbour; None if all are large enough or touch no other."""
    lengths = (spans[:, 1] - spans[:, 0]).astype(np.int64)
    sizes = np.bincount(names, lengths, minlength=1).astype(np.int64)
    sizes[0] = smallest
    small = sizes < smallest
    if not small.any():
        return None
    own, other = _contacts(labels, lines, spans, np.flatnonzero(small[names]))
    if not len(own):
        return None
    pairs, votes = np.unique(np.stack([own, other]), axis=1, return_counts=True)
    order = np.lexsort((-pairs[1], votes))  # the last of a region wins: most votes, then the first name
    own, other = pairs[:, order]
    best = np.arange(len(sizes))
    best[own[small[own]]] = other[small[own]]
    edges = coo_array((np.ones(len(best)), (np.arange(len(best)), best)), shape=(len(best), len(best)))
    count, group = connected_components(edges, directed=False)
    ranked = np.lexsort((-np.arange(len(sizes)), sizes))
    largest = np.zeros(count, labels.dtype)
    largest[group[ranked]] = ranked  # the last of a group wins
    largest[group[0]] = 0
    return largest[group]


def _contacts(labels: Labels, lines: Ints, spans: np.ndarray, chosen: Ints) -> tuple[Labels, Labels]:
    """The region of each voxel of the `chosen` spans beside that of each neighbour in another, shape (m,) each."""
    r = labels.shape[0]
    lengths = (spans[chosen, 1] - spans[chosen, 0]).astype(np.int64)
    ends = np.cumsum(lengths)
    line = np.repeat(np.searchsorted(lines, chosen, side="right") - 1, lengths)
    along = np.repeat(spans[chosen, 0] - (ends - lengths), lengths) + np.arange(lengths.sum())
    voxels = np.stack([line // r, line % r, along], axis=1)
    steps = np.array([step for step in product((-1, 0, 1), repeat=3) if any(step)])
    near = voxels[:, None] + steps
    within = ((near >= 0) & (near < r)).all(axis=2)
    own = np.broadcast_to(labels[tuple(voxels.T)][:, None], within.shape)[within]
    other = labels[tuple(near[within].T)]
    touching = (other > 0) & (other != own)
    return own[touching], other[touching]
