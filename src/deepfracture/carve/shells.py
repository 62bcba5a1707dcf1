"""From faces that belong to cells to the closed surfaces of the cells: shells, and which edge runs back along which."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.crossing import NotGeneral
from deepfracture.carve.join import root, unite
from deepfracture.threads import apportion
from deepfracture.types import Floats, Ints

Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The surfaces of all cells, which are closed."""

    twin: NDArray
    """For the edge from each corner to the next (number 3 face + corner) the one that runs back in the same cell's
    surface, where one of its ends is not plain; anything for the others. Shape (3 f,)."""
    shell: NDArray
    """Number 0.. of the shell that each face belongs to, shape (f,)."""
    first: Ints
    """The first face of each shell, shape (s,) ..."""
    volumes: Floats
    """... and its signed volume [m^3]."""
    cell: NDArray
    """Number 0.. of the cell of each face, shape (f,)."""
    order: NDArray[np.int32]
    """The faces, cell by cell, shape (f,) ..."""
    start: Ints
    """... and where each starts, and their number, shape (c + 1,)."""


def surfaces_of(positions: Floats, corners: NDArray, cell: NDArray, plain: Flags, marks: Marks) -> Surfaces:
    """See there. Raises NotGeneral if an edge has none that runs back, or several."""
    if cell.max(initial=0) > len(cell):  # names, not numbers
        cell = np.unique(cell, return_inverse=True)[1].reshape(-1).astype(np.int32)
    cells = int(cell.max(initial=0)) + 1
    order, start = by_number(cell, np.arange(cells), np.zeros(len(cell), np.bool_), cells)
    twin, shell = np.empty(3 * len(cell), np.int32), np.empty(len(cell), np.int32)

    def close(n: int) -> tuple[bool, Ints, Floats]:
        own = order[start[n] : start[n + 1]]
        with marks.taken(len(own)) as (scratch, base):
            return _closed(positions, corners, own, plain, scratch, base, twin, shell)

    found = apportion(close, np.diff(start).tolist())
    if not all(fine for fine, *_ in found):
        raise NotGeneral
    shells = np.array([len(first) for _, first, _ in found])
    _shift(shell, cell, np.cumsum(shells) - shells)
    first, volumes = (np.concatenate([part[n] for part in found]) for n in (1, 2))
    return Surfaces(twin, shell, first, volumes, cell, order, start)


@njit(cache=True, nogil=True)
def _shift(shell, cell, by):
    for f in range(len(shell)):
        shell[f] += by[cell[f]]


@njit(cache=True, nogil=True)
def _closed(positions, corners, own, plain, marks, base, twin, shell):
    """Whether the surface of a cell is closed; the first face and the signed volume of each of its shells. Writes
    `twin`, and `shell` from 0.

    Faces hang together at plain points, and at edges elsewhere. `marks`: base + the first face at a plain point."""
    parent, first, volumes = np.empty(len(own), np.int32), np.empty(len(own), np.int64), np.zeros(len(own))
    loose = 0
    for i in range(len(own)):
        parent[i] = head = np.int32(i)
        for n in range(3):
            p = corners[own[i], n]
            if not plain[p]:
                loose += 1
            elif marks[p] < base:
                marks[p] = base + i
            else:
                other = root(parent, marks[p] - base)
                if other != head:
                    parent[max(head, other)] = min(head, other)
                    head = min(head, other)
    if loose and not _paired(corners, own, plain, loose, twin, parent):
        return False, first[:0], volumes[:0]
    shells = 0
    for i in range(len(own)):
        f, head = own[i], root(parent, i)
        if head == i:
            shell[f], first[shells] = shells, f
            shells += 1
        else:
            shell[f] = shell[own[head]]
        n = shell[f]
        volumes[n] += _six_volumes(positions, corners[first[n], 0], corners[f, 0], corners[f, 1], corners[f, 2])
    return True, first[:shells].copy(), volumes[:shells] / 6


@njit(cache=True, nogil=True)
def _paired(corners, own, plain, loose, twin, parent):
    """Whether each edge of a cell's faces with an end that is not plain has exactly one that runs back: its twin, whose
    face joins its own. `loose`: corners of these faces that are not plain.

    In a table with open addresses an edge (`keys`) has the number of the first that ran along it, ~number if from the
    higher point, and the place of its face in `own`, -1 once its twin has come (`edges`)."""
    room = 16
    while room < 2 * loose:  # two such corners at least belong to each edge that has a twin
        room *= 2
    keys, edges = np.full((room, 2), -1, np.int32), np.empty((room, 2), np.int32)
    used, lonely = 0, 0
    for i in range(len(own)):
        a, b, c = corners[own[i], 0], corners[own[i], 1], corners[own[i], 2]
        if plain[a] and plain[b] and plain[c]:
            continue
        for n in range(3):
            if not (plain[a] and plain[b]):
                low, high = min(a, b), max(a, b)
                edge = np.int32(3 * own[i] + n)
                # Neighbours meet nearby in the table; only what finds its place taken is sent far away.
                at = np.int64(8 * np.int64(low) + (5 * np.int64(high) >> 1 & 7)) & (room - 1)
                step = (np.int64(high) * 0x9E3779B97F4A7C1) >> 20 | 1
                while keys[at, 0] >= 0 and (keys[at, 0] != low or keys[at, 1] != high):
                    at = (at + step) & (room - 1)
                if keys[at, 0] < 0:
                    if used == loose:
                        return False
                    keys[at, 0], keys[at, 1], edges[at, 0], edges[at, 1] = low, high, edge if a < b else ~edge, i
                    used, lonely = used + 1, lonely + 1
                else:
                    other = edges[at, 0] if a > b else ~edges[at, 0]
                    if other < 0 or edges[at, 1] < 0:
                        return False
                    twin[edge], twin[other] = other, edge
                    unite(parent, i, edges[at, 1])
                    edges[at, 1] = -1
                    lonely -= 1
            a, b, c = b, c, a
    return lonely == 0


