"""Short edges collapsed: slivers arise where a crack passes close to a vertex of the surface."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.cutting.intersect import line_hits_triangle, side_of_triangle
from deepfracture.carve.cutting.solids import CellFaces
from deepfracture.runtime.parallel import parallel_for, parallel_invoke
from deepfracture.types import Floats, Ints

Flags = NDArray[np.bool_]

PASSES = 3
"""Rounds of collapses: in one, no two that share a face."""
MIN_ROTATION_COSINE = 0.5
"""Least cosine of the angle by which a collapse may rotate a face that is no sliver."""
MAX_FOLD_COSINE = 0.9998
"""Cosine of the angle between two adjacent faces, about a degree, above which they overlap."""
MAX_VALENCE = 64
"""Faces at a point above which its edges stay."""


class Complex(NamedTuple):
    """Faces near intersections, for kernels."""

    positions: Floats
    """[m], shape (p, 3)."""
    corners: Ints
    """Shape (f, 3); -1 once a face has collapsed."""
    cells: Ints
    """Cells below and above each face, 0 for the outside, shape (f, 2)."""
    source: Ints
    """Of outer faces, -1 of crack faces, shape (f,)."""


class Limits(NamedTuple):
    """What a collapse may do."""

    shortest: float
    """Edges below this are collapsed [m]."""
    first_crack: int
    """Points below this are the surface's own vertices, which never move; points from here to ..."""
    first_intersection: int
    """... here belong to cracks alone; the rest are intersections, on both."""


class Stars(NamedTuple):
    """The faces around some points."""

    slot: NDArray[np.int32]
    """Number of each point among those with a star, -1 for the others."""
    start: Ints
    """The first face of each star, and their number."""
    faces: Ints


def collapse_short_edges(faces: CellFaces, shortest: float, first_crack: int, first_intersection: int) -> CellFaces:
    """The same faces without edges below `shortest` [m] that can be collapsed: both ends become one of them.

    The points below `first_crack`, the surface's own vertices, never move, and outer faces stay in the plane of their
    source. An edge collapses only if the topology of all cells is preserved: every cell that meets at one of its ends
    meets along all of it, and no two faces become one (link condition, Dey et al. 1999). Only edges at the points from
    `first_intersection` on are examined, where cracks cross the surface."""
    of_outer, of_inner = parallel_invoke(
        lambda: _faces_near(faces.outer, faces.manifold), lambda: _faces_near(faces.inner, faces.manifold)
    )
    near = Complex(
        faces.positions,
        *_gather(faces.outer, faces.source, faces.cell, of_outer, faces.inner, faces.inner_cells, of_inner),
    )
    limits, changed, dirty = (
        Limits(shortest, first_crack, first_intersection),
        False,
        np.ones(len(faces.positions), np.bool_),
    )
    for _ in range(PASSES):
        short = _short_edges(near, limits, dirty)
        if not len(short) or not _collapse_pass(near, limits, short, dirty):
            break
        changed = True
    if not changed:
        return faces
    m = len(of_outer)
    (outer, of_face), (inner, inner_cells) = parallel_invoke(
        lambda: _scatter(faces.outer, (faces.source, faces.cell), of_outer, near.corners[:m]),
        lambda: _scatter(faces.inner, (faces.inner_cells[:, 0], faces.inner_cells[:, 1]), of_inner, near.corners[m:]),
    )
    return replace(faces, outer=outer, source=of_face[:, 0], cell=of_face[:, 1], inner=inner, inner_cells=inner_cells)


@njit(cache=True)
def _gather(outer, source, cell, of_outer, inner, inner_cells, of_inner):
    """Corners of some outer and some inner faces, cells below and above them (0: outside), source (-1: none)."""
    m, k = len(of_outer), len(of_inner)
    corners, cells, lies_in = np.empty((m + k, 3), np.int64), np.empty((m + k, 2), np.int64), np.empty(m + k, np.int64)
    for n in range(m):
        f = of_outer[n]
        corners[n, 0], corners[n, 1], corners[n, 2] = outer[f, 0], outer[f, 1], outer[f, 2]
        cells[n, 0], cells[n, 1], lies_in[n] = 0, cell[f], source[f]
    for n in range(k):
        f = of_inner[n]
        corners[m + n, 0], corners[m + n, 1], corners[m + n, 2] = inner[f, 0], inner[f, 1], inner[f, 2]
        cells[m + n, 0], cells[m + n, 1], lies_in[m + n] = inner_cells[f, 0], inner_cells[f, 1], -1
    return corners, cells, lies_in


