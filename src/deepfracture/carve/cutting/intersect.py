"""Where crack sheets cross the body's surface: points on edges, and the segments between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.carve.cutting.interfaces import Sheets
from deepfracture.carve.cutting.mesh_on_grid import Ground
from deepfracture.carve.cutting.predicates import side, volume
from deepfracture.geometry.hashing import empty_table, insert_pair
from deepfracture.runtime.parallel import parallel_for, parallel_invoke
from deepfracture.types import Floats, Ints

OUTSIDE, INSIDE = 1, 2
"""Sides of the body's surface, as labels."""


SURE = 1e-14
"""Relative rounding of a height above a plane in floats, with room to spare: some ten operations."""


class NotGeneral(ArithmeticError):
    """Crack and surface are not in general position as far as rounding can tell; other jitter will do."""


@dataclass(frozen=True, eq=False)
class EdgeNodes:
    """The nodes on some edges, edge by edge and in order from an edge's lower vertex to its higher one."""

    edges: Ints
    """Code of each edge with a node, ascending, shape (e,)."""
    start: Ints
    """The first node of each edge, and their number at the end, shape (e + 1,)."""
    nodes: Ints
    """Shape (n,)."""
    before: Ints
    """What the edge is in before each node: a cell for the surface's edges, OUTSIDE or INSIDE for the sheets' ..."""
    after: Ints
    """... and after it, shape (n,)."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Straight lines from node to node, each in one triangle."""

    triangle: Ints
    """Shape (k,)."""
    tail: Ints
    head: Ints
    """Nodes, shape (k,)."""
    left: Ints
    right: Ints
    """Labels on both sides, seen from where the triangle turns to the left, shape (k,)."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """The curves in which sheets and surface meet, from node to node."""

    ends: Ints
    """The two vertices of the edge that each node lies on, shape (n, 2); of the surface or of the sheets ..."""
    on_surface: np.ndarray
    """... as this says, shape (n,)."""
    share: Floats
    """Of the way from the first to the second, shape (n,)."""
    on_faces: Segments
    """In the surface's faces, between cells."""
    on_sheets: Segments
    """In the sheets' triangles, between OUTSIDE and INSIDE."""
    surface_nodes: EdgeNodes
    """On the surface's edges, by number."""
    sheet_nodes: EdgeNodes
    """On the sheets' edges, by `edge_code`."""


@njit(cache=True, inline="always")
def edge_code(one: int, two: int, count: int) -> int:
    """One number for the edge between two of `count` vertices, whichever comes first."""
    return min(one, two) * count + max(one, two)


def edge_codes(triangles: Ints, count: int) -> Ints:
    """The code of the edge from each corner of triangles to the next, shape (t, 3)."""
    following = triangles[:, [1, 2, 0]]
    return np.minimum(triangles, following) * count + np.maximum(triangles, following)


def cross(ground: Ground, sheets: Sheets) -> Crossing:
    """All crossings of sheets and surface. Raises NotGeneral if they cannot be told exactly."""
    start, members = _members(sheets.number, len(sheets.cubes), ground.cubes, ground.touching)
    found = parallel_for(
        lambda first, last: _segments(
            ground.points, ground.faces, ground.edge_of, sheets.points, sheets.triangles, sheets.quads, sheets.around,
            start, members, first, last,
        ),
        len(sheets.around), least=256, uneven=True,
    )  # fmt: skip
    if any(failed for failed, _ in found):
        raise NotGeneral
    segments = np.concatenate([part for _, part in found])
    node, nodes = _nodes(segments)
    ends, share, sides = np.empty((len(nodes), 2), np.int64), np.empty(len(nodes)), np.empty((len(nodes), 2), np.int64)
    parallel_for(
        lambda first, last: _placed(
            ground.points, ground.faces, ground.edges, sheets.points, sheets.triangles, sheets.sides, nodes,
            ends, share, sides, first, last,
        ),
        len(nodes), least=1024,
    )  # fmt: skip
    on_surface = nodes[:, 0] < 0
    # Where a segment runs, the cell below the sheet is on its left seen from outside the body, and the outside is
    # on its left seen from above the sheet.
    tail, head, (face, triangle) = node[::2], node[1::2], segments[:, :2].T
    below, above = sheets.sides[triangle].astype(np.int64).T
    return Crossing(
        ends, on_surface, share,
        Segments(face, tail, head, below, above),
        Segments(triangle, tail, head, np.full_like(below, OUTSIDE), np.full_like(below, INSIDE)),
        *parallel_invoke(
            lambda: _along(np.flatnonzero(on_surface), ~nodes[on_surface, 0], share, sides),
            lambda: _along(np.flatnonzero(~on_surface), nodes[~on_surface, 0], share, sides),
        ),
    )  # fmt: skip


