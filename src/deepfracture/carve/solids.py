"""From faces that belong to cells to closed solids: half edges, shells, dust, vertices."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.carve.crossing import NotGeneral
from deepfracture.carve.join import root
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
    corners = np.concatenate([faces.outer, faces.inner, faces.inner[:, [0, 2, 1]]])
    cell = np.concatenate([faces.cell, faces.sides[:, 0], faces.sides[:, 1]])
    m, k = len(faces.outer), len(faces.inner)
    mate = np.concatenate([np.full(m, -1), np.arange(m + k, m + 2 * k), np.arange(m, m + k)])
    twin = _twins(corners, cell, len(faces.positions))
    if twin[0] == -2:
        raise NotGeneral
    shell = _shells(twin, len(corners))
    solid, count = _solids_of_shells(faces, corners, cell, mate, shell, smallest)
    kept = (mate < 0) | (solid != solid[mate])
    kept &= solid >= 0
    twin = _relinked(twin, mate, kept)
    order = np.flatnonzero(kept)[np.argsort(solid[kept], kind="stable")]
    fans, points, point_start, face_start = _numbered(corners, twin, solid, order, count)
    place = np.empty(len(corners), np.int64)
    place[order] = np.arange(len(order))
    pair = 3 * place[twin.reshape(-1, 3)[order] // 3] + twin.reshape(-1, 3)[order] % 3
    source = np.concatenate([faces.source, np.full(2 * k, -1)])[order]
    made = []
    for n in range(count):
        span = slice(face_start[n], face_start[n + 1])
        vertices = faces.positions[points[point_start[n] : point_start[n + 1]]]
        made.append(_solid(vertices, fans[span], pair[span] - 3 * face_start[n], source[span]))
    return made


def _solid(vertices: Floats, faces: Ints, pair: Ints, source: Ints) -> Solid:
    """A solid, with an edge halved where two run between the same vertices: as after dust has joined at an edge.

    `pair`: for the edge from each corner to the next the number (3 face + corner) of its twin, shape (m, 3)."""
    while len(doubles := _doubles(faces, len(vertices))):
        faces, pair, source = faces.tolist(), pair.tolist(), source.tolist()
        points, busy = [vertices], set()
        for f, n in (divmod(int(e), 3) for e in doubles):
            g, k = divmod(pair[f][n], 3)
            if f in busy or g in busy:
                continue
            busy |= {f, g}
            middle = len(vertices) + len(points) - 1
            points.append(vertices[[faces[f][n], faces[g][k]]].mean(axis=0, keepdims=True))
            _halve(faces, pair, source, f, n, g, k, middle)
        vertices, faces, pair, source = np.concatenate(points), np.array(faces), np.array(pair), np.array(source)
    return Solid(Mesh(vertices, faces), source)


def _doubles(faces: Ints, count: int) -> Ints:
    """Edges, as 3 face + corner and in one direction, between vertices that another edge joins already."""
    following = faces[:, [1, 2, 0]]
    forth = np.flatnonzero((faces < following).ravel())
    keys = (faces * count + following).ravel()[forth]
    if _all_differ(keys, 3 * count):
        return forth[:0]
    order = np.argsort(keys, kind="stable")
    return forth[order[1:][keys[order][1:] == keys[order][:-1]]]


def _halve(faces: list, pair: list, source: list, f: int, n: int, g: int, k: int, middle: int) -> None:
    """Halve the edge from corner n of face f, which is that from corner k of face g: both become two faces."""
    for face, corner, new, other in ((f, n, len(faces), len(faces) + 1), (g, k, len(faces) + 1, len(faces))):
        a, b, c = (faces[face][(corner + m) % 3] for m in range(3))
        behind = pair[face][(corner + 1) % 3]
        # a, middle, c stays in place; middle, b, c is new.
        faces[face][(corner + 1) % 3] = middle
        faces.append([middle, b, c])
        source.append(source[face])
        pair[face][corner] = 3 * other
        pair[face][(corner + 1) % 3] = 3 * new + 2
        pair.append([3 * (g if face == f else f) + (k if face == f else n), behind, 3 * face + (corner + 1) % 3])
        pair[behind // 3][behind % 3] = 3 * new + 1
        assert a != b


@njit(cache=True)
def _all_differ(keys, room):
    """Whether no key comes twice: by a table with open addresses."""
    size = 16
    while size < 2 * room:
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


@njit(cache=True)
def _twins(corners, cell, count):
    """For the edge from each corner to the next (number 3 face + corner) the one that runs back in the same cell's
    surface. The first is -2 if some edge has none or several."""
    start = np.zeros(count + 1, np.int64)
    for f in range(len(corners)):
        for n in range(3):
            start[min(corners[f, n], corners[f, (n + 1) % 3]) + 1] += 1
    for v in range(count):
        start[v + 1] += start[v]
    place = start[:-1].copy()
    bucket = np.empty(3 * len(corners), np.int64)
    for f in range(len(corners)):
        for n in range(3):
            low = min(corners[f, n], corners[f, (n + 1) % 3])
            bucket[place[low]] = 3 * f + n
            place[low] += 1
    twin = np.full(3 * len(corners), -1, np.int64)
    cells = cell.max() + 1
    keys = np.empty(len(bucket), np.int64)
    for e in range(len(bucket)):
        f, n = bucket[e] // 3, bucket[e] % 3
        keys[e] = max(corners[f, n], corners[f, (n + 1) % 3]) * cells + cell[f]
    for v in range(count):
        first, last = start[v], start[v + 1]
        crowded = last - first > CROWD
        if crowded:
            order = np.argsort(keys[first:last])
            bucket[first:last], keys[first:last] = bucket[first:last][order], keys[first:last][order]
        for e in range(first, last):
            own = bucket[e]
            if twin[own] >= 0:
                continue
            found = 0
            for o in range(e + 1, last):
                if keys[o] == keys[e]:
                    found += 1
                    twin[own], twin[bucket[o]] = bucket[o], own
                elif crowded:
                    break
            if found != 1 or (corners[own // 3, own % 3] == v) == (corners[twin[own] // 3, twin[own] % 3] == v):
                twin[0] = -2
                return twin
    return twin


@njit(cache=True)
def _shells(twin, count):
    """Number 0.. of the connected surface that each face belongs to, in the order of their first faces."""
    parent = np.arange(count)
    for e in range(len(twin)):
        a, b = root(parent, e // 3), root(parent, twin[e] // 3)
        if a != b:
            parent[max(a, b)] = min(a, b)
    number, shells = np.empty(count, np.int64), 0
    for f in range(count):
        first = root(parent, f)
        if first == f:
            number[f] = shells
            shells += 1
        else:
            number[f] = number[first]
    return number


def _solids_of_shells(
    faces: Faces, corners: Ints, cell: Ints, mate: Ints, shell: Ints, smallest: float
) -> tuple[Ints, int]:
    """The solid 0.. that each face belongs to, -1 for flat debris, and their number, ordered by cell."""
    first = np.unique(shell, return_index=True)[1]
    volumes = _volumes(faces.positions, corners, shell, len(first))
    flat = FLAT * np.abs(volumes).sum()
    into = np.arange(len(volumes))
    for void in np.flatnonzero(volumes < -flat):
        around = np.flatnonzero((cell[first] == cell[first[void]]) & (volumes > flat))
        into[void] = _holder(faces.positions, corners, shell, void, around[np.argsort(volumes[around])])
    whole = np.bincount(into, volumes, minlength=len(into))
    if (whole[into] < smallest).any():
        into = _join_dust(into, whole, _neighbours(faces.positions, corners, mate, into[shell]), smallest, flat)
    names = np.unique(into[into >= 0])
    names = names[np.lexsort([names, cell[first[names]]])]
    number = np.full(len(into) + 1, -1)
    number[names] = np.arange(len(names))
    return number[into][shell], len(names)


@njit(cache=True)
def _volumes(positions, corners, shell, count):
    """Signed volume of each shell, by tetrahedra from a vertex of it."""
    volumes, pivot = np.zeros(count), np.full(count, -1, np.int64)
    for f in range(len(corners)):
        n = shell[f]
        if pivot[n] < 0:
            pivot[n] = corners[f, 0]
        p, a, b, c = positions[pivot[n]], positions[corners[f, 0]], positions[corners[f, 1]], positions[corners[f, 2]]
        ax, ay, az, bx, by, bz = a[0] - p[0], a[1] - p[1], a[2] - p[2], b[0] - p[0], b[1] - p[1], b[2] - p[2]
        cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
        volumes[n] += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return volumes / 6


def _neighbours(positions: Floats, corners: Ints, mate: Ints, solid: Ints) -> dict[int, dict[int, float]]:
    """Area [m^2] of the crack surface between each two solids that have one."""
    inner = np.flatnonzero(mate >= 0)
    inner = inner[solid[inner] != solid[mate[inner]]]
    a, b, c = np.moveaxis(positions[corners[inner]], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    most = int(solid.max()) + 1
    pairs, which = np.unique(solid[inner] * most + solid[mate[inner]], return_inverse=True)
    shared: dict[int, dict[int, float]] = {}
    for pair, size in zip(pairs.tolist(), np.bincount(which.ravel(), area).tolist(), strict=True):
        shared.setdefault(pair // most, {})[pair % most] = size
    return shared


def _holder(positions: Floats, corners: Ints, shell: Ints, void: int, around: Ints) -> int:
    """The smallest of the shells `around`, in ascending order, that holds a void."""
    if not len(around):
        raise NotGeneral
    point = positions[corners[np.flatnonzero(shell == void)[0], 0]]
    for candidate in around[:-1]:
        triangles = positions[corners[shell == candidate]]
        if (triangles.min(axis=(0, 1)) <= point).all() and (triangles.max(axis=(0, 1)) >= point).all():
            if _encloses(triangles, point):
                return int(candidate)
    return int(around[-1])


def _encloses(triangles: Floats, point: Floats) -> bool:
    """Whether a closed surface winds around a point off it (van Oosterom & Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    dots = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
    angle = 2 * np.arctan2((a * np.cross(b, c)).sum(1), dots)
    return bool(angle.sum() > 2 * np.pi)


def _join_dust(into: Ints, volumes: Floats, shared: dict[int, dict[int, float]], smallest: float, flat: float) -> Ints:
    """The solid that each shell ends in, -1 for flat ones that touch nothing. Empties `shared`."""
    ends, volumes = np.arange(len(into)), volumes.copy()
    small = [n for n in np.flatnonzero(volumes < smallest).tolist() if into[n] == n]
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


@njit(cache=True)
def _relinked(twin, mate, kept):
    """Twins across the faces that have gone: the faces behind both sides of one meet."""
    linked = twin.copy()
    for e in range(len(twin)):
        if not kept[e // 3]:
            continue
        other = twin[e]
        while not kept[other // 3]:
            # Edge n of a face runs along edge 2 - n of its mate.
            other = twin[3 * mate[other // 3] + 2 - other % 3]
        linked[e] = other
    return linked


@njit(cache=True)
def _numbered(corners, twin, solid, order, count):
    """Faces in `order` with their solid's own vertex numbers: one vertex for each fan of faces around a point."""
    local = np.full(3 * len(corners), -1, np.int64)
    points, faces = np.empty(3 * len(order), np.int64), np.empty((len(order), 3), np.int64)
    point_start, face_start = np.zeros(count + 1, np.int64), np.zeros(count + 1, np.int64)
    used = 0
    for f in range(len(order)):
        own = solid[order[f]]
        face_start[own + 1] = f + 1
        for n in range(3):
            corner = 3 * order[f] + n
            if local[corner] < 0:
                name = used - point_start[own]
                points[used] = corners[order[f], n]
                used += 1
                at = corner
                while local[at] < 0:
                    local[at] = name
                    back = twin[at]
                    at = back - back % 3 + (back % 3 + 1) % 3
            faces[f, n] = local[corner]
        point_start[own + 1] = used
    return faces, points[:used], point_start, face_start
