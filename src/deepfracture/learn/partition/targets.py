"""Training targets: for each voxel inside, the channel of its fragment and of the next one.

Fragments of different patterns that lie in the same place share a channel, as far as possible, so that
channels mean places. Close to a crack the target is a probability, by the distance to the crack, so that
the channels are equal exactly on the crack and a voxel is cut where the crack cuts it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from deepfracture.types import Floats, FracturePattern, Ints

FADE = 0.35
"""Scale [voxels] of the logistic transition between two channels at a crack."""
GREATEST_PROBABILITY = 0.99
"""Of a target (label smoothing): the margins between channels stay finite."""
LEAST_WEIGHT, GREATEST_WEIGHT = 0.3, 4.0
"""Weight of a voxel against the mean, by its fragment's size: without it the network forgets small fragments."""


@dataclass(frozen=True, eq=False)
class Target:
    """For the voxels inside the shape, shape (n,) each."""

    channel: NDArray[np.uint8]
    next: NDArray[np.uint8]
    """Channel beyond the nearest crack; the same as `channel` away from cracks."""
    share: NDArray[np.float16]
    """Probability of `channel`; the rest is that of `next`."""
    weight: NDArray[np.float16]


def anchors(inside: Floats, count: int) -> Floats:
    """`count` positions spread over the body, the places that channels stand for (farthest points)."""
    chosen = [inside[0]]
    away = ((inside - chosen[0]) ** 2).sum(axis=1)
    for _ in range(count - 1):
        chosen.append(inside[int(away.argmax())])
        away = np.minimum(away, ((inside - chosen[-1]) ** 2).sum(axis=1))
    return np.array(chosen)


def target_of(pattern: FracturePattern, voxels: tuple[Ints, Ints, Ints], places: Floats) -> Target:
    """The target of one pattern.

    Args:
        voxels: Indices of the voxels inside the shape; voxels without a label take their neighbour's.
        places: Position of each channel [m], shape (channels, 3).
    """
    labels = fill(pattern.labels, voxels)
    beyond = _beyond(labels)
    channel_of = _channels(labels, beyond, pattern.grid.centres(), places)
    mine, other = labels[voxels], beyond[voxels]
    near = other > 0
    depth = pattern.distance[voxels] / (FADE * pattern.grid.spacing)
    share = np.where(near, np.minimum(1 / (1 + np.exp(-np.minimum(depth, 20))), GREATEST_PROBABILITY), 1.0)
    sizes = np.bincount(mine, minlength=len(channel_of))
    mean = len(mine) / np.count_nonzero(sizes)
    weight = np.clip(np.sqrt(mean / np.maximum(sizes, 1)), LEAST_WEIGHT, GREATEST_WEIGHT)[mine]
    channel = channel_of[mine]
    return Target(
        channel,
        np.where(near, channel_of[other], channel),
        share.astype(np.float16),
        weight.astype(np.float16),
    )


def fill(labels: NDArray, voxels: tuple[Ints, Ints, Ints]) -> NDArray:
    """Labels in which every voxel inside has one: the nearest voxel's that has."""
    bare = labels[voxels] == 0
    if not bare.any():
        return labels
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(labels == 0, return_distances=False, return_indices=True)
    filled = labels.copy()
    where = tuple(axis[bare] for axis in voxels)
    filled[where] = labels[tuple(axis[where] for axis in np.asarray(nearest))]
    return filled


def _channels(labels: NDArray, beyond: NDArray, centres: Floats, places: Floats) -> NDArray[np.uint8]:
    """Channel of each label: the largest fragments take the nearest places, one each; the others share
    with the fragment farthest from them that they do not touch."""
    names, sizes = np.unique(labels[labels > 0], return_counts=True)
    middle = {name: centres[labels == name].mean(axis=0) for name in names}
    order = names[np.argsort(-sizes, kind="stable")]
    first, rest = order[: len(places)], order[len(places) :]
    cost = ((np.array([middle[name] for name in first])[:, None] - places[None]) ** 2).sum(axis=-1)
    rows, columns = linear_sum_assignment(cost)
    channel_of = np.zeros(labels.max() + 1, np.uint8)
    channel_of[first[rows]] = columns
    given = {int(first[row]): int(column) for row, column in zip(rows, columns, strict=True)}
    for name in rest:
        touching = {given[int(n)] for n in np.unique(beyond[labels == name]) if int(n) in given}
        gap = np.full(len(places), np.inf)
        for other, channel in given.items():
            gap[channel] = min(gap[channel], float(((middle[name] - middle[other]) ** 2).sum()))
        gap[list(touching)] = -1.0  # taken only when fragments of every channel touch this one
        channel_of[name] = given[int(name)] = int(gap.argmax())
    return channel_of


@njit(cache=True)
def _beyond(labels):
    """For each labelled voxel the nearest other label among its 26 neighbours, 0 if there is none."""
    n0, n1, n2 = labels.shape
    found = np.zeros_like(labels)
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                mine = labels[i, j, k]
                if mine == 0:
                    continue
                nearest = 4
                for a in range(max(i - 1, 0), min(i + 2, n0)):
                    for b in range(max(j - 1, 0), min(j + 2, n1)):
                        for c in range(max(k - 1, 0), min(k + 2, n2)):
                            away = abs(a - i) + abs(b - j) + abs(c - k)
                            other = labels[a, b, c]
                            if other != 0 and other != mine and away < nearest:
                                nearest = away
                                found[i, j, k] = other
    return found
