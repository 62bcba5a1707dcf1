"""Watershed segmentation from the peaks of a field, by catchment basins.

Flooding voxel by voxel, from the highest down (Vincent and Soille 1991), each voxel takes the region of its steepest
higher neighbour, and regions merge where they meet. Which neighbour that is does not depend on the merging. So the
lattice is divided first, in the order of memory, into catchment basins (all voxels whose paths of steepest ascent end
at one peak), and only the voxels where two basins meet have to be taken from the highest down, with the few that tell
when a basin has grown to the minimum size. The regions are the same."""

from __future__ import annotations

from itertools import product

import numpy as np
from numba import njit

from deepfracture.geometry.disjoint_sets import find
from deepfracture.geometry.oriented_points import FAR
from deepfracture.types import Floats32, Ints, Labels

BUCKETS = 1 << 16
"""Levels into which heights are sorted: finer than float16 noise, so the order within a level is free."""
PEAK, KNOWN, OUTSIDE = 255, 254, 253
"""In place of the number of a step: no neighbour is higher; the basin is known; the voxel does not take part."""
EARLY = 64
"""Among the events at a voxel; the lower bits are the steps across faces."""
UNASSIGNED = -1
"""Basin of a voxel below zero without a higher neighbour."""


def watershed(values: Floats32, spacing: float, lowest: float, tolerance: float, min_voxels: int) -> Labels:
    """Regions 1..n where the value is positive, numbered by their peaks, the highest first; 0 elsewhere.

    Args:
        values: [m], shape (a, b, c).
        spacing: Of the voxels [m].
        lowest: Only voxels above this take part [m].
        tolerance, min_voxels: As in `segment`.
    """
    labels = np.zeros(values.shape, np.int32)
    low, high = _bounding_box(values, np.float32(lowest - spacing))
    box = tuple(slice(first, end) for first, end in zip(low, high, strict=True))
    # Larger values are no distances, and would leave no levels to sort by.
    top = np.float32(min(values[box].max(initial=-FAR), FAR)) / np.float32(spacing)
    if not top > lowest / spacing:
        return labels
    # numpy's arrays come on large pages, Numba's do not.
    heights = np.full(high - low + 2, -np.inf, np.float32)
    level = np.full(heights.size, BUCKETS, np.int32)
    flat, shape = heights.reshape(-1), heights.shape
    _levels(values, low, high, np.float32(spacing), lowest / spacing, float(top), heights, level.reshape(shape))
    steps, lengths = _neighbour_steps(shape)
    ascent = np.full(level.size, OUTSIDE, np.uint8)
    spans = _steepest_ascent(flat, level, shape, steps, lengths, ascent)
    basin = np.full(level.size, 0, np.int32)
    peaks, size, incomplete = _catchment_basins(flat, ascent, spans, steps, np.empty(level.size, np.int32), basin)
    if incomplete:
        unassigned = np.flatnonzero(basin == UNASSIGNED)
        peaks, size = _assign_rest(
            flat, level, basin, peaks, size, unassigned[np.argsort(level[unassigned], kind="stable")], steps, lengths
        )
    early = _early_voxels(flat, level, basin, size, spans, min_voxels)
    meetings = _sort_events(flat, level, basin, *_find_events(level, basin, early, spans, steps[:6]), steps[:6])
    peak = np.concatenate([np.zeros(1, np.float32), flat[peaks]])
    region = _merge_basins(meetings, peak, tolerance, min_voxels)
    names = _number_regions(region, 1 + np.lexsort((peaks, level[peaks])))
    _paint(heights, basin.reshape(shape), names, labels[box])
    return labels


def _neighbour_steps(shape: tuple[int, ...]) -> tuple[Ints, Floats32]:
    """Flat index steps to the 26 neighbours, the 6 across a face first, and their lengths [voxels]."""
    steps = np.array([step for step in product((-1, 0, 1), repeat=3) if any(step)])
    lengths = np.sqrt((steps**2).sum(axis=1))
    order = np.argsort(lengths, kind="stable")
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    return (steps @ strides)[order], lengths[order].astype(np.float32)


