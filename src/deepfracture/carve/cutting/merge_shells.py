"""Which shells make up a solid: voids belong to the shell around them, small solids to a neighbour."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.cutting.intersect import DegenerateIntersection
from deepfracture.carve.cutting.shells import CellSurfaces
from deepfracture.types import Floats, Ints
from deepfracture.voxels import merge_graph

FLAT = 1e-13
"""Share of the body's volume below which a shell is flat: nothing but rounding."""


def merge_shells(
    positions: Floats, corners: NDArray, cell: NDArray, surfaces: CellSurfaces, outer: int, inner: int, smallest: float
) -> Ints:
    """The shell that each shell's solid is known by in the end, -1 for flat debris."""
    shell, first, volumes = surfaces.shell, surfaces.first, surfaces.volumes
    flat = FLAT * np.abs(volumes).sum()
    owner = np.arange(len(volumes))
    voids = np.flatnonzero(volumes < -flat)
    low, high = _bounding_boxes(positions, corners, shell, len(volumes)) if len(voids) else (positions, positions)
    for void in voids.tolist():
        point = positions[corners[first[void], 0]]
        in_box = (low <= point).all(axis=1) & (high >= point).all(axis=1)
        candidates = np.flatnonzero((cell[first] == cell[first[void]]) & (volumes > flat) & in_box)
        owner[void] = _enclosing_shell(positions, corners, shell, point, candidates[np.argsort(volumes[candidates])])
    solid_volumes = np.zeros(len(owner))
    np.add.at(solid_volumes, owner, volumes)
    small = (solid_volumes < smallest) & (owner == np.arange(len(owner)))
    if not small.any():
        return owner
    pairs, area = _contact_areas(positions, corners, owner, shell, small, outer, inner)
    contacts: list[dict[int, float]] = [{} for _ in owner]
    unique, which = np.unique(pairs, return_inverse=True)
    for pair, common in zip(unique.tolist(), np.bincount(which.ravel(), area).tolist(), strict=True):
        a, b = divmod(pair, len(owner))
        contacts[a][b] = contacts[b][a] = common
    target = merge_graph(solid_volumes, contacts, np.flatnonzero(small), smallest, larger_first=True)
    debris = small & (target == np.arange(len(owner))) & (solid_volumes <= flat)  # flat, and touches nothing
    return np.where(debris[target], -1, target)[owner]


@njit(cache=True, nogil=True)
def _contact_areas(positions, corners, owner, shell, small, outer, inner):
    """Faces between a small solid and another: both shells as one number, the lower first, and the area."""
    pairs, area = np.empty(inner, np.int64), np.empty(inner)
    count = 0
    for f in range(outer, outer + inner):
        one, two = owner[shell[f]], owner[shell[f + inner]]
        if one == two or not (small[one] or small[two]):
            continue
        a, b, c = positions[corners[f, 0]], positions[corners[f, 1]], positions[corners[f, 2]]
        ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        square = (uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2
        pairs[count], area[count] = min(one, two) * len(owner) + max(one, two), 0.5 * np.sqrt(square)
        count += 1
    return pairs[:count], area[:count]


@njit(cache=True, nogil=True)
def _bounding_boxes(positions, corners, shell, count):
    """Lowest and highest coordinates of each shell, shape (count, 3) each."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for f in range(len(shell)):
        for n in range(3):
            for x in range(3):
                value = positions[corners[f, n], x]
                low[shell[f], x] = min(low[shell[f], x], value)
                high[shell[f], x] = max(high[shell[f], x], value)
    return low, high


def _enclosing_shell(positions: Floats, corners: NDArray, shell: NDArray, point: Floats, candidates: Ints) -> int:
    """The smallest of the `candidates`, shells in ascending order of volume, that encloses a point of a void."""
    if not len(candidates):
        raise DegenerateIntersection
    for candidate in candidates[:-1].tolist():
        if _winds_around(positions[corners[shell == candidate]], point):
            return candidate
    return int(candidates[-1])


def _winds_around(triangles: Floats, point: Floats) -> bool:
    """Whether a closed surface winds around a point off it (van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    dots = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
    angle = 2 * np.arctan2((a * np.cross(b, c)).sum(1), dots)
    return bool(angle.sum() > 2 * np.pi)
