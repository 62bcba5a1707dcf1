"""From faces that belong to cells to closed solids, each with its own vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.carve.cutting.merge_shells import merge_shells
from deepfracture.carve.cutting.shells import (
    Flags,
    Solid,
    VertexMaps,
    build_mesh,
    cell_surfaces,
    group_faces,
    oriented_faces,
    twins_across,
)
from deepfracture.geometry import moments
from deepfracture.geometry.hashing import all_distinct
from deepfracture.runtime.parallel import parallel_for, parallel_map
from deepfracture.types import Floats, Ints, Mesh


@dataclass(frozen=True, eq=False)
class CellFaces:
    """The body's surface and all cracks inside it, as faces of cells. Every edge of a cell's surface has two faces."""

    positions: Floats
    """[m], shape (p, 3)."""
    outer: Ints
    """Corners, facing outward, shape (m, 3)."""
    source: Ints
    """As in `Fragment.source`, shape (m,)."""
    cell: Ints
    """Shape (m,)."""
    inner: Ints
    """Corners, counter-clockwise seen from the cell above, shape (k, 3)."""
    inner_cells: Ints
    """Cells below and above, shape (k, 2)."""
    manifold: Flags
    """Points around which the faces of each cell are a single fan, known from mesh and cells: these need no half-edges
    to be told apart. Shape (p,)."""


def solids(faces: CellFaces, smallest: float) -> list[Solid]:
    """The connected solids of all cells, those below the volume `smallest` [m^3] merged into a neighbour.

    A small solid joins the neighbour that it shares most crack area with, and the faces between them are removed; one
    that touches no other stays. Raises DegenerateIntersection if some cell's surface is not closed."""
    while True:
        made, double_edges = _solids(faces, smallest)
        if not len(double_edges):
            return made
        faces = _split_edges(faces, double_edges)


def _solids(faces: CellFaces, smallest: float) -> tuple[list[Solid], Ints]:
    """The solids, and the edges, as points, that join the same two vertices of a solid twice, shape (d, 2)."""
    outer, inner = len(faces.outer), len(faces.inner)
    corners, cell = np.empty((outer + 2 * inner, 3), np.int32), np.empty(outer + 2 * inner, np.int32)
    parallel_for(
        lambda first, last: oriented_faces(
            faces.outer, faces.cell, faces.inner, faces.inner_cells, corners, cell, first, last
        ),
        outer + inner, least=16384,
    )  # fmt: skip
    maps = VertexMaps(len(faces.positions))
    surfaces = cell_surfaces(faces.positions, faces.source, corners, cell, faces.manifold, maps)
    shell, first = surfaces.shell, surfaces.first
    owner = merge_shells(faces.positions, corners, cell, surfaces, outer, inner, smallest)
    owners = np.unique(owner[owner >= 0])
    owners = owners[np.lexsort([owners, cell[first[owners]]])]
    number = np.full(len(owner) + 1, -1)
    number[owners] = np.arange(len(owners))
    solid = number[owner]  # of each shell
    several = np.bincount(solid[solid >= 0], minlength=len(owners)) > 1
    made = [None if several[n] else surfaces.solids[shell] for n, shell in enumerate(owners.tolist())]
    doubled = [np.empty((0, 2), np.int64)]
    pending = np.array([found is None for found in made], np.bool_)
    if pending.any():
        removed, merged = _removed_faces(shell, solid, outer, inner, len(owners))
        order, start = group_faces(shell, solid, removed, len(owners))
        manifold = _without_guests(faces.manifold, corners, shell, cell[first] != cell[first[owner]])
        cells = np.unique(surfaces.cell[first[(solid >= 0) & pending[solid]]])
        twin = twins_across(surfaces, corners, cells, removed, manifold, outer, inner)

        def build(n: int) -> None:
            own = order[start[n] : start[n + 1]]
            with maps.borrowed(3 * len(own)) as (vertex_map, base):
                vertices, triangles, source, points = build_mesh(
                    faces.positions, faces.source, corners, twin, own, manifold, vertex_map, base
                )
            made[n] = Solid(Mesh(vertices, triangles), source, *moments(vertices, triangles, vertices[0]))
            if merged[n]:
                doubled.append(points[_double_edges(triangles, len(points))])

        which = np.flatnonzero(pending)
        parallel_map(lambda n: build(which[n]), np.diff(start)[which].tolist())
    return [solid for solid in made if solid is not None], np.concatenate(doubled)


