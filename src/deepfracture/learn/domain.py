"""The voxels inside a shape: where a model's fields are defined."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deepfracture.types import Floats, Floats32, Grid, Ints, Shape

SURFACE_TOLERANCE = 0.5
"""Voxels by which distances to the surface of one shape may differ: another tessellation, stored precision."""


@dataclass(frozen=True, eq=False)
class VoxelDomain:
    """A shape on a grid."""

    grid: Grid
    surface: Floats32
    """Signed distance to the shape's surface [m], + inside, shape (r, r, r)."""

    @cached_property
    def voxels(self) -> tuple[Ints, Ints, Ints]:
        """Indices of the voxels inside, shape (n,) each."""
        i, j, k = np.nonzero(self.surface > 0)
        return i, j, k

    @property
    def points(self) -> Floats:
        """Positions of the voxels inside [m], shape (n, 3)."""
        return self.grid.to_world(np.stack(self.voxels, axis=1))

    def matches_shape(self, shape: Shape) -> bool:
        """Whether `shape` has this surface, however it is tessellated."""
        from deepfracture.geometry import signed_distance_points

        voxels = np.argwhere(np.abs(self.surface) < 4 * self.grid.spacing)[:: max(1, self.surface.size // 10**5)]
        found = signed_distance_points(shape.mesh, self.grid.to_world(voxels))
        error = np.abs(found - self.surface[tuple(voxels.T)])
        return bool(np.percentile(error, 99) < SURFACE_TOLERANCE * self.grid.spacing)