def _along(nodes: Ints, codes: Ints, share: Floats, sides: Ints) -> EdgeNodes:
    order = np.argsort(codes)
    nodes = nodes[order]
    failed, edges, start = _runs(nodes, codes[order], share, sides)
    if failed:
        raise NotGeneral
    return EdgeNodes(edges, start, nodes, sides[nodes, 0], sides[nodes, 1])


@njit(cache=True, nogil=True)
def _runs(nodes, codes, share, sides):
    """Puts the nodes of each code into the order of their shares. Whether what lies between two of them has two names;
    the codes; and where the nodes of each start."""
    edges, start = np.empty(len(codes), np.int64), np.zeros(len(codes) + 1, np.int64)
    count = 0
    for n in range(len(codes)):
        if n == 0 or codes[n] != codes[n - 1]:
            edges[count], start[count] = codes[n], n
            count += 1
        node, m = nodes[n], n
        while m > start[count - 1] and (share[nodes[m - 1]], nodes[m - 1]) > (share[node], node):
            nodes[m] = nodes[m - 1]
            m -= 1
        nodes[m] = node
    start[count] = len(codes)
    failed = False
    for n in range(1, len(codes)):
        if codes[n] == codes[n - 1]:
            failed |= sides[nodes[n - 1], 1] != sides[nodes[n], 0]
    return failed, edges[:count].copy(), start[: count + 1].copy()


