"""Edges too short to matter, taken out where a crack passes close by a vertex of the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.cutting.intersect import over, pierces
from deepfracture.carve.cutting.solids import Faces
from deepfracture.runtime.parallel import parallel_for, parallel_invoke
from deepfracture.types import Floats, Ints

Flags = NDArray[np.bool_]

PASSES = 3
"""Rounds of collapses: in one, no two that have a face in common."""
TURN = 0.5
"""Least cosine of the angle by which a collapse may turn a face that is no sliver."""
FOLD = 0.9998
"""Cosine of the angle between two neighbouring faces, about a degree, above which they lie on each other."""
MANY = 64
"""Faces at a vertex above which its edges stay."""


def without_short_edges(faces: Faces, shortest: float, originals: int, nodes_from: int) -> Faces:
    """The same faces with no edge below `shortest` [m] that can go: both its points become one.

    The first `originals` points, the surface's own vertices, never move, and outer faces stay in the plane of their
    source. An edge goes only if the cells on both sides of it remain what they were: every cell that meets at one of
    its points meets along all of it, and no two faces become one (link condition, Dey et al. 1999). Only edges at the
    points from `nodes_from` on are looked at, where cracks cross the surface."""
    of_outer, of_inner = parallel_invoke(
        lambda: _near(faces.outer, faces.plain), lambda: _near(faces.inner, faces.plain)
    )
    corners, sides, source = _gathered(
        faces.outer, faces.source, faces.cell, of_outer, faces.inner, faces.sides, of_inner
    )  # fmt: skip
    changed, sheets, news = False, (originals, nodes_from), np.ones(len(faces.positions), np.bool_)
    for _ in range(PASSES):
        short = _short_edges(faces.positions, corners, shortest, nodes_from, news)
        if not len(short) or not _collapsed(faces.positions, corners, sides, source, short, shortest, sheets, news):
            break
        changed = True
    if not changed:
        return faces
    (outer, beside), (inner, sides) = parallel_invoke(
        lambda: _put_back(faces.outer, (faces.source, faces.cell), of_outer, corners[: len(of_outer)]),
        lambda: _put_back(faces.inner, (faces.sides[:, 0], faces.sides[:, 1]), of_inner, corners[len(of_outer) :]),
    )
    return replace(faces, outer=outer, source=beside[:, 0], cell=beside[:, 1], inner=inner, sides=sides)


@njit(cache=True)
def _gathered(outer, source, cell, of_outer, inner, sides, of_inner):
    """Corners of some outer and some inner faces, cells below and above them (0: outside), source (-1: none)."""
    m, k = len(of_outer), len(of_inner)
    corners, beside, lies_in = np.empty((m + k, 3), np.int64), np.empty((m + k, 2), np.int64), np.empty(m + k, np.int64)
    for n in range(m):
        f = of_outer[n]
        corners[n, 0], corners[n, 1], corners[n, 2] = outer[f, 0], outer[f, 1], outer[f, 2]
        beside[n, 0], beside[n, 1], lies_in[n] = 0, cell[f], source[f]
    for n in range(k):
        f = of_inner[n]
        corners[m + n, 0], corners[m + n, 1], corners[m + n, 2] = inner[f, 0], inner[f, 1], inner[f, 2]
        beside[m + n, 0], beside[m + n, 1], lies_in[m + n] = sides[f, 0], sides[f, 1], -1
    return corners, beside, lies_in


@njit(cache=True, nogil=True)
def _put_back(faces, columns, of, corners):
    """All faces with some of them changed, without those that are gone; and what the two columns say of each."""
    left, beside = np.empty_like(faces), np.empty((len(faces), 2), np.int64)
    count, at = 0, 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if at < len(of) and of[at] == f:
            a, b, c = corners[at, 0], corners[at, 1], corners[at, 2]
            at += 1
        if a >= 0:
            left[count, 0], left[count, 1], left[count, 2] = a, b, c
            beside[count, 0], beside[count, 1] = columns[0][f], columns[1][f]
            count += 1
    return left[:count], beside[:count]


@njit(cache=True, nogil=True)
def _near(faces, plain):
    """The faces at a point of a face with a node, and those at other points that are not plain."""
    found = np.empty(len(faces), np.int64)
    used = 0
    for f in range(len(faces)):
        found[used] = f
        used += not (plain[faces[f, 0]] and plain[faces[f, 1]] and plain[faces[f, 2]])
    return found[:used].copy()


def _short_edges(positions: Floats, corners: Ints, shortest: float, nodes_from: int, news: Flags) -> Ints:
    """Edges at a node below the length, the shortest first, the lower point first, shape (s, 2).

    Only those at points of `news`: what could not go keeps its reasons until a face around it changes."""
    found = parallel_for(
        lambda first, last: _short(positions, corners, shortest, nodes_from, news, first, last),
        len(corners), least=4096,
    )  # fmt: skip
    edges, lengths = (np.concatenate(column) for column in zip(*found, strict=True))
    return edges[np.argsort(lengths, kind="stable")]


@njit(cache=True, nogil=True)
def _short(positions, corners, shortest, nodes_from, news, from_face, to_face):
    """Short edges of some faces, and the squares of their lengths."""
    found, lengths = np.empty((16, 2), np.int64), np.empty(16)
    count = 0
    for f in range(from_face, to_face):
        for n in range(3):
            a, b = corners[f, n], corners[f, (n + 1) % 3]
            if a > b or a < 0 or b < nodes_from or not (news[a] or news[b]):
                continue
            square = 0.0
            for x in range(3):
                square += (positions[a, x] - positions[b, x]) ** 2
            if square >= shortest * shortest:
                continue
            if count == len(found):
                found, lengths = np.concatenate((found, found)), np.concatenate((lengths, lengths))
            found[count, 0], found[count, 1], lengths[count] = a, b, square
            count += 1
    return found[:count].copy(), lengths[:count].copy()


def _collapsed(
    positions: Floats, corners: Ints, sides: Ints, source: Ints, short: Ints, shortest: float,
    sheets: tuple[int, int], news: Flags,
) -> int:  # fmt: skip
    """Collapse what can go; rows of `corners` that are gone become -1. Returns how many edges went.

    `sheets`: the first of the points that belong to sheets alone, and one past the last. `news` is written anew: the
    points with a face one of whose points has had a face changed."""
    slot, start, around = _faces_around(len(positions), corners, short)
    choice = np.empty(len(short), np.int8)
    parallel_for(
        lambda first, last: _choose(
            positions, corners, sides, source, short, shortest, sheets, slot, start, around, choice, first, last
        ),
        len(short), least=64,
    )  # fmt: skip
    return _collapse(positions, corners, sides, source, short, shortest, sheets, slot, start, around, choice, news)


@njit(cache=True, nogil=True)
def _choose(
    positions, corners, sides, source, short, shortest, sheets, slot, start, around, choice, first, last
):  # fmt: skip
    """`_choice` for some edges, as long as nothing has changed."""
    seen = np.zeros(len(corners) + 1, np.int64)
    for e in range(first, last):
        a, b = short[e]
        choice[e] = _choice(positions, corners, sides, source, a, b, shortest, sheets, slot, start, around, seen)


@njit(cache=True)
def _choice(positions, corners, sides, source, a, b, shortest, sheets, slot, start, around, seen):
    """How the edge a b may go: 1, b goes to a; 2, a goes to b; 0, it may not.

    The higher point goes to the lower, as those of the original come first, or else the lower to the higher."""
    own, other = around[start[slot[a]] : start[slot[a] + 1]], around[start[slot[b]] : start[slot[b] + 1]]
    if max(len(own), len(other)) > MANY:
        return 0
    down = _may_move(positions, corners, source, other, own, b, a, shortest)
    up = a >= sheets[0] and _may_move(positions, corners, source, own, other, a, b, shortest)
    if not (down or up) or not _is_whole(corners, sides, own, other, a, b):
        return 0
    if down and not _crosses(positions, corners, source, other, b, a, slot, start, around, seen, sheets):
        return 1
    if up and not _crosses(positions, corners, source, own, a, b, slot, start, around, seen, sheets):
        return 2
    return 0


@njit(cache=True)
def _collapse(positions, corners, sides, source, short, shortest, sheets, slot, start, around, choice, news):
    """See `_collapsed`. What was chosen counts as long as no face at a point of a face at the edge has changed."""
    busy, seen = np.zeros(len(corners), np.bool_), np.zeros(len(corners) + 1, np.int64)
    touched = np.zeros(len(positions), np.bool_)
    gone = 0
    for e in range(len(short)):
        a, b = short[e]
        own, other = around[start[slot[a]] : start[slot[a] + 1]], around[start[slot[b]] : start[slot[b] + 1]]
        if _any(busy, own) or _any(busy, other):
            continue
        way = choice[e]
        if _touches(corners, own, touched) or _touches(corners, other, touched):
            way = _choice(positions, corners, sides, source, a, b, shortest, sheets, slot, start, around, seen)
        if way == 0:
            continue
        stays, goes, faces = (a, b, other) if way == 1 else (b, a, own)
        for f in own:
            busy[f] = True
        for f in other:
            busy[f] = True
        touched[stays] = True
        for f in faces:
            for n in range(3):
                touched[corners[f, n]] = True
            if _has(corners, f, stays):
                corners[f] = -1
                continue
            for n in range(3):
                if corners[f, n] == goes:
                    corners[f, n] = stays
        gone += 1
    news[:] = False
    for f in range(len(corners)):
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        if a >= 0 and (touched[a] or touched[b] or touched[c]):
            news[a] = news[b] = news[c] = True
    return gone


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
def _faces_around(count, corners, short):
    """A slot for each point of a face at a short edge; where the faces around it start; and they."""
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
    around, place = np.empty(start[used], np.int64), start[:-1].copy()
    for f in range(len(corners)):
        for n in range(3 if corners[f, 0] >= 0 else 0):
            at = slot[corners[f, n]]
            if at >= 0:
                around[place[at]] = f
                place[at] += 1
    return slot, start, around


@njit(cache=True)
def _is_whole(corners, sides, own, other, a, b):
    """Whether the edge a b can go without a change of what meets what."""
    cells = np.empty(2 * len(own), np.int64)
    count, shared = 0, 0
    for f in own:
        if corners[f, 0] == b or corners[f, 1] == b or corners[f, 2] == b:
            cells[count], cells[count + 1] = sides[f, 0], sides[f, 1]
            count += 2
            shared += 1
    along = cells[:count]
    if not (_within(sides, own, along) or _within(sides, other, along)):
        return False
    beside = 0
    for f in own:
        for n in range(3):
            v = corners[f, n]
            if v in (a, b):
                continue
            first = True
            for g in own:
                if g == f:
                    break
                first = first and not _has(corners, g, v)
            if not first:
                continue
            for g in other:
                if _has(corners, g, v):
                    beside += 1
                    break
    return beside == shared and _stays_closed(corners, sides, own, other, a, b)


@njit(cache=True, inline="always")
def _has(corners, face, v):
    return corners[face, 0] == v or corners[face, 1] == v or corners[face, 2] == v


@njit(cache=True)
def _stays_closed(corners, sides, own, other, a, b):
    """Whether around the one point that a and b become every edge still has two faces of each cell that meets there."""
    ends = np.empty((4 * (len(own) + len(other)), 2), np.int64)
    count = 0
    for which in range(2):
        for f in own if which == 0 else other:
            if _has(corners, f, a) and _has(corners, f, b):
                continue
            for n in range(3):
                for m in range(2):
                    if corners[f, n] not in (a, b):
                        ends[count, 0], ends[count, 1] = corners[f, n], sides[f, m]
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
def _within(sides, faces, cells):
    """Whether all cells at the faces are among `cells`."""
    for f in faces:
        for n in range(2):
            found = False
            for cell in cells:
                found = found or cell == sides[f, n]
            if not found:
                return False
    return True


@njit(cache=True)
def _may_move(positions, corners, source, faces, others, goes, stays, shortest):
    """Whether `goes` may move to `stays`: outer faces keep their planes, no face turns, none becomes flat."""
    old, new = np.empty((3, 3)), np.empty((3, 3))
    for f in faces:
        if source[f] >= 0:
            found = False
            for g in others:
                found = found or source[g] == source[f]
            if not found:
                return False
        if corners[f, 0] == stays or corners[f, 1] == stays or corners[f, 2] == stays:
            continue
        for n in range(3):
            v = corners[f, n]
            for x in range(3):
                old[n, x] = positions[v, x]
                new[n, x] = positions[stays, x] if v == goes else positions[v, x]
        before, height = _normal(old)
        after, lower = _normal(new)
        if lower <= 0 or lower < min(height, 0.5 * shortest):
            return False
        dot = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
        if dot < (TURN if height >= shortest else 0.0):
            return False
    return True


@njit(cache=True)
def _crosses(positions, corners, source, faces, goes, stays, slot, start, around, seen, sheets):
    """Whether a face that moves with `goes` to `stays` would cross one nearby, or a crack's face lie in the surface.

    `seen`: the comparison in which each face last took part, and the number of comparisons; `sheets`: the first of the
    points that belong to sheets alone, and one past the last."""
    new, near = np.empty((3, 3)), np.empty((3, 3))
    names, others = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in faces:
        if _has(corners, f, stays):
            continue
        on_surface = _moved(positions, corners, f, goes, stays, names, new, sheets)
        if source[f] < 0 and on_surface:
            return True
        seen[-1] += 1
        for n in range(3):
            at = slot[names[n]]
            if start[at + 1] - start[at] > MANY:
                return True
            for where in range(start[at], start[at + 1]):
                g = around[where]
                if seen[g] == seen[-1]:
                    continue
                seen[g] = seen[-1]
                if corners[g, 0] < 0 or g == f or (_has(corners, g, goes) and _has(corners, g, stays)):
                    continue
                _moved(positions, corners, g, goes, stays, others, near, sheets)
                if _cross(new, names, near, others):
                    return True
    return False


@njit(cache=True, inline="always")
def _moved(positions, corners, face, goes, stays, names, places, sheets):
    """A face's points and their places once `goes` is `stays`. Returns whether all lie on the body's surface."""
    on_surface = True
    for n in range(3):
        v = corners[face, n]
        names[n] = stays if v == goes else v
        on_surface &= not sheets[0] <= names[n] < sheets[1]
        for x in range(3):
            places[n, x] = positions[names[n], x]
    return on_surface


@njit(cache=True)
def _cross(one, its, two, other):
    """Whether an edge of one triangle pierces the other; points that both have are left out."""
    shared = 0
    for n in range(3):
        shared += its[n] == other[0] or its[n] == other[1] or its[n] == other[2]
    if shared == 2:
        return _folded(one, its, two, other)
    if shared == 3 or (shared == 0 and _apart(one, two)) or (shared == 1 and _only_meet(one, its, two, other)):
        return False
    a0, a1, a2 = _height(one, its, two, other, 0), _height(one, its, two, other, 1), _height(one, its, two, other, 2)
    if min(a0, a1, a2) >= 0 or max(a0, a1, a2) <= 0:
        return False
    b0, b1, b2 = _height(two, other, one, its, 0), _height(two, other, one, its, 1), _height(two, other, one, its, 2)
    if min(b0, b1, b2) >= 0 or max(b0, b1, b2) <= 0:
        return False
    for n in range(3):
        here, there = (a0, a1) if n == 0 else ((a1, a2) if n == 1 else (a2, a0))
        if here * there < 0 and pierces(two[n], two[(n + 1) % 3], one) == 1:
            return True
        here, there = (b0, b1) if n == 0 else ((b1, b2) if n == 1 else (b2, b0))
        if here * there < 0 and pierces(one[n], one[(n + 1) % 3], two) == 1:
            return True
    return False


@njit(cache=True, inline="always")
def _height(one, its, two, other, n):
    """Side of the first triangle on which a corner of the second lies, 0 for a common point."""
    if other[n] == its[0] or other[n] == its[1] or other[n] == its[2]:
        return 0
    return over(one, two[n])


@njit(cache=True, inline="always")
def _apart(one, two):
    """Whether the boxes of two triangles lie beside each other."""
    for x in range(3):
        if max(one[0, x], one[1, x], one[2, x]) < min(two[0, x], two[1, x], two[2, x]):
            return True
        if min(one[0, x], one[1, x], one[2, x]) > max(two[0, x], two[1, x], two[2, x]):
            return True
    return False


@njit(cache=True, inline="always")
def _only_meet(one, its, two, other):
    """Whether a plane across an axis at the common corner of two triangles has them on its two sides, but for it."""
    n, m = 0, 0
    for x in range(3):
        if its[x] == other[0] or its[x] == other[1] or its[x] == other[2]:
            n = x
        if other[x] == its[0] or other[x] == its[1] or other[x] == its[2]:
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
def _folded(one, its, two, other):
    """Whether two triangles with a common edge lie on each other."""
    n, m = 0, 0
    for x in range(3):
        if its[x] != other[0] and its[x] != other[1] and its[x] != other[2]:
            n = x
        if other[x] != its[0] and other[x] != its[1] and other[x] != its[2]:
            m = x
    i, j = (n + 1) % 3, (n + 2) % 3
    square, up, over_there = 0.0, 0.0, 0.0
    for x in range(3):
        along = one[j, x] - one[i, x]
        square += along * along
        up += (one[n, x] - one[i, x]) * along
        over_there += (two[m, x] - one[i, x]) * along
    if square == 0:
        return True
    dot, first, second = 0.0, 0.0, 0.0
    for x in range(3):
        along = one[j, x] - one[i, x]
        a = one[n, x] - one[i, x] - along * (up / square)
        b = two[m, x] - one[i, x] - along * (over_there / square)
        dot, first, second = dot + a * b, first + a * a, second + b * b
    return dot > FOLD * np.sqrt(first * second)


@njit(cache=True, inline="always")
def _normal(t):
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
