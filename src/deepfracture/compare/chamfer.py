"""Fragments as points on their surfaces, and how far each is from its like in another pattern."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.types import Floats32, Grid, Ints, Labels

DENSE = 512
"""Most surface points kept of a fragment ..."""
SPARSE = 64
"""... and of those, how many look for their nearest point in the other fragment."""


def surface_points(labels: Labels, count: int, grid: Grid) -> tuple[Floats32, Ints]:
    """At most DENSE voxel centres on the surface of each fragment (cracks and outside).

    Voxels are taken in one scattered order that depends on the resolution alone, so that what two patterns have in
    common they share point by point, and the first SPARSE points are themselves spread over the fragment.

    Args:
        labels: 1..count, 0 outside, shape (r, r, r).

    Returns:
        Points [m], fragment after fragment, shape (n, 3), and where each fragment starts, shape (count + 1,).
    """
    places, owners = _surface(np.pad(labels, 1))
    order = np.lexsort((_scattered(places, grid.resolution), owners))
    first = np.searchsorted(owners[order], np.arange(1, count + 2))
    rank = np.arange(len(order)) - np.repeat(first[:-1], np.diff(first))
    kept = places[order[rank < DENSE]]
    starts = np.concatenate([[0], np.minimum(np.diff(first), DENSE).cumsum()])
    return grid.to_world(np.stack(np.unravel_index(kept, grid.shape), axis=1)).astype(np.float32), starts


def _scattered(places: Ints, resolution: int) -> Ints:
    """A permutation of the voxels' flat indices: resolutions are powers of two, so odd factors and shifts permute."""
    bits = 3 * int(np.log2(resolution))
    last = (1 << bits) - 1
    mixed = (places * 0x9E3779B1) & last
    mixed ^= mixed >> (bits // 2)
    return (mixed * 0x85EBCA6B) & last


@njit(cache=True)
def _surface(labels):
    """Flat index of every voxel beside one of another label, and its own label."""
    r = labels.shape[0] - 2
    size = 0
    places = np.empty(r**3, np.int64)
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
                    places[size] = ((i - 1) * r + j - 1) * r + k - 1
                    owners[size] = own
                    size += 1
    return places[:size].copy(), owners[:size].copy()


def mean_chamfer(a: Floats32, starts_a: Ints, b: Floats32, starts_b: Ints) -> float:
    """Mean over all fragments, of both patterns, of the chamfer distance to the most alike one of the other [m].

    The chamfer distance of two fragments is the mean distance from points of one to the nearest of the other, both
    ways. The means over the fragments of a and of b count equally."""
    boxes_a, boxes_b = _boxes(a, starts_a), _boxes(b, starts_b)
    there = _best(a, starts_a, boxes_a, b, starts_b, boxes_b, SPARSE)
    back = _best(b, starts_b, boxes_b, a, starts_a, boxes_a, SPARSE)
    return 0.5 * float(there.mean() + back.mean())


def _boxes(points: Floats32, starts: Ints) -> Floats32:
    low = np.minimum.reduceat(points, starts[:-1], axis=0)
    high = np.maximum.reduceat(points, starts[:-1], axis=0)
    return np.stack([low, high], axis=1)


@njit(cache=True)
def _best(a, starts_a, boxes_a, b, starts_b, boxes_b, sparse) -> NDArray:
    """For each fragment of a the smallest chamfer distance to one of b, the least promising left out."""
    n, m = len(starts_a) - 1, len(starts_b) - 1
    best = np.full(n, np.inf)
    bound = np.empty(m)
    for f in range(n):
        own = a[starts_a[f] : starts_a[f + 1]]
        for g in range(m):
            other = b[starts_b[g] : starts_b[g + 1]]
            bound[g] = 0.5 * (_to_box(own, boxes_b[g], sparse) + _to_box(other, boxes_a[f], sparse))
        for g in np.argsort(bound):
            if bound[g] >= best[f]:
                break
            other = b[starts_b[g] : starts_b[g + 1]]
            found = 0.5 * (_one_way(own, other, sparse) + _one_way(other, own, sparse))
            best[f] = min(best[f], found)
    return best


@njit(cache=True)
def _to_box(points, box, sparse):
    """Mean distance to a box: no more than that to what is in it."""
    n = min(sparse, len(points))
    total = 0.0
    for p in range(n):
        squared = 0.0
        for axis in range(3):
            out = max(box[0, axis] - points[p, axis], points[p, axis] - box[1, axis], np.float32(0.0))
            squared += out * out
        total += np.sqrt(squared)
    return total / n


@njit(cache=True)
def _one_way(points, others, sparse):
    n = min(sparse, len(points))
    total = 0.0
    for p in range(n):
        x, y, z = points[p]
        nearest = np.float32(np.inf)
        for q in range(len(others)):
            dx, dy, dz = others[q, 0] - x, others[q, 1] - y, others[q, 2] - z
            nearest = min(nearest, dx * dx + dy * dy + dz * dz)
        total += np.sqrt(nearest)
    return total / n
