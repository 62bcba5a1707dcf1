"""From faces that belong to cells to closed solids: half edges, shells, dust, vertices."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.crossing import NotGeneral
from deepfracture.carve.join import root
from deepfracture.threads import spread
from deepfracture.types import Floats, Ints, Mesh

FLAT = 1e-13
"""Share of the body's volume below which a shell is flat: nothing but rounding."""


CROWD = 48
"""Edges at a vertex above which they are sorted to find those that belong together."""


@dataclass(frozen=True, eq=False)
class Solid:
    """One connected solid with a closed 2-manifold surface; voids inside it are shells of their own."""

    mesh: Mesh
    source: Ints
    """As in `Fragment.source`."""


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
    corners, cell = _half_faces(faces.outer, faces.cell, faces.inner, faces.sides)
    outer, inner = len(faces.outer), len(faces.inner)
    twin = _twins(corners, cell, outer, inner, len(faces.positions))
    shell, first = _shells(twin, cell)
    into = _solids_of_shells(faces.positions, corners, cell, shell, first, outer, inner, smallest)
    names = np.unique(into[into >= 0])
    names = names[np.lexsort([names, cell[first[names]]])]
    number = np.full(len(into) + 1, -1)
    number[names] = np.arange(len(names))
    solid = number[into][shell]
    goes, joined = _going(solid, outer, inner, len(names))
    order, face_start = _sorted(solid, goes, len(names))
    if joined.any():
        twin = _relinked(twin, goes, outer, inner)
    local = np.full(3 * len(corners), -1, np.int32)

    def make(n: int) -> tuple[Solid, Ints]:
        own = order[face_start[n] : face_start[n + 1]]
        fans, points = _numbered(corners, twin, own, local)
        positions, source = _taken(faces.positions, points, faces.source, own)
        twice = points[_doubles(fans, len(points))] if joined[n] else np.empty((0, 2), np.int64)
        return Solid(Mesh(positions, fans), source), twice

    made = spread(lambda first, last: [make(n) for n in range(first, last)], len(names), least=1)
    pairs = [pair for part in made for pair in part]
    return [solid for solid, _ in pairs], np.concatenate([np.empty((0, 2), np.int64), *(twice for _, twice in pairs)])


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
    return Faces(positions, outer, faces.source[of_outer], faces.cell[of_outer], inner, faces.sides[of_inner])


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
def _half_faces(outer, cell, inner, sides):
    """Corners and cell of each face of each cell: the outer ones, the inner ones as the cell below them has them,
    and as the one above has them. `_mate` leads from one to the other."""
    m, k = len(outer), len(inner)
    corners, cells = np.empty((m + 2 * k, 3), np.int32), np.empty(m + 2 * k, np.int32)
    for f in range(m):
        corners[f, 0], corners[f, 1], corners[f, 2] = outer[f]
        cells[f] = cell[f]
    for f in range(k):
        corners[m + f, 0], corners[m + f, 1], corners[m + f, 2] = inner[f]
        corners[m + k + f, 0], corners[m + k + f, 1], corners[m + k + f, 2] = inner[f, 0], inner[f, 2], inner[f, 1]
        cells[m + f], cells[m + k + f] = sides[f, 0], sides[f, 1]
    return corners, cells


@njit(cache=True, inline="always")
def _mate(face, outer, inner):
    """The other side of a crack's face, -1 of an outer one. Edge n of the one runs along edge 2 - n of the other."""
    if face < outer:
        return -1
    return face + inner if face < outer + inner else face - inner


@njit(cache=True, nogil=True)
def _going(solid, outer, inner, count):
    """Which faces go: those between two parts of a solid, and flat debris; and which solids have such parts."""
    goes, joined = solid < 0, np.zeros(count, np.bool_)
    for f in range(outer, outer + inner):
        if solid[f] == solid[f + inner]:
            goes[f] = goes[f + inner] = True
            if solid[f] >= 0:
                joined[solid[f]] = True
    return goes, joined


