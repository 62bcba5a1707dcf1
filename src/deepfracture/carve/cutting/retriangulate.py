"""Triangles divided along the segments in which others cross them: polygons by label, then ears, then flips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.cutting.intersect import EdgeNodes, NotGeneral, Segments
from deepfracture.geometry.hashing import lookup, table_of
from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import Floats, Ints

Flags = NDArray[np.bool_]

FLIPS = 8
"""Diagonals flipped for each triangle of a polygon, at most."""
FEW = 16
"""Triangles of a polygon up to which comparing all their edges is quicker than sorting them."""


@dataclass(frozen=True, eq=False)
class Division:
    """What the divided triangles fall into."""

    corners: Ints
    """Points of each part, turning as the triangle that it is part of, shape (p, 3)."""
    label: Ints
    """Shape (p,)."""
    parent: Ints
    """The triangle, shape (p,)."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The triangles of one surface, of which some are crossed. All points are rows of one table of positions."""

    triangles: Ints
    """Vertices, shape (t, 3)."""
    labels: Ints
    """Of the vertices."""
    codes: Callable[[Ints], Ints]
    """Gives the codes of the edges from each corner to the next of some triangles."""
    nodes: EdgeNodes
    """Those on the edges."""
    segments: Segments
    """Between nodes."""
    first: int
    """Row of the first vertex in the table of positions ..."""
    first_node: int
    """... and of the first node."""