@njit(cache=True, nogil=True)
def _without_guests(manifold, corners, shell, guests):
    """The manifold points less those of some shells, which have joined the solid of another cell: there the faces of
    both may be two fans."""
    left = manifold.copy()
    for f in range(len(shell)):
        if guests[shell[f]]:
            left[corners[f, 0]] = left[corners[f, 1]] = left[corners[f, 2]] = False
    return left


def _double_edges(faces: Ints, count: int) -> Ints:
    """Pairs of vertices joined by more than one edge, as where a small solid touches its new solid along an edge,
    too."""
    following = faces[:, [1, 2, 0]]
    forth = (faces < following).ravel()
    keys = (faces * count + following).ravel()[forth]
    if all_distinct(keys):
        return np.empty((0, 2), np.int64)
    unique, times = np.unique(keys, return_counts=True)
    return np.stack(np.divmod(unique[times > 1], count), axis=1)


def _split_edges(faces: CellFaces, edges: Ints) -> CellFaces:
    """The same faces with some edges split at their midpoints, whichever cells they belong to: where two parts of a
    solid touch along an edge only, each of them then has a midpoint of its own."""
    count = len(faces.positions)
    keys = np.unique(edges.min(axis=1) * count + edges.max(axis=1))
    ends = np.stack(np.divmod(keys, count), axis=1)
    positions = np.concatenate([faces.positions, faces.positions[ends].mean(axis=1)])
    outer, of_outer = _split_triangles(faces.outer, keys, count)
    inner, of_inner = _split_triangles(faces.inner, keys, count)
    manifold = np.concatenate([faces.manifold, np.zeros(len(ends), np.bool_)])
    manifold[ends] = False
    return CellFaces(
        positions, outer, faces.source[of_outer], faces.cell[of_outer], inner, faces.inner_cells[of_inner], manifold
    )


def _split_triangles(corners: Ints, keys: Ints, count: int) -> tuple[Ints, Ints]:
    """Triangles with the edges `keys` split at the points from `count` on, and the triangle each is part of."""
    of = np.arange(len(corners))
    for n in [0, 1, 2] * 3:
        a, b, c = corners[:, n], corners[:, (n + 1) % 3], corners[:, (n + 2) % 3]
        code = np.where(np.maximum(a, b) < count, np.minimum(a, b) * count + np.maximum(a, b), -1)
        at = np.minimum(np.searchsorted(keys, code), len(keys) - 1)
        hit = keys[at] == code
        middle = count + at[hit]
        second = np.stack([middle, b[hit], c[hit]], axis=1)
        corners = corners.copy()
        corners[hit, (n + 1) % 3] = middle
        corners, of = np.concatenate([corners, second]), np.concatenate([of, of[hit]])
    return corners, of


@njit(cache=True, nogil=True)
def _removed_faces(shell, solid, outer, inner, count):
    """Which faces are removed: those between two merged parts of a solid, and flat debris; and which solids have such
    parts. `solid`: of each shell, -1 for flat debris."""
    removed, merged = np.empty(len(shell), np.bool_), np.zeros(count, np.bool_)
    for f in range(outer):
        removed[f] = solid[shell[f]] < 0
    for f in range(outer, outer + inner):
        one, two = solid[shell[f]], solid[shell[f + inner]]
        removed[f], removed[f + inner] = one < 0 or one == two, two < 0 or one == two
        if one == two and one >= 0:
            merged[one] = True
    return removed, merged
