"""Which shells make up a solid: voids belong to what holds them, dust to a neighbour."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.cutting.intersect import NotGeneral
from deepfracture.types import Floats, Ints
from deepfracture.voxels import merge_graph

FLAT = 1e-13
"""Share of the body's volume below which a shell is flat: nothing but rounding."""


def solids_of_shells(
    positions: Floats,
    corners: NDArray,
    cell: NDArray,
    shell: NDArray,
    first: Ints,
    volumes: Floats,
    outer: int,
    inner: int,
    smallest: float,
) -> Ints:
    """The shell whose solid each shell belongs to in the end, -1 for flat debris."""
    flat = FLAT * np.abs(volumes).sum()
    into = np.arange(len(volumes))
    voids = np.flatnonzero(volumes < -flat)
    low, high = _boxes(positions, corners, shell, len(volumes)) if len(voids) else (positions, positions)
    for void in voids.tolist():
        point = positions[corners[first[void], 0]]
        boxed = (low <= point).all(axis=1) & (high >= point).all(axis=1)
        around = np.flatnonzero((cell[first] == cell[first[void]]) & (volumes > flat) & boxed)
        into[void] = _holder(positions, corners, shell, point, around[np.argsort(volumes[around])])
    whole = np.zeros(len(into))
    np.add.at(whole, into, volumes)
    small = (whole < smallest) & (into == np.arange(len(into)))
    if not small.any():
        return into
    pairs, area = _touching(positions, corners, into, shell, small, outer, inner)
    shared: list[dict[int, float]] = [{} for _ in into]
    unique, which = np.unique(pairs, return_inverse=True)
    for pair, common in zip(unique.tolist(), np.bincount(which.ravel(), area).tolist(), strict=True):
        one, two = divmod(pair, len(into))
        shared[one][two] = shared[two][one] = common
    target = merge_graph(whole, shared, np.flatnonzero(small), smallest, larger_first=True)
    debris = small & (target == np.arange(len(into))) & (whole <= flat)  # flat, and touches nothing
    return np.where(debris[target], -1, target)[into]


@njit(cache=True, nogil=True)
def _touching(positions, corners, into, shell, small, outer, inner):
    """Faces between a small solid and another: both shells as one number, the lower first, and the area."""
    pairs, area = np.empty(inner, np.int64), np.empty(inner)
    count = 0
    for f in range(outer, outer + inner):
        one, two = into[shell[f]], into[shell[f + inner]]
        if one == two or not (small[one] or small[two]):
            continue
        a, b, c = positions[corners[f, 0]], positions[corners[f, 1]], positions[corners[f, 2]]
        ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        square = (uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2
        pairs[count], area[count] = min(one, two) * len(into) + max(one, two), 0.5 * np.sqrt(square)
        count += 1
    return pairs[:count], area[:count]


@njit(cache=True, nogil=True)
def _boxes(positions, corners, shell, count):
    """The lowest and the highest coordinates of each shell, shape (count, 3) each."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for f in range(len(shell)):
        for n in range(3):
            for x in range(3):
                value = positions[corners[f, n], x]
                low[shell[f], x] = min(low[shell[f], x], value)
                high[shell[f], x] = max(high[shell[f], x], value)
    return low, high


def _holder(positions: Floats, corners: NDArray, shell: NDArray, point: Floats, around: Ints) -> int:
    """The smallest of the shells `around`, in ascending order, that holds a point of a void."""
    if not len(around):
        raise NotGeneral
    for candidate in around[:-1].tolist():
        if _encloses(positions[corners[shell == candidate]], point):
            return candidate
    return int(around[-1])


def _encloses(triangles: Floats, point: Floats) -> bool:
    """Whether a closed surface winds around a point off it (van Oosterom & Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    dots = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
    angle = 2 * np.arctan2((a * np.cross(b, c)).sum(1), dots)
    return bool(angle.sum() > 2 * np.pi)