@njit(cache=True)
def _bounding_box(values, lowest):
    """First and end index along each axis of the voxels above `lowest`, shape (3,) each."""
    low, high = np.array(values.shape), np.zeros(3, np.int64)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            line = values[i, j]
            above = 0
            for k in range(len(line)):
                above += line[k] > lowest
            if above == 0:
                continue
            first, end = 0, len(line)
            while not line[first] > lowest:
                first += 1
            while not line[end - 1] > lowest:
                end -= 1
            low[0], low[1], low[2] = min(low[0], i), min(low[1], j), min(low[2], first)
            high[0], high[1], high[2] = max(high[0], i + 1), max(high[1], j + 1), max(high[2], end)
    return np.minimum(low, high), high


@njit(cache=True)
def _levels(values, low, high, spacing, lowest, top, heights, level):
    """The values of a box in voxels, within the border of `heights`, and the `level` of each, 0 for `top`; voxels that
    do not take part keep the last."""
    scale = (BUCKETS - 1) / (top - lowest)
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            x, y = i - low[0] + 1, j - low[1] + 1
            line = values[i, j][low[2] : high[2]]
            _quantise(line, heights[x, y][1:-1], level[x, y][1:-1], spacing, lowest, top, scale)


@njit(cache=True, error_model="numpy")
def _quantise(values, heights, level, spacing, lowest, top, scale):
    """Heights [voxels] and levels of one line of voxels."""
    most = np.float32(FAR)
    for k in range(len(values)):
        height = (values[k] if values[k] < most else most) / spacing
        depth = np.int32((top - height) * scale)
        heights[k] = height
        level[k] = depth if height > lowest else np.int32(BUCKETS)


@njit(cache=True)
def _steepest_ascent(heights, level, shape, steps, lengths, ascent):
    """Fill `ascent` with the number of the step to the steepest neighbour that comes before each voxel in the order of
    the flood, PEAK if there is none; it is OUTSIDE for voxels that do not take part. Returns where the remaining part
    of each line starts and ends, shape (n, 2).

    Voxels of one level come in the order of memory. Neighbours that no crack can separate from a voxel have precedence:
    heights [voxels] change by at most the length of a step, so two that sum to more than the step have no zero between
    them."""
    m = shape[2]
    spans = np.zeros((shape[0] * shape[1], 2), np.int64)
    best, number, sure = np.empty(m, np.float32), np.empty(m, np.int32), np.empty(m, np.int32)
    for line in range(shape[1] + 1, (shape[0] - 1) * shape[1] - 1):
        first, end = line * m + 1, (line + 1) * m - 1
        while first < end and level[first] == BUCKETS:
            first += 1
        while first < end and level[end - 1] == BUCKETS:
            end -= 1
        if first == end:
            continue
        count = end - first
        spans[line] = first, end
        best[:count], number[:count], sure[:count] = -np.inf, PEAK, 0
        for n in range(len(steps)):
            _compare_neighbour(
                heights[first:end],
                heights[first + steps[n] : end + steps[n]],
                level[first:end],
                level[first + steps[n] : end + steps[n]],
                np.int32(steps[n] < 0),
                lengths[n],
                np.int32(n),
                best,
                number,
                sure,
            )
        for k in range(count):
            ascent[first + k] = number[k] if level[first + k] < BUCKETS else OUTSIDE
    return spans


@njit(cache=True, error_model="numpy")
def _compare_neighbour(mine, theirs, own, other, tie, length, n, best, number, sure):
    """Take step `n` for one line of voxels, where it is steeper than the `best`."""
    for k in range(len(mine)):
        slope = (theirs[k] - mine[k]) / length
        held = np.int32(theirs[k] + mine[k] > length)
        steeper = (other[k] < own[k] + tie) & ((held > sure[k]) | ((held == sure[k]) & (slope > best[k])))
        best[k] = slope if steeper else best[k]
        number[k] = n if steeper else number[k]
        sure[k] = held if steeper else sure[k]


