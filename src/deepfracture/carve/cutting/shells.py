"""From faces that belong to cells to the closed surfaces of the cells: their shells, and the twin of each half-edge."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.cutting.intersect import DegenerateIntersection
from deepfracture.geometry import moments
from deepfracture.geometry.disjoint_sets import find, union
from deepfracture.runtime.parallel import parallel_map
from deepfracture.types import Floats, Ints, Mesh

Flags = NDArray[np.bool_]

PAIRED = np.iinfo(np.int32).min
"""In place of a half-edge whose twin has been found: no half-edge's number, nor the ~ of one."""


@dataclass(frozen=True, eq=False)
class Solid:
    """One connected solid with a closed 2-manifold surface; voids inside it are shells of their own."""

    mesh: Mesh
    source: Ints
    """As in `Fragment.source`."""
    volume: float
    """[m^3]"""
    first: Floats
    """Integral of x [m^4], shape (3,) ..."""
    second: Floats
    """... and of x x^T [m^5], shape (3, 3), both about its first vertex."""


@dataclass(frozen=True, eq=False)
class CellSurfaces:
    """The closed surfaces of all cells."""

    shell: NDArray
    """Number 0.. of the shell that each face belongs to, shape (f,)."""
    first: Ints
    """The first face of each shell, shape (s,) ..."""
    volumes: Floats
    """... and its signed volume [m^3]."""
    solids: list[Solid | None]
    """The solid in each shell, None where its cell has other shells."""
    cell: NDArray
    """Number 0.. of the cell of each face, shape (f,)."""
    order: NDArray[np.int32]
    """The faces, cell by cell, shape (f,) ..."""
    start: Ints
    """... and where those of each cell start, and their number, shape (c + 1,)."""


def cell_surfaces(
    positions: Floats, source: Ints, corners: NDArray, cell: NDArray, manifold: Flags, vertex_map: VertexMaps
) -> CellSurfaces:
    """The closed surfaces of all cells. Raises DegenerateIntersection if a half-edge has no twin, or several."""
    if cell.max(initial=0) > len(cell):  # labels with gaps
        cell = np.unique(cell, return_inverse=True)[1].reshape(-1).astype(np.int32)
    cells = int(cell.max(initial=0)) + 1
    order, start = group_faces(cell, np.arange(cells), np.zeros(len(cell), np.bool_), cells)
    twin, shell = np.empty(3 * len(cell), np.int32), np.zeros(len(cell), np.int32)

    def close(n: int) -> tuple[bool, Ints, Floats, list[Solid | None]]:
        own = order[start[n] : start[n + 1]]
        with vertex_map.borrowed(3 * len(own)) as (scratch, base):
            closed, vertices, faces, face_source, first, volumes = _close_surface(
                positions, source, corners, own, manifold, scratch, base, twin, shell
            )
        if len(first) != 1:
            return closed, first, volumes, [None] * len(first)
        solid = Solid(Mesh(vertices, faces), face_source, *moments(vertices, faces, vertices[0]))
        return closed, first, np.array([solid.volume]), [solid]

    found = parallel_map(close, np.diff(start).tolist())
    if not all(closed for closed, *_ in found):
        raise DegenerateIntersection
    shells = np.array([len(first) for _, first, *_ in found])
    _shift(shell, cell, np.cumsum(shells) - shells)
    first, volumes = np.concatenate([part[1] for part in found]), np.concatenate([part[2] for part in found])
    return CellSurfaces(shell, first, volumes, [solid for part in found for solid in part[3]], cell, order, start)


@njit(cache=True, nogil=True)
def _shift(shell, cell, by):
    for f in range(len(shell)):
        shell[f] += by[cell[f]]


