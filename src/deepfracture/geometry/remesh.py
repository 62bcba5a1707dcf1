"""Uniform, well-shaped triangulations of a closed surface, for boundary elements."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.acvd import cluster_vertices, dual_mesh
from deepfracture.geometry.distance import closest_points
from deepfracture.geometry.topology import compact, defective_vertices, mesh_defects, split_pinches
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Mesh

FINENESS = (10, 24)
"""Input vertices a cluster needs so that clusters come out round and even: tried in turn."""


def remesh(mesh: Mesh, triangles: int) -> Mesh:
    """A closed manifold of about `triangles` well-shaped triangles on the surface of `mesh`.

    Approximated centroidal Voronoi clusters (`geometry.clusters`). Sharp edges are rounded by up to half a
    triangle's size; the volume is kept by a small offset along the normals. Limbs thinner than a triangle get
    smaller ones, up to twice as many in all. Raises BadInput when the surface is too thin or wild for so few."""
    if triangles < 20:
        raise BadInput(f"triangles must be 20 or more, got {triangles}")
    before = mesh_defects(mesh)
    if not before.closed:
        raise BadInput(f"only a closed mesh can be remeshed, this one has {before}")
    mesh = split_pinches(mesh)
    euler = _euler(mesh)
    # Euler: faces = 2 (vertices - chi).
    wanted = max(10, triangles // 2 + euler)
    for fineness in FINENESS:
        fine = split_pinches(_subdivided(mesh, fineness * wanted))
        result = dual_mesh(fine, cluster_vertices(fine, wanted))
        if (
            not len(defective_vertices(result))
            and _euler(result) == euler
            and mesh_defects(result).shells == before.shells
        ):
            break
    else:
        raise BadInput(f"{triangles} triangles are too few to follow this surface; ask for more, or repair it")
    if len(result.faces) > 2 * triangles:
        raise BadInput(f"{triangles} triangles are too few to follow this surface; ask for {len(result.faces)} or more")
    if len(result.faces) > 1.05 * triangles:
        log.info("remesh: thin limbs; %d triangles where %d were asked for", len(result.faces), triangles)
    return _keep_volume(_outward(Mesh(closest_points(fine, result.vertices).points, result.faces)), mesh)


def _area(mesh: Mesh) -> float:
    return float(np.linalg.norm(mesh.area_vectors, axis=1).sum())


def _outward(mesh: Mesh) -> Mesh:
    return mesh if mesh.volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def _euler(mesh: Mesh) -> int:
    """Euler characteristic V - E + F of a closed mesh."""
    return len(np.unique(mesh.faces)) - len(mesh.faces) // 2


def _subdivided(mesh: Mesh, vertices: int) -> Mesh:
    """The same surface with long edges split until there are enough vertices, evenly spread."""
    from manifold3d import Manifold, Mesh64

    length = np.sqrt(_area(mesh) / vertices * 2 / np.sqrt(3))  # edge of equilateral triangles, 2 a vertex
    solid = Manifold(Mesh64(np.array(mesh.vertices), np.asarray(mesh.faces, np.uint64)))
    if solid.is_empty():
        raise BadInput(f"the mesh is not a manifold that can be remeshed ({solid.status()})")
    raw = solid.refine_to_length(float(length)).to_mesh64()
    return compact(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, np.int64))


def _keep_volume(mesh: Mesh, original: Mesh) -> Mesh:
    """The mesh moved along its normals, everywhere as far, so that it encloses the original volume."""
    for _ in range(4):  # Newton steps; the volume is a cubic in the length.
        normals = np.zeros_like(mesh.vertices)
        np.add.at(normals, mesh.faces.ravel(), np.repeat(mesh.area_vectors, 3, axis=0))
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.maximum(lengths, 1e-300)
        # What the volume gains per length of the move: a third of each face goes to each corner.
        gain = float(lengths.sum()) / 3
        mesh = Mesh(mesh.vertices + (original.volume - mesh.volume) / gain * normals, mesh.faces)
    return mesh