@njit(cache=True)
def _catchment_basins(heights, ascent, spans, steps, path, basin):
    """Fill `basin` with 1, 2, ... or UNASSIGNED; it is 0 for voxels that do not take part. `ascent` and `path` are used
    up.

    Returns the peak of each basin, its number of voxels above zero, shape (n + 1,), and whether any are UNASSIGNED."""
    peaks = np.empty(len(heights), np.int32)
    size = np.zeros(len(heights) + 1, np.int32)
    count, incomplete = 0, False
    for line in range(len(spans)):
        for v in range(spans[line, 0], spans[line, 1]):
            if ascent[v] == OUTSIDE:
                continue
            length, here = 0, v
            while ascent[here] < OUTSIDE:
                path[length] = here
                length += 1
                here += steps[ascent[here]]
            if ascent[here] == KNOWN:
                found = basin[here]
            elif heights[here] > 0:
                peaks[count] = here
                count += 1
                found = np.int32(count)
            else:
                found, incomplete = np.int32(UNASSIGNED), True  # the band connects regions, it starts none
            basin[here], ascent[here] = found, KNOWN
            for n in range(length):
                basin[path[n]], ascent[path[n]] = found, KNOWN
            if found > 0 and heights[v] > 0:
                size[found] += 1
    return peaks[:count].copy(), size[: count + 1].copy(), incomplete


@njit(cache=True)
def _assign_rest(heights, level, basin, peaks, size, unassigned, steps, lengths):
    """Assign voxels, from the highest down, to the basin of their steepest neighbour that has one.

    Returns the peaks and sizes, with those of new basins."""
    found, sizes = np.empty(len(peaks) + len(unassigned), np.int32), np.zeros(len(size) + len(unassigned), np.int32)
    found[: len(peaks)], sizes[: len(size)] = peaks, size
    count = len(peaks)
    for v in unassigned:
        best, steepest, sure = np.int32(UNASSIGNED), np.float32(-np.inf), False
        for n in range(len(steps)):
            u = v + steps[n]
            if basin[u] <= 0 or not _is_before(level, u, v):
                continue
            slope = (heights[u] - heights[v]) / lengths[n]
            held = heights[u] + heights[v] > lengths[n]
            if (held and not sure) or (held == sure and slope > steepest):
                best, steepest, sure = basin[u], slope, held
        if best == UNASSIGNED and heights[v] > 0:
            found[count] = v
            count += 1
            best = count
        basin[v] = best
        if heights[v] > 0:
            sizes[best] += 1
    return found[:count].copy(), sizes[: count + 1].copy()


@njit(cache=True, inline="always")
def _is_before(level, one, other):
    """Whether a voxel comes before another in the order of the flood."""
    return level[one] < level[other] or (level[one] == level[other] and one < other)


@njit(cache=True)
def _early_voxels(heights, level, basin, size, spans, least):
    """Whether a voxel is one of the `least` first above zero of its basin, in the order of the flood."""
    early = np.zeros(len(basin), np.bool_)
    start = np.zeros(len(size) + 1, np.int64)
    for b in range(1, len(size)):
        start[b + 1] = start[b] + min(size[b], least)
    heap = np.empty(start[-1], np.int64)  # of each basin, the last on top
    held = np.zeros(len(size), np.int64)
    worst = np.full(len(size), np.int32(BUCKETS if least > 0 else -1))
    for line in range(len(spans)):
        for v in range(spans[line, 0], spans[line, 1]):
            b = basin[v]
            if b <= 0 or level[v] > worst[b] or not heights[v] > 0:
                continue
            key = np.int64(level[v]) << 32 | v
            own = heap[start[b] : start[b + 1]]
            if held[b] < len(own):
                _heap_push(own, held[b], key)
                held[b] += 1
            elif key < own[0]:
                _heap_replace(own, key)
            if held[b] == len(own):
                worst[b] = own[0] >> 32
    for key in heap:
        early[key & 0xFFFFFFFF] = True
    return early


