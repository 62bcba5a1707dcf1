"""Fragments out of the original mesh: its surface and the crack mesh, retriangulated along the curves where they
meet."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.carve.cutting.cells import cell_labels
from deepfracture.carve.cutting.classify import crack_sides, surface_cells
from deepfracture.carve.cutting.interfaces import CrackMesh, crack_mesh
from deepfracture.carve.cutting.intersect import (
    INSIDE,
    OUTSIDE,
    DegenerateIntersection,
    Intersections,
    edge_codes,
    intersect,
)
from deepfracture.carve.cutting.mesh_on_grid import MeshOnGrid, mesh_on_grid
from deepfracture.carve.cutting.retriangulate import IntersectedMesh, retriangulate
from deepfracture.carve.cutting.shells import Solid
from deepfracture.carve.cutting.short_edges import collapse_short_edges
from deepfracture.carve.cutting.solids import CellFaces, solids
from deepfracture.geometry import moments, properties_from_moments
from deepfracture.runtime.parallel import parallel_invoke
from deepfracture.runtime.progress import stage
from deepfracture.types import (
    BadInput,
    FracturePattern,
    Fragment,
    Fragments,
    Grid,
    Ints,
    Labels,
    Mesh,
    NoSolution,
    Shape,
)

SMALLEST_VOXELS = 8.0
"""A solid below this volume [voxels] joins the neighbour it shares most crack area with: too small to have a shape."""
SHORT_EDGE = 1e-2
"""Edges below this [voxels] are collapsed, unless they are the original's."""
ATTEMPTS = 4
"""Draws of the jitter after which a cut that none of them makes exact is given up."""


def cut(shape: Shape, pattern: FracturePattern, *, density: float, roughness: float = 0.0) -> Fragments:
    """Cut the original mesh of a shape along a pattern's cracks.

    Every fragment is one connected solid with a closed 2-manifold surface; together they fill the original.
    Outside, their triangles are the original's, untouched except where a crack crosses them; neighbours share
    their crack vertices. Disconnected parts of a label become separate fragments; very small ones join a
    neighbour (`SMALLEST_VOXELS`).

    No boolean operation is needed. Only triangles that cracks intersect are retriangulated, all others pass
    through. Exact signs decide which edges intersect which triangles, so the result is closed.

    Args:
        shape: The whole body.
        pattern: Its cracks, on any grid.
        density: [kg/m^3]
        roughness: Grain of the crack faces [m]: their vertices are scattered by up to this, at most within a voxel.

    Raises:
        BadInput: The mesh is not closed and oriented, density is not positive, or roughness is negative.
        NoSolution: The mesh is so degenerate that its intersections with the cracks cannot be decided.
    """
    if not density > 0:
        raise BadInput(f"density must be positive, got {density}")
    if not 0 <= roughness < np.inf:
        raise BadInput(f"roughness must be zero or more, got {roughness}")
    on_grid = mesh_on_grid(shape.mesh, pattern.grid, shape.name)
    with stage("cells"):
        labels, edges = cell_labels(on_grid, pattern)
    for attempt in range(ATTEMPTS):
        with stage("sheets"):
            crack = crack_mesh(
                labels, edges, pattern, on_grid.low, roughness=roughness / pattern.grid.spacing, seed=attempt
            )
        try:
            pieces = _solids(shape.mesh, pattern.grid, on_grid, labels, crack)
            break
        except DegenerateIntersection:
            continue
    else:
        raise NoSolution(
            f"{shape.name}: cannot be cut: its surface intersects itself or degenerates where cracks cross it; "
            "try --repair"
        )
    return Fragments(tuple(_fragment(piece, density) for piece in pieces))


def _solids(mesh: Mesh, grid: Grid, on_grid: MeshOnGrid, labels: Labels, crack: CrackMesh) -> list[Solid]:
    with stage("cross"):
        intersections = intersect(on_grid, crack)
        cells, sides = parallel_invoke(
            lambda: surface_cells(on_grid, crack, intersections, labels),
            lambda: crack_sides(on_grid, crack, intersections),
        )
    with stage("divide"):
        faces = _cell_faces(mesh, grid, on_grid, crack, intersections, cells, sides)
        faces = collapse_short_edges(
            faces, SHORT_EDGE * grid.spacing, len(mesh.vertices), len(mesh.vertices) + len(crack.points)
        )
    pieces: list[Solid] = []
    if len(faces.inner):
        with stage("solids"):
            pieces = solids(faces, SMALLEST_VOXELS * grid.spacing**3)
    return pieces if len(pieces) > 1 else [_whole(mesh)]


def _whole(mesh: Mesh) -> Solid:
    return Solid(mesh, np.arange(len(mesh.faces)), *moments(mesh.vertices, mesh.faces, mesh.vertices[0]))