def divide(surface: Surface, positions: Floats, *, unwanted: int) -> Division:
    """Parts of the triangles that segments cross, without those of the label `unwanted`.

    Raises NotGeneral if segments and labels contradict each other."""
    segments, nodes = surface.segments, surface.nodes
    names, start, order = _by_triangle(segments.triangle, len(surface.triangles))
    codes, table = surface.codes(names), table_of(nodes.edges)

    def part(first: int, last: int) -> tuple[Ints, Ints, Ints]:
        loops, loop_start, label, parent, bounded, flat, corners, of = _parts(
            positions, surface.triangles, surface.labels, names, codes, table, nodes.edges, nodes.start, nodes.nodes,
            nodes.before, nodes.after, start, order, segments.tail, segments.head, segments.left, segments.right,
            surface.first, surface.first_node, unwanted, first, last,
        )  # fmt: skip
        if len(loop_start) == 0:
            raise NotGeneral
        if not bounded.all():
            corners, of = _with_holes(loops, loop_start, flat, label, parent, bounded, label != unwanted)
        return corners, label[of], names[first:last][parent[of]]

    parts = parallel_for(part, len(names), least=256)
    return Division(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@njit(cache=True, nogil=True)
def _parts(
    positions, triangles, labels, names, codes, table, edges, node_start, nodes, before, after, start, order, tail,
    head, left, right, shift, shift_node, unwanted, first, last,
):  # fmt: skip
    """Of some of the triangles: what `_trace` gives, what `_projected` does, and what `_ears` does if no polygon may be
    a hole."""
    corners, inside = np.empty((last - first, 3), np.int64), np.empty((last - first, 3), np.int64)
    forward = np.empty((last - first, 3), np.bool_)
    for t in range(first, last):
        for n in range(3):
            here, there = triangles[names[t], n], triangles[names[t], (n + 1) % 3]
            corners[t - first, n], inside[t - first, n], forward[t - first, n] = (
                here + shift,
                labels[here],
                here < there,
            )
    rim_start, rim, beyond = _rims(codes[first:last], forward, table, edges, node_start, nodes, before, after)
    own = order[start[first] : start[last]]
    loops, loop_start, label, parent, bounded = _trace(
        corners, inside, rim_start, rim + shift_node, beyond, start[first : last + 1] - start[first],
        tail[own] + shift_node, head[own] + shift_node, left[own], right[own],
    )  # fmt: skip
    flat = _projected(positions, corners[parent], loops, loop_start)
    made, of = np.empty((0, 3), np.int64), np.empty(0, np.int64)
    if len(loop_start) and bounded.all():
        made, of = _ears(loops, loop_start, flat, label != unwanted)
    return loops, loop_start, label, parent, bounded, flat, made, of


@njit(cache=True, nogil=True)
def _by_triangle(triangle, count):
    """The triangles with segments; where those of each start; and their order."""
    place = np.zeros(count + 1, np.int32)
    for t in triangle:
        place[t + 1] += 1
    names, start = np.empty(len(triangle), np.int64), np.zeros(len(triangle) + 1, np.int64)
    found = 0
    for t in range(count):
        if place[t + 1]:
            names[found] = t
            start[found + 1] = start[found] + place[t + 1]
            place[t + 1] = start[found + 1]
            found += 1
    order = np.empty(len(triangle), np.int64)
    for s in range(len(triangle) - 1, -1, -1):
        place[triangle[s] + 1] -= 1
        order[place[triangle[s] + 1]] = s
    return names[:found].copy(), start[: found + 1].copy(), order


@njit(cache=True, nogil=True)
def _rims(codes, forward, table, edges, start, nodes, before, after):
    """The nodes on the sides of triangles, in the order of each side, and the labels after them."""
    rim_start = np.zeros(3 * len(codes) + 1, np.int64)
    rim, beyond = np.empty(16, np.int64), np.empty(16, np.int64)
    count = 0
    for t in range(len(codes)):
        for n in range(3):
            at = lookup(table, edges, codes[t, n])
            if at >= 0:
                size = start[at + 1] - start[at]
                while count + size > len(rim):
                    rim = np.concatenate((rim, np.empty_like(rim)))
                    beyond = np.concatenate((beyond, np.empty_like(beyond)))
                for m in range(size):
                    if forward[t, n]:
                        rim[count], beyond[count] = nodes[start[at] + m], after[start[at] + m]
                    else:
                        rim[count], beyond[count] = nodes[start[at + 1] - 1 - m], before[start[at + 1] - 1 - m]
                    count += 1
            rim_start[3 * t + n + 1] = count
    return rim_start, rim[:count], beyond[:count]


@njit(cache=True, nogil=True)
def _trace(corners, labels, rim_start, rim, beyond, start, tail, head, left, right):
    """All closed polygons with one label inside, as loops of points with the inside on the left; no starts of loops if
    segments and labels contradict each other.

    At every point one line at most leaves with a given label on its left, so labels lead around each polygon."""
    room = 6 * len(corners) + 2 * len(rim) + 2 * len(tail)
    loops = np.empty(room, np.int64)
    loop_start, label, parent = np.zeros(room + 1, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    bounded = np.empty(room, np.bool_)
    used, count = 0, 0
    for t in range(len(corners)):
        lines = 3 + rim_start[3 * t + 3] - rim_start[3 * t] + 2 * (start[t + 1] - start[t])
        origin, target = np.empty(lines, np.int64), np.empty(lines, np.int64)
        name = np.empty(lines, np.int64)
        made = 0
        for n in range(3):
            here, inside = corners[t, n], labels[t, n]
            for r in range(rim_start[3 * t + n], rim_start[3 * t + n + 1]):
                origin[made], target[made], name[made] = here, rim[r], inside
                here, inside = rim[r], beyond[r]
                made += 1
            if inside != labels[t, (n + 1) % 3]:
                return loops, loop_start[:0], label, parent, bounded
            origin[made], target[made], name[made] = here, corners[t, (n + 1) % 3], inside
            made += 1
        rims = made
        for s in range(start[t], start[t + 1]):
            origin[made], target[made], name[made] = tail[s], head[s], left[s]
            origin[made + 1], target[made + 1], name[made + 1] = head[s], tail[s], right[s]
            made += 2
        following = _following(origin, target, name)
        done = np.zeros(lines, np.bool_)
        for first in range(lines):
            if done[first]:
                continue
            at, on_rim = first, False
            while not done[at]:
                done[at] = True
                on_rim |= at < rims
                loops[used] = origin[at]
                used += 1
                at = following[at]
                if at < 0:
                    return loops, loop_start[:0], label, parent, bounded
            if at != first:
                return loops, loop_start[:0], label, parent, bounded
            label[count], parent[count], bounded[count] = name[first], t, on_rim
            count += 1
            loop_start[count] = used
    return loops[:used], loop_start[: count + 1], label[:count], parent[:count], bounded[:count]


@njit(cache=True)
def _following(origin, target, name):
    """The line that leaves where each arrives with the same label, -1 if none or several do."""
    lines = len(origin)
    following = np.full(lines, -1, np.int64)
    if lines <= 32:
        for a in range(lines):
            for b in range(lines):
                if origin[b] == target[a] and name[b] == name[a]:
                    if following[a] >= 0:
                        following[a] = -1
                        return following
                    following[a] = b
        return following
    most = name.max() + 1
    keys = origin * most + name
    order = np.argsort(keys)
    keys = keys[order]
    for a in range(lines):
        key = target[a] * most + name[a]
        at = np.searchsorted(keys, key)
        if at < lines and keys[at] == key and not (at + 1 < lines and keys[at + 1] == key):
            following[a] = order[at]
    return following


@njit(cache=True, nogil=True)
def _projected(positions, corners, loops, loop_start):
    """The loops' points along the two axes that show their triangle best, turning to the left, shape (n, 2)."""
    flat = np.empty((len(loops), 2))
    for n in range(len(loop_start) - 1):
        a, b, c = positions[corners[n, 0]], positions[corners[n, 1]], positions[corners[n, 2]]
        u, v = b - a, c - a
        normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        axis = 0
        for x in range(1, 3):
            if abs(normal[x]) > abs(normal[axis]):
                axis = x
        p, q = (axis + 1) % 3, (axis + 2) % 3
        if normal[axis] < 0:
            p, q = q, p
        for m in range(loop_start[n], loop_start[n + 1]):
            flat[m, 0], flat[m, 1] = positions[loops[m], p] - a[p], positions[loops[m], q] - a[q]
    return flat


def _with_holes(
    loops: Ints, loop_start: Ints, flat: Floats, label: Ints, parent: Ints, bounded: Flags, wanted: Flags
) -> tuple[Ints, Ints]:
    """Triangles of the polygons that are wanted, some of which have holes, and the loop of each."""
    simple = np.ones(len(label), np.bool_)
    outer_of: dict[int, list[int]] = {}
    for hole in np.flatnonzero(~bounded):
        if _area(flat[loop_start[hole] : loop_start[hole + 1]]) > 0:
            continue
        simple[hole] = False
        point = flat[loop_start[hole]]
        around = []
        for n in np.flatnonzero((parent == parent[hole]) & (label == label[hole])):
            loop = flat[loop_start[n] : loop_start[n + 1]]
            if n != hole and _area(loop) > 0 and _holds(loop, point):
                around.append((_area(loop), int(n)))
        if not around:
            raise NotGeneral
        outer_of.setdefault(min(around)[1], []).append(int(hole))
    simple[list(outer_of)] = False
    parts = [_ears(loops, loop_start, flat, simple & wanted)]
    parts += [
        _around_holes(loops, loop_start, flat, outer, holes)
        for outer, holes in sorted(outer_of.items())
        if wanted[outer]
    ]
    corners, of = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(of, kind="stable")  # so that nothing depends on which triangles are looked at parallel_invoke
    return corners[order], of[order]


def _area(loop: Floats) -> float:
    x, y = (loop - loop[0]).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def _holds(loop: Floats, point: Floats) -> bool:
    """Whether a polygon holds a point off its rim (crossings of a ray)."""
    a, b = loop - point, np.roll(loop, -1, axis=0) - point
    spans = (a[:, 1] > 0) != (b[:, 1] > 0)
    turn = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return bool(np.count_nonzero(spans & ((turn > 0) == (b[:, 1] > a[:, 1]))) % 2)


def _around_holes(loops: Ints, loop_start: Ints, flat: Floats, outer: int, holes: list[int]) -> tuple[Ints, Ints]:
    from manifold3d import triangulate

    spans = [slice(loop_start[n], loop_start[n + 1]) for n in (outer, *holes)]
    points = np.concatenate([loops[span] for span in spans])
    corners = np.asarray(triangulate([flat[span] for span in spans]), np.int64)
    return points[corners], np.full(len(corners), outer)


@njit(cache=True, nogil=True)
def _ears(loops, loop_start, flat, wanted):
    """Triangles of simple polygons, and the loop of each: the best-shaped ear first."""
    room, longest = 0, 3
    for n in range(len(wanted)):
        if wanted[n]:
            room += loop_start[n + 1] - loop_start[n] - 2
            longest = max(longest, loop_start[n + 1] - loop_start[n])
    corners, of = np.empty((room, 3), np.int64), np.empty(room, np.int64)
    before, after, worth = np.empty(longest, np.int64), np.empty(longest, np.int64), np.empty(longest)
    beside = np.empty(3 * longest, np.int64)
    made = 0
    for n in range(len(wanted)):
        if not wanted[n]:
            continue
        first, size = loop_start[n], loop_start[n + 1] - loop_start[n]
        if size == 3:
            corners[made, 0], corners[made, 1], corners[made, 2] = loops[first + 2], loops[first], loops[first + 1]
            of[made] = n
            made += 1
            continue
        own = flat[first : first + size]
        for m in range(size):
            before[m], after[m] = m - 1 if m > 0 else size - 1, m + 1 if m < size - 1 else 0
        for m in range(size):
            worth[m] = _worth(own, before, after, m)
        at = 0
        for left in range(size, 2, -1):
            if left > 3:
                best = at
                m = after[at]
                while m != at:
                    if worth[m] > worth[best]:
                        best = m
                    m = after[m]
                at = best
            a, b = before[at], after[at]
            corners[made, 0], corners[made, 1], corners[made, 2] = a, at, b
            of[made] = n
            made += 1
            after[a], before[b] = b, a
            at = a
            if left > 4:
                worth[a] = _worth(own, before, after, a)
                worth[b] = _worth(own, before, after, b)
        _flip(own, corners[made - size + 2 : made], beside)
        for m in range(made - size + 2, made):
            for x in range(3):
                corners[m, x] = loops[first + corners[m, x]]
    return corners, of


@njit(cache=True)
def _neighbours(corners, beside):
    """For the edge after each corner of some triangles the one that runs back, -1 for none; into `beside`."""
    count = 3 * len(corners)
    beside[:count] = -1
    if count > 3 * FEW:
        keys = np.empty(count, np.int64)
        most = corners.max() + 1
        for e in range(count):
            a, b = corners[e // 3, e % 3], corners[e // 3, (e % 3 + 1) % 3]
            keys[e] = min(a, b) * most + max(a, b)
        order = np.argsort(keys)
        for m in range(count - 1):
            e, f = order[m], order[m + 1]
            if keys[e] == keys[f]:
                beside[e], beside[f] = f, e
        return
    for e in range(count):
        if beside[e] >= 0:
            continue
        a, b = corners[e // 3, e % 3], corners[e // 3, (e % 3 + 1) % 3]
        for f in range(e // 3 * 3 + 3, count):
            if corners[f // 3, f % 3] == b and corners[f // 3, (f % 3 + 1) % 3] == a:
                beside[e], beside[f] = f, e
                break


@njit(cache=True)
def _flip(flat, corners, beside):
    """Flip diagonals between two triangles while that makes the worse of the two better: ears leave slivers where
    nodes lie in one line. `beside`: scratch."""
    count = len(corners)
    _neighbours(corners, beside)
    left = FLIPS * count
    changed = True
    while changed and left > 0:
        changed = False
        for e in range(3 * count):
            f = beside[e]
            if f < e or left == 0:
                continue
            t, n, u, m = e // 3, e % 3, f // 3, f % 3
            a, b, c = corners[t, n], corners[t, (n + 1) % 3], corners[t, (n + 2) % 3]
            d = corners[u, (m + 2) % 3]
            now = min(_shape(flat, a, b, c), _shape(flat, b, a, d))
            if min(_shape(flat, a, d, c), _shape(flat, d, b, c)) <= now + 1e-9:
                continue
            # t keeps the edge c a, u the edge d b; the new diagonal is d c.
            bc, ca, ad, db = 3 * t + (n + 1) % 3, 3 * t + (n + 2) % 3, 3 * u + (m + 1) % 3, 3 * u + (m + 2) % 3
            outside = (beside[ad], beside[ca], beside[db], beside[bc])
            inside = (3 * t, 3 * t + 2, 3 * u, 3 * u + 1)
            corners[t, 0], corners[t, 1], corners[t, 2] = a, d, c
            corners[u, 0], corners[u, 1], corners[u, 2] = d, b, c
            for x in range(4):
                beside[inside[x]] = outside[x]
                if outside[x] >= 0:
                    beside[outside[x]] = inside[x]
            beside[3 * t + 1], beside[3 * u + 2] = 3 * u + 2, 3 * t + 1
            changed, left = True, left - 1


@njit(cache=True, inline="always")
def _shape(flat, a, b, c):
    """Shape of a triangle: 1 equilateral, 0 flat, negative if it turns to the right."""
    ux, uy, vx, vy = flat[b, 0] - flat[a, 0], flat[b, 1] - flat[a, 1], flat[c, 0] - flat[a, 0], flat[c, 1] - flat[a, 1]
    longest = ux * ux + uy * uy + vx * vx + vy * vy + (vx - ux) ** 2 + (vy - uy) ** 2
    return 2 * np.sqrt(3.0) * (ux * vy - uy * vx) / longest if longest > 0 else 0.0


@njit(cache=True)
def _worth(flat, before, after, at):
    """Shape of the ear at a point, less 2 if it is reflex, less 4 if it holds another point."""
    a, b = before[at], after[at]
    ux, uy = flat[at, 0] - flat[a, 0], flat[at, 1] - flat[a, 1]
    vx, vy = flat[b, 0] - flat[at, 0], flat[b, 1] - flat[at, 1]
    wx, wy = flat[a, 0] - flat[b, 0], flat[a, 1] - flat[b, 1]
    shape = _shape(flat, a, at, b)
    if shape <= 0:
        return shape - 2.0
    n = after[b]
    while n != a:
        px, py = flat[n, 0], flat[n, 1]
        one = ux * (py - flat[a, 1]) - uy * (px - flat[a, 0])
        two = vx * (py - flat[at, 1]) - vy * (px - flat[at, 0])
        three = wx * (py - flat[b, 1]) - wy * (px - flat[b, 0])
        if one >= 0 and two >= 0 and three >= 0:
            return shape - 4.0
        n = after[n]
    return shape