@njit(cache=True, nogil=True)
def _close_surface(positions, source, corners, own, manifold, vertex_map, base, twin, shell):
    """Whether the surface of a cell is closed; vertices, faces and sources as of `build_mesh`; the first face and,
    where there are several, the signed volume of each of its shells. Writes `shell`, from 0. `twin`: scratch."""
    first, volumes = np.empty(0, np.int64), np.empty(0)
    if not pair_edges(corners, own, manifold, twin):
        return False, np.empty((0, 3)), np.empty((0, 3), np.int64), first, first, volumes
    vertices, faces, face_source, _ = build_mesh(positions, source, corners, twin, own, manifold, vertex_map, base)
    parent, shells = np.arange(len(vertices)).astype(np.int32), len(vertices)
    for f in range(len(faces)):
        for n in range(1, 3):
            shells -= union(parent, faces[f, 0], faces[f, n])
    first = np.empty(shells, np.int64)
    if shells == 1:
        first[0] = own[0]
    if shells <= 1:
        return True, vertices, faces, face_source, first, volumes
    number, volumes = np.full(len(vertices), -1), np.zeros(shells)
    made = 0
    for f in range(len(faces)):
        head = find(parent, faces[f, 0])
        if number[head] < 0:
            number[head], first[made] = made, own[f]
            made += 1
        n = number[head]
        shell[own[f]] = n
        volumes[n] += _six_volumes(
            positions, corners[first[n], 0], corners[own[f], 0], corners[own[f], 1], corners[own[f], 2]
        )
    return True, vertices, faces, face_source, first, volumes / 6


@njit(cache=True, nogil=True)
def pair_edges(corners, own, manifold, twin):
    """Whether each half-edge of a cell's faces with a non-manifold end has exactly one that runs back in the same cell:
    its twin, which is written. Half-edges are numbered 3 face + corner from which they lead to the next.

    The hash table maps an edge (`keys`) to the first half-edge along it, ~number if from the higher point, PAIRED once
    its twin has come (`edges`). Its hash puts neighbouring edges next to each other, which keeps it in the cache;
    collisions are resolved by double hashing."""
    faces, count, free = np.empty(len(own), np.int32), 0, 0
    for f in own:
        here = 3 - int(manifold[corners[f, 0]]) - int(manifold[corners[f, 1]]) - int(manifold[corners[f, 2]])
        faces[count] = f
        count += here > 0
        free += here
    room = 16
    while room < 2 * free:  # each edge that has a twin has at least two such corners
        room *= 2
    keys, edges = np.full((room, 2), -1, np.int32), np.empty(room, np.int32)
    used, unpaired = 0, 0
    for f in faces[:count]:
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        for n in range(3):
            if not (manifold[a] and manifold[b]):
                low, high = min(a, b), max(a, b)
                edge = np.int32(3 * f + n)
                # Neighbours meet nearby in the table; only what finds its place borrowed is sent far away.
                at = np.int64(8 * np.int64(low) + (5 * np.int64(high) >> 1 & 7)) & (room - 1)
                step = (np.int64(high) * 0x9E3779B97F4A7C1) >> 20 | 1
                while keys[at, 0] >= 0 and (keys[at, 0] != low or keys[at, 1] != high):
                    at = (at + step) & (room - 1)
                if keys[at, 0] < 0:
                    if used == free:
                        return False
                    keys[at, 0], keys[at, 1], edges[at] = low, high, edge if a < b else ~edge
                    used, unpaired = used + 1, unpaired + 1
                else:
                    other = edges[at] if a > b else ~edges[at]
                    if edges[at] == PAIRED or other < 0:
                        return False
                    twin[edge], twin[other] = other, edge
                    edges[at] = PAIRED
                    unpaired -= 1
            a, b, c = b, c, a
    return unpaired == 0


@njit(cache=True, nogil=True)
def build_mesh(positions, source, corners, twin, own, manifold, vertex_map, base):
    """Vertices and faces of a closed surface, the source of each face (-1 of cracks), and the point of each vertex.

    One vertex for each manifold point, and for each fan of faces around any other. `own`: its faces, in `corners`;
    `vertex_map`: base + vertex of a manifold point. The twin of a corner at another point becomes ~vertex."""
    faces, points = np.empty((len(own), 3), np.int64), np.empty(3 * len(own), np.int64)
    face_source = np.empty(len(own), np.int64)
    used = 0
    for f in range(len(own)):
        face_source[f] = source[own[f]] if own[f] < len(source) else -1
        for n in range(3):
            p = corners[own[f], n]
            if manifold[p]:
                if vertex_map[p] < base:
                    vertex_map[p], points[used] = base + used, p
                    used += 1
                faces[f, n] = vertex_map[p] - base
                continue
            corner = 3 * own[f] + n
            if twin[corner] >= 0:
                points[used] = p
                at = corner
                while twin[at] >= 0:
                    back = twin[at]
                    twin[at] = ~used
                    at = back - 2 if back % 3 == 2 else back + 1
                used += 1
            faces[f, n] = ~twin[corner]
    vertices = np.empty((used, 3))
    for n in range(used):
        for x in range(3):
            vertices[n, x] = positions[points[n], x]
    return vertices, faces, face_source, points[:used].copy()