@njit(cache=True, nogil=True)
def _scatter(faces, columns, of, corners):
    """All faces with some of them changed, without collapsed ones; and the two `columns` of each."""
    left, values = np.empty_like(faces), np.empty((len(faces), 2), np.int64)
    count, at = 0, 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if at < len(of) and of[at] == f:
            a, b, c = corners[at, 0], corners[at, 1], corners[at, 2]
            at += 1
        if a >= 0:
            left[count, 0], left[count, 1], left[count, 2] = a, b, c
            values[count, 0], values[count, 1] = columns[0][f], columns[1][f]
            count += 1
    return left[:count], values[:count]


@njit(cache=True, nogil=True)
def _faces_near(faces, manifold):
    """The faces at a point of a face with an intersection, and those at other non-manifold points."""
    found = np.empty(len(faces), np.int64)
    used = 0
    for f in range(len(faces)):
        found[used] = f
        used += not (manifold[faces[f, 0]] and manifold[faces[f, 1]] and manifold[faces[f, 2]])
    return found[:used].copy()


def _short_edges(near: Complex, limits: Limits, dirty: Flags) -> Ints:
    """Short edges at an intersection, the shortest first, the lower point first, shape (s, 2).

    Only those at `dirty` points: what could not collapse cannot until a face around it changes."""
    found = parallel_for(lambda first, last: _short(near, limits, dirty, first, last), len(near.corners), least=4096)
    edges, lengths = (np.concatenate(column) for column in zip(*found, strict=True))
    return edges[np.argsort(lengths, kind="stable")]


@njit(cache=True, nogil=True)
def _short(near, limits, dirty, from_face, to_face):
    """Short edges of some faces, and the squares of their lengths."""
    positions, corners = near.positions, near.corners
    found, lengths = np.empty((16, 2), np.int64), np.empty(16)
    count = 0
    for f in range(from_face, to_face):
        for n in range(3):
            a, b = corners[f, n], corners[f, (n + 1) % 3]
            if a > b or a < 0 or b < limits.first_intersection or not (dirty[a] or dirty[b]):
                continue
            square = 0.0
            for x in range(3):
                square += (positions[a, x] - positions[b, x]) ** 2
            if square >= limits.shortest * limits.shortest:
                continue
            if count == len(found):
                found, lengths = np.concatenate((found, found)), np.concatenate((lengths, lengths))
            found[count, 0], found[count, 1], lengths[count] = a, b, square
            count += 1
    return found[:count].copy(), lengths[:count].copy()


def _collapse_pass(near: Complex, limits: Limits, short: Ints, dirty: Flags) -> int:
    """Collapse edges whose faces have not changed in this pass; returns how many.

    `dirty` becomes the points with a face one of whose points has had a face changed."""
    stars = Stars(*_stars(len(near.positions), near.corners, short))
    choice = np.empty(len(short), np.int8)
    parallel_for(
        lambda first, last: _choose_directions(near, limits, short, stars, choice, first, last), len(short), least=64
    )
    return _collapse(near, limits, short, stars, choice, dirty)


@njit(cache=True, nogil=True)
def _choose_directions(near, limits, short, stars, choice, first, last):
    """`_direction` of some edges, as long as nothing has changed."""
    seen = np.zeros(len(near.corners) + 1, np.int64)
    for e in range(first, last):
        choice[e] = _direction(near, limits, short[e, 0], short[e, 1], stars, seen)


@njit(cache=True, inline="always")
def _star(stars, point):
    return stars.faces[stars.start[stars.slot[point]] : stars.start[stars.slot[point] + 1]]


@njit(cache=True)
def _direction(near, limits, a, b, stars, seen):
    """How the edge a b may collapse: 1, b into a; 2, a into b; 0, it may not.

    The higher point goes into the lower, as those of the original come first, or else the lower into the higher."""
    at_a, at_b = _star(stars, a), _star(stars, b)
    if max(len(at_a), len(at_b)) > MAX_VALENCE:
        return 0
    down = _may_move(near, at_b, at_a, b, a, limits.shortest)
    up = a >= limits.first_crack and _may_move(near, at_a, at_b, a, b, limits.shortest)
    if not (down or up) or not _preserves_topology(near.corners, near.cells, at_a, at_b, a, b):
        return 0
    if down and not _would_intersect(near, limits, at_b, b, a, stars, seen):
        return 1
    if up and not _would_intersect(near, limits, at_a, a, b, stars, seen):
        return 2
    return 0


