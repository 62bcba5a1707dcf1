"""From faces that belong to cells to closed solids, each with its own vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.carve.cutting.shells import Flags, Marks, Solid, by_number, half_faces, meshed, surfaces_of, twins
from deepfracture.carve.cutting.small_components import solids_of_shells
from deepfracture.geometry import moments
from deepfracture.geometry.hashing import all_distinct
from deepfracture.runtime.parallel import parallel_for, parallel_map
from deepfracture.types import Floats, Ints, Mesh


@dataclass(frozen=True, eq=False)
class Faces:
    """The body's surface and all cracks inside it. Every edge of a cell's surface has two faces."""

    positions: Floats
    """[m], shape (p, 3)."""
    outer: Ints
    """Corners, outward, shape (m, 3)."""
    source: Ints
    """Shape (m,)."""
    cell: Ints
    """Shape (m,)."""
    inner: Ints
    """Corners, counter-clockwise seen from the cell above, shape (k, 3)."""
    sides: Ints
    """Cells below and above, shape (k, 2)."""
    plain: Flags
    """Points around which the faces of each cell are one fan, as cells and mesh are there: these need no pairs of
    edges to be told apart. Shape (p,)."""


def solids(faces: Faces, smallest: float) -> list[Solid]:
    """The connected solids of all cells, those below the volume `smallest` [m^3] joined to a neighbour.

    Dust joins the neighbour that it shares most crack surface with, and the faces between them go; what touches no
    other solid stays as it is. Raises NotGeneral if some cell's surface is not closed."""
    while True:
        made, doubles = _solids(faces, smallest)
        if not len(doubles):
            return made
        faces = _halved(faces, doubles)


def _solids(faces: Faces, smallest: float) -> tuple[list[Solid], Ints]:
    """The solids, and the edges, as points, that join the same two vertices of a solid twice, shape (d, 2)."""
    outer, inner = len(faces.outer), len(faces.inner)
    corners, cell = np.empty((outer + 2 * inner, 3), np.int32), np.empty(outer + 2 * inner, np.int32)
    parallel_for(
        lambda first, last: half_faces(
            faces.outer, faces.cell, faces.inner, faces.sides, corners, cell, first, last
        ),
        outer + inner, least=16384,
    )  # fmt: skip
    marks = Marks(len(faces.positions))
    surfaces = surfaces_of(faces.positions, faces.source, corners, cell, faces.plain, marks)
    shell, first = surfaces.shell, surfaces.first
    into = solids_of_shells(faces.positions, corners, cell, shell, first, surfaces.volumes, outer, inner, smallest)
    names = np.unique(into[into >= 0])
    names = names[np.lexsort([names, cell[first[names]]])]
    number = np.full(len(into) + 1, -1)
    number[names] = np.arange(len(names))
    solid = number[into]
    several = np.bincount(solid[solid >= 0], minlength=len(names)) > 1
    made = [None if several[n] else surfaces.solids[name] for n, name in enumerate(names.tolist())]
    twice = [np.empty((0, 2), np.int64)]
    rest = np.array([found is None for found in made], np.bool_)
    if rest.any():
        goes, joined = _going(shell, solid, outer, inner, len(names))
        order, start = by_number(shell, solid, goes, len(names))
        plain = _without_corners(faces.plain, corners, shell, cell[first] != cell[first[into]])
        cells = np.unique(surfaces.cell[first[(solid >= 0) & rest[solid]]])
        twin = twins(surfaces, corners, cells, goes, plain, outer, inner)

        def make(n: int) -> None:
            own = order[start[n] : start[n + 1]]
            with marks.taken(3 * len(own)) as (scratch, base):
                vertices, turned, source, points = meshed(
                    faces.positions, faces.source, corners, twin, own, plain, scratch, base
                )
            made[n] = Solid(Mesh(vertices, turned), source, *moments(vertices, turned, vertices[0]))
            if joined[n]:
                twice.append(points[_doubles(turned, len(points))])

        which = np.flatnonzero(rest)
        parallel_map(lambda n: make(which[n]), np.diff(start)[which].tolist())
    return [solid for solid in made if solid is not None], np.concatenate(twice)


@njit(cache=True, nogil=True)
def _without_corners(plain, corners, shell, guests):
    """The plain points less those of some shells, which have joined the solid of another cell: there the faces of both
    may be two fans."""
    left = plain.copy()
    for f in range(len(shell)):
        if guests[shell[f]]:
            left[corners[f, 0]] = left[corners[f, 1]] = left[corners[f, 2]] = False
    return left


def _doubles(faces: Ints, count: int) -> Ints:
    """Pairs of vertices that more than one edge joins: as where dust has joined a solid along an edge, too."""
    following = faces[:, [1, 2, 0]]
    forth = (faces < following).ravel()
    keys = (faces * count + following).ravel()[forth]
    if all_distinct(keys):
        return np.empty((0, 2), np.int64)
    unique, times = np.unique(keys, return_counts=True)
    return np.stack(np.divmod(unique[times > 1], count), axis=1)


def _halved(faces: Faces, edges: Ints) -> Faces:
    """The same faces with some edges halved, whichever cells they belong to: where two parts of a solid meet along
    an edge only, each of them then has a midpoint of its own."""
    count = len(faces.positions)
    keys = np.unique(edges.min(axis=1) * count + edges.max(axis=1))
    ends = np.stack(np.divmod(keys, count), axis=1)
    positions = np.concatenate([faces.positions, faces.positions[ends].mean(axis=1)])
    outer, of_outer = _halves(faces.outer, keys, count)
    inner, of_inner = _halves(faces.inner, keys, count)
    plain = np.concatenate([faces.plain, np.zeros(len(ends), np.bool_)])
    plain[ends] = False
    return Faces(positions, outer, faces.source[of_outer], faces.cell[of_outer], inner, faces.sides[of_inner], plain)


def _halves(corners: Ints, keys: Ints, count: int) -> tuple[Ints, Ints]:
    """Triangles with the edges `keys` halved at the points from `count` on, and the triangle each is part of."""
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
def _going(shell, solid, outer, inner, count):
    """Which faces go: those between two parts of a solid, and flat debris; and which solids have such parts. `solid`:
    of each shell, -1 for flat debris."""
    goes, joined = np.empty(len(shell), np.bool_), np.zeros(count, np.bool_)
    for f in range(outer):
        goes[f] = solid[shell[f]] < 0
    for f in range(outer, outer + inner):
        one, two = solid[shell[f]], solid[shell[f + inner]]
        goes[f], goes[f + inner] = one < 0 or one == two, two < 0 or one == two
        if one == two and one >= 0:
            joined[one] = True
    return goes, joined
