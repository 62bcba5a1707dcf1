"""Uniform, well-shaped triangulations of a closed surface, for boundary elements."""

from __future__ import annotations

import warnings

import numpy as np

from deepfracture.geometry.collapse import collapse_short
from deepfracture.geometry.distance import closest
from deepfracture.geometry.topology import compact, faults, torn_vertices
from deepfracture.progress import log
from deepfracture.types import BadInput, Mesh

FINENESS = (8, 12)
"""Input vertices a cluster needs so that clusters come out round: tried in turn."""


def remesh(mesh: Mesh, triangles: int) -> Mesh:
    """A closed manifold of about `triangles` well-shaped triangles on the surface of `mesh`.

    Approximated centroidal Voronoi clusters (Valette and Chassery 2004, pyacvd). Sharp edges are
    rounded by up to a triangle's size; the volume is kept by a small offset along the normals.
    Where limbs are thinner than a triangle, edges are collapsed instead (less even, never torn).
    Raises BadInput when the surface is too thin or wild for so few triangles."""
    if triangles < 20:
        raise BadInput(f"triangles must be 20 or more, got {triangles}")
    before = faults(mesh)
    if not before.closed:
        raise BadInput(f"only a closed mesh can be remeshed, this one has {before}")
    euler = _euler(mesh)
    # Euler: faces = 2 (vertices - chi).
    wanted = triangles // 2 + euler
    for fineness in FINENESS:
        fine = _subdivided(mesh, fineness * wanted)
        result = _clusters(fine, max(10, wanted))
        if not len(torn_vertices(result)) and _euler(result) == euler and faults(result).shells == before.shells:
            break
    else:
        # Limbs thinner than a cluster pinch it: coarsen edge by edge instead, which cannot tear.
        result = _coarsened(fine, triangles)
        log.info("remesh: thin limbs; %d triangles where %d were asked for", len(result.faces), triangles)
    return _keep_volume(_outward(Mesh(closest(fine, result.vertices).points, result.faces)), mesh)


def _coarsened(mesh: Mesh, triangles: int) -> Mesh:
    """The mesh with ever longer edges collapsed until it has `triangles` or fewer, or up to twice as
    many where its form allows no fewer."""
    length = np.sqrt(_area(mesh) / triangles * 4 / np.sqrt(3))
    for share in (0.25, 0.4, 0.55, 0.65, 0.75, 0.85, 1.0, 1.2, 1.4):
        mesh = collapse_short(mesh, share * length)
        if len(mesh.faces) <= triangles:
            return mesh
    if len(mesh.faces) <= 2 * triangles:
        return mesh
    raise BadInput(f"{triangles} triangles are too few to follow this surface; ask for {len(mesh.faces)} or more")


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


def _clusters(mesh: Mesh, count: int) -> Mesh:
    """The dual of `count` clusters of vertices; torn where the mesh is thinner than a cluster."""
    import pyvista

    with warnings.catch_warnings():
        # pyacvd 0.4 calls a private name of pyvista that newer versions warn about.
        warnings.simplefilter("ignore")
        from pyacvd import Clustering

        faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces])
        clustering = Clustering(pyvista.PolyData(np.array(mesh.vertices), faces.ravel()))
        clustering.cluster(count)
        made = clustering.create_mesh()
    return compact(np.asarray(made.points, float), made.faces.reshape(-1, 4)[:, 1:].astype(np.int64))


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