@njit(cache=True)
def _collapse(near, limits, short, stars, choice, dirty):
    """See `_collapse_pass`. A direction chosen holds as long as no face at a point of a face at the edge has
    changed."""
    corners = near.corners
    locked, seen = np.zeros(len(corners), np.bool_), np.zeros(len(corners) + 1, np.int64)
    touched = np.zeros(len(near.positions), np.bool_)
    collapsed = 0
    for e in range(len(short)):
        a, b = short[e]
        at_a, at_b = _star(stars, a), _star(stars, b)
        if _any(locked, at_a) or _any(locked, at_b):
            continue
        direction = choice[e]
        if _touches(corners, at_a, touched) or _touches(corners, at_b, touched):
            direction = _direction(near, limits, a, b, stars, seen)
        if direction == 0:
            continue
        kept, removed, faces = (a, b, at_b) if direction == 1 else (b, a, at_a)
        for f in at_a:
            locked[f] = True
        for f in at_b:
            locked[f] = True
        touched[kept] = True
        for f in faces:
            for n in range(3):
                touched[corners[f, n]] = True
            if _has(corners, f, kept):
                corners[f] = -1
                continue
            for n in range(3):
                if corners[f, n] == removed:
                    corners[f, n] = kept
        collapsed += 1
    dirty[:] = False
    for f in range(len(corners)):
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        if a >= 0 and (touched[a] or touched[b] or touched[c]):
            dirty[a] = dirty[b] = dirty[c] = True
    return collapsed


@njit(cache=True, inline="always")
def _touches(corners, faces, touched):
    """Whether a corner of some faces is marked."""
    found = False
    for f in faces:
        found = found or touched[corners[f, 0]] or touched[corners[f, 1]] or touched[corners[f, 2]]
    return found


@njit(cache=True, inline="always")
def _any(marks, where):
    found = False
    for f in where:
        found = found or marks[f]
    return found


@njit(cache=True)
def _stars(count, corners, short):
    """A slot for each point of a face at a short edge; where the faces around each start; and the faces."""
    slot = np.full(count, -1, np.int32)
    used = 0
    for e in range(len(short)):
        for n in range(2):
            if slot[short[e, n]] < 0:
                slot[short[e, n]] = used
                used += 1
    first = used
    for f in range(len(corners)):
        if corners[f, 0] < 0:
            continue
        at_edge = False
        for n in range(3):
            at_edge |= 0 <= slot[corners[f, n]] < first
        for n in range(3):
            if at_edge and slot[corners[f, n]] < 0:
                slot[corners[f, n]] = used
                used += 1
    start = np.zeros(used + 1, np.int64)
    for f in range(len(corners)):
        for n in range(3 if corners[f, 0] >= 0 else 0):
            at = slot[corners[f, n]]
            if at >= 0:
                start[at + 1] += 1
    for at in range(used):
        start[at + 1] += start[at]
    faces, place = np.empty(start[used], np.int64), start[:-1].copy()
    for f in range(len(corners)):
        for n in range(3 if corners[f, 0] >= 0 else 0):
            at = slot[corners[f, n]]
            if at >= 0:
                faces[place[at]] = f
                place[at] += 1
    return slot, start, faces


@njit(cache=True)
def _preserves_topology(corners, cells, at_a, at_b, a, b):
    """Whether the edge a b can collapse without a change of topology, of faces and of cells (link condition)."""
    along_cells = np.empty(2 * len(at_a), np.int64)
    count, shared = 0, 0
    for f in at_a:
        if corners[f, 0] == b or corners[f, 1] == b or corners[f, 2] == b:
            along_cells[count], along_cells[count + 1] = cells[f, 0], cells[f, 1]
            count += 2
            shared += 1
    along = along_cells[:count]
    if not (_all_among(cells, at_a, along) or _all_among(cells, at_b, along)):
        return False
    common = 0
    for f in at_a:
        for n in range(3):
            v = corners[f, n]
            if v in (a, b):
                continue
            first = True
            for g in at_a:
                if g == f:
                    break
                first = first and not _has(corners, g, v)
            if not first:
                continue
            for g in at_b:
                if _has(corners, g, v):
                    common += 1
                    break
    return common == shared and _stays_closed(corners, cells, at_a, at_b, a, b)


@njit(cache=True, inline="always")
def _has(corners, face, v):
    return corners[face, 0] == v or corners[face, 1] == v or corners[face, 2] == v


