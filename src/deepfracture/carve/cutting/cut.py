"""Fragments out of the original mesh: its surface and the crack sheets, divided along the curves where they meet."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.carve.cutting.cells import cell_labels
from deepfracture.carve.cutting.classify import sheet_walls, surface_cells
from deepfracture.carve.cutting.interfaces import Sheets, crack_sheets
from deepfracture.carve.cutting.intersect import INSIDE, OUTSIDE, Crossing, NotGeneral, cross, edge_codes
from deepfracture.carve.cutting.mesh_on_grid import Ground, ground_of
from deepfracture.carve.cutting.retriangulate import Surface, divide
from deepfracture.carve.cutting.shells import Solid
from deepfracture.carve.cutting.short_edges import without_short_edges
from deepfracture.carve.cutting.solids import Faces, solids
from deepfracture.geometry import moments, properties_of
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

DUST_VOXELS = 8.0
"""A piece below this volume [voxels] joins the neighbour it fits best: too small to have a shape."""
SHORT = 1e-2
"""Edges below this [voxels] go, but for those of the original."""
TRIES = 4
"""Draws of the jitter, each another, after which a cut that no draw makes exact is given up."""


def cut(shape: Shape, pattern: FracturePattern, *, density: float, roughness: float = 0.0) -> Fragments:
    """Cut the original mesh of a shape along a pattern's cracks.

    Every fragment is one connected solid with a closed 2-manifold surface; together they fill the original.
    Outside, their triangles are the original's, untouched except where a crack crosses them; neighbours
    hold the same crack vertices. Parts of a label that do not hang together become fragments of their own; dust joins
    a neighbour (`DUST_VOXELS`).

    No boolean is needed. Only triangles that cracks cross are divided, and only where they do; all others pass
    through. Which edges cross which triangles is decided by exact signs, so what is put together is closed.

    Args:
        shape: The whole body.
        pattern: Its cracks, on any grid.
        density: [kg/m^3]
        roughness: Grain of the crack faces [m]: their vertices are scattered by up to this, at most within a voxel.

    Raises:
        BadInput: The mesh is not closed and oriented, density is not positive, or roughness is negative.
        NoSolution: The mesh degenerates so that its crossings cannot be told.
    """
    if not density > 0:
        raise BadInput(f"density must be positive, got {density}")
    if not 0 <= roughness < np.inf:
        raise BadInput(f"roughness must be zero or more, got {roughness}")
    ground = ground_of(shape.mesh, pattern.grid, shape.name)
    with stage("cells"):
        labels, edges = cell_labels(ground, pattern)
    for attempt in range(TRIES):
        with stage("sheets"):
            sheets = crack_sheets(
                labels, edges, pattern, ground.low, grain=roughness / pattern.grid.spacing, seed=attempt
            )
        try:
            pieces = _pieces(shape.mesh, pattern.grid, ground, labels, sheets)
            break
        except NotGeneral:
            continue
    else:
        raise NoSolution(
            f"{shape.name}: cannot be cut: its surface crosses itself or degenerates where cracks cross it; "
            "try --repair"
        )
    return Fragments(tuple(_fragment(piece, density) for piece in pieces))


def _pieces(mesh: Mesh, grid: Grid, ground: Ground, labels: Labels, sheets: Sheets) -> list[Solid]:
    with stage("cross"):
        crossing = cross(ground, sheets)
        cells, walls = parallel_invoke(
            lambda: surface_cells(ground, sheets, crossing, labels), lambda: sheet_walls(ground, sheets, crossing)
        )
    with stage("divide"):
        faces = _faces(mesh, grid, ground, sheets, crossing, cells, walls)
        faces = without_short_edges(
            faces, SHORT * grid.spacing, len(mesh.vertices), len(mesh.vertices) + len(sheets.points)
        )
    pieces: list[Solid] = []
    if len(faces.inner):
        with stage("solids"):
            pieces = solids(faces, DUST_VOXELS * grid.spacing**3)
    return pieces if len(pieces) > 1 else [_whole(mesh)]


def _whole(mesh: Mesh) -> Solid:
    return Solid(mesh, np.arange(len(mesh.faces)), *moments(mesh.vertices, mesh.faces, mesh.vertices[0]))


def _faces(
    mesh: Mesh, grid: Grid, ground: Ground, sheets: Sheets, crossing: Crossing, cells: Ints, walls: Ints
) -> Faces:
    """Both surfaces, divided where they cross; of the sheets only what lies inside."""
    n, v = len(ground.points), len(sheets.points)
    positions = _positions(
        mesh.vertices, sheets.points, grid.to_world(ground.low), grid.spacing, crossing.ends, crossing.on_surface,
        crossing.share,
    )  # fmt: skip

    parts = divide(
        Surface(
            ground.faces, cells, lambda names: ground.edge_of[names], crossing.surface_nodes, crossing.on_faces,
            0, n + v,
        ),
        positions, unwanted=0,
    )  # fmt: skip
    outer, source, cell = _outer(
        ground.faces, cells, crossing.on_faces.triangle, parts.corners, parts.label, parts.parent
    )  # fmt: skip
    parts = divide(
        Surface(
            sheets.triangles, walls, lambda names: edge_codes(sheets.triangles[names], v), crossing.sheet_nodes,
            crossing.on_sheets, n, n + v,
        ),
        positions, unwanted=OUTSIDE,
    )  # fmt: skip
    inner, sides = _inner(
        sheets.triangles, sheets.sides, walls, crossing.on_sheets.triangle, parts.corners, parts.parent, n
    )
    plain = _plain(outer, inner, ground.plain, sheets.plain, n + v, len(positions))
    return Faces(positions, outer, source, cell, inner, sides, plain)


@njit(cache=True)
def _plain(outer, inner, on_surface, on_sheets, nodes_from, count):
    """See `Faces.plain`: what is said of the points of surface and sheets, less the points of faces with a node."""
    plain = np.zeros(count, np.bool_)
    plain[: len(on_surface)] = on_surface
    plain[len(on_surface) : nodes_from] = on_sheets
    for faces in (outer, inner):
        for f in range(len(faces)):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            if max(a, b, c) >= nodes_from:
                plain[a] = plain[b] = plain[c] = False
    return plain


@njit(cache=True)
def _positions(vertices, sheet_points, low, spacing, ends, on_surface, share):
    """Positions of the surface's vertices, the sheets' and the nodes [m], shape (p, 3).

    Nodes lie between the vertices as they are in the world: those on edges of the mesh exactly on them."""
    n, v = len(vertices), len(sheet_points)
    world = np.empty((n + v + len(share), 3))
    world[:n] = vertices
    for p in range(v):
        for x in range(3):
            world[n + p, x] = low[x] + spacing * sheet_points[p, x]
    for p in range(len(share)):
        shift = 0 if on_surface[p] else n
        a, b = ends[p, 0] + shift, ends[p, 1] + shift
        for x in range(3):
            world[n + v + p, x] = world[a, x] + share[p] * (world[b, x] - world[a, x])
    return world


@njit(cache=True, nogil=True)
def _outer(faces, cells, crossed, corners, label, parent):
    """Corners, source and cell of the faces that no crack crosses, and of the parts of the others."""
    whole = np.ones(len(faces), np.bool_)
    whole[crossed] = False
    count = len(corners) + whole.sum()
    out, source, cell = np.empty((count, 3), np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    made = 0
    for f in range(len(faces)):
        if whole[f]:
            out[made, 0], out[made, 1], out[made, 2] = faces[f, 0], faces[f, 1], faces[f, 2]
            source[made], cell[made] = f, cells[faces[f, 0]]
            made += 1
    out[made:], source[made:], cell[made:] = corners, parent, label
    return out, source, cell


@njit(cache=True, nogil=True)
def _inner(triangles, sides, walls, crossed, corners, parent, shift):
    """Corners of the sheets' triangles inside that the surface does not cross, by `shift` more, and of the parts of
    the others; and the cells below and above them."""
    whole = np.ones(len(triangles), np.bool_)
    whole[crossed] = False
    out, beside = (
        np.empty((len(triangles) + len(corners), 3), np.int64),
        np.empty((len(triangles) + len(corners), 2), np.int64),
    )
    made = 0
    for t in range(len(triangles)):
        if whole[t] and walls[triangles[t, 0]] == INSIDE:
            for n in range(3):
                out[made, n] = triangles[t, n] + shift
            beside[made, 0], beside[made, 1] = sides[t, 0], sides[t, 1]
            made += 1
    for p in range(len(corners)):
        out[made, 0], out[made, 1], out[made, 2] = corners[p, 0], corners[p, 1], corners[p, 2]
        beside[made, 0], beside[made, 1] = sides[parent[p], 0], sides[parent[p], 1]
        made += 1
    return out[:made], beside[:made]


def _fragment(piece: Solid, density: float) -> Fragment:
    mass = properties_of(piece.volume, piece.first, piece.second, piece.mesh.vertices[0], density)
    return Fragment(piece.mesh, piece.source, mass.mass, mass.centre, mass.inertia)
