"""Smooth functions over a shape from few coefficients: quadratic B-splines on a coarse lattice (de Boor 1978).

The lattice does not depend on the resolution of the grid, so a model can be evaluated at any.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from deepfracture.types import Floats, Floats32, Grid

CELLS = (36, 32, 28, 24)
"""Cells along an axis; fewer where a body fills so much of the grid that they would need too many nodes."""
MOST_NODES = 19_000
"""384 waves at so many nodes are 29 MB."""


@dataclass(frozen=True, eq=False)
class SplineLattice:
    """Cells that tile the grid, and nodes at their centres and around; a spline has a coefficient a node."""

    cells: NDArray[np.int32]
    """Cells that hold a voxel inside the body, shape (n, 3)."""
    number: NDArray[np.int32]
    """Number of the node at the centre of each cell, of those around the grid too, or -1, shape (c + 2,) * 3."""
    nodes: Floats
    """Positions [m] of the nodes that the cells depend on, shape (m, 3)."""
    cell: NDArray[np.int32]
    """Cell along an axis of each voxel, shape (r,)."""
    start: NDArray[np.int32]
    """First voxel of each cell along an axis, and the end, shape (c + 1,)."""
    weights: Floats32
    """Of the three nearest nodes along an axis, for each voxel, shape (r, 3)."""
    width: float
    """Side of a cell [m]."""

    @staticmethod
    def of(grid: Grid, surface: Floats32) -> SplineLattice:
        """The finest lattice that needs no more than MOST_NODES for the voxels where `surface` is positive."""
        for count in CELLS:
            cell, rest = np.divmod((2 * np.arange(grid.resolution) + 1) * count, 2 * grid.resolution)
            held, needed = _used(surface, cell, count)
            if np.count_nonzero(needed) <= MOST_NODES:
                break
        place = np.argwhere(needed)
        number = np.full(needed.shape, -1, np.int32)
        number[needed] = np.arange(len(place))
        width = 2.0 / count
        t = rest / (2 * grid.resolution)  # of the way through the cell
        weights = np.stack([(1 - t) ** 2 / 2, 0.75 - (t - 0.5) ** 2, t**2 / 2], axis=1)
        return SplineLattice(
            np.argwhere(held).astype(np.int32),
            number,
            np.asarray((place - 0.5) * width - 1.0, float),
            cell.astype(np.int32),
            np.searchsorted(cell, np.arange(count + 1)).astype(np.int32),
            weights.astype(np.float32),
            width,
        )

    def gain(self, vectors: ArrayLike) -> Floats:
        """Factors for the values of sine waves of wave `vectors` [1/m], shape (3, n), at the nodes, so that the splines
        with these coefficients are nearest to the waves, by least squares; shape (n,).

        Along an axis the spline of sin(kx) is sinc^3 of it and its aliases; the ratio is that of its
        product with sin(kx) to its square (Unser 1999, section on the dual spline)."""
        phase = np.asarray(vectors, float) * self.width
        direct = np.sinc(phase / (2 * np.pi)) ** 3
        square = (33 + 26 * np.cos(phase) + np.cos(2 * phase)) / 60
        return (direct / square).prod(axis=0)


@njit(cache=True)
def _used(surface, cell, count):
    """Which cells hold a voxel inside, shape (count,) * 3, and which nodes they need, shape (count + 2,) * 3."""
    held = np.zeros((count, count, count), np.bool_)
    n0, n1, n2 = surface.shape
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                if surface[i, j, k] > 0:
                    held[cell[i], cell[j], cell[k]] = True
    needed = np.zeros((count + 2, count + 2, count + 2), np.bool_)
    for i in range(count):
        for j in range(count):
            for k in range(count):
                if held[i, j, k]:
                    needed[i : i + 3, j : j + 3, k : k + 3] = True
    return held, needed