@njit(cache=True, inline="always")
def _six_volumes(positions, pivot, one, two, three):
    """Six times the signed volume of a tetrahedron."""
    p, a, b, c = positions[pivot], positions[one], positions[two], positions[three]
    ax, ay, az, bx, by, bz = a[0] - p[0], a[1] - p[1], a[2] - p[2], b[0] - p[0], b[1] - p[1], b[2] - p[2]
    cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    return ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)


def relink(surfaces: Surfaces, corners: NDArray, goes: Flags, plain: Flags, outer: int, inner: int) -> None:
    """Twins across the faces that go: the faces behind both sides of one meet. So the edges of the cells beside them
    need pairs where their corners were plain, too."""
    parted = np.zeros(len(surfaces.start) - 1, np.bool_)
    parted[surfaces.cell[goes]] = True
    cells = [surfaces.order[surfaces.start[n] : surfaces.start[n + 1]] for n in np.flatnonzero(parted)]
    sizes = [len(own) for own in cells]
    apportion(lambda n: _pair(corners, cells[n], plain, surfaces.twin), sizes)
    apportion(lambda n: _bridge(corners, cells[n], plain, goes, outer, inner, surfaces.twin), sizes)


@njit(cache=True, nogil=True)
def _pair(corners, own, plain, twin):
    """Write the twins of a cell, which is known to be closed."""
    parent, loose = np.empty(len(own), np.int32), 0
    for i in range(len(own)):
        parent[i] = i
        for n in range(3):
            loose += not plain[corners[own[i], n]]
    _paired(corners, own, plain, loose, twin, parent)


@njit(cache=True, nogil=True)
def _bridge(corners, own, plain, goes, outer, inner, twin):
    """Twins of the faces of a cell that stay where they were faces that go. Only twins of faces that go are read."""
    for f in own:
        if goes[f]:
            continue
        for n in range(3):
            if plain[corners[f, n]] and plain[corners[f, (n + 1) % 3]]:
                continue
            other = twin[3 * f + n]
            while goes[other // 3]:
                other = twin[3 * mate(other // 3, outer, inner) + 2 - other % 3]
            twin[3 * f + n] = other


@njit(cache=True, nogil=True)
def half_faces(outer, cell, inner, sides, corners, cells, first, last):
    """Write corners and cell of each face of each cell: the outer ones, the inner ones as the cell below them has them,
    and as the one above has them, for some of the outer and inner faces. `mate` leads from one to the other."""
    m, k = len(outer), len(inner)
    for f in range(first, min(last, m)):
        corners[f, 0], corners[f, 1], corners[f, 2] = outer[f, 0], outer[f, 1], outer[f, 2]
        cells[f] = cell[f]
    for f in range(max(first, m), last):
        a, b, c = inner[f - m, 0], inner[f - m, 1], inner[f - m, 2]
        corners[f, 0], corners[f, 1], corners[f, 2] = a, b, c
        corners[k + f, 0], corners[k + f, 1], corners[k + f, 2] = a, c, b
        cells[f], cells[k + f] = sides[f - m, 0], sides[f - m, 1]


@njit(cache=True, inline="always")
def mate(face, outer, inner):
    """The other side of a crack's face, -1 of an outer one. Edge n of the one runs along edge 2 - n of the other."""
    if face < outer:
        return -1
    return face + inner if face < outer + inner else face - inner


@njit(cache=True, nogil=True)
def by_number(names, number, goes, count):
    """The faces that stay, by the numbers of their names, and where those of each number start."""
    start = np.zeros(count + 1, np.int64)
    for f in range(len(names)):
        if not goes[f]:
            start[number[names[f]] + 1] += 1
    for n in range(count):
        start[n + 1] += start[n]
    place, order = start[:-1].copy(), np.empty(start[-1], np.int32)
    for f in range(len(names)):
        if not goes[f]:
            n = number[names[f]]
            order[place[n]] = f
            place[n] += 1
    return order, start


class Marks:
    """Numbers on points for whoever asks, a table for each thread: what others have written lies below the `base`."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._free: list[tuple[NDArray[np.int32], int]] = []

    @contextmanager
    def taken(self, room: int) -> Iterator[tuple[NDArray[np.int32], int]]:
        """A table and its base; less than base + `room` may be written to it."""
        try:
            marks, base = self._free.pop()
        except IndexError:
            marks, base = np.zeros(self._count, np.int32), 1
        if base > np.iinfo(np.int32).max - room:
            marks, base = np.zeros(self._count, np.int32), 1
        yield marks, base
        self._free.append((marks, base + room))
