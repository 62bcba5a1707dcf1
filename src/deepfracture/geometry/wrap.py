"""Shrink-wrap: the solid of everything that cannot be reached from outside a triangle soup."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.distance import distance_lattice, signed_distance_lattice
from deepfracture.geometry.topology import compact
from deepfracture.types import BadInput, Floats, Floats32, Mesh

VOXELS = 128
"""Voxels along the longest side."""

GAPS = (1.5, 3.0, 6.0, 12.0)
"""Radii [voxels] of the ball that feels its way round the outside, tried in turn: it does not
enter gaps narrower than twice its radius."""


def wrap(mesh: Mesh, name: str) -> tuple[Mesh, float]:
    """A closed surface round `mesh` (any triangles) and the width of the gaps that it bridges.

    A ball rolls over the outside; what it cannot reach is solid (a morphological closing). The
    smallest ball that leaves a solid core is taken. Raises BadInput when none does."""
    low, high = mesh.bounds
    spacing = float((high - low).max()) / VOXELS
    for radius in GAPS:
        reach = radius * spacing
        margin = reach + 3 * spacing
        origin = low - margin
        nx, ny, nz = (int(n) for n in np.ceil((high - low + 2 * margin) / spacing) + 1)
        shape = (nx, ny, nz)
        away = distance_lattice(mesh, origin, spacing, shape, limit=margin)
        free = np.where(_outside(away, reach), away, np.minimum(away, reach))
        outer = isosurface(np.asarray(free - reach, np.float32), origin, spacing)
        inside = signed_distance_lattice(outer, origin, spacing, shape, limit=margin) - np.float32(reach)
        # A core thicker than the ball: not just the sheets themselves.
        if inside.max() > 2 * spacing:
            return _lightened(isosurface(-inside, origin, spacing), 0.1 * spacing), 2 * reach
    raise BadInput(f"{name}: open too wide to tell inside from outside, even with --repair; close it in a modeller")


def _outside(away: Floats32, reach: float) -> np.ndarray:
    """Lattice points farther than `reach` from the surface that connect to the border."""
    from scipy.ndimage import label

    free: np.ndarray = label(away > reach)[0]  # type: ignore[index]
    return free == free[0, 0, 0]


def isosurface(values: Floats32, origin: Floats, spacing: float) -> Mesh:
    """The closed surface where lattice values change from positive (outside) to negative."""
    import pyvista

    image = pyvista.ImageData(dimensions=values.shape, spacing=(spacing,) * 3, origin=tuple(origin))
    # Crossings next to a lattice point make slivers: keep them a twentieth of a step away.
    least = np.float32(0.05 * spacing)
    field = np.where(np.abs(values) < least, np.where(values > 0, least, -least), values)
    made = image.contour([0.0], scalars=field.ravel(order="F"), method="flying_edges")
    mesh = compact(np.asarray(made.points, float), made.faces.reshape(-1, 4)[:, 1:].astype(np.int64))
    return mesh if mesh.volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def _lightened(mesh: Mesh, tolerance: float) -> Mesh:
    """Fewer triangles, moved by no more than the tolerance."""
    from manifold3d import Manifold, Mesh64

    solid = Manifold(Mesh64(np.array(mesh.vertices), np.asarray(mesh.faces, np.uint64)))
    raw = solid.simplify(tolerance).to_mesh64()
    return compact(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, np.int64))