@njit(cache=True, nogil=True)
def _nodes(segments):
    """The node at the tail and at the head of each segment, shape (2 k,); the edge (of the surface: ~number, of the
    sheets: code) and the triangle of the other in which each node lies, shape (n, 2)."""
    count = 2 * len(segments)
    table, node, nodes = empty_table(count), np.empty(count, np.int64), np.empty((count, 2), np.int64)
    made = 0
    for e in range(count):
        nodes[made, 0], nodes[made, 1] = segments[e // 2, 2 + 2 * (e % 2)], segments[e // 2, 3 + 2 * (e % 2)]
        node[e] = insert_pair(table, nodes, made)
        made += node[e] == made
    return node, nodes[:made].copy()


@njit(cache=True, nogil=True)
def _members(number, count, touched, touching):
    """The faces that touch each of the sheets' cubes: where they start, and they."""
    start = np.zeros(count + 1, np.int64)
    hits = np.empty((len(touched), 2), np.int32)  # where it is not written to it costs nothing
    found = 0
    for p in range(len(touched)):
        n = number[touched[p]]
        if n > 0:
            hits[found, 0], hits[found, 1] = n - 1, p
            found += 1
            start[n] += 1
    for n in range(count):
        start[n + 1] += start[n]
    place, members = start[:-1].copy(), np.empty(found, np.int64)
    for h in range(found):
        n = hits[h, 0]
        members[place[n]] = touching[hits[h, 1]]
        place[n] += 1
    return start, members


@njit(cache=True, nogil=True)
def _segments(points, faces, edge_of, sheet_points, triangles, quads, around, start, members, from_quad, to_quad):
    """Rows of (face, triangle, edge and triangle of the tail, edge and triangle of the head)."""
    segments = np.empty((256, 6), np.int64)
    count = 0
    seen = np.full(len(faces), -1, np.int64)
    row = np.empty(6, np.int64)
    s, c, box, planes = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3)), np.empty((5, 9))
    for quad in range(from_quad, to_quad):
        first, last = quads[quad], quads[quad + 1]
        known = False
        for corner in range(4):
            cube = around[quad, corner]
            for m in range(start[cube], start[cube + 1]):
                face = members[m]
                if seen[face] == quad:
                    continue
                seen[face] = quad
                if not known:
                    _bound(sheet_points, triangles, first, last, box)
                    _planes(sheet_points, triangles, first, last, planes)
                    known = True
                if _apart(points, faces, face, box):
                    continue
                _planes(points, faces, face, face + 1, planes[4:])
                copied = False
                for triangle in range(first, last):
                    if _on_one_side(sheet_points, triangles, triangle, planes, 4):
                        continue
                    if _on_one_side(points, faces, face, planes, triangle - first):
                        continue
                    if not copied:
                        _copy(points, faces, face, s)
                        copied = True
                    _copy(sheet_points, triangles, triangle, c)
                    found = _segment(s, c, planes, triangle - first, row)
                    if found < 0:
                        return True, segments[:0]
                    if found == 0:
                        continue
                    _name(row, face, triangle, edge_of, triangles, len(sheet_points))
                    if count == len(segments):
                        segments = np.concatenate((segments, np.empty_like(segments)))
                    segments[count] = row
                    count += 1
    return False, segments[:count].copy()


@njit(cache=True, inline="always")
def _name(row, face, triangle, edge_of, triangles, count):
    """Put the names of edges and triangles into a row from `_segment`."""
    row[0], row[1] = face, triangle
    for end in (2, 4):
        n = row[end + 1]
        if row[end] == 0:
            row[end], row[end + 1] = ~edge_of[face, n], triangle
        else:
            row[end], row[end + 1] = edge_code(triangles[triangle, n], triangles[triangle, (n + 1) % 3], count), face


@njit(cache=True)
def _planes(points, triangles, first, last, planes):
    """A corner, the normal, and what bounds the normal's rounding, of some triangles."""
    for t in range(first, last):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            one = (points[b, y] - points[a, y]) * (points[c, z] - points[a, z])
            two = (points[b, z] - points[a, z]) * (points[c, y] - points[a, y])
            planes[t - first, x], planes[t - first, 3 + x] = points[a, x], one - two
            planes[t - first, 6 + x] = SURE * (abs(one) + abs(two))


@njit(cache=True, inline="always")
def _on_one_side(points, faces, face, planes, row):
    """Whether a triangle lies on one side of a plane beyond doubt."""
    above, below = 0, 0
    for n in range(3):
        v = faces[face, n]
        where = _height(planes, row, points[v, 0], points[v, 1], points[v, 2])
        above += where > 0
        below += where < 0
    return above == 3 or below == 3


@njit(cache=True, inline="always")
def _height(planes, row, x, y, z):
    """1 above a plane, -1 below it, 0 in doubt."""
    x, y, z = x - planes[row, 0], y - planes[row, 1], z - planes[row, 2]
    height = x * planes[row, 3] + y * planes[row, 4] + z * planes[row, 5]
    doubt = abs(x) * planes[row, 6] + abs(y) * planes[row, 7] + abs(z) * planes[row, 8]
    return (1 if height > doubt else 0) - (1 if height < -doubt else 0)


@njit(cache=True, inline="always")
def _bound(points, triangles, first, last, box):
    for x in range(3):
        box[0, x], box[1, x] = np.inf, -np.inf
    for t in range(first, last):
        for n in range(3):
            for x in range(3):
                value = points[triangles[t, n], x]
                box[0, x], box[1, x] = min(box[0, x], value), max(box[1, x], value)


