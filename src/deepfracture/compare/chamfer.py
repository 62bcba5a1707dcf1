"""Chamfer distance between the fragments of two patterns, from points on their surfaces."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.types import Floats32, Grid, Ints, Labels

MAX_POINTS = 512
"""Most surface points of a fragment ..."""
QUERY_POINTS = 64
"""... and how many of them query their nearest neighbour in the other fragment."""


def surface_points(labels: Labels, count: int, grid: Grid) -> tuple[Floats32, Ints]:
    """At most MAX_POINTS voxel centres on the surface of each fragment (cracks and outside).

    Voxels are taken in a scrambled order that depends on the resolution alone: where two patterns agree they share
    their points, and the first QUERY_POINTS points are themselves spread over the fragment.

    Args:
        labels: 1..count, 0 outside, shape (r, r, r).

    Returns:
        Points [m], fragment by fragment, shape (n, 3), and the index of each fragment's first, shape (count + 1,).
    """
    voxels, owners = _surface_voxels(np.pad(labels, 1))
    order = np.lexsort((_scrambled(voxels, grid.resolution), owners))
    first = np.searchsorted(owners[order], np.arange(1, count + 2))
    rank = np.arange(len(order)) - np.repeat(first[:-1], np.diff(first))
    kept = voxels[order[rank < MAX_POINTS]]
    starts = np.concatenate([[0], np.minimum(np.diff(first), MAX_POINTS).cumsum()])
    return grid.to_world(np.stack(np.unravel_index(kept, grid.shape), axis=1)).astype(np.float32), starts


def _scrambled(voxels: Ints, resolution: int) -> Ints:
    """A permutation of the voxels' flat indices: resolutions are powers of two, so odd factors and shifts permute."""
    bits = 3 * int(np.log2(resolution))
    last = (1 << bits) - 1
    mixed = (voxels * 0x9E3779B1) & last
    mixed ^= mixed >> (bits // 2)
    return (mixed * 0x85EBCA6B) & last


@njit(cache=True)
def _surface_voxels(labels):
    """Flat index and label of every voxel with a neighbour of another label."""
    r = labels.shape[0] - 2
    size = 0
    voxels = np.empty(r**3, np.int64)
    owners = np.empty(r**3, np.int32)
    for i in range(1, r + 1):
        for j in range(1, r + 1):
            for k in range(1, r + 1):
                own = labels[i, j, k]
                if own != 0 and (
                    labels[i - 1, j, k] != own or labels[i + 1, j, k] != own
                    or labels[i, j - 1, k] != own or labels[i, j + 1, k] != own
                    or labels[i, j, k - 1] != own or labels[i, j, k + 1] != own
                ):  # fmt: skip
                    voxels[size] = ((i - 1) * r + j - 1) * r + k - 1
                    owners[size] = own
                    size += 1
    return voxels[:size].copy(), owners[:size].copy()


def mean_chamfer(a: Floats32, starts_a: Ints, b: Floats32, starts_b: Ints) -> float:
    """Mean over the fragments of both patterns of the chamfer distance to the closest one of the other pattern [m].

    The chamfer distance of two fragments is the mean distance from points of one to the nearest of the other, averaged
    over both directions. The means over the fragments of a and of b have equal weight."""
    boxes_a, boxes_b = _bounding_boxes(a, starts_a), _bounding_boxes(b, starts_b)
    forward = _closest_distances(a, starts_a, boxes_a, b, starts_b, boxes_b, QUERY_POINTS)
    backward = _closest_distances(b, starts_b, boxes_b, a, starts_a, boxes_a, QUERY_POINTS)
    return 0.5 * float(forward.mean() + backward.mean())


def _bounding_boxes(points: Floats32, starts: Ints) -> Floats32:
    low = np.minimum.reduceat(points, starts[:-1], axis=0)
    high = np.maximum.reduceat(points, starts[:-1], axis=0)
    return np.stack([low, high], axis=1)


@njit(cache=True)
def _closest_distances(a, starts_a, boxes_a, b, starts_b, boxes_b, queries) -> NDArray:
    """For each fragment of a the smallest chamfer distance to one of b; bounding boxes prune the search."""
    n, m = len(starts_a) - 1, len(starts_b) - 1
    best = np.full(n, np.inf)
    bound = np.empty(m)
    for f in range(n):
        own = a[starts_a[f] : starts_a[f + 1]]
        for g in range(m):
            other = b[starts_b[g] : starts_b[g + 1]]
            bound[g] = 0.5 * (_box_distance(own, boxes_b[g], queries) + _box_distance(other, boxes_a[f], queries))
        for g in np.argsort(bound):
            if bound[g] >= best[f]:
                break
            other = b[starts_b[g] : starts_b[g + 1]]
            found = 0.5 * (_directed_distance(own, other, queries) + _directed_distance(other, own, queries))
            best[f] = min(best[f], found)
    return best


@njit(cache=True)
def _box_distance(points, box, queries):
    """Mean distance to a box: a lower bound of the distance to its content."""
    n = min(queries, len(points))
    total = 0.0
    for p in range(n):
        squared = 0.0
        for axis in range(3):
            out = max(box[0, axis] - points[p, axis], points[p, axis] - box[1, axis], np.float32(0.0))
            squared += out * out
        total += np.sqrt(squared)
    return total / n


@njit(cache=True)
def _directed_distance(points, others, queries):
    n = min(queries, len(points))
    total = 0.0
    for p in range(n):
        x, y, z = points[p]
        nearest = np.float32(np.inf)
        for q in range(len(others)):
            dx, dy, dz = others[q, 0] - x, others[q, 1] - y, others[q, 2] - z
            nearest = min(nearest, dx * dx + dy * dy + dz * dz)
        total += np.sqrt(nearest)
    return total / n
