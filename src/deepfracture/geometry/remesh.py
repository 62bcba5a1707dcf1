"""Uniform, well-shaped triangulations of a closed surface, for boundary elements."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.distance import closest
from deepfracture.geometry.topology import compact, faults, shells
from deepfracture.progress import log
from deepfracture.types import BadInput, Mesh

FINENESS = 12
"""Input vertices a cluster needs so that clusters come out round."""


def remesh(mesh: Mesh, triangles: int) -> Mesh:
    """A closed manifold of about `triangles` well-shaped triangles on the surface of `mesh`.

    Approximated centroidal Voronoi clusters (Valette and Chassery 2004, pyacvd). Sharp edges are
    rounded by up to a triangle's size; the volume is kept by a small offset along the normals.
    Raises BadInput when the surface is too thin or wild for so few triangles."""
    if triangles < 20:
        raise BadInput(f"triangles must be 20 or more, got {triangles}")
    before = faults(mesh)
    if not before.closed:
        raise BadInput(f"only a closed mesh can be remeshed, this one has {before}")
    holes = _euler(mesh)
    # Euler: faces = 2 (vertices - chi).
    wanted = triangles // 2 + holes
    fine = _subdivided(mesh, FINENESS * wanted)
    for factor in (1.0, 1.06, 0.94, 1.15, 1.3, 1.6, 2.0):
        result = _clusters(fine, max(10, round(wanted * factor)))
        if result is not None and _euler(result) == holes and faults(result).shells == before.shells:
            if factor != 1.0:
                log.info("remesh: %d triangles where %d were asked for", len(result.faces), triangles)
            return _keep_volume(result, mesh)
    raise BadInput(f"{triangles} triangles are too few to follow this surface; ask for more")


def _euler(mesh: Mesh) -> int:
    """Euler characteristic V - E + F of a closed mesh."""
    return len(np.unique(mesh.faces)) - len(mesh.faces) // 2


def _subdivided(mesh: Mesh, vertices: int) -> Mesh:
    """The same surface with long edges split until there are enough vertices, evenly spread."""
    from manifold3d import Manifold
    from manifold3d import Mesh64

    area = float(np.linalg.norm(mesh.area_vectors, axis=1).sum())
    length = np.sqrt(area / vertices * 2 / np.sqrt(3))  # edge of equilateral triangles, 2 a vertex
    solid = Manifold(Mesh64(np.array(mesh.vertices), np.asarray(mesh.faces, np.uint64)))
    if solid.is_empty():
        raise BadInput(f"the mesh is not a manifold that can be remeshed ({solid.status()})")
    raw = solid.refine_to_length(float(length)).to_mesh64()
    return compact(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, np.int64))


def _clusters(mesh: Mesh, count: int) -> Mesh | None:
    """The dual of `count` clusters of vertices, on the surface; None when it is not a closed manifold."""
    import pyvista
    from pyacvd import Clustering

    faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces])
    clustering = Clustering(pyvista.PolyData(np.array(mesh.vertices), faces.ravel()))
    clustering.cluster(count)
    made = clustering.create_mesh()
    result = compact(np.asarray(made.points, float), made.faces.reshape(-1, 4)[:, 1:].astype(np.int64))
    if not faults(result).closed:
        return None
    result = Mesh(closest(mesh, result.vertices).points, result.faces)
    return result if result.volume > 0 else Mesh(result.vertices, result.faces[:, ::-1])


def _keep_volume(mesh: Mesh, original: Mesh) -> Mesh:
    """The mesh moved along its normals by one small length, so that it encloses the original volume."""
    area = np.linalg.norm(mesh.area_vectors, axis=1).sum()
    normals = np.zeros_like(mesh.vertices)
    np.add.at(normals, mesh.faces.ravel(), np.repeat(mesh.area_vectors, 3, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    shift = (original.volume - mesh.volume) / area
    return Mesh(mesh.vertices + shift * normals, mesh.faces)