def _cell_faces(
    mesh: Mesh,
    grid: Grid,
    on_grid: MeshOnGrid,
    crack: CrackMesh,
    intersections: Intersections,
    cells: Ints,
    sides: Ints,
) -> CellFaces:
    """Both meshes, retriangulated where they intersect; of the crack mesh only what lies inside."""
    n, v = len(on_grid.points), len(crack.points)
    positions = _positions(
        mesh.vertices, crack.points, grid.to_world(on_grid.low), grid.spacing, intersections.ends,
        intersections.on_surface, intersections.t,
    )  # fmt: skip
    surface = IntersectedMesh(
        on_grid.faces, cells, lambda faces: on_grid.face_edges[faces], intersections.on_mesh_edges,
        intersections.mesh_segments, 0, n + v,
    )  # fmt: skip
    made = retriangulate(surface, positions, unwanted=0)
    outer, source, outer_cells = _outer_faces(
        on_grid.faces, cells, surface.segments.triangle, made.corners, made.label, made.parent
    )
    interfaces = IntersectedMesh(
        crack.triangles, sides, lambda triangles: edge_codes(crack.triangles[triangles], v),
        intersections.on_crack_edges, intersections.crack_segments, n, n + v,
    )  # fmt: skip
    made = retriangulate(interfaces, positions, unwanted=OUTSIDE)
    inner, inner_cells = _inner_faces(
        crack.triangles, crack.cells, sides, interfaces.segments.triangle, made.corners, made.parent, n
    )
    manifold = _manifold(outer, inner, on_grid.manifold, crack.manifold, n + v, len(positions))
    return CellFaces(positions, outer, source, outer_cells, inner, inner_cells, manifold)


@njit(cache=True)
def _manifold(outer, inner, on_surface, on_crack, first_intersection, count):
    """See `CellFaces.manifold`: the manifold vertices of both meshes, less those of faces with an intersection."""
    manifold = np.zeros(count, np.bool_)
    manifold[: len(on_surface)] = on_surface
    manifold[len(on_surface) : first_intersection] = on_crack
    for faces in (outer, inner):
        for f in range(len(faces)):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            if max(a, b, c) >= first_intersection:
                manifold[a] = manifold[b] = manifold[c] = False
    return manifold


@njit(cache=True)
def _positions(vertices, crack_points, low, spacing, ends, on_surface, t):
    """Positions of the surface's vertices, the crack mesh's and the intersections [m], shape (p, 3).

    Intersections are interpolated between the ends of their edges in the world, so those of the surface lie exactly on
    its edges."""
    n, v = len(vertices), len(crack_points)
    positions = np.empty((n + v + len(t), 3))
    positions[:n] = vertices
    for p in range(v):
        for x in range(3):
            positions[n + p, x] = low[x] + spacing * crack_points[p, x]
    for p in range(len(t)):
        shift = 0 if on_surface[p] else n
        a, b = ends[p, 0] + shift, ends[p, 1] + shift
        for x in range(3):
            positions[n + v + p, x] = positions[a, x] + t[p] * (positions[b, x] - positions[a, x])
    return positions


@njit(cache=True, nogil=True)
def _outer_faces(faces, cells, crossed, corners, label, parent):
    """Corners, source and cell of the faces that no crack crosses, and of those that replace the others."""
    whole = np.ones(len(faces), np.bool_)
    whole[crossed] = False
    count = len(corners) + whole.sum()
    outer, source, cell = np.empty((count, 3), np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    made = 0
    for f in range(len(faces)):
        if whole[f]:
            outer[made, 0], outer[made, 1], outer[made, 2] = faces[f, 0], faces[f, 1], faces[f, 2]
            source[made], cell[made] = f, cells[faces[f, 0]]
            made += 1
    outer[made:], source[made:], cell[made:] = corners, parent, label
    return outer, source, cell


@njit(cache=True, nogil=True)
def _inner_faces(triangles, cells, sides, crossed, corners, parent, shift):
    """Corners, shifted, of the crack triangles that lie inside whole, and of those that replace triangles which the
    surface crosses; and the cells below and above them."""
    whole = np.ones(len(triangles), np.bool_)
    whole[crossed] = False
    inner = np.empty((len(triangles) + len(corners), 3), np.int64)
    adjacent = np.empty((len(triangles) + len(corners), 2), np.int64)
    made = 0
    for t in range(len(triangles)):
        if whole[t] and sides[triangles[t, 0]] == INSIDE:
            for n in range(3):
                inner[made, n] = triangles[t, n] + shift
            adjacent[made, 0], adjacent[made, 1] = cells[t, 0], cells[t, 1]
            made += 1
    for p in range(len(corners)):
        inner[made, 0], inner[made, 1], inner[made, 2] = corners[p, 0], corners[p, 1], corners[p, 2]
        adjacent[made, 0], adjacent[made, 1] = cells[parent[p], 0], cells[parent[p], 1]
        made += 1
    return inner[:made], adjacent[:made]


def _fragment(piece: Solid, density: float) -> Fragment:
    mass = properties_from_moments(piece.volume, piece.first, piece.second, piece.mesh.vertices[0], density)
    return Fragment(piece.mesh, piece.source, mass.mass, mass.centre, mass.inertia)