@njit(cache=True)
def _stays_closed(corners, cells, at_a, at_b, a, b):
    """Whether around the one point that a and b become every edge still has two faces of each cell that meets there."""
    ends = np.empty((4 * (len(at_a) + len(at_b)), 2), np.int64)
    count = 0
    for which in range(2):
        for f in at_a if which == 0 else at_b:
            if _has(corners, f, a) and _has(corners, f, b):
                continue
            for n in range(3):
                for m in range(2):
                    if corners[f, n] not in (a, b):
                        ends[count, 0], ends[count, 1] = corners[f, n], cells[f, m]
                        count += 1
    for e in range(count):
        if ends[e, 0] < 0:
            continue
        same = 1
        for o in range(e + 1, count):
            if ends[o, 0] == ends[e, 0] and ends[o, 1] == ends[e, 1]:
                ends[o, 0] = -1
                same += 1
        if same != 2:
            return False
    return True


@njit(cache=True, inline="always")
def _all_among(cells, faces, allowed):
    """Whether all cells at the faces are among those allowed."""
    for f in faces:
        for n in range(2):
            found = False
            for cell in allowed:
                found = found or cell == cells[f, n]
            if not found:
                return False
    return True


@njit(cache=True)
def _may_move(near, faces, others, removed, kept, shortest):
    """Whether `removed` may move to `kept`: outer faces keep their planes, no face turns over, none becomes flat."""
    positions, corners, source = near.positions, near.corners, near.source
    old, new = np.empty((3, 3)), np.empty((3, 3))
    for f in faces:
        if source[f] >= 0:
            found = False
            for g in others:
                found = found or source[g] == source[f]
            if not found:
                return False
        if corners[f, 0] == kept or corners[f, 1] == kept or corners[f, 2] == kept:
            continue
        for n in range(3):
            v = corners[f, n]
            for x in range(3):
                old[n, x] = positions[v, x]
                new[n, x] = positions[kept, x] if v == removed else positions[v, x]
        before, height = _normal_and_altitude(old)
        after, lower = _normal_and_altitude(new)
        if lower <= 0 or lower < min(height, 0.5 * shortest):
            return False
        dot = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
        if dot < (MIN_ROTATION_COSINE if height >= shortest else 0.0):
            return False
    return True


@njit(cache=True)
def _would_intersect(near, limits, faces, removed, kept, stars, seen):
    """Whether a face that moves with `removed` to `kept` would intersect one nearby, or a crack face lie in the
    surface.

    `seen`: the comparison in which each face last took part, and the number of comparisons."""
    corners, source = near.corners, near.source
    new, old = np.empty((3, 3)), np.empty((3, 3))
    names, others = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in faces:
        if _has(corners, f, kept):
            continue
        on_surface = _moved(near, limits, f, removed, kept, names, new)
        if source[f] < 0 and on_surface:
            return True
        seen[-1] += 1
        for n in range(3):
            star = _star(stars, names[n])
            if len(star) > MAX_VALENCE:
                return True
            for g in star:
                if seen[g] == seen[-1]:
                    continue
                seen[g] = seen[-1]
                if corners[g, 0] < 0 or g == f or (_has(corners, g, removed) and _has(corners, g, kept)):
                    continue
                _moved(near, limits, g, removed, kept, others, old)
                if _triangles_intersect(new, names, old, others):
                    return True
    return False


@njit(cache=True, inline="always")
def _moved(near, limits, face, removed, kept, names, places):
    """Write a face's points and their places once `removed` is `kept`; whether all lie on the body's surface."""
    on_surface = True
    for n in range(3):
        v = near.corners[face, n]
        names[n] = kept if v == removed else v
        on_surface &= not limits.first_crack <= names[n] < limits.first_intersection
        for x in range(3):
            places[n, x] = near.positions[names[n], x]
    return on_surface


