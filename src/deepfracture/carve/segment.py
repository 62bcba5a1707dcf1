"""From a GS-SDF to fragments: a flood from the peaks of the field (paper, section 5.2)."""

from __future__ import annotations

from itertools import product

import numpy as np
from numba import njit

from deepfracture.carve.join import joined, root
from deepfracture.types import BadInput, FracturePattern, Volume

CAGE = 0.03
"""Depth [m] of the shell outside the zero level that the flood may pass through (the paper's epsilon)."""
BUCKETS = 1 << 16
"""Levels into which values are sorted: finer than float16 noise, so the order within a level is free."""
SURE = 10.0
"""Added to the slope [1, at most 1 in a distance field] towards a voxel that no crack can separate."""


def segment(volume: Volume, *, tolerance: float = 0.5, min_voxels: int = 8) -> FracturePattern:
    """Caged segmentation of a GS-SDF into fragments.

    Where the cuts are known, what they part is parted and what they do not is not (`join`), whatever the values.
    Otherwise the values have to tell:

    Voxels are flooded from the highest value down. A peak starts a region; where two regions meet, at
    the pass between them, the one with the lower peak joins the other if it is shallow - its peak rises
    above the pass by less than `tolerance` of the peak's own height - or holds fewer than `min_voxels`
    voxels; otherwise they stay apart for good, without a dam between them. Depth is measured against
    the peak, not in metres as in the paper, because a crack's pass lies near zero whatever the size of
    the fragment, while the necks inside one fragment scale with it. A voxel goes to the region of its
    steepest higher neighbour.

    As in the paper the flood may pass through a shell (the cage) of thickness CAGE outside the zero
    level: it leads from thin parts, whose voxels hang together badly, to the fragment they belong to.
    The labels themselves end at the zero level.

    Args:
        volume: The GS-SDF; predicted ones may be blurred.
        tolerance: Relative depth, 0 to 1: higher merges more.
        min_voxels: Smallest fragment, unless it touches no other.

    Returns:
        Labels 1..n where the value is positive. Its `distance` is the value itself, the distance to the
        nearest boundary: to the crack near cracks, but to the surface near the surface.

    Raises:
        BadInput: tolerance or min_voxels is out of range.
    """
    if not 0 <= tolerance < 1:
        raise BadInput(f"tolerance must lie in [0, 1), got {tolerance}")
    if min_voxels < 0:
        raise BadInput(f"min_voxels must be zero or more, got {min_voxels}")
    if volume.cuts is not None:
        labels = joined(volume.values > 0, volume.cuts, min_voxels)
        return FracturePattern(volume.grid, labels, np.maximum(volume.values, 0))
    heights = np.pad(volume.values / np.float32(volume.grid.spacing), 1, constant_values=-np.inf)
    flat = heights.reshape(-1)
    order = _descending(flat, -CAGE / volume.grid.spacing)
    labels = np.zeros(flat.size, np.int32)
    steps, lengths = _neighbours(heights.shape)
    _flood(flat, order, steps, lengths, labels, tolerance, min_voxels)
    inner = labels.reshape(heights.shape)[1:-1, 1:-1, 1:-1]
    return FracturePattern(volume.grid, inner, np.maximum(volume.values, 0))


def _neighbours(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Flat index steps to the 26 neighbours, the 6 across a face first, and their lengths [voxels]."""
    steps = np.array([step for step in product((-1, 0, 1), repeat=3) if any(step)])
    lengths = np.sqrt((steps**2).sum(axis=1))
    order = np.argsort(lengths, kind="stable")
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    return (steps @ strides)[order], lengths[order].astype(np.float32)


@njit(cache=True)
def _descending(heights: np.ndarray, lowest: float) -> np.ndarray:
    """Indices of the values above `lowest`, from the highest down (counting sort)."""
    count, top = 0, lowest
    for height in heights:
        if height > lowest:
            count += 1
            top = max(top, height)
    order = np.empty(count, np.int64)
    if count == 0:
        return order
    scale = (BUCKETS - 1) / (top - lowest)
    start = np.zeros(BUCKETS + 1, np.int64)
    for height in heights:
        if height > lowest:
            start[int((top - height) * scale) + 1] += 1
    for bucket in range(BUCKETS):
        start[bucket + 1] += start[bucket]
    for v in range(len(heights)):
        if heights[v] > lowest:
            bucket = int((top - heights[v]) * scale)
            order[start[bucket]] = v
            start[bucket] += 1
    return order


@njit(cache=True)
def _flood(
    heights: np.ndarray,
    order: np.ndarray,
    steps: np.ndarray,
    lengths: np.ndarray,
    labels: np.ndarray,
    tolerance: float,
    min_voxels: int,
) -> None:
    """Fill `labels` (zero on entry), regions kept as a union-find forest with peak and size."""
    parent = np.zeros(len(order) + 1, np.int32)
    peak = np.zeros(len(order) + 1, np.float32)
    size = np.zeros(len(order) + 1, np.int32)
    count = 0
    for v in order:
        region = _uphill(heights, labels, steps, lengths, v)
        if region == 0:
            if heights[v] <= 0:
                continue  # the cage connects regions, it starts none
            count += 1
            parent[count], peak[count] = count, heights[v]
            region = count
        region = root(parent, region)
        labels[v] = region
        size[region] += heights[v] > 0
        for n in range(6):
            if labels[v + steps[n]] == 0:
                continue
            other = root(parent, int(labels[v + steps[n]]))
            if other == region:
                continue
            low, high = (region, other) if peak[region] < peak[other] else (other, region)
            # Halfway between the two voxels a pass without a crack is no lower than their mean.
            crest = 0.5 * (heights[v + steps[n]] + heights[v])
            if peak[low] - crest < tolerance * peak[low] or size[low] < min_voxels:
                parent[low] = high
                size[high] += size[low]
                region = high
    _rename(heights, order, parent, labels, count)


@njit(cache=True, inline="always")
def _uphill(heights: np.ndarray, labels: np.ndarray, steps: np.ndarray, lengths: np.ndarray, v: int) -> int:
    """Label of the steepest flooded neighbour of v, 0 if none is flooded.

    Neighbours that no crack can separate from v come first: heights [voxels] change by at most the
    length of a step, so two that sum to more than the step have no zero between them."""
    best, steepest = 0, -np.inf
    for n in range(26):
        u = v + steps[n]
        if labels[u] > 0:
            slope = (heights[u] - heights[v]) / lengths[n]
            if heights[u] + heights[v] > lengths[n]:
                slope += SURE
            if slope > steepest:
                best, steepest = int(labels[u]), slope
    return best


@njit(cache=True)
def _rename(heights: np.ndarray, order: np.ndarray, parent: np.ndarray, labels: np.ndarray, count: int) -> None:
    """Number the regions from 1 by their peaks, highest first, and clear the cage."""
    name = np.zeros(count + 1, np.int32)
    names = 0
    for v in order:
        region = root(parent, int(labels[v]))
        if heights[v] <= 0:
            labels[v] = 0
            continue
        if name[region] == 0:
            names += 1
            name[region] = names
        labels[v] = name[region]
