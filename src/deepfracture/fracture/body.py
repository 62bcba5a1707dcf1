"""A shape prepared for fracture: everything that does not depend on the collision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt

from deepfracture.fracture.cache import cached_distances, cached_elastic_body
from deepfracture.fracture.elastostatics import ElasticBody
from deepfracture.fracture.padded_grid import PaddedGrid
from deepfracture.types import BadInput, Floats, Floats32, Grid, Ints, Material, Shape

ELEMENTS = 1500
"""Approximate number of boundary elements of a body."""
STRESS_CELLS = 40
"""Cells of the coarse grid along an axis; cosine transforms are fast at this size."""
CLEARANCE = 0.25
"""Least distance to the surface at which stress is evaluated [coarse cells]."""
OUTER_BAND = 4.0
"""Distances are truncated this far outside [fine voxels]: cracks run less than two past the surface."""


@dataclass(frozen=True, eq=False)
class FractureBody:
    """A shape of one material, ready to be hit."""

    shape: Shape
    material: Material
    grid: Grid
    elastic: ElasticBody
    area: float
    """Surface area [m^2]."""
    fine: PaddedGrid
    coarse: PaddedGrid
    sdf: Floats32
    """Signed distance to the surface on the fine grid, positive inside, at least -`OUTER_BAND` voxels [m]."""
    cells: Ints
    """Coarse cells in which stress is evaluated, shape (n, 3)."""
    centres: Floats
    """Their centres [m], shape (n, 3)."""
    nearest_cell: Ints
    """Index into `cells` of the cell nearest to each cell of the coarse grid, shape (m, m, m)."""
    thickness: Floats32
    """Local wall thickness on the coarse grid [m], shape (m, m, m)."""


@njit(cache=True)
def _local_thickness(sdf, spacing):
    """Diameter of the largest ball inside the body that covers each cell (Hildebrand & Ruegsegger 1997)."""
    n = sdf.shape[0]
    thickness = np.zeros_like(sdf)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                radius = sdf[i, j, k]
                if radius <= 0 or thickness[i, j, k] > 2.2 * radius:
                    continue
                reach = int(np.ceil(radius / spacing))
                for a in range(max(0, i - reach), min(n, i + reach + 1)):
                    for b in range(max(0, j - reach), min(n, j + reach + 1)):
                        for c in range(max(0, k - reach), min(n, k + reach + 1)):
                            away = ((a - i) ** 2 + (b - j) ** 2 + (c - k) ** 2) * spacing**2
                            if away <= radius**2 and thickness[a, b, c] < 2 * radius:
                                thickness[a, b, c] = 2 * radius
    return thickness


def prepare_body(
    shape: Shape, material: Material, grid: Grid, *, elements: int = ELEMENTS, cache: bool = True
) -> FractureBody:
    """Prepare `shape` for collisions; patterns are on `grid`.

    Args:
        elements: Approximate number of boundary elements.
        cache: Store the factorised system and the distances on disk, and read them from there.

    Raises:
        BadInput: The shape is too thin for the coarse grid or for the boundary elements."""
    fine = PaddedGrid.fine(grid)
    coarse = fine.coarsened(STRESS_CELLS)
    rough = cached_distances(shape.mesh, coarse, outside=np.inf, cache=cache)
    inside = rough > CLEARANCE * coarse.spacing
    if not inside.any():
        raise BadInput(
            f"{shape.name}: thinner than a cell of {coarse.spacing:.3g} m everywhere (it is two metres long), so "
            "no stress can be computed in it; make it thicker, or use another breaker"
        )
    elastic = cached_elastic_body(shape.mesh, material.poisson, elements, cache=cache)
    sdf = cached_distances(shape.mesh, fine, outside=OUTER_BAND * fine.spacing, cache=cache)
    number = np.cumsum(inside.ravel()).reshape(inside.shape) - 1
    nearest = np.asarray(distance_transform_edt(~inside, return_distances=False, return_indices=True))
    return FractureBody(
        shape=shape,
        material=material,
        grid=grid,
        elastic=elastic,
        area=float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum()),
        fine=fine,
        coarse=coarse,
        sdf=sdf,
        cells=np.argwhere(inside),
        centres=coarse.centres()[inside],
        nearest_cell=number[tuple(nearest)],
        thickness=np.maximum(_local_thickness(rough, coarse.spacing), coarse.spacing).astype(np.float32),
    )