@njit(cache=True, nogil=True)
def _sorted(solid, goes, count):
    """The faces that stay, solid by solid, and where each starts."""
    start = np.zeros(count + 1, np.int64)
    for f in range(len(solid)):
        if not goes[f]:
            start[solid[f] + 1] += 1
    for n in range(count):
        start[n + 1] += start[n]
    place, order = start[:-1].copy(), np.empty(start[-1], np.int64)
    for f in range(len(solid)):
        if not goes[f]:
            order[place[solid[f]]] = f
            place[solid[f]] += 1
    return order, start


def _twins(corners: NDArray, cell: NDArray, outer: int, inner: int, count: int) -> NDArray:
    """For the edge from each corner to the next (number 3 face + corner) the one that runs back in the same cell's
    surface. Raises NotGeneral if some edge has none or several.

    Edges are sorted by their lower point. Both sides of a crack's face have the same edges: one is enough."""
    start, bucket, far = _sorted_edges(corners, outer + inner, count)
    twin = np.full(3 * len(corners), -1, np.int32)
    fine = spread(
        lambda first, last: _paired(corners, cell, outer, inner, start, bucket, far, twin, first, last),
        count, least=8192,
    )  # fmt: skip
    if not all(fine):
        raise NotGeneral
    return twin


@njit(cache=True, nogil=True)
def _sorted_edges(corners, faces, count):
    """Where the edges at each lower point start, and they and their higher points."""
    start = np.zeros(count + 1, np.int32)
    for f in range(faces):
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        start[min(a, b) + 1] += 1
        start[min(b, c) + 1] += 1
        start[min(c, a) + 1] += 1
    for v in range(count):
        start[v + 1] += start[v]
    place = start[:-1].copy()
    bucket, far = np.empty(3 * faces, np.int32), np.empty(3 * faces, np.int32)
    for f in range(faces):
        for n in range(3):
            a, b = corners[f, n], corners[f, n + 1 if n < 2 else 0]
            low = min(a, b)
            bucket[place[low]], far[place[low]] = 3 * f + n, max(a, b)
            place[low] += 1
    return start, bucket, far


