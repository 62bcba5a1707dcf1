"""What becomes of components too small to be fragments: each joins a neighbour.

Three rules, for three kinds of input. Simulated fragments and solids merge smallest first into the neighbour of the
largest common area (`merge_graph`). Where a volume's cut faces are known, whole groups merge at once, by contacts at
edges and corners too, because a body thinner than a voxel has no others (`components_of_at_least`). Noise of a network
takes the label that surrounds it most (`relabel_small_components`), in one pass that a prediction can afford.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from itertools import product
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components as graph_components

from deepfracture.types import Ints, Labels
from deepfracture.voxels.components import components_of_runs, paint_runs, runs_inside, uncut_runs

Area = TypeVar("Area", int, float)


def merge_graph(
    sizes: NDArray, contacts: Sequence[dict[int, Area]], small: Ints, smallest: float, *, larger_first: bool = False
) -> Ints:
    """The node that each node ends up in, shape (n,): those below `smallest`, smallest first, join a neighbour.

    Each joins the neighbour of the largest common area; among equals the larger one if `larger_first`, then the first.
    A node without neighbours stays.

    Args:
        sizes: Of all nodes, shape (n,). Becomes that of the merged nodes, at the nodes that stay.
        contacts: For each node its neighbours and their common area. Used up: empty for the nodes that have merged.
        small: The nodes below `smallest`.
        smallest: Least size of a node that stays.
    """
    target = np.arange(len(sizes))
    queue = [(sizes[node].item(), node) for node in small.tolist()]
    heapq.heapify(queue)
    while queue:
        size, node = heapq.heappop(queue)
        beside = contacts[node]
        if size != sizes[node] or target[node] != node or not beside:
            continue  # it has grown or merged since, or touches nothing
        into = max(beside, key=lambda other: (beside[other], sizes[other] if larger_first else 0, -other))
        target[node] = into
        sizes[into] += size
        for other, area in beside.items():
            del contacts[other][node]
            if other != into:
                contacts[into][other] = contacts[other][into] = contacts[into].get(other, 0) + area
        beside.clear()
        if sizes[into] < smallest:
            heapq.heappush(queue, (sizes[into].item(), into))
    while (target[target] != target).any():  # what took a node in may itself have joined another
        target = target[target]
    return target


def merge_small_components(labels: Labels, smallest: int) -> Labels:
    """Give each label below `smallest` voxels, smallest first, to the neighbour it shares most faces with.

    What touches nothing goes to the nearest large component: voxels that connect by an edge only, in a thin tip.
    Labels are renumbered without gaps."""
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    present = sizes > 0
    small = np.flatnonzero(present & (sizes < smallest))
    target = merge_graph(sizes, _label_contacts(labels) if len(small) else [], small, smallest)
    kept = np.unique(target[present])
    merged = np.where(present, np.searchsorted(kept, target) + 1, 0).astype(np.int32)[labels]
    large = np.append(False, sizes[kept] >= smallest)
    return merged if large[1:].all() or not large.any() else _nearest_large(merged, large)


def _nearest_large(labels: Labels, large: np.ndarray) -> Labels:
    """Labels with only the `large` ones (by label) left, renumbered; their voxels take in the others."""
    nearest = distance_transform_edt(~large[labels], return_distances=False, return_indices=True)
    number = np.where(large, np.cumsum(large), 0).astype(np.int32)
    return np.where(labels > 0, number[labels[tuple(np.asarray(nearest))]], 0).astype(np.int32)


def _label_contacts(labels: Labels) -> list[dict[int, int]]:
    """For each label the labels that touch it and how many faces they share."""
    count = int(labels.max()) + 1
    touching: list[dict[int, int]] = [{} for _ in range(count)]
    keys, shared = np.unique(_face_pairs(labels), return_counts=True)
    for a, b, faces in zip((keys // count).tolist(), (keys % count).tolist(), shared.tolist(), strict=True):
        touching[a][b] = touching[b][a] = faces
    return touching


@njit(cache=True)
def _face_pairs(labels):
    """The two labels at each face between unlike voxels, as low * count + high with count = highest label + 1."""
    nx, ny, nz = labels.shape
    count = np.int64(labels.max()) + 1
    keys = [np.int64(0) for _ in range(0)]
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                here = labels[i, j, k]
                if here == 0:
                    continue
                for axis in range(3):
                    a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                    there = labels[a, b, c] if a < nx and b < ny and c < nz else here
                    if there != here and there != 0:
                        keys.append(min(here, there) * count + max(here, there))
    return np.array(keys)


def components_of_at_least(values: np.ndarray, cuts: NDArray[np.uint8], smallest: int) -> Labels:
    """`connected_components`, where one of fewer than `smallest` voxels joins the one that it touches most, at faces,
    edges or corners. Components are numbered in the order of their first voxels."""
    runs = uncut_runs(runs_inside(values), cuts)
    names = components_of_runs(runs, cuts)
    labels = np.zeros(values.shape, np.int32)
    paint_runs(labels, runs, names)
    while (target := _targets(labels, runs, names, smallest)) is not None:
        names = _renumbered(names, target)
        paint_runs(labels, runs, names)
    return labels


def _renumbered(names: Labels, target: Labels) -> Labels:
    """Components that have merged into their `target`, renumbered 1..n in the same order."""
    found, first = np.unique(target[names], return_index=True)
    renumbered = np.zeros(len(target), np.int32)
    renumbered[found[np.argsort(first)]] = np.arange(1, len(found) + 1)
    return renumbered[target[names]]


def _targets(labels: Labels, runs: Ints, names: Labels, smallest: int) -> Labels | None:
    """Which component each merges into, itself or a neighbour; None if all are large enough or touch no other."""
    lengths = (runs[:, 3] - runs[:, 2]).astype(np.int64)
    sizes = np.bincount(names, lengths, minlength=1).astype(np.int64)
    sizes[0] = smallest
    small = sizes < smallest
    if not small.any():
        return None
    own, other = _contacts(labels, runs[small[names]])
    if not len(own):
        return None
    pairs, votes = np.unique(np.stack([own, other]), axis=1, return_counts=True)
    order = np.lexsort((-pairs[1], votes))  # the last of a component wins: most votes, then the first name
    own, other = pairs[:, order]
    best = np.arange(len(sizes))
    best[own[small[own]]] = other[small[own]]
    edges = coo_array((np.ones(len(best)), (np.arange(len(best)), best)), shape=(len(best), len(best)))
    count, group = graph_components(edges, directed=False)
    ranked = np.lexsort((-np.arange(len(sizes)), sizes))
    largest = np.zeros(count, labels.dtype)
    largest[group[ranked]] = ranked  # the last of a group wins
    largest[group[0]] = 0
    return largest[group]


def _contacts(labels: Labels, runs: Ints) -> tuple[Labels, Labels]:
    """The component of each voxel of some runs, and that of each of its 26 neighbours in another, shape (m,) each."""
    lengths = (runs[:, 3] - runs[:, 2]).astype(np.int64)
    voxels = np.repeat(runs[:, :3].astype(np.int64), lengths, axis=0)
    voxels[:, 2] += np.arange(len(voxels)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    steps = np.array([step for step in product((-1, 0, 1), repeat=3) if any(step)])
    near = voxels[:, None] + steps
    within = ((near >= 0) & (near < labels.shape)).all(axis=2)
    own = np.broadcast_to(labels[tuple(voxels.T)][:, None], within.shape)[within]
    other = labels[tuple(near[within].T)]
    touching = (other > 0) & (other != own)
    return own[touching], other[touching]


@njit(cache=True)
def relabel_small_components(labels: np.ndarray, runs: np.ndarray, component: np.ndarray, smallest: int) -> bool:
    """Give components of fewer than `smallest` voxels, in order, to the label that surrounds them most, if any.

    Args:
        labels: Padded by one voxel of label 0 on every side. Changed in place.
        runs: Of one label each, in the grid without padding.
        component: 1..n, of each run.
        smallest: Voxels of a component that stays.

    Returns:
        Whether a label has changed.
    """
    count = component.max() if len(component) else 0
    size, start = np.zeros(count + 1, np.int64), np.zeros(count + 2, np.int64)
    for n in range(len(runs)):
        size[component[n]] += runs[n, 3] - runs[n, 2]
        start[component[n] + 1] += 1
    for c in range(count + 1):
        start[c + 1] += start[c]
    order, place = np.empty(len(runs), np.int64), start.copy()
    for n in range(len(runs)):
        order[place[component[n]]] = n
        place[component[n]] += 1
    votes = np.empty(labels.max() + 1, np.int64)
    changed = False
    for c in range(1, count + 1):
        if size[c] >= smallest:
            continue
        votes[:] = 0
        for n in order[start[c] : start[c + 1]]:
            _vote(labels, runs[n], votes)
        if votes.max() > 0:
            changed = True
            for n in order[start[c] : start[c + 1]]:
                labels[runs[n, 0] + 1, runs[n, 1] + 1, runs[n, 2] + 1 : runs[n, 3] + 1] = votes.argmax()
    return changed


@njit(cache=True)
def _vote(labels, run, votes):
    """Count the other labels across the faces of a run of one."""
    i, j = run[0] + 1, run[1] + 1
    own = labels[i, j, run[2] + 1]
    for k in range(run[2] + 1, run[3] + 1):
        for other in (
            labels[i - 1, j, k],
            labels[i + 1, j, k],
            labels[i, j - 1, k],
            labels[i, j + 1, k],
            labels[i, j, k - 1],
            labels[i, j, k + 1],
        ):
            if other > 0 and other != own:
                votes[other] += 1
