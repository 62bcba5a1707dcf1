"""Retriangulation (corefinement) of the triangles that others intersect: polygons by label, then ear clipping, then
edge flips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.carve.cutting.intersect import DegenerateIntersection, EdgeVertices, Segments
from deepfracture.geometry.hashing import lookup, table_of
from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import Floats, Ints

Flags = NDArray[np.bool_]

FLIPS_PER_TRIANGLE = 8
"""Edge flips for each triangle of a polygon, at most."""
LINEAR_SEARCH = 16
"""Triangles of a polygon up to which comparing all their edges is faster than sorting them."""


@dataclass(frozen=True, eq=False)
class Retriangulation:
    """The triangles that replace those with intersections."""

    corners: Ints
    """Points, oriented as the triangle that is replaced, shape (p, 3)."""
    label: Ints
    """Shape (p,)."""
    parent: Ints
    """The triangle that is replaced, shape (p,)."""


@dataclass(frozen=True, eq=False)
class IntersectedMesh:
    """A mesh of which some triangles are intersected. All points are rows of one table of positions."""

    triangles: Ints
    """Vertices, shape (t, 3)."""
    labels: Ints
    """Of the vertices."""
    codes: Callable[[Ints], Ints]
    """Gives the codes of the edges from each corner to the next of some triangles."""
    on_edges: EdgeVertices
    """The intersection vertices on the edges."""
    segments: Segments
    """Between intersection vertices."""
    first: int
    """Row of the first vertex in the table of positions ..."""
    first_intersection: int
    """... and of the first intersection vertex."""


class Corners(NamedTuple):
    """Some triangles, in the table of positions."""

    points: Ints
    """Shape (t, 3)."""
    labels: Ints
    """Shape (t, 3)."""
    forward: Flags
    """Whether the edge from each corner leads from its lower vertex to its higher one, shape (t, 3)."""
    codes: Ints
    """Of that edge, shape (t, 3)."""


class EdgeTable(NamedTuple):
    """`EdgeVertices` by code, with the vertices as rows of the table of positions."""

    table: NDArray[np.int32]
    """Hash table of `edges`."""
    edges: Ints
    start: Ints
    vertices: Ints
    before: Ints
    after: Ints


class Lines(NamedTuple):
    """`Segments` grouped by triangle, with their ends as rows of the table of positions."""

    start: Ints
    """The first segment of each triangle, and their number."""
    tail: Ints
    head: Ints
    left: Ints
    right: Ints


class Polygons(NamedTuple):
    """Closed points of points with one label inside, which is on their left."""

    points: Ints
    start: Ints
    """The first point of each loop, and their number; empty if segments and labels contradict each other."""
    label: Ints
    parent: Ints
    """The triangle, by its number among those looked at."""
    bounded: Flags
    """Whether the loop touches the triangle's boundary; others may be holes."""


