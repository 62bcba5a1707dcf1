"""Descriptors of a fracture pattern: computed once per pattern, compared many times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.compare.chamfer import surface_points
from deepfracture.compare.cracks import crack_surface
from deepfracture.types import BadInput, Floats, Floats32, FracturePattern, Grid, Impact, Ints

MAX_RESOLUTION = 64
"""Largest resolution at which partitions are compared: finer grids are subsampled."""


@dataclass(frozen=True, eq=False)
class Descriptors:
    """What is compared of a fracture pattern under an impact."""

    grid: Grid
    volumes: Floats
    """Volumes of the fragments [m^3], ascending, shape (n,)."""
    area: float
    """Area of the crack surfaces [m^2], each counted once."""
    normals: Floats
    """Share of the crack area that faces each axial bin of `cracks`, body frame, shape (bins,)."""
    centre: Floats
    """Centre of the shattered region relative to the strongest contact [m], body frame, shape (3,): the mean of the
    fragments' centres. Unweighted, so it lies among the small fragments. Weights of crack area would follow the few
    long cracks through the whole body, weights of volume the large fragments."""
    size: float
    """Root mean square distance of the fragments' centres from that centre [m]; 0 for one fragment."""
    points: Floats32
    """Points on the surfaces of the fragments [m], fragment by fragment, shape (m, 3); see `chamfer`."""
    starts: Ints
    """Index of each fragment's first point, shape (n + 1,)."""
    partition: NDArray[np.uint16]
    """Fragment 1..n of each voxel, 0 outside, on at most MAX_RESOLUTION^3 voxels."""

    @property
    def count(self) -> int:
        """Number of fragments."""
        return len(self.volumes)


def describe(pattern: FracturePattern, impact: Impact) -> Descriptors:
    """The descriptors of a pattern; takes some 10 ms at r = 64.

    Raises:
        BadInput: The pattern holds no fragment.
    """
    grid, spacing = pattern.grid, pattern.grid.spacing
    sizes = np.bincount(pattern.labels.ravel())
    sizes[0] = 0
    present = sizes > 0
    count = int(present.sum())
    if not count:
        raise BadInput("pattern: holds no fragment, so there is nothing to compare; check its source")
    labels = (np.cumsum(present) * present).astype(np.int32)[pattern.labels]
    centres = grid.to_world(_index_sums(labels, count) / sizes[present, None])
    centre = centres.mean(axis=0)
    area, normals = crack_surface(labels, spacing)
    points, starts = surface_points(labels, count, grid)
    step = max(1, grid.resolution // MAX_RESOLUTION)
    return Descriptors(
        grid=grid,
        volumes=np.sort(sizes[present] * spacing**3).astype(float),
        area=area,
        normals=normals,
        centre=centre - impact.position[0],
        size=float(np.sqrt(((centres - centre) ** 2).sum(axis=1).mean())),
        points=points,
        starts=starts,
        partition=labels[::step, ::step, ::step].astype(np.uint16),
    )


@njit(cache=True)
def _index_sums(labels, count):
    """Sum of the indices of each fragment's voxels, shape (count, 3)."""
    sums = np.zeros((count, 3))
    r = labels.shape[0]
    for i in range(r):
        for j in range(r):
            for k in range(r):
                own = labels[i, j, k] - 1
                if own >= 0:
                    sums[own, 0] += i
                    sums[own, 1] += j
                    sums[own, 2] += k
    return sums
