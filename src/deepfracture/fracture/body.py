"""What is worked out once for a shape and serves every collision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt

from deepfracture.fracture.cache import distances, elastic_body
from deepfracture.fracture.elastostatics import ElasticBody
from deepfracture.fracture.lattice import Lattice
from deepfracture.types import BadInput, Floats, Floats32, Grid, Ints, Material, Shape

ELEMENTS = 1500
"""Boundary elements of a body, about."""
STRESS_CELLS = 40
"""Cells of the coarse lattice along an axis: its cosine transforms are quick at this size."""
SKIN = 0.25
"""Stress is evaluated no nearer to the surface than this share of a coarse cell."""
SHELL = 4.0
"""Distances on the fine lattice are cut off this many voxels outside: cracks run less than two past the surface."""


@dataclass(frozen=True, eq=False)
class FractureBody:
    """A shape of one material, ready to be hit."""

    shape: Shape
    material: Material
    grid: Grid
    elastic: ElasticBody
    area: float
    """Surface area [m^2]."""
    fine: Lattice
    coarse: Lattice
    sdf: Floats32
    """Distance to the surface on the fine lattice, positive inside, at least -`SHELL` voxels [m]."""
    nodes: Floats
    """Coarse centres at which stress is known [m], shape (n, 3)."""
    cells: Ints
    """Their cells on the coarse lattice, shape (n, 3)."""
    node_of: Ints
    """For each coarse cell the index into `nodes` of the nearest one, shape (m, m, m)."""
    wall: Floats32
    """Local wall thickness on the coarse lattice [m], shape (m, m, m)."""


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
    shape: Shape, material: Material, grid: Grid, *, elements: int = ELEMENTS, keep: bool = True
) -> FractureBody:
    """Everything about `shape` that no collision changes; patterns will live on `grid`.

    Unless `keep`, nothing of it is kept on disk. Raises BadInput if the shape is too thin for the stresses' lattice, or
    for boundary elements."""
    fine = Lattice.fine(grid)
    coarse = fine.coarsened(STRESS_CELLS)
    rough = distances(shape.mesh, coarse, outside=np.inf, keep=keep)
    known = rough > SKIN * coarse.spacing
    if not known.any():
        raise BadInput(
            f"{shape.name}: thinner than a cell of {coarse.spacing:.3g} m everywhere (it is two metres long), so "
            "that no stress can be computed in it; make it thicker, or use another breaker"
        )
    elastic = elastic_body(shape.mesh, material.poisson, elements, keep=keep)
    sdf = distances(shape.mesh, fine, outside=SHELL * fine.spacing, keep=keep)
    number = np.cumsum(known.ravel()).reshape(known.shape) - 1
    nearest = np.asarray(distance_transform_edt(~known, return_distances=False, return_indices=True))
    return FractureBody(
        shape=shape,
        material=material,
        grid=grid,
        elastic=elastic,
        area=float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum()),
        fine=fine,
        coarse=coarse,
        sdf=sdf,
        nodes=coarse.centres()[known],
        cells=np.argwhere(known),
        node_of=number[tuple(nearest)],
        wall=np.maximum(_local_thickness(rough, coarse.spacing), coarse.spacing).astype(np.float32),
    )
