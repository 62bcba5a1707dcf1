"""Triangles divided along the segments in which others cross them: polygons by label, then ears, then flips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.carve.crossing import EdgeNodes, NotGeneral, Segments, edge_at, edge_table
from deepfracture.types import Floats, Ints

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
class Crossed:
    """Triangles that are crossed, and by what. All points are rows of one table of positions."""

    triangles: Ints
    """Names of the triangles, shape (t,)."""
    corners: Ints
    """Shape (t, 3)."""
    labels: Ints
    """At the corners, shape (t, 3)."""
    rim_start: Ints
    """Where the nodes on each side (from a corner to the next) start, and their number, shape (3 t + 1,)."""
    rim: Ints
    """Nodes, in the order of the side, shape (r,) ..."""
    beyond: Ints
    """... and the label after each, shape (r,)."""
    start: Ints
    """Where each triangle's segments start, and their number, shape (t + 1,)."""
    tail: Ints
    head: Ints
    """Points of the segments, shape (k,)."""
    left: Ints
    right: Ints
    """Labels on both sides of them, shape (k,)."""


def crossed_triangles(
    triangles: Ints,
    labels: Ints,
    codes: Callable[[Ints], Ints],
    nodes: EdgeNodes,
    segments: Segments,
    first: int,
    first_node: int,
) -> Crossed:
    """The triangles with segments.

    Args:
        triangles: Vertices of all triangles, shape (t, 3).
        labels: Of the vertices.
        codes: Gives the codes of the edges from each corner to the next of some triangles.
        nodes: Those on the edges.
        segments: Between nodes.
        first, first_node: Rows of the first vertex and the first node in the table of positions.
    """
    order = np.argsort(segments.triangle * len(segments.triangle) + np.arange(len(segments.triangle)))
    names, start = np.unique(segments.triangle[order], return_index=True)
    corners = triangles[names]
    rim_start, rim, beyond = _rims(
        codes(names), corners < np.roll(corners, -1, axis=1), nodes.edges, nodes.start, nodes.nodes, nodes.before,
        nodes.after,
    )  # fmt: skip
    tail, head, left, right = (
        column[order] for column in (segments.tail, segments.head, segments.left, segments.right)
    )
    return Crossed(
        names, corners + first, labels[corners], rim_start, rim + first_node, beyond, np.append(start, len(order)),
        tail + first_node, head + first_node, left, right,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _rims(codes, forward, edges, start, nodes, before, after):
    """The nodes on the sides of triangles, in the order of each side, and the labels after them."""
    rim_start = np.zeros(3 * len(codes) + 1, np.int64)
    rim, beyond = np.empty(16, np.int64), np.empty(16, np.int64)
    table, count = edge_table(edges), 0
    for t in range(len(codes)):
        for n in range(3):
            at = edge_at(table, edges, codes[t, n])
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


def divide(crossed: Crossed, positions: Floats, *, unwanted: int) -> Division:
    """Parts of the crossed triangles, without those of the label `unwanted`.

    Raises NotGeneral if segments and labels contradict each other."""
    failed, loops, loop_start, label, parent, bounded = _trace(
        crossed.corners, crossed.labels, crossed.rim_start, crossed.rim, crossed.beyond, crossed.start,
        crossed.tail, crossed.head, crossed.left, crossed.right,
    )  # fmt: skip
    if failed:
        raise NotGeneral
    wanted = label != unwanted
    flat = _projected(positions, crossed.corners[parent], loops, loop_start)
    simple, holed = _with_holes(flat, loop_start, label, parent, bounded)
    corners, of = _ears(loops, loop_start, flat, simple & wanted)
    parts = [(corners, of)]
    for outer, holes in holed:
        if wanted[outer]:
            parts.append(_around_holes(loops, loop_start, flat, outer, holes))
    corners, of = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Division(corners, label[of], crossed.triangles[parent[of]])


@njit(cache=True, nogil=True)
def _trace(corners, labels, rim_start, rim, beyond, start, tail, head, left, right):
    """All closed polygons with one label inside, as loops of points with the inside on the left.

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
                return True, loops, loop_start, label, parent, bounded
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
                    return True, loops, loop_start, label, parent, bounded
            if at != first:
                return True, loops, loop_start, label, parent, bounded
            label[count], parent[count], bounded[count] = name[first], t, on_rim
            count += 1
            loop_start[count] = used
    return False, loops[:used], loop_start[: count + 1], label[:count], parent[:count], bounded[:count]


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
    flat: Floats, loop_start: Ints, label: Ints, parent: Ints, bounded: np.ndarray
) -> tuple[np.ndarray, list[tuple[int, list[int]]]]:
    """Which loops are simple polygons, and those with holes with the loops of their holes."""
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
    return simple, sorted(outer_of.items())


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
