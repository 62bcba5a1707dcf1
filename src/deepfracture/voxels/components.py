"""Face-connected components of voxels, found by runs along the last axis and a disjoint-set forest.

Runs are rows (i, j, first k, one past the last k), in the order of memory.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry.disjoint_sets import find, union
from deepfracture.types import Labels
from deepfracture.voxels.cut_faces import cut_faces


def connected_labels(labels: Labels) -> Labels:
    """Labels 1..n of the face-connected components of every positive label, int32, shape as `labels` (3 axes).

    Components are numbered in the order of their first voxels."""
    return connected_components(labels, cut_faces(labels))


def connected_components(values: np.ndarray, cuts: NDArray[np.uint8]) -> Labels:
    """Labels 1..n of the voxels of positive value that connect across faces that are not cut, 0 elsewhere, int32.

    Components are numbered in the order of their first voxels.

    Args:
        values: Shape (a, b, c); bool for a mask.
        cuts: As in `Volume`, the same shape.
    """
    runs = uncut_runs(runs_inside(values), cuts)
    labels = np.zeros(values.shape, np.int32)
    paint_runs(labels, runs, components_of_runs(runs, cuts))
    return labels


@njit(cache=True)
def runs_inside(values: np.ndarray) -> np.ndarray:
    """Runs of voxels of positive value, int32, shape (n, 4)."""
    n0, n1, n2 = values.shape
    runs = np.empty((n0 * n1 * ((n2 + 1) // 2), 4), np.int32)  # memory that is not written to costs nothing
    count = 0
    for i in range(n0):
        for j in range(n1):
            inside = False
            for k in range(n2):
                if (values[i, j, k] > 0) != inside:
                    inside = not inside
                    if inside:
                        runs[count, 0], runs[count, 1], runs[count, 2] = i, j, k
                    else:
                        runs[count, 3] = k
                        count += 1
            if inside:
                runs[count, 3] = n2
                count += 1
    return runs[:count].copy()


@njit(cache=True)
def uncut_runs(runs: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """The same voxels, with runs split at the faces that are cut."""
    split = np.empty((np.sum(runs[:, 3] - runs[:, 2]), 4), np.int32)
    count = 0
    for n in range(len(runs)):
        i, j, first = runs[n, 0], runs[n, 1], runs[n, 2]
        bits = cuts[i, j]
        for k in range(first, runs[n, 3]):
            if bits[k] & 4 or k + 1 == runs[n, 3]:
                split[count, 0], split[count, 1], split[count, 2], split[count, 3] = i, j, first, k + 1
                count += 1
                first = k + 1
    return split[:count].copy()


@njit(cache=True)
def components_of_runs(runs: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """The component 1..n of each uncut run, int32, numbered in the order of their first runs."""
    side = cuts.shape[1]
    start = np.zeros(cuts.shape[0] * side + 1, np.int64)  # of each line along the last axis, in `runs`
    for n in range(len(runs)):
        start[runs[n, 0] * side + runs[n, 1] + 1] = n + 1
    for line in range(len(start) - 1):
        start[line + 1] = max(start[line], start[line + 1])
    parent = np.arange(len(runs)).astype(np.int32)
    for line in range(len(start) - 1):
        i, j = line // side, line % side
        if i > 0:
            _unite_lines(parent, runs, start, line - side, line, cuts[i - 1, j], 1)
        if j > 0:
            _unite_lines(parent, runs, start, line - 1, line, cuts[i, j - 1], 2)
    names = np.zeros(len(runs), np.int32)
    count = 0
    for n in range(len(runs)):
        if parent[n] == n:
            count += 1
            names[n] = count
        else:
            names[n] = names[find(parent, n)]
    return names


@njit(cache=True)
def _unite_lines(parent, runs, start, behind, here, bits, bit):
    """Unite the runs of two neighbouring lines where the `bits` of the one behind have a voxel that is not cut."""
    m, n = start[behind], start[here]
    while m < start[behind + 1] and n < start[here + 1]:
        end = min(runs[m, 3], runs[n, 3])
        for k in range(max(runs[m, 2], runs[n, 2]), end):
            if not bits[k] & bit:
                union(parent, m, n)
                break
        if runs[m, 3] == end:
            m += 1
        else:
            n += 1


@njit(cache=True)
def paint_runs(labels: np.ndarray, runs: np.ndarray, names: np.ndarray) -> None:
    """Write the name of each run to its voxels."""
    for n in range(len(runs)):
        labels[runs[n, 0], runs[n, 1], runs[n, 2] : runs[n, 3]] = names[n]
