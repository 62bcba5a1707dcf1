"""Voxels that no crack parts, as regions: all that is left of the flood when the cuts are known."""

from __future__ import annotations

from itertools import product

import numpy as np
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from deepfracture.types import Labels


@njit(cache=True, inline="always")
def root(parent: np.ndarray, region: int) -> int:
    """The name of a region in a union-find forest, with path halving."""
    while parent[region] != region:
        parent[region] = parent[parent[region]]
        region = parent[region]
    return region


def joined(inside: np.ndarray, cuts: np.ndarray, smallest: int) -> Labels:
    """Regions 1..n of the voxels `inside` that hang together across faces that are not cut, 0 elsewhere, int32.

    One of fewer than `smallest` voxels joins the region that it touches most, at faces, edges or corners: where a
    body is thinner than a voxel, its voxels touch at their edges only. Regions are numbered in the order of their
    first voxels.

    Args:
        inside: Shape (r, r, r).
        cuts: As in `Volume`, the same shape.
    """
    labels, count = _regions(np.pad(inside, 1), np.pad(cuts, 1))
    while (into := _destinations(labels, count, smallest)) is not None:
        labels, count = _renamed(labels, into)
    return labels[1:-1, 1:-1, 1:-1]


@njit(cache=True)
def _regions(inside, cuts):
    """Face-connected regions 1..n, across uncut faces, and n; the border must not be inside."""
    m = inside.shape[0]
    flat, bits = inside.reshape(-1), cuts.reshape(-1)
    parent = np.zeros(flat.size, np.int32)
    count = 0
    labels = np.zeros(flat.size, np.int32)
    for here in range(flat.size):
        if not flat[here]:
            continue
        own = 0
        for axis, step in enumerate((m * m, m, 1)):
            behind = here - step
            if flat[behind] and not bits[behind] & (1 << axis):
                other = root(parent, labels[behind])
                if own == 0:
                    own = other
                elif own != other:
                    parent[max(own, other)] = min(own, other)
                    own = min(own, other)
        if own == 0:
            count += 1
            parent[count] = own = count
        labels[here] = own
    name = np.zeros(count + 1, np.int32)
    names = 0
    for region in range(1, count + 1):
        if parent[region] == region:
            names += 1
            name[region] = names
        else:
            name[region] = name[root(parent, region)]
    for here in range(flat.size):
        labels[here] = name[labels[here]]
    return labels.reshape(inside.shape), names


@njit(cache=True)
def _renamed(labels, into):
    """Regions that have gone `into` others, by new names 1..n, and n."""
    name = np.zeros(len(into), np.int32)
    renamed = np.zeros(labels.shape, np.int32)
    names = 0
    for here in range(labels.size):
        region = into[labels.flat[here]]
        if region == 0:
            continue
        if name[region] == 0:
            names += 1
            name[region] = names
        renamed.flat[here] = name[region]
    return renamed, names


@njit(cache=True)
def _sizes(labels, count):
    sizes = np.zeros(count + 1, np.int64)
    for here in range(labels.size):
        sizes[labels.flat[here]] += 1
    return sizes


def _destinations(labels: Labels, count: int, smallest: int) -> Labels | None:
    """Where each region goes, itself or a neighbour; None if all are large enough or touch no other."""
    sizes = _sizes(labels, count)
    sizes[0] = smallest
    small = sizes < smallest
    if not small.any():
        return None
    where = np.flatnonzero(small[labels.ravel()])
    m = labels.shape[0]
    steps = np.array([(a * m + b) * m + c for a, b, c in product((-1, 0, 1), repeat=3) if a or b or c])
    own = np.repeat(labels.ravel()[where], len(steps))
    other = labels.ravel()[where[:, None] + steps].ravel()
    touching = (other > 0) & (other != own)
    if not touching.any():
        return None
    pairs, votes = np.unique(np.stack([own[touching], other[touching]]), axis=1, return_counts=True)
    order = np.lexsort((-pairs[1], votes))  # the last of a region wins: most votes, then the first name
    own, other = pairs[:, order]
    best = np.arange(len(sizes))
    best[own[small[own]]] = other[small[own]]
    edges = coo_array((np.ones(len(best)), (np.arange(len(best)), best)), shape=(len(best), len(best)))
    count, group = connected_components(edges, directed=False)
    names = np.lexsort((-np.arange(len(sizes)), sizes))
    largest = np.zeros(count, labels.dtype)
    largest[group[names]] = names  # the last of a group wins
    largest[group[0]] = 0
    return largest[group]
