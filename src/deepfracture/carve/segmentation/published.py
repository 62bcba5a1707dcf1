"""The paper's own segmentation (section 5.2): extended maxima of an absolute depth, then a watershed from them."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.carve.segmentation.segment import BAND
from deepfracture.carve.segmentation.watershed import BUCKETS
from deepfracture.geometry.disjoint_sets import find
from deepfracture.geometry.oriented_points import FAR
from deepfracture.types import BadInput, FracturePattern, Volume

DEPTH = 0.04
"""The paper's increment [m]: a maximum less deep than this above its pass is none."""


def segment_as_published(volume: Volume, *, tolerance: float = DEPTH) -> FracturePattern:
    """Segmentation of a GS-SDF as the paper does it; `segment` loses less.

    Its maxima are the extended ones: a region keeps its own label when its peak rises above the pass to a higher one by
    at least `tolerance`, in metres, whatever the size of the fragment. A watershed from them labels the rest: a voxel
    goes to the region of its highest neighbour across a face. The band of values above -BAND takes part; the labels end
    at the zero level. The volume's cut faces are ignored, as the paper has none.

    The paper runs a morphological reconstruction, then a watershed (MorphoLibJ). A union-find forest that takes the
    voxels from the highest down merges and labels in one pass and finds the same regions: the persistence of a maximum
    is the depth at which the reconstruction fills it (Edelsbrunner, Letscher and Zomorodian 2002). There are no dams
    between regions.

    Args:
        volume: The GS-SDF.
        tolerance: Least depth of a maximum above its pass [m].

    Returns:
        Labels 1..n where the value is positive; `distance` is the value itself.

    Raises:
        BadInput: tolerance is negative or not finite.
    """
    if not 0 <= tolerance < np.inf:
        raise BadInput(f"tolerance must be zero or more and finite [m], got {tolerance}")
    heights = np.pad(np.minimum(volume.values, FAR), 1, constant_values=-np.inf)
    flat = heights.reshape(-1)
    order = _descending(flat, -BAND)
    labels = np.zeros(flat.size, np.int32)
    parent = np.zeros(len(order) + 1, np.int32)
    steps = np.array([heights.shape[1] * heights.shape[2], heights.shape[2], 1])
    count = _label_by_height(flat, order, np.concatenate([-steps, steps]), labels, parent, float(tolerance))
    _renumber(flat, order, parent, labels, count)
    inner = labels.reshape(heights.shape)[1:-1, 1:-1, 1:-1]
    return FracturePattern(volume.grid, inner, np.maximum(volume.values, 0))


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
def _label_by_height(
    heights: np.ndarray,
    order: np.ndarray,
    steps: np.ndarray,
    labels: np.ndarray,
    parent: np.ndarray,
    tolerance: float,
) -> int:
    """Fill `labels` and the forest `parent` (zero on entry); returns the number of maxima."""
    peak = np.zeros(len(parent), np.float32)
    count = 0
    for v in order:
        region, highest = 0, -np.inf
        for step in steps:
            if labels[v + step] > 0 and heights[v + step] > highest:
                region, highest = int(labels[v + step]), heights[v + step]
        if region == 0:
            count += 1
            parent[count], peak[count] = count, heights[v]
            region = count
        region = find(parent, region)
        labels[v] = region
        for step in steps:
            if labels[v + step] == 0:
                continue
            other = find(parent, int(labels[v + step]))
            if other == region:
                continue
            low, high = (region, other) if peak[region] < peak[other] else (other, region)
            if peak[low] - heights[v] < tolerance:
                parent[low] = high
                region = high
    return count


@njit(cache=True)
def _renumber(heights: np.ndarray, order: np.ndarray, parent: np.ndarray, labels: np.ndarray, count: int) -> None:
    """Number the regions from 1 by their peaks, highest first, and clear the band outside."""
    name = np.zeros(count + 1, np.int32)
    names = 0
    for v in order:
        region = find(parent, int(labels[v]))
        if heights[v] <= 0:
            labels[v] = 0
            continue
        if name[region] == 0:
            names += 1
            name[region] = names
        labels[v] = name[region]
