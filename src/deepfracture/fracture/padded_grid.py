"""Grids of the crack solver: a fine one for crack fronts, a coarse one for stress."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.types import Floats, Grid

MARGIN = 4
"""Empty cells around the pattern's grid: cracks must run past the surface, or uncut voxels are left there."""


@dataclass(frozen=True)
class PaddedGrid:
    """n^3 cells that cover the pattern's grid and a margin around it."""

    n: int
    spacing: float
    """[m]"""
    low: float
    """Lower corner of the first cell, the same on each axis [m]."""

    @staticmethod
    def fine(grid: Grid) -> PaddedGrid:
        """The voxels of `grid`, extended by `MARGIN` cells on each side."""
        return PaddedGrid(grid.resolution + 2 * MARGIN, grid.spacing, -1.0 - MARGIN * grid.spacing)

    def coarsened(self, n: int) -> PaddedGrid:
        """`n`^3 cells over the same box."""
        return PaddedGrid(n, self.n * self.spacing / n, self.low)

    @property
    def shape(self) -> tuple[int, int, int]:
        return (self.n, self.n, self.n)

    @property
    def first_centre(self) -> float:
        return self.low + 0.5 * self.spacing

    def centres(self) -> Floats:
        """Cell centres, shape (n, n, n, 3)."""
        axis = self.first_centre + self.spacing * np.arange(self.n, dtype=float)
        return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


@njit(cache=True, inline="always")
def interpolate(field, x, y, z):
    """Trilinear value of `field` (n, n, n) at the fractional index (x, y, z), clamped to the box."""
    nx, ny, nz = field.shape
    x = min(max(x, 0.0), nx - 1.001)
    y = min(max(y, 0.0), ny - 1.001)
    z = min(max(z, 0.0), nz - 1.001)
    i, j, k = int(x), int(y), int(z)
    u, v, w = x - i, y - j, z - k
    low = (field[i, j, k] * (1 - u) + field[i + 1, j, k] * u) * (1 - v) + (
        field[i, j + 1, k] * (1 - u) + field[i + 1, j + 1, k] * u
    ) * v
    high = (field[i, j, k + 1] * (1 - u) + field[i + 1, j, k + 1] * u) * (1 - v) + (
        field[i, j + 1, k + 1] * (1 - u) + field[i + 1, j + 1, k + 1] * u
    ) * v
    return low * (1 - w) + high * w
