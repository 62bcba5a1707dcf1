"""Patterns of a whole shape for its fragments: impacts are mapped to the whole, patterns back to the fragment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from deepfracture.geometry import voxels_inside
from deepfracture.types import RESOLUTIONS, Floats, FracturePattern, Grid, Impact, Shape
from deepfracture.voxels import connected_labels


def fragment_grid(piece: Shape, whole: Grid) -> Grid:
    """A grid around a fragment whose voxels are no larger than those of the whole, unless there is none finer."""
    return Grid(next(r for r in RESOLUTIONS if r >= min(whole.resolution * piece.size, RESOLUTIONS[-1])))


def impact_on_whole(impact: Impact, piece: Shape) -> Impact:
    """An impact in a fragment's own frame, at the same place of the whole.

    Its impulses and radius stay those of the fragment's frame, where stress and speed are as in a whole of
    the same size."""
    return replace(impact, position=impact.position * piece.size + _centre_in_whole(piece))


def pattern_on_fragment(pattern: FracturePattern, piece: Shape) -> FracturePattern:
    """A pattern of the whole restricted to a fragment, on the fragment's own grid.

    Each label's distance is interpolated trilinearly between voxel centres and the largest wins, so that cracks cross
    the edges of the whole's grid where `FracturePattern.distance` puts them. The new distance is the lead of the
    largest over the second, in the fragment's units.

    Args:
        pattern: On the grid of the whole.
        piece: A fragment in its own frame (`world.refracture.fragment_as_shape`).
    """
    grid = fragment_grid(piece, pattern.grid)
    voxels = np.argwhere(voxels_inside(piece.mesh, grid))
    places = pattern.grid.to_index(grid.to_world(voxels) * piece.size + _centre_in_whole(piece))
    own, lead = _interpolate(pattern.labels, pattern.distance, places)
    labels, distance = np.zeros(grid.shape, np.int32), np.zeros(grid.shape, np.float32)
    labels[tuple(voxels.T)], distance[tuple(voxels.T)] = own, lead / piece.size
    return FracturePattern(grid, connected_labels(labels), distance)


def _centre_in_whole(piece: Shape) -> Floats:
    """Centre of a piece's box in the frame of the whole."""
    assert piece.whole is not None
    return (piece.centre - piece.whole.centre) / piece.whole.scale


@njit(cache=True)
def _interpolate(labels, distance, places):
    """Label with the largest interpolated distance at each fractional index, shape (n,), and its lead, shape (n,).

    Where no voxel around is inside the whole (fragments reach half a voxel out of it), the nearest one counts."""
    r = labels.shape[0]
    own, lead = np.zeros(len(places), np.int32), np.zeros(len(places), np.float32)
    seen, weight = np.zeros(8, np.int32), np.zeros(8)
    low, part = np.zeros(3, np.int64), np.zeros(3)
    for p in range(len(places)):
        for k in range(3):
            at = min(max(places[p, k], 0.0), r - 1.0)
            low[k] = min(int(at), r - 2)
            part[k] = at - low[k]
        count, total = 0, 0.0
        for corner in range(8):
            a, b, c = (corner >> 2) & 1, (corner >> 1) & 1, corner & 1
            label = labels[low[0] + a, low[1] + b, low[2] + c]
            if label == 0:
                continue
            share = (part[0] if a else 1 - part[0]) * (part[1] if b else 1 - part[1]) * (part[2] if c else 1 - part[2])
            total += share
            n = 0
            while n < count and seen[n] != label:
                n += 1
            if n == count:
                seen[n], weight[n] = label, 0.0
                count += 1
            weight[n] += share * distance[low[0] + a, low[1] + b, low[2] + c]
        best = 0
        for n in range(1, count):
            if weight[n] > weight[best]:
                best = n
        if count == 0:
            own[p], lead[p] = _nearest_label(labels, distance, places[p])
            continue
        second = 0.0
        for n in range(count):
            if n != best:
                second = max(second, weight[n])
        own[p], lead[p] = seen[best], (weight[best] - second) / max(total, 1e-9)
    return own, lead


@njit(cache=True)
def _nearest_label(labels, distance, place):
    """Label and distance of the voxel inside that is nearest to a fractional index."""
    r = labels.shape[0]
    middle = np.empty(3, np.int64)
    for k in range(3):
        middle[k] = min(max(int(np.round(place[k])), 0), r - 1)
    for reach in range(1, r):
        best, label, value = np.inf, 0, 0.0
        for i in range(max(middle[0] - reach, 0), min(middle[0] + reach + 1, r)):
            for j in range(max(middle[1] - reach, 0), min(middle[1] + reach + 1, r)):
                for k in range(max(middle[2] - reach, 0), min(middle[2] + reach + 1, r)):
                    away = (i - place[0]) ** 2 + (j - place[1]) ** 2 + (k - place[2]) ** 2
                    if labels[i, j, k] > 0 and away < best:
                        best, label, value = away, labels[i, j, k], distance[i, j, k]
        if label > 0:
            return label, value
    return 0, 0.0
