"""What describes a way of breaking: computed once a pattern, compared many times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.compare.chamfer import surface_points
from deepfracture.compare.cracks import crack_surface
from deepfracture.types import BadInput, Floats, Floats32, FracturePattern, Grid, Impact, Ints

FINEST = 64
"""Resolution at which divisions are compared: finer grids are read at every second or fourth voxel."""


@dataclass(frozen=True, eq=False)
class Traits:
    """A fracture pattern under an impact, described."""

    grid: Grid
    volumes: Floats
    """Of the fragments [m^3], ascending, shape (n,)."""
    area: float
    """Of the crack surfaces [m^2], each counted once."""
    normals: Floats
    """Share of the crack area that faces each axial bin of `cracks`, body frame, shape (bins,)."""
    centre: Floats
    """Centre of the shattered region, seen from the strongest hit [m], body frame, shape (3,): the mean of the
    fragments' centres. Each fragment counts once, so it lies where the small ones are. Crack area as the weight would
    follow the few long cracks that run through the whole body, and volume the large pieces that are left over."""
    size: float
    """Root mean square distance of the fragments' centres from that centre [m]; 0 for one fragment."""
    points: Floats32
    """On the surfaces of the fragments [m], fragment after fragment, shape (m, 3); see `chamfer`."""
    starts: Ints
    """Where each fragment's points start, shape (n + 1,)."""
    division: NDArray[np.uint16]
    """Fragment 1..n of each voxel, 0 outside, on at most FINEST^3 voxels."""

    @property
    def count(self) -> int:
        """Number of fragments."""
        return len(self.volumes)


def traits_of(pattern: FracturePattern, impact: Impact) -> Traits:
    """Describe a pattern; some 10 ms at r = 64.

    Raises:
        BadInput: The pattern holds no fragment.
    """
    grid, spacing = pattern.grid, pattern.grid.spacing
    sizes = np.bincount(pattern.labels.ravel())
    sizes[0] = 0
    there = sizes > 0
    count = int(there.sum())
    if not count:
        raise BadInput("pattern: holds no fragment, so there is nothing to compare; check where it comes from")
    labels = (np.cumsum(there) * there).astype(np.int32)[pattern.labels]
    centres = grid.to_world(_sums(labels, count) / sizes[there, None])
    centre = centres.mean(axis=0)
    area, normals = crack_surface(labels, spacing)
    points, starts = surface_points(labels, count, grid)
    step = max(1, grid.resolution // FINEST)
    return Traits(
        grid=grid,
        volumes=np.sort(sizes[there] * spacing**3).astype(float),
        area=area,
        normals=normals,
        centre=centre - impact.position[0],
        size=float(np.sqrt(((centres - centre) ** 2).sum(axis=1).mean())),
        points=points,
        starts=starts,
        division=labels[::step, ::step, ::step].astype(np.uint16),
    )


@njit(cache=True)
def _sums(labels, count):
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