@njit(cache=True, inline="always")
def _apart(points, triangles, t, box):
    """Whether a triangle's box lies beside another."""
    for x in range(3):
        one, two, three = points[triangles[t, 0], x], points[triangles[t, 1], x], points[triangles[t, 2], x]
        if max(one, two, three) < box[0, x] or min(one, two, three) > box[1, x]:
            return True
    return False


@njit(cache=True, inline="always")
def _copy(points, triangles, t, out):
    for n in range(3):
        for x in range(3):
            out[n, x] = points[triangles[t, n], x]


@njit(cache=True)
def _segment(s, c, planes, plane, row):
    """Where a face s and a sheet's triangle c meet: 1, 0 if they do not, -1 if rounding hides it. If they do, row[2:4]
    and row[4:6] are tail and head: 0 and the side of the face, or 1 and the side of the triangle.

    `planes`: that of c in the row `plane`, that of s in row 4."""
    s0, s1, s2 = (
        _corner_side(c, planes, plane, s, 0),
        _corner_side(c, planes, plane, s, 1),
        _corner_side(c, planes, plane, s, 2),
    )
    if s0 == s1 == s2:
        return 0 if s0 != 0 else -1
    if s0 * s1 * s2 == 0:
        return -1
    c0, c1, c2 = _corner_side(s, planes, 4, c, 0), _corner_side(s, planes, 4, c, 1), _corner_side(s, planes, 4, c, 2)
    # A face without area has no sides: only its edges are pierced.
    flat = c0 == 0 and c1 == 0 and c2 == 0
    if not flat:
        if c0 * c1 * c2 == 0:
            return -1
        if c0 == c1 == c2:
            return 0
    # Seen from its start a segment has the side of a face's corner before it on its left, and so what is below the
    # sheet; or the side of a triangle's corner, and so the outside.
    tails, heads = 0, 0
    if flat:
        for i in range(3):
            here, there = (s0, s1) if i == 0 else ((s1, s2) if i == 1 else (s2, s0))
            hit = 0 if here == there else _side_pierces(s, i, c)
            if hit < 0:
                return -1
            if hit:
                at = 2 if here < 0 else 4
                tails, heads = tails + (at == 2), heads + (at == 4)
                row[at], row[at + 1] = 0, i
        return 0 if tails + heads == 0 else (1 if tails == 1 and heads == 1 else -1)
    # Each lies across the plane of the other with the sides to and from one corner: where these pass each other tells
    # how the parts of the common line that are in the one and in the other overlap (Guigue and Devillers 2003).
    k, m = _odd(s0, s1, s2), _odd(c0, c1, c2)
    sides = ((k + 2) % 3, k), ((m + 2) % 3, m)
    turns = (
        (_turn(s, sides[0][0], c, sides[1][0]), _turn(s, sides[0][0], c, sides[1][1])),
        (_turn(s, sides[0][1], c, sides[1][0]), _turn(s, sides[0][1], c, sides[1][1])),
    )
    if turns[0][0] == 0 or turns[0][1] == 0 or turns[1][0] == 0 or turns[1][1] == 0:
        return -1
    for n in range(2):
        i = sides[0][n]
        if turns[n][0] == turns[n][1]:
            at = 2 if (s0 if i == 0 else (s1 if i == 1 else s2)) < 0 else 4
            tails, heads = tails + (at == 2), heads + (at == 4)
            row[at], row[at + 1] = 0, i
        i = sides[1][n]
        if turns[0][n] == turns[1][n]:
            at = 2 if (c0 if i == 0 else (c1 if i == 1 else c2)) > 0 else 4
            tails, heads = tails + (at == 2), heads + (at == 4)
            row[at], row[at + 1] = 1, i
    if tails + heads == 0:
        return 0
    return 1 if tails == 1 and heads == 1 else -1