def retriangulate(mesh: IntersectedMesh, positions: Floats, *, unwanted: int) -> Retriangulation:
    """Triangulations of the triangles with segments that contain these as edges, without triangles labelled `unwanted`.

    Each triangle falls into polygons of one label, which are cut into ears.
    Raises DegenerateIntersection if segments and labels contradict each other."""
    segments, on_edges = mesh.segments, mesh.on_edges
    crossed, start, order = _by_triangle(segments.triangle, len(mesh.triangles))
    vertices = mesh.triangles[crossed]
    corners = Corners(
        vertices + mesh.first, mesh.labels[vertices], vertices < vertices[:, [1, 2, 0]], mesh.codes(crossed)
    )
    edges = EdgeTable(
        table_of(on_edges.edges), on_edges.edges, on_edges.start, on_edges.vertices + mesh.first_intersection,
        on_edges.before, on_edges.after,
    )  # fmt: skip
    lines = Lines(
        start, segments.tail[order] + mesh.first_intersection, segments.head[order] + mesh.first_intersection,
        segments.left[order], segments.right[order],
    )  # fmt: skip

    def replace(first: int, last: int) -> tuple[Ints, Ints, Ints]:
        polygons, flat, made, of = _triangulate(positions, corners, edges, lines, unwanted, first, last)
        if len(polygons.start) == 0:
            raise DegenerateIntersection
        if not polygons.bounded.all():
            made, of = _with_holes(polygons, flat, polygons.label != unwanted)
        return made, polygons.label[of], crossed[first:last][polygons.parent[of]]

    parts = parallel_for(replace, len(crossed), least=256)
    return Retriangulation(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@njit(cache=True, nogil=True)
def _triangulate(positions, all_corners, edges, all_lines, unwanted, first, last):
    """The polygons of some of the triangles, their points in the plane, and what `_clip_ears` gives if none may be a
    hole."""
    corners = Corners(
        all_corners.points[first:last], all_corners.labels[first:last], all_corners.forward[first:last],
        all_corners.codes[first:last],
    )  # fmt: skip
    begin, end = all_lines.start[first], all_lines.start[last]
    lines = Lines(
        all_lines.start[first : last + 1] - begin, all_lines.tail[begin:end], all_lines.head[begin:end],
        all_lines.left[begin:end], all_lines.right[begin:end],
    )  # fmt: skip
    polygons = _trace_polygons(corners, lines, *_boundary_vertices(corners, edges))
    flat = _project(positions, corners.points[polygons.parent], polygons.points, polygons.start)
    made, of = np.empty((0, 3), np.int64), np.empty(0, np.int64)
    if len(polygons.start) and polygons.bounded.all():
        made, of = _clip_ears(polygons.points, polygons.start, flat, polygons.label != unwanted)
    return polygons, flat, made, of


@njit(cache=True, nogil=True)
def _by_triangle(triangle, count):
    """The triangles with segments; where those of each start; and the order of the segments by triangle."""
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
def _boundary_vertices(corners, edges):
    """The intersection vertices on the edges of triangles, in the order around each triangle: where those of each edge
    start, the vertices, and the labels after them."""
    start = np.zeros(3 * len(corners.codes) + 1, np.int64)
    vertices, after = np.empty(16, np.int64), np.empty(16, np.int64)
    count = 0
    for t in range(len(corners.codes)):
        for n in range(3):
            at = lookup(edges.table, edges.edges, corners.codes[t, n])
            if at >= 0:
                low, high = edges.start[at], edges.start[at + 1]
                while count + high - low > len(vertices):
                    vertices = np.concatenate((vertices, np.empty_like(vertices)))
                    after = np.concatenate((after, np.empty_like(after)))
                for m in range(high - low):
                    if corners.forward[t, n]:
                        vertices[count], after[count] = edges.vertices[low + m], edges.after[low + m]
                    else:
                        vertices[count], after[count] = edges.vertices[high - 1 - m], edges.before[high - 1 - m]
                    count += 1
            start[3 * t + n + 1] = count
    return start, vertices[:count], after[:count]


@njit(cache=True, nogil=True)
def _trace_polygons(corners, lines, boundary_start, boundary, after):
    """All polygons of some triangles: their edges and segments, both ways, are directed lines with a label on the left.

    At every point at base one line leaves with a given label on its left, so labels lead around each polygon."""
    room = 6 * len(corners.points) + 2 * len(boundary) + 2 * len(lines.tail)
    points = np.empty(room, np.int64)
    start, label, parent = np.zeros(room + 1, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    bounded = np.empty(room, np.bool_)
    contradiction = Polygons(points, start[:0], label, parent, bounded)
    used, count = 0, 0
    for t in range(len(corners.points)):
        origin, target, left, on_boundary = _directed_lines(corners, lines, boundary_start, boundary, after, t)
        if on_boundary < 0:
            return contradiction
        following = _following(origin, target, left)
        done = np.zeros(len(origin), np.bool_)
        for first in range(len(origin)):
            if done[first]:
                continue
            at, touches = first, False
            while not done[at]:
                done[at] = True
                touches |= at < on_boundary
                points[used] = origin[at]
                used += 1
                at = following[at]
                if at < 0:
                    return contradiction
            if at != first:
                return contradiction
            label[count], parent[count], bounded[count] = left[first], t, touches
            count += 1
            start[count] = used
    return Polygons(points[:used], start[: count + 1], label[:count], parent[:count], bounded[:count])


@njit(cache=True, nogil=True)
def _directed_lines(corners, lines, boundary_start, boundary, after, t):
    """Origin and target of the lines in a triangle, and the label on their left; and how many are on its boundary,
    which come first, -1 if labels contradict each other."""
    count = 3 + boundary_start[3 * t + 3] - boundary_start[3 * t] + 2 * (lines.start[t + 1] - lines.start[t])
    origin, target, left = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    made = 0
    for n in range(3):
        here, label = corners.points[t, n], corners.labels[t, n]
        for r in range(boundary_start[3 * t + n], boundary_start[3 * t + n + 1]):
            origin[made], target[made], left[made] = here, boundary[r], label
            here, label = boundary[r], after[r]
            made += 1
        if label != corners.labels[t, (n + 1) % 3]:
            return origin, target, left, -1
        origin[made], target[made], left[made] = here, corners.points[t, (n + 1) % 3], label
        made += 1
    on_boundary = made
    for s in range(lines.start[t], lines.start[t + 1]):
        origin[made], target[made], left[made] = lines.tail[s], lines.head[s], lines.left[s]
        origin[made + 1], target[made + 1], left[made + 1] = lines.head[s], lines.tail[s], lines.right[s]
        made += 2
    return origin, target, left, on_boundary


@njit(cache=True)
def _following(origin, target, name):
    """The line that leaves where each one arrives, with the same label, -1 if none or several do."""
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
    base = name.max() + 1
    keys = origin * base + name
    order = np.argsort(keys)
    keys = keys[order]
    for a in range(lines):
        key = target[a] * base + name[a]
        at = np.searchsorted(keys, key)
        if at < lines and keys[at] == key and not (at + 1 < lines and keys[at + 1] == key):
            following[a] = order[at]
    return following


@njit(cache=True, nogil=True)
def _project(positions, corners, points, start):
    """The loops' points along the two axes that show their triangle best, counter-clockwise, shape (n, 2)."""
    flat = np.empty((len(points), 2))
    for n in range(len(start) - 1):
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
        for m in range(start[n], start[n + 1]):
            flat[m, 0], flat[m, 1] = positions[points[m], p] - a[p], positions[points[m], q] - a[q]
    return flat


def _with_holes(polygons: Polygons, flat: Floats, wanted: Flags) -> tuple[Ints, Ints]:
    """Triangles of the polygons that are wanted, some of which have holes, and the polygon of each."""
    start, label, parent = polygons.start, polygons.label, polygons.parent
    simple = np.ones(len(label), np.bool_)
    holes_in: dict[int, list[int]] = {}
    for hole in np.flatnonzero(~polygons.bounded):
        if _area(flat[start[hole] : start[hole + 1]]) > 0:
            continue
        simple[hole] = False
        point = flat[start[hole]]
        candidates = []
        for n in np.flatnonzero((parent == parent[hole]) & (label == label[hole])):
            loop = flat[start[n] : start[n + 1]]
            if n != hole and _area(loop) > 0 and _contains(loop, point):
                candidates.append((_area(loop), int(n)))
        if not candidates:
            raise DegenerateIntersection
        holes_in.setdefault(min(candidates)[1], []).append(int(hole))
    simple[list(holes_in)] = False
    parts = [_clip_ears(polygons.points, start, flat, simple & wanted)]
    parts += [
        _around_holes(polygons.points, start, flat, outer, holes)
        for outer, holes in sorted(holes_in.items())
        if wanted[outer]
    ]
    corners, of = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(of, kind="stable")  # so that nothing depends on which triangles are looked at together
    return corners[order], of[order]


def _area(loop: Floats) -> float:
    x, y = (loop - loop[0]).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def _contains(loop: Floats, point: Floats) -> bool:
    """Whether a polygon contains a point off its boundary (crossings of a ray)."""
    a, b = loop - point, np.roll(loop, -1, axis=0) - point
    spans = (a[:, 1] > 0) != (b[:, 1] > 0)
    turn = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return bool(np.count_nonzero(spans & ((turn > 0) == (b[:, 1] > a[:, 1]))) % 2)


def _around_holes(points: Ints, start: Ints, flat: Floats, outer: int, holes: list[int]) -> tuple[Ints, Ints]:
    """Triangles of a polygon with holes, and its number for each."""
    from manifold3d import triangulate

    loops = [slice(start[n], start[n + 1]) for n in (outer, *holes)]
    corners = np.asarray(triangulate([flat[loop] for loop in loops]), np.int64)
    return np.concatenate([points[loop] for loop in loops])[corners], np.full(len(corners), outer)


@njit(cache=True, nogil=True)
def _clip_ears(points, start, flat, wanted):
    """Triangles of simple polygons, and the polygon of each, by ear clipping (Meisters 1975) with the best-shaped ear
    first.

    Every simple polygon has two ears: a convex corner whose triangle contains no other point. Cutting one off changes
    the quality of its two neighbours only, so these alone are recomputed. Points on a line leave no proper ear at
    times; then the least bad corner goes (`_ear_quality`), and `_flip_diagonals` repairs the slivers."""
    room, longest = 0, 3
    for n in range(len(wanted)):
        if wanted[n]:
            room += start[n + 1] - start[n] - 2
            longest = max(longest, start[n + 1] - start[n])
    corners, of = np.empty((room, 3), np.int64), np.empty(room, np.int64)
    previous, following, quality = np.empty(longest, np.int64), np.empty(longest, np.int64), np.empty(longest)
    opposite = np.empty(3 * longest, np.int64)
    made = 0
    for n in range(len(wanted)):
        if not wanted[n]:
            continue
        first, size = start[n], start[n + 1] - start[n]
        if size == 3:
            corners[made, 0], corners[made, 1], corners[made, 2] = points[first + 2], points[first], points[first + 1]
            of[made] = n
            made += 1
            continue
        own = flat[first : first + size]
        for m in range(size):
            previous[m], following[m] = m - 1 if m > 0 else size - 1, m + 1 if m < size - 1 else 0
        for m in range(size):
            quality[m] = _ear_quality(own, previous, following, m)
        at = 0
        for left in range(size, 2, -1):
            if left > 3:
                best = at
                m = following[at]
                while m != at:
                    if quality[m] > quality[best]:
                        best = m
                    m = following[m]
                at = best
            a, b = previous[at], following[at]
            corners[made, 0], corners[made, 1], corners[made, 2] = a, at, b
            of[made] = n
            made += 1
            following[a], previous[b] = b, a
            at = a
            if left > 4:
                quality[a] = _ear_quality(own, previous, following, a)
                quality[b] = _ear_quality(own, previous, following, b)
        _flip_diagonals(own, corners[made - size + 2 : made], opposite)
        for m in range(made - size + 2, made):
            for x in range(3):
                corners[m, x] = points[first + corners[m, x]]
    return corners, of


@njit(cache=True)
def _opposite_edges(corners, opposite):
    """For the edge after each corner of some triangles the opposite half-edge, -1 for none; written to `opposite`."""
    count = 3 * len(corners)
    opposite[:count] = -1
    if count > 3 * LINEAR_SEARCH:
        keys = np.empty(count, np.int64)
        base = corners.max() + 1
        for e in range(count):
            a, b = corners[e // 3, e % 3], corners[e // 3, (e % 3 + 1) % 3]
            keys[e] = min(a, b) * base + max(a, b)
        order = np.argsort(keys)
        for m in range(count - 1):
            e, f = order[m], order[m + 1]
            if keys[e] == keys[f]:
                opposite[e], opposite[f] = f, e
        return
    for e in range(count):
        if opposite[e] >= 0:
            continue
        a, b = corners[e // 3, e % 3], corners[e // 3, (e % 3 + 1) % 3]
        for f in range(e // 3 * 3 + 3, count):
            if corners[f // 3, f % 3] == b and corners[f // 3, (f % 3 + 1) % 3] == a:
                opposite[e], opposite[f] = f, e
                break


@njit(cache=True)
def _flip_diagonals(flat, corners, opposite):
    """Flip edges while that improves the worse of the two triangles (Lawson 1977, by shape): ears leave slivers where
    intersections are collinear. `opposite`: scratch, half-edges as in `_opposite_edges`."""
    count = len(corners)
    _opposite_edges(corners, opposite)
    left = FLIPS_PER_TRIANGLE * count
    changed = True
    while changed and left > 0:
        changed = False
        for e in range(3 * count):
            f = opposite[e]
            if f < e or left == 0:
                continue
            t, n, u, m = e // 3, e % 3, f // 3, f % 3
            a, b, c = corners[t, n], corners[t, (n + 1) % 3], corners[t, (n + 2) % 3]
            d = corners[u, (m + 2) % 3]
            worst = min(_triangle_quality(flat, a, b, c), _triangle_quality(flat, b, a, d))
            if min(_triangle_quality(flat, a, d, c), _triangle_quality(flat, d, b, c)) <= worst + 1e-9:
                continue
            # t keeps the edge c a, u the edge d b; the new diagonal is d c.
            bc, ca, ad, db = 3 * t + (n + 1) % 3, 3 * t + (n + 2) % 3, 3 * u + (m + 1) % 3, 3 * u + (m + 2) % 3
            outside = (opposite[ad], opposite[ca], opposite[db], opposite[bc])
            inside = (3 * t, 3 * t + 2, 3 * u, 3 * u + 1)
            corners[t, 0], corners[t, 1], corners[t, 2] = a, d, c
            corners[u, 0], corners[u, 1], corners[u, 2] = d, b, c
            for x in range(4):
                opposite[inside[x]] = outside[x]
                if outside[x] >= 0:
                    opposite[outside[x]] = inside[x]
            opposite[3 * t + 1], opposite[3 * u + 2] = 3 * u + 2, 3 * t + 1
            changed, left = True, left - 1


@njit(cache=True, inline="always")
def _triangle_quality(flat, a, b, c):
    """Quality of a triangle: 1 equilateral, 0 degenerate, negative if clockwise."""
    ux, uy, vx, vy = flat[b, 0] - flat[a, 0], flat[b, 1] - flat[a, 1], flat[c, 0] - flat[a, 0], flat[c, 1] - flat[a, 1]
    longest = ux * ux + uy * uy + vx * vx + vy * vy + (vx - ux) ** 2 + (vy - uy) ** 2
    return 2 * np.sqrt(3.0) * (ux * vy - uy * vx) / longest if longest > 0 else 0.0


@njit(cache=True)
def _ear_quality(flat, previous, following, at):
    """Quality of the ear at a point, less 2 if it is reflex, less 4 if it contains another point."""
    a, b = previous[at], following[at]
    ux, uy = flat[at, 0] - flat[a, 0], flat[at, 1] - flat[a, 1]
    vx, vy = flat[b, 0] - flat[at, 0], flat[b, 1] - flat[at, 1]
    wx, wy = flat[a, 0] - flat[b, 0], flat[a, 1] - flat[b, 1]
    shape = _triangle_quality(flat, a, at, b)
    if shape <= 0:
        return shape - 2.0
    n = following[b]
    while n != a:
        px, py = flat[n, 0], flat[n, 1]
        one = ux * (py - flat[a, 1]) - uy * (px - flat[a, 0])
        two = vx * (py - flat[at, 1]) - vy * (px - flat[at, 0])
        three = wx * (py - flat[b, 1]) - wy * (px - flat[b, 0])
        if one >= 0 and two >= 0 and three >= 0:
            return shape - 4.0
        n = following[n]
    return shape