@njit(cache=True)
def _triangles_intersect(one, one_ids, two, two_ids):
    """Whether an edge of one triangle passes through the other; common points are left out."""
    shared = 0
    for n in range(3):
        shared += one_ids[n] == two_ids[0] or one_ids[n] == two_ids[1] or one_ids[n] == two_ids[2]
    if shared == 2:
        return _overlap(one, one_ids, two, two_ids)
    if (
        shared == 3
        or (shared == 0 and _boxes_disjoint(one, two))
        or (shared == 1 and _separated_at_vertex(one, one_ids, two, two_ids))
    ):
        return False
    a0, a1, a2 = (
        _vertex_side(one, one_ids, two, two_ids, 0),
        _vertex_side(one, one_ids, two, two_ids, 1),
        _vertex_side(one, one_ids, two, two_ids, 2),
    )
    if min(a0, a1, a2) >= 0 or max(a0, a1, a2) <= 0:
        return False
    b0, b1, b2 = (
        _vertex_side(two, two_ids, one, one_ids, 0),
        _vertex_side(two, two_ids, one, one_ids, 1),
        _vertex_side(two, two_ids, one, one_ids, 2),
    )
    if min(b0, b1, b2) >= 0 or max(b0, b1, b2) <= 0:
        return False
    for n in range(3):
        here, there = (a0, a1) if n == 0 else ((a1, a2) if n == 1 else (a2, a0))
        if here * there < 0 and line_hits_triangle(two[n], two[(n + 1) % 3], one) == 1:
            return True
        here, there = (b0, b1) if n == 0 else ((b1, b2) if n == 1 else (b2, b0))
        if here * there < 0 and line_hits_triangle(one[n], one[(n + 1) % 3], two) == 1:
            return True
    return False


@njit(cache=True, inline="always")
def _vertex_side(one, one_ids, two, two_ids, n):
    """Side of the first triangle on which a corner of the second lies, 0 for a common point."""
    if two_ids[n] == one_ids[0] or two_ids[n] == one_ids[1] or two_ids[n] == one_ids[2]:
        return 0
    return side_of_triangle(one, two[n])


@njit(cache=True, inline="always")
def _boxes_disjoint(one, two):
    """Whether the bounding boxes of two triangles are disjoint."""
    for x in range(3):
        if max(one[0, x], one[1, x], one[2, x]) < min(two[0, x], two[1, x], two[2, x]):
            return True
        if min(one[0, x], one[1, x], one[2, x]) > max(two[0, x], two[1, x], two[2, x]):
            return True
    return False


@njit(cache=True, inline="always")
def _separated_at_vertex(one, one_ids, two, two_ids):
    """Whether an axis-aligned plane through the common corner of two triangles separates the rest of them."""
    n, m = 0, 0
    for x in range(3):
        if one_ids[x] == two_ids[0] or one_ids[x] == two_ids[1] or one_ids[x] == two_ids[2]:
            n = x
        if two_ids[x] == one_ids[0] or two_ids[x] == one_ids[1] or two_ids[x] == one_ids[2]:
            m = x
    i, j, k, o = (n + 1) % 3, (n + 2) % 3, (m + 1) % 3, (m + 2) % 3
    for x in range(3):
        at = one[n, x]
        if max(one[i, x], one[j, x]) < at <= min(two[k, x], two[o, x]):
            return True
        if min(one[i, x], one[j, x]) > at >= max(two[k, x], two[o, x]):
            return True
        if max(two[k, x], two[o, x]) < at <= min(one[i, x], one[j, x]):
            return True
        if min(two[k, x], two[o, x]) > at >= max(one[i, x], one[j, x]):
            return True
    return False


@njit(cache=True)
def _overlap(one, one_ids, two, two_ids):
    """Whether two triangles with a common edge lie on each other."""
    n, m = 0, 0
    for x in range(3):
        if one_ids[x] != two_ids[0] and one_ids[x] != two_ids[1] and one_ids[x] != two_ids[2]:
            n = x
        if two_ids[x] != one_ids[0] and two_ids[x] != one_ids[1] and two_ids[x] != one_ids[2]:
            m = x
    i, j = (n + 1) % 3, (n + 2) % 3
    square, up, other_up = 0.0, 0.0, 0.0
    for x in range(3):
        along = one[j, x] - one[i, x]
        square += along * along
        up += (one[n, x] - one[i, x]) * along
        other_up += (two[m, x] - one[i, x]) * along
    if square == 0:
        return True
    dot, first, second = 0.0, 0.0, 0.0
    for x in range(3):
        along = one[j, x] - one[i, x]
        a = one[n, x] - one[i, x] - along * (up / square)
        b = two[m, x] - one[i, x] - along * (other_up / square)
        dot, first, second = dot + a * b, first + a * a, second + b * b
    return dot > MAX_FOLD_COSINE * np.sqrt(first * second)


@njit(cache=True, inline="always")
def _normal_and_altitude(t):
    """Unit normal of a triangle and its lowest altitude."""
    ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    longest = np.sqrt(max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz))
    if area == 0 or longest == 0:
        return (0.0, 0.0, 0.0), 0.0
    return (nx / area, ny / area, nz / area), area / longest
