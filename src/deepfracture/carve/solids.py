"""From faces that belong to cells to closed solids: half edges, shells, dust, vertices."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.crossing import NotGeneral
from deepfracture.carve.join import root
from deepfracture.geometry import moments
from deepfracture.threads import apportion, spread
from deepfracture.types import Floats, Ints, Mesh

Flags = NDArray[np.bool_]

FLAT = 1e-13
"""Share of the body's volume below which a shell is flat: nothing but rounding."""


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
    spread(
        lambda first, last: _half_faces(
            faces.outer, faces.cell, faces.inner, faces.sides, corners, cell, first, last
        ),
        outer + inner, least=16384,
    )  # fmt: skip
    marks = _Marks(len(faces.positions))
    surfaces = _surfaces(faces.positions, corners, cell, faces.plain, marks)
    shell, first = surfaces.shell, surfaces.first
    into = _solids_of_shells(faces.positions, corners, cell, shell, first, surfaces.volumes, outer, inner, smallest)
    names = np.unique(into[into >= 0])
    names = names[np.lexsort([names, cell[first[names]]])]
    number = np.full(len(into) + 1, -1)
    number[names] = np.arange(len(names))
    solid = number[into]
    goes, joined = _going(shell, solid, outer, inner, len(names))
    order, face_start = _sorted(shell, solid, goes, len(names))
    twin, plain = surfaces.twin, faces.plain
    if joined.any():
        guests = cell[first] != cell[first[into]]
        plain = _without_corners(plain, corners, shell, guests)
        _relink(surfaces, corners, goes, plain, outer, inner)

    def make(n: int) -> tuple[Solid, Ints]:
        own = order[face_start[n] : face_start[n + 1]]
        with marks.taken(3 * len(own)) as (scratch, base):
            vertices, fans, points, source, mass = _solid(
                faces.positions, faces.source, corners, twin, own, plain if joined[n] else faces.plain, scratch, base
            )
        twice = points[_doubles(fans, len(points))] if joined[n] else np.empty((0, 2), np.int64)
        return Solid(Mesh(vertices, fans), source, *mass), twice

    pairs = apportion(make, np.diff(face_start).tolist())
    return [solid for solid, _ in pairs], np.concatenate([np.empty((0, 2), np.int64), *(twice for _, twice in pairs)])


class _Marks:
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
    if _all_differ(keys):
        return np.empty((0, 2), np.int64)
    unique, times = np.unique(keys, return_counts=True)
    return np.stack(np.divmod(unique[times > 1], count), axis=1)


@njit(cache=True, nogil=True)
def _all_differ(keys):
    """Whether no key comes twice: by a table with open addresses."""
    size = 16
    while size < 4 * len(keys):
        size *= 2
    table = np.full(size, -1, np.int64)
    for key in keys:
        at = (key * 0x9E3779B97F4A7C1) >> 20 & (size - 1)
        while table[at] >= 0:
            if table[at] == key:
                return False
            at = (at + 1) & (size - 1)
        table[at] = key
    return True


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
def _half_faces(outer, cell, inner, sides, corners, cells, first, last):
    """Write corners and cell of each face of each cell: the outer ones, the inner ones as the cell below them has them,
    and as the one above has them, for some of the outer and inner faces. `_mate` leads from one to the other."""
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
def _mate(face, outer, inner):
    """The other side of a crack's face, -1 of an outer one. Edge n of the one runs along edge 2 - n of the other."""
    if face < outer:
        return -1
    return face + inner if face < outer + inner else face - inner


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


@njit(cache=True, nogil=True)
def _sorted(names, number, goes, count):
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


@dataclass(frozen=True, eq=False)
class _Surfaces:
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


def _surfaces(positions: Floats, corners: NDArray, cell: NDArray, plain: Flags, marks: _Marks) -> _Surfaces:
    """See there. Raises NotGeneral if an edge has none that runs back, or several."""
    if cell.max(initial=0) > len(cell):  # names, not numbers
        cell = np.unique(cell, return_inverse=True)[1].reshape(-1).astype(np.int32)
    cells = int(cell.max(initial=0)) + 1
    order, start = _sorted(cell, np.arange(cells), np.zeros(len(cell), np.bool_), cells)
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
    return _Surfaces(twin, shell, first, volumes, cell, order, start)


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


@njit(cache=True, inline="always")
def _join(parent, one, other):
    one, other = root(parent, one), root(parent, other)
    if one < other:
        parent[other] = one
    elif other < one:
        parent[one] = other


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
                    _join(parent, i, edges[at, 1])
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


