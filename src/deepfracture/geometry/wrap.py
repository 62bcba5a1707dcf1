"""Shrink-wrap: the solid of everything that cannot be reached from outside a triangle soup."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.distance import distance_lattice, signed_distance_lattice
from deepfracture.geometry.isosurface import isosurface
from deepfracture.geometry.topology import compact
from deepfracture.geometry.untangle import untangle
from deepfracture.types import BadInput, Floats32, Mesh

VOXELS = 128
"""Voxels along the longest side."""

BALL_RADII = (1.5, 3.0, 6.0, 12.0)
"""Radii [voxels] of the ball that feels its way round the outside, tried in turn: it does not
enter gaps narrower than twice its radius."""


def wrap(mesh: Mesh, name: str) -> tuple[Mesh, float]:
    """A closed surface round `mesh` (any triangles) and the width of the gaps that it bridges.

    A ball rolls over the outside; what it cannot reach is solid (a morphological closing). The
    smallest ball that leaves a solid core is taken. Raises BadInput when none does."""
    middle = mesh.bounds.mean(axis=0)
    mesh = mesh.moved(1.0, -middle)  # far from the origin a lattice's steps would drown in rounding
    spacing = float(np.ptp(mesh.bounds, axis=0).max()) / VOXELS
    for radius in BALL_RADII:
        reach = radius * spacing
        # A coarse lattice sees no gap that a fine one does not, and costs an eighth: what leaks there leaks.
        if _closing(mesh, 2 * spacing, reach, 0.25 * spacing) is None:
            continue
        solid = _closing(mesh, spacing, reach, 2 * spacing)
        if solid is not None:
            return _simplified(solid, 0.1 * spacing).moved(1.0, middle), 2 * reach
    raise BadInput(f"{name}: open too wide to tell inside from outside, even with --repair; close it in a modeller")


def _closing(mesh: Mesh, spacing: float, reach: float, core: float) -> Mesh | None:
    """The surface of what a ball of radius `reach` cannot touch from outside; None if that is but a skin, with no point
    deeper than `core`."""
    low, high = mesh.bounds
    margin = reach + 3 * spacing
    origin = low - margin
    nx, ny, nz = (int(n) for n in np.ceil((high - low + 2 * margin) / spacing) + 1)
    shape = (nx, ny, nz)
    away = distance_lattice(mesh, origin, spacing, shape, limit=margin)
    free = np.where(_outside(away, reach), away, np.minimum(away, reach))
    outer = isosurface(np.asarray(free - reach, np.float32), origin, spacing)
    # Outside any depth will do: the surface that is wanted lies `reach` within.
    depth = signed_distance_lattice(outer, origin, spacing, shape, limit=margin, outside=spacing)
    inside = depth - np.float32(reach)
    return isosurface(-inside, origin, spacing) if inside.max() > core else None


def _outside(away: Floats32, reach: float) -> np.ndarray:
    """Lattice points farther than `reach` from the surface that connect to the border."""
    from scipy.ndimage import label

    free: np.ndarray = label(away > reach)[0]  # type: ignore[index]
    return free == free[0, 0, 0]


def _simplified(mesh: Mesh, tolerance: float) -> Mesh:
    """Fewer triangles, moved by about the tolerance at most; the mesh itself where they would cross each other."""
    from manifold3d import Manifold, Mesh64

    solid = Manifold(Mesh64(np.array(mesh.vertices), np.asarray(mesh.faces, np.uint64)))
    for share in (1.0, 0.2):
        raw = solid.simplify(share * tolerance).to_mesh64()
        made = compact(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, np.int64))
        smooth = untangle(made, np.zeros(len(made.faces), np.int64))
        if smooth is not None:
            return smooth[0]
    return mesh