@njit(cache=True)
def _heap_push(heap, n, key):
    """Add a key to a max-heap of n."""
    while n > 0 and heap[(n - 1) // 2] < key:
        heap[n] = heap[(n - 1) // 2]
        n = (n - 1) // 2
    heap[n] = key


@njit(cache=True)
def _heap_replace(heap, key):
    """Replace the greatest key of a max-heap by a smaller one."""
    n = 0
    while 2 * n + 1 < len(heap):
        child = 2 * n + 1
        if child + 1 < len(heap) and heap[child + 1] > heap[child]:
            child += 1
        if heap[child] <= key:
            break
        heap[n] = heap[child]
        n = child
    heap[n] = key


@njit(cache=True)
def _find_events(level, basin, early, spans, steps):
    """Voxels with an event for their basin, in order, and the events: bit EARLY, it is one of the basin's `early`
    voxels; bit n, the basin meets another, which is before it in the order of the flood, across step n."""
    voxels, events = np.empty(len(basin), np.int32), np.empty(len(basin), np.uint8)
    found = np.empty((spans[:, 1] - spans[:, 0]).max(), np.uint8)
    count = 0
    for line in range(len(spans)):
        here, end = spans[line]
        for v in range(here, end):
            found[v - here] = np.uint8(early[v]) * np.uint8(EARLY)
        for n in range(len(steps)):
            there, beyond = here + steps[n], end + steps[n]
            tie = np.int32(steps[n] < 0)
            _mark_meetings(
                basin[here:end], basin[there:beyond], level[here:end], level[there:beyond], tie, 1 << n, found
            )
        for v in range(here, end):
            if found[v - here]:
                voxels[count], events[count] = v, found[v - here]
                count += 1
    return voxels[:count].copy(), events[:count].copy()


@njit(cache=True)
def _mark_meetings(mine, theirs, own, other, tie, bit, found):
    """Mark the voxels of one line at which two basins meet across one step."""
    for k in range(len(mine)):
        meets = (mine[k] > 0) & (theirs[k] > 0) & (mine[k] != theirs[k]) & (other[k] < own[k] + tie)
        found[k] |= np.uint8(meets) * np.uint8(bit)


@njit(cache=True)
def _sort_events(heights, level, basin, voxels, events, steps):
    """The events in the order of the flood (counting sort).

    Returns shape (n, 2) and (n,): basin and 0 for an early voxel, at height 0; two basins where the first meets the
    second, and the mean height of the two voxels."""
    start = np.zeros(BUCKETS + 1, np.int64)
    for m in range(len(voxels)):
        rest = events[m]
        while rest:
            start[level[voxels[m]] + 1] += 1
            rest &= rest - 1
    for bucket in range(BUCKETS):
        start[bucket + 1] += start[bucket]
    pairs, passes = np.zeros((start[BUCKETS], 2), np.int32), np.zeros(start[BUCKETS], np.float64)
    for m in range(len(voxels)):
        v, rest = voxels[m], events[m]
        at = start[level[v]]
        if rest & EARLY:
            pairs[at, 0] = basin[v]
            at += 1
        rest &= EARLY - 1
        n = 0
        while rest:
            if rest & 1:
                u = v + steps[n]
                # Halfway between the two voxels a pass without a crack is no lower than their mean.
                pairs[at, 0], pairs[at, 1], passes[at] = basin[v], basin[u], 0.5 * (heights[u] + heights[v])
                at += 1
            rest >>= 1
            n += 1
        start[level[v]] = at
    return pairs, passes


@njit(cache=True)
def _merge_basins(meetings, peak, tolerance, min_voxels):
    """The basin that stands for the region of each basin, itself included; `peak`: the height of each, from 1 on."""
    parent = np.arange(len(peak)).astype(np.int32)
    size = np.zeros(len(peak), np.int64)
    pairs, passes = meetings
    for n in range(len(pairs)):
        region = find(parent, pairs[n, 0])
        if pairs[n, 1] == 0:
            size[region] += 1
            continue
        other = find(parent, pairs[n, 1])
        if other == region:
            continue
        low, high = (region, other) if peak[region] < peak[other] else (other, region)
        if peak[low] - passes[n] < tolerance * peak[low] or size[low] < min_voxels:
            parent[low] = high
            size[high] += size[low]
    for b in range(len(parent)):
        parent[b] = find(parent, b)
    return parent


def _number_regions(region: Labels, order: Ints) -> Labels:
    """Numbers 1..n for the regions of the basins, 0 for none, by the `order` of the basins' peaks."""
    _, first = np.unique(region[order], return_index=True)
    names = np.zeros(len(region), np.int32)
    names[region[order[np.sort(first)]]] = np.arange(1, len(first) + 1)
    return names[region]


@njit(cache=True)
def _paint(heights, basin, names, labels):
    """Write the region of each voxel above zero."""
    n0, n1, n2 = labels.shape
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                if heights[i + 1, j + 1, k + 1] > 0:
                    labels[i, j, k] = names[basin[i + 1, j + 1, k + 1]]