def _solids_of_shells(
    positions: Floats,
    corners: NDArray,
    cell: NDArray,
    shell: NDArray,
    first: Ints,
    volumes: Floats,
    outer: int,
    inner: int,
    smallest: float,
) -> Ints:
    """The shell whose solid each shell belongs to in the end, -1 for flat debris."""
    flat = FLAT * np.abs(volumes).sum()
    into = np.arange(len(volumes))
    voids = np.flatnonzero(volumes < -flat)
    low, high = _boxes(positions, corners, shell, len(volumes)) if len(voids) else (positions, positions)
    for void in voids.tolist():
        point = positions[corners[first[void], 0]]
        boxed = (low <= point).all(axis=1) & (high >= point).all(axis=1)
        around = np.flatnonzero((cell[first] == cell[first[void]]) & (volumes > flat) & boxed)
        into[void] = _holder(positions, corners, shell, point, around[np.argsort(volumes[around])])
    whole = np.zeros(len(into))
    np.add.at(whole, into, volumes)
    small = (whole < smallest) & (into == np.arange(len(into)))
    if not small.any():
        return into
    pairs, area = _touching(positions, corners, into, shell, small, outer, inner)
    shared: dict[int, dict[int, float]] = {}
    unique, which = np.unique(pairs, return_inverse=True)
    for pair, size in zip(unique.tolist(), np.bincount(which.ravel(), area).tolist(), strict=True):
        one, two = divmod(pair, len(into))
        shared.setdefault(one, {})[two] = size
        shared.setdefault(two, {})[one] = size
    return _join_dust(into, whole, shared, np.flatnonzero(small).tolist(), smallest, flat)


@njit(cache=True, nogil=True)
def _touching(positions, corners, into, shell, small, outer, inner):
    """Faces between a small solid and another: both shells as one number, the lower first, and the area."""
    pairs, area = np.empty(inner, np.int64), np.empty(inner)
    count = 0
    for f in range(outer, outer + inner):
        one, two = into[shell[f]], into[shell[f + inner]]
        if one == two or not (small[one] or small[two]):
            continue
        a, b, c = positions[corners[f, 0]], positions[corners[f, 1]], positions[corners[f, 2]]
        ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        square = (uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2
        pairs[count], area[count] = min(one, two) * len(into) + max(one, two), 0.5 * np.sqrt(square)
        count += 1
    return pairs[:count], area[:count]


@njit(cache=True, nogil=True)
def _boxes(positions, corners, shell, count):
    """The lowest and the highest coordinates of each shell, shape (count, 3) each."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for f in range(len(shell)):
        for n in range(3):
            for x in range(3):
                value = positions[corners[f, n], x]
                low[shell[f], x] = min(low[shell[f], x], value)
                high[shell[f], x] = max(high[shell[f], x], value)
    return low, high


def _holder(positions: Floats, corners: NDArray, shell: NDArray, point: Floats, around: Ints) -> int:
    """The smallest of the shells `around`, in ascending order, that holds a point of a void."""
    if not len(around):
        raise NotGeneral
    for candidate in around[:-1].tolist():
        if _encloses(positions[corners[shell == candidate]], point):
            return candidate
    return int(around[-1])


def _encloses(triangles: Floats, point: Floats) -> bool:
    """Whether a closed surface winds around a point off it (van Oosterom & Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    dots = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
    angle = 2 * np.arctan2((a * np.cross(b, c)).sum(1), dots)
    return bool(angle.sum() > 2 * np.pi)


def _join_dust(
    into: Ints, volumes: Floats, shared: dict[int, dict[int, float]], small: list[int], smallest: float, flat: float
) -> Ints:
    """The solid that each shell ends in, -1 for flat ones that touch nothing. Empties `shared`."""
    ends, volumes = np.arange(len(into)), volumes.copy()
    queue = [(volumes[n], n) for n in small]
    heapq.heapify(queue)
    while queue:
        volume, n = heapq.heappop(queue)
        if ends[n] != n or volume != volumes[n]:
            continue
        beside = shared.pop(n, {})
        if not beside:
            if volume <= flat:
                ends[n] = -1
            continue
        goal = max(beside, key=lambda other: (beside[other], volumes[other], -other))
        ends[n] = goal
        volumes[goal] += volume
        for other, size in beside.items():
            del shared[other][n]
            if other != goal:
                shared[other][goal] = shared[goal][other] = shared[goal].get(other, 0.0) + size
        if volumes[goal] < smallest:
            heapq.heappush(queue, (volumes[goal], goal))
    while (further := np.where(ends >= 0, ends[ends], -1)).tolist() != ends.tolist():
        ends = further
    return ends[into]


def _relink(surfaces: _Surfaces, corners: NDArray, goes: Flags, plain: Flags, outer: int, inner: int) -> None:
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
                other = twin[3 * _mate(other // 3, outer, inner) + 2 - other % 3]
            twin[3 * f + n] = other


@njit(cache=True, nogil=True)
def _solid(positions, source, corners, twin, own, plain, marks, base):
    """Vertices and faces of a solid, the point of each vertex, the source of each face (-1 of cracks), and its moments
    about its first vertex.

    A vertex for each plain point, and else for each fan of faces around it. `own`: the solid's faces, in `corners`;
    `marks`: base + vertex of a plain point. The twin of a corner that is not plain becomes ~vertex."""
    faces, points = np.empty((len(own), 3), np.int64), np.empty(3 * len(own), np.int64)
    come_from = np.empty(len(own), np.int64)
    used = 0
    for f in range(len(own)):
        come_from[f] = source[own[f]] if own[f] < len(source) else -1
        for n in range(3):
            p = corners[own[f], n]
            if plain[p]:
                if marks[p] < base:
                    marks[p], points[used] = base + used, p
                    used += 1
                faces[f, n] = marks[p] - base
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
    return vertices, faces, points[:used].copy(), come_from, moments(vertices, faces, vertices[0])