@njit(cache=True, nogil=True)
def _paired(corners, cell, outer, inner, start, bucket, far, twin, from_point, to_point):
    """Twins among the edges at some lower points; False if some edge has none or several."""
    for v in range(from_point, to_point):
        first, last = start[v], start[v + 1]
        crowded = last - first > CROWD
        if crowded:
            order = np.argsort(far[first:last])
            bucket[first:last], far[first:last] = bucket[first:last][order], far[first:last][order]
        for e in range(first, last):
            for back in range(2):
                own = bucket[e] if back == 0 else _behind(bucket[e], outer, inner)
                if own < 0 or twin[own] >= 0:
                    continue
                forth, found = corners[own // 3, own % 3] == v, 0
                for o in range(e + 1, last):
                    if far[o] != far[e]:
                        if crowded:
                            break
                        continue
                    other = bucket[o]
                    if cell[other // 3] != cell[own // 3]:
                        other = _behind(other, outer, inner)
                        if other < 0 or cell[other // 3] != cell[own // 3]:
                            continue
                    found += 1
                    if forth == (corners[other // 3, other % 3] == v):
                        found = 2
                    twin[own], twin[other] = other, own
                if found != 1:
                    return False
    return True


@njit(cache=True, inline="always")
def _behind(edge, outer, inner):
    """The same edge of the other side of a crack's face, -1 for an outer one."""
    mate = _mate(edge // 3, outer, inner)
    return 3 * mate + 2 - edge % 3 if mate >= 0 else -1


def _shells(twin: NDArray, cell: NDArray) -> tuple[NDArray, Ints]:
    """Number 0.. of the connected surface that each face belongs to, and the first face of each."""
    parent = np.arange(len(cell), dtype=np.int32)
    # Surfaces of different cells have nothing to do with each other.
    spread(lambda first, last: _join(parent, twin, cell, first, last), int(cell.max(initial=0)) + 1, least=2)
    return _shell_numbers(parent)


@njit(cache=True, nogil=True)
def _join(parent, twin, cell, first, last):
    """Join the faces of some cells across their edges, the lowest face of each surface being its root."""
    for f in range(len(cell)):
        if not first <= cell[f] < last:
            continue
        for n in range(3):
            other = twin[3 * f + n] // 3
            if other > f:
                a, b = root(parent, f), root(parent, other)
                if a != b:
                    parent[max(a, b)] = min(a, b)


@njit(cache=True, nogil=True)
def _shell_numbers(parent):
    number, first = np.empty(len(parent), np.int32), np.empty(len(parent), np.int64)
    shells = 0
    for f in range(len(parent)):
        head = root(parent, f)
        if head == f:
            number[f], first[shells] = shells, f
            shells += 1
        else:
            number[f] = number[head]
    return number, first[:shells].copy()


def _solids_of_shells(
    positions: Floats,
    corners: NDArray,
    cell: NDArray,
    shell: NDArray,
    first: Ints,
    outer: int,
    inner: int,
    smallest: float,
) -> Ints:
    """The shell whose solid each shell belongs to in the end, -1 for flat debris."""
    volumes = np.zeros(len(first))
    spread(
        lambda one, end: _add_volumes(positions, corners, shell, first, volumes, one, end), len(first), least=2
    )  # fmt: skip
    flat = FLAT * np.abs(volumes).sum()
    into = np.arange(len(volumes))
    for void in np.flatnonzero(volumes < -flat).tolist():
        around = np.flatnonzero((cell[first] == cell[first[void]]) & (volumes > flat))
        into[void] = _holder(positions, corners, shell, void, around[np.argsort(volumes[around])])
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
def _add_volumes(positions, corners, shell, first, volumes, from_shell, to_shell):
    """Signed volume of some shells, by tetrahedra from a vertex of each."""
    for f in range(len(corners)):
        n = shell[f]
        if not from_shell <= n < to_shell:
            continue
        p, a, b, c = (
            positions[corners[first[n], 0]], positions[corners[f, 0]], positions[corners[f, 1]],
            positions[corners[f, 2]],
        )  # fmt: skip
        ax, ay, az, bx, by, bz = a[0] - p[0], a[1] - p[1], a[2] - p[2], b[0] - p[0], b[1] - p[1], b[2] - p[2]
        cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
        volumes[n] += (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6


def _holder(positions: Floats, corners: NDArray, shell: NDArray, void: int, around: Ints) -> int:
    """The smallest of the shells `around`, in ascending order, that holds a void."""
    if not len(around):
        raise NotGeneral
    point = positions[corners[np.flatnonzero(shell == void)[0], 0]]
    for candidate in around[:-1]:
        triangles = positions[corners[shell == candidate]]
        boxed = (triangles.min(axis=(0, 1)) <= point).all() and (triangles.max(axis=(0, 1)) >= point).all()
        if boxed and _encloses(triangles, point):
            return int(candidate)
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


@njit(cache=True, nogil=True)
def _relinked(twin, goes, outer, inner):
    """Twins across the faces that go: the faces behind both sides of one meet."""
    linked = twin.copy()
    for e in range(len(twin)):
        other = twin[e]
        if not goes[other // 3] or goes[e // 3]:
            continue
        while goes[other // 3]:
            other = twin[3 * _mate(other // 3, outer, inner) + 2 - other % 3]
        linked[e] = other
    return linked


@njit(cache=True, nogil=True)
def _numbered(corners, twin, own, local):
    """Corners of a solid's faces `own` by the solid's own vertices, one for each fan of faces around a point, shape
    (m, 3), and the point of each vertex. `local`: scratch, -1 at the corners of these faces."""
    faces, points = np.empty((len(own), 3), np.int64), np.empty(3 * len(own), np.int64)
    used = 0
    for f in range(len(own)):
        for n in range(3):
            corner = 3 * own[f] + n
            if local[corner] < 0:
                points[used] = corners[own[f], n]
                at = corner
                while local[at] < 0:
                    local[at] = used
                    back = twin[at]
                    at = back - 2 if back % 3 == 2 else back + 1
                used += 1
            faces[f, n] = local[corner]
    return faces, points[:used].copy()


@njit(cache=True, nogil=True)
def _taken(positions, points, source, own):
    """The positions of a solid's vertices, and the source of each of its faces `own`, -1 of cracks."""
    taken, come_from = np.empty((len(points), 3)), np.empty(len(own), np.int64)
    for n in range(len(points)):
        for x in range(3):
            taken[n, x] = positions[points[n], x]
    for f in range(len(own)):
        come_from[f] = source[own[f]] if own[f] < len(source) else -1
    return taken, come_from