@njit(cache=True, inline="always")
def _odd(a, b, c):
    """Which of three corners lies on another side than the two others."""
    return 2 if a == b else (0 if b == c else 1)


@njit(cache=True)
def _turn(one, i, two, n):
    """On which side the line from corner i of a triangle to the next passes the one from corner n of another."""
    j, m = (i + 1) % 3, (n + 1) % 3
    return side(
        one[i, 0], one[i, 1], one[i, 2], one[j, 0], one[j, 1], one[j, 2],
        two[n, 0], two[n, 1], two[n, 2], two[m, 0], two[m, 1], two[m, 2],
    )  # fmt: skip


@njit(cache=True, inline="always")
def _corner_side(t, planes, row, other, n):
    """`over` for a corner of another triangle, by the plane of t where that is beyond doubt."""
    where = _height(planes, row, other[n, 0], other[n, 1], other[n, 2])
    if where != 0:
        return where
    return side(
        t[0, 0], t[0, 1], t[0, 2], t[1, 0], t[1, 1], t[1, 2], t[2, 0], t[2, 1], t[2, 2],
        other[n, 0], other[n, 1], other[n, 2],
    )  # fmt: skip


@njit(cache=True)
def _side_pierces(one, i, two):
    """`pierces` for the side of a triangle from its corner i to the next."""
    first, second, third = _turn(one, i, two, 0), _turn(one, i, two, 1), _turn(one, i, two, 2)
    if first == 0 or second == 0 or third == 0:
        return -1
    return 1 if first == second == third else 0


@njit(cache=True, inline="always")
def over(t, p):
    """Sign of the side of a triangle (3, 3) on which a point lies."""
    return side(t[0, 0], t[0, 1], t[0, 2], t[1, 0], t[1, 1], t[1, 2], t[2, 0], t[2, 1], t[2, 2], p[0], p[1], p[2])


@njit(cache=True)
def pierces(a, b, t):
    """Whether the line through a and b passes through a triangle: 1, 0, or -1 if through its rim."""
    first = 0
    for n in range(3):
        m = (n + 1) % 3
        turn = side(
            a[0], a[1], a[2], b[0], b[1], b[2], t[n, 0], t[n, 1], t[n, 2], t[m, 0], t[m, 1], t[m, 2]
        )  # fmt: skip
        if turn == 0:
            return -1
        if n == 0:
            first = turn
        elif turn != first:
            return 0
    return 1


@njit(cache=True, nogil=True)
def _placed(points, faces, edges, sheet_points, triangles, sides, nodes, ends, share, beside, first, last):
    """Of some nodes: the ends of their edges, how far along they lie, and what the edge is in before and after it."""
    t = np.empty((3, 3))
    for n in range(first, last):
        edge, triangle = nodes[n]
        if edge < 0:
            ends[n, 0], ends[n, 1] = edges[~edge, 0], edges[~edge, 1]
            _copy(sheet_points, triangles, triangle, t)
            one, two = _volume(t, points[ends[n, 0]]), _volume(t, points[ends[n, 1]])
            beside[n, 0], beside[n, 1] = sides[triangle, 0], sides[triangle, 1]
        else:
            ends[n, 0], ends[n, 1] = edge // len(sheet_points), edge % len(sheet_points)
            _copy(points, faces, triangle, t)
            one, two = _volume(t, sheet_points[ends[n, 0]]), _volume(t, sheet_points[ends[n, 1]])
            beside[n, 0], beside[n, 1] = INSIDE, OUTSIDE
        if one >= 0:
            beside[n, 0], beside[n, 1] = beside[n, 1], beside[n, 0]
        share[n] = one / (one - two)


@njit(cache=True, inline="always")
def _volume(t, p):
    return volume(t[0, 0], t[0, 1], t[0, 2], t[1, 0], t[1, 1], t[1, 2], t[2, 0], t[2, 1], t[2, 2], p[0], p[1], p[2])
