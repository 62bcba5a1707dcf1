"""The usual way from a GS-SDF to fragments, to measure ours against: the paper's run time by common libraries.

Extended minima and a watershed with dams, the isosurface of each label, one boolean with the original each
(Huang and Kanai 2024, section 5.2, whose Python run time does the same with scikit-image)."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import find_objects, label

from deepfracture.types import Grid, Labels, Mesh, Shape, Volume

if TYPE_CHECKING:
    from manifold3d import Manifold

CAGE = 0.03
"""Thickness of the shell outside the zero level that the flood may enter [m], the paper's epsilon."""
TOLERANCE = 0.04
"""Least depth of a minimum [m]."""
GROWTH = 2
"""Voxels by which labels grow into the dams between them and past the surface."""
MARGIN = 4
"""Voxels added on every side for that: bodies touch the grid's border."""


def installed() -> bool:
    """Whether scikit-image is there; it is no dependency of the package."""
    return find_spec("skimage") is not None


def reference_labels(volume: Volume) -> Labels:
    """Labels 1..n of a GS-SDF, 0 on the dams between them and outside the cage, shape (r, r, r)."""
    from skimage.morphology import h_minima  # type: ignore  (not there unless installed for this)
    from skimage.segmentation import watershed  # type: ignore

    caged = volume.values > -CAGE
    depths = -volume.values
    seeds, _ = label(h_minima(depths, TOLERANCE) * caged, np.ones((3, 3, 3)))  # type: ignore[misc]
    return watershed(depths, seeds, mask=caged, watershed_line=True).astype(np.int32)


def reference_surfaces(labels: Labels, grid: Grid) -> list[Mesh]:
    """The isosurface of each label, grown by GROWTH, by marching cubes."""
    from skimage.measure import marching_cubes  # type: ignore
    from skimage.segmentation import expand_labels  # type: ignore

    grown = expand_labels(np.pad(labels, MARGIN), GROWTH)
    surfaces = []
    for name, box in enumerate(find_objects(grown), 1):
        if box is None:
            continue
        own = np.pad(grown[box] == name, 1).astype(np.float32)
        points, faces, _, _ = marching_cubes(own, 0.5, gradient_direction="ascent")
        corner = np.array([side.start for side in box]) - 1 - MARGIN
        surfaces.append(Mesh(grid.to_world(points + corner), faces))
    return surfaces


def reference_cut(shape: Shape, surfaces: list[Mesh]) -> tuple[list[Mesh], int]:
    """The original intersected with each surface, and how many of them are no solid to manifold3d."""
    body = _solid(shape.mesh)
    cells = [_solid(surface) for surface in surfaces]
    sound = [cell for cell in cells if cell.status().name == "NoError"]
    pieces = [(body ^ cell).to_mesh64() for cell in sound]
    meshes = [Mesh(piece.vert_properties[:, :3], np.asarray(piece.tri_verts, np.int64)) for piece in pieces]
    return [mesh for mesh in meshes if len(mesh.faces)], len(cells) - len(sound)


def _solid(mesh: Mesh) -> Manifold:
    from manifold3d import Manifold, Mesh64

    return Manifold(Mesh64(np.array(mesh.vertices), mesh.faces.astype(np.uint64)))