@njit(cache=True, inline="always")
def _six_volumes(positions, pivot, one, two, three):
    """Six times the signed volume of a tetrahedron."""
    p, a, b, c = positions[pivot], positions[one], positions[two], positions[three]
    ax, ay, az, bx, by, bz = a[0] - p[0], a[1] - p[1], a[2] - p[2], b[0] - p[0], b[1] - p[1], b[2] - p[2]
    cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    return ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)


def twins_across(
    surfaces: CellSurfaces, corners: NDArray, cells: Ints, removed: Flags, manifold: Flags, outer: int, inner: int
) -> NDArray:
    """For half-edges of some cells, numbered 3 face + corner, with a non-manifold end, their twins once some faces are
    `removed`: the faces on both sides of a removed pair become neighbours. Anything for all others."""
    twin = np.empty(3 * len(corners), np.int32)
    owned = [surfaces.order[surfaces.start[n] : surfaces.start[n + 1]] for n in cells]
    sizes = [len(own) for own in owned]
    parallel_map(lambda n: pair_edges(corners, owned[n], manifold, twin), sizes)
    parallel_map(lambda n: _bridge_removed(corners, owned[n], manifold, removed, outer, inner, twin), sizes)
    return twin


@njit(cache=True, nogil=True)
def _bridge_removed(corners, own, manifold, removed, outer, inner, twin):
    """Twins of a cell's remaining faces where they were `removed` faces. Only twins of removed faces are read."""
    for f in own:
        if removed[f]:
            continue
        for n in range(3):
            if manifold[corners[f, n]] and manifold[corners[f, (n + 1) % 3]]:
                continue
            other = twin[3 * f + n]
            while removed[other // 3]:
                other = twin[3 * opposite_face(other // 3, outer, inner) + 2 - other % 3]
            twin[3 * f + n] = other


@njit(cache=True, nogil=True)
def oriented_faces(outer, cell, inner, inner_cells, corners, cells, first, last):
    """Write corners and cell of each face of each cell: the outer ones, the inner ones as the cell below them has them,
    and reversed as the one above has them, for some of the outer and inner faces. `opposite_face` leads from one to the
    other."""
    m, k = len(outer), len(inner)
    for f in range(first, min(last, m)):
        corners[f, 0], corners[f, 1], corners[f, 2] = outer[f, 0], outer[f, 1], outer[f, 2]
        cells[f] = cell[f]
    for f in range(max(first, m), last):
        a, b, c = inner[f - m, 0], inner[f - m, 1], inner[f - m, 2]
        corners[f, 0], corners[f, 1], corners[f, 2] = a, b, c
        corners[k + f, 0], corners[k + f, 1], corners[k + f, 2] = a, c, b
        cells[f], cells[k + f] = inner_cells[f - m, 0], inner_cells[f - m, 1]


@njit(cache=True, inline="always")
def opposite_face(face, outer, inner):
    """The other side of a crack face, -1 of an outer one. Edge n of the one runs along edge 2 - n of the other."""
    if face < outer:
        return -1
    return face + inner if face < outer + inner else face - inner


@njit(cache=True, nogil=True)
def group_faces(names, number, removed, count):
    """The remaining faces by the number of their names, and where those of each number start."""
    start = np.zeros(count + 1, np.int64)
    for f in range(len(names)):
        if not removed[f]:
            start[number[names[f]] + 1] += 1
    for n in range(count):
        start[n + 1] += start[n]
    place, order = start[:-1].copy(), np.empty(start[-1], np.int32)
    for f in range(len(names)):
        if not removed[f]:
            n = number[names[f]]
            order[place[n]] = f
            place[n] += 1
    return order, start


class VertexMaps:
    """Maps from points to numbers, one for each thread, reused without clearing: numbers below the `base` are stale."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._free: list[tuple[NDArray[np.int32], int]] = []

    @contextmanager
    def borrowed(self, room: int) -> Iterator[tuple[NDArray[np.int32], int]]:
        """A map and its base; numbers up to base + `room` may be written to it."""
        try:
            vertex_map, base = self._free.pop()
        except IndexError:
            vertex_map, base = np.zeros(self._count, np.int32), 1
        if base > np.iinfo(np.int32).max - room:
            vertex_map, base = np.zeros(self._count, np.int32), 1
        yield vertex_map, base
        self._free.append((vertex_map, base + room))
