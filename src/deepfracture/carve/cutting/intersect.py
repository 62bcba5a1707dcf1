"""Where the crack mesh intersects the body's surface: vertices on edges, and the segments between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from deepfracture.carve.cutting.interfaces import CrackMesh
from deepfracture.carve.cutting.mesh_on_grid import MeshOnGrid
from deepfracture.carve.cutting.predicates import orient3d, orient3d_value
from deepfracture.geometry.hashing import empty_table, insert_pair
from deepfracture.runtime.parallel import parallel_for, parallel_invoke
from deepfracture.types import Floats, Ints, Labels

OUTSIDE, INSIDE = 1, 2
"""Sides of the body's surface, as labels."""

HEIGHT_ERROR = 1e-14
"""Relative rounding error of a height above a plane in floats, with a margin: some ten operations."""


class DegenerateIntersection(ArithmeticError):
    """Crack and surface are not in general position as far as rounding can tell; another jitter will do."""


@dataclass(frozen=True, eq=False)
class EdgeVertices:
    """The intersection vertices on some edges, edge by edge and in order from an edge's lower vertex to its higher
    one."""

    edges: Ints
    """Code of each edge with an intersection, ascending, shape (e,)."""
    start: Ints
    """The first intersection of each edge, and their number at the end, shape (e + 1,)."""
    vertices: Ints
    """Shape (n,)."""
    before: Ints
    """What the edge is in before each vertex: a cell for edges of the surface, OUTSIDE or INSIDE for those of the crack
    ..."""
    after: Ints
    """... and after it, shape (n,)."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Straight lines between intersection vertices, each in one triangle."""

    triangle: Ints
    """Shape (k,)."""
    tail: Ints
    head: Ints
    """Intersection vertices, shape (k,)."""
    left: Ints
    right: Ints
    """Labels on both sides, seen from where the triangle is counter-clockwise, shape (k,)."""


@dataclass(frozen=True, eq=False)
class Intersections:
    """The curves in which crack mesh and surface meet, as vertices and segments."""

    ends: Ints
    """The two vertices of the edge that each intersection lies on, shape (n, 2); of the surface or of the crack ..."""
    on_surface: np.ndarray
    """... as this says, shape (n,)."""
    t: Floats
    """Edge parameter of each intersection, from 0 at the first end to 1 at the second, shape (n,)."""
    mesh_segments: Segments
    """In the surface's faces, between cells."""
    crack_segments: Segments
    """In the crack's triangles, between OUTSIDE and INSIDE."""
    on_mesh_edges: EdgeVertices
    """On the surface's edges, by number."""
    on_crack_edges: EdgeVertices
    """On the crack's edges, by `edge_code`."""


@njit(cache=True, inline="always")
def edge_code(one: int, two: int, count: int) -> int:
    """One number for the edge between two of `count` vertices, whichever comes first."""
    return min(one, two) * count + max(one, two)


def edge_codes(triangles: Ints, count: int) -> Ints:
    """The code of the edge from each corner of triangles to the next, shape (t, 3)."""
    following = triangles[:, [1, 2, 0]]
    return np.minimum(triangles, following) * count + np.maximum(triangles, following)


class SurfaceMesh(NamedTuple):
    """The body's surface for kernels, fields as in `MeshOnGrid`."""

    points: Floats
    faces: Ints
    edges: Ints
    face_edges: Ints


class CrackTriangles(NamedTuple):
    """The crack mesh for kernels, fields as in `CrackMesh`."""

    points: Floats
    triangles: Ints
    cells: Labels
    quad_start: Ints
    quad_cubes: Ints


def intersect(on_grid: MeshOnGrid, crack: CrackMesh) -> Intersections:
    """All intersections of crack and surface. Raises DegenerateIntersection if they cannot be decided."""
    surface = SurfaceMesh(on_grid.points, on_grid.faces, on_grid.edges, on_grid.face_edges)
    mesh = CrackTriangles(crack.points, crack.triangles, crack.cells, crack.quad_start, crack.quad_cubes)
    by_cube = _faces_by_cube(crack.cube_index, len(crack.cubes), on_grid.cubes, on_grid.cube_faces)
    found = parallel_for(
        lambda first, last: _intersect_quads(surface, mesh, *by_cube, first, last),
        len(crack.quad_cubes), least=256, uneven=True,
    )  # fmt: skip
    if any(failed for failed, _ in found):
        raise DegenerateIntersection
    segments = np.concatenate([part for _, part in found])
    vertex, vertices = _unique_vertices(segments)
    ends, t, sides = (
        np.empty((len(vertices), 2), np.int64),
        np.empty(len(vertices)),
        np.empty((len(vertices), 2), np.int64),
    )
    parallel_for(
        lambda first, last: _place_vertices(surface, mesh, vertices, ends, t, sides, first, last),
        len(vertices), least=1024,
    )  # fmt: skip
    on_surface = vertices[:, 0] < 0
    # The cell below the crack is on a segment's left seen from outside the body, and the outside is on its left seen
    # from above the crack.
    tail, head, (face, triangle) = vertex[::2], vertex[1::2], segments[:, :2].T
    below, above = crack.cells[triangle].astype(np.int64).T
    return Intersections(
        ends, on_surface, t,
        Segments(face, tail, head, below, above),
        Segments(triangle, tail, head, np.full_like(below, OUTSIDE), np.full_like(below, INSIDE)),
        *parallel_invoke(
            lambda: _edge_vertices(np.flatnonzero(on_surface), ~vertices[on_surface, 0], t, sides),
            lambda: _edge_vertices(np.flatnonzero(~on_surface), vertices[~on_surface, 0], t, sides),
        ),
    )  # fmt: skip


def _edge_vertices(vertices: Ints, codes: Ints, t: Floats, sides: Ints) -> EdgeVertices:
    order = np.argsort(codes)
    vertices = vertices[order]
    failed, edges, start = _sort_along_edges(vertices, codes[order], t, sides)
    if failed:
        raise DegenerateIntersection
    return EdgeVertices(edges, start, vertices, sides[vertices, 0], sides[vertices, 1])


@njit(cache=True, nogil=True)
def _sort_along_edges(vertices, codes, t, sides):
    """Sort the vertices of each edge by their parameters. Returns whether what lies between two of them has two labels;
    the edges; and where the vertices of each start."""
    edges, start = np.empty(len(codes), np.int64), np.zeros(len(codes) + 1, np.int64)
    count = 0
    for n in range(len(codes)):
        if n == 0 or codes[n] != codes[n - 1]:
            edges[count], start[count] = codes[n], n
            count += 1
        vertex, m = vertices[n], n
        while m > start[count - 1] and (t[vertices[m - 1]], vertices[m - 1]) > (t[vertex], vertex):
            vertices[m] = vertices[m - 1]
            m -= 1
        vertices[m] = vertex
    start[count] = len(codes)
    failed = False
    for n in range(1, len(codes)):
        if codes[n] == codes[n - 1]:
            failed |= sides[vertices[n - 1], 1] != sides[vertices[n], 0]
    return failed, edges[:count].copy(), start[: count + 1].copy()


@njit(cache=True, nogil=True)
def _unique_vertices(segments):
    """The vertex at the tail and at the head of each segment, shape (2 k,); the edge (of the surface: ~number, of the
    crack: code) and the triangle of the other mesh that meet in each vertex, shape (n, 2)."""
    count = 2 * len(segments)
    table, vertex, vertices = empty_table(count), np.empty(count, np.int64), np.empty((count, 2), np.int64)
    made = 0
    for e in range(count):
        vertices[made, 0], vertices[made, 1] = segments[e // 2, 2 + 2 * (e % 2)], segments[e // 2, 3 + 2 * (e % 2)]
        vertex[e] = insert_pair(table, vertices, made)
        made += vertex[e] == made
    return vertex, vertices[:made].copy()


@njit(cache=True, nogil=True)
def _faces_by_cube(number, count, cubes, cube_faces):
    """The faces that touch each of the crack's cubes: where those of each cube start, and the faces."""
    start = np.zeros(count + 1, np.int64)
    hits = np.empty((len(cubes), 2), np.int32)  # where it is not written to it costs nothing
    found = 0
    for p in range(len(cubes)):
        n = number[cubes[p]]
        if n > 0:
            hits[found, 0], hits[found, 1] = n - 1, p
            found += 1
            start[n] += 1
    for n in range(count):
        start[n + 1] += start[n]
    place, faces = start[:-1].copy(), np.empty(found, np.int64)
    for h in range(found):
        n = hits[h, 0]
        faces[place[n]] = cube_faces[hits[h, 1]]
        place[n] += 1
    return start, faces


@njit(cache=True, nogil=True)
def _intersect_quads(surface, crack, start, faces, from_quad, to_quad):
    """Whether rounding hides an intersection; and the segments in which faces meet some quadrilaterals of the crack, as
    rows of (face, triangle, edge and triangle of the tail, edge and triangle of the head).

    A triangle lies in the four cubes around its grid edge, so only `faces` of these cubes are tested: box against box,
    triangle against plane both ways, then `_intersect_triangles`. Planes 0 to 3 are those of the quadrilateral's
    triangles, 4 is that of the face."""
    points, triangles = surface.points, crack.triangles
    segments = np.empty((256, 6), np.int64)
    count = 0
    seen = np.full(len(surface.faces), -1, np.int64)
    row = np.empty(6, np.int64)
    s, c, box, planes = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3)), np.empty((5, 9))
    for quad in range(from_quad, to_quad):
        first, last = crack.quad_start[quad], crack.quad_start[quad + 1]
        prepared = False
        for corner in range(4):
            cube = crack.quad_cubes[quad, corner]
            for face in faces[start[cube] : start[cube + 1]]:
                if seen[face] == quad:
                    continue
                seen[face] = quad
                if not prepared:
                    _bounding_box(crack.points, triangles, first, last, box)
                    _planes(crack.points, triangles, first, last, planes)
                    prepared = True
                if _boxes_disjoint(points, surface.faces, face, box):
                    continue
                _planes(points, surface.faces, face, face + 1, planes[4:])
                _copy_triangle(points, surface.faces, face, s)
                for triangle in range(first, last):
                    if _on_one_side(crack.points, triangles, triangle, planes, 4):
                        continue
                    if _on_one_side(points, surface.faces, face, planes, triangle - first):
                        continue
                    _copy_triangle(crack.points, triangles, triangle, c)
                    found = _intersect_triangles(s, c, planes, triangle - first, row)
                    if found < 0:
                        return True, segments[:0]
                    if found == 0:
                        continue
                    _write_ids(row, face, triangle, surface.face_edges, triangles, len(crack.points))
                    if count == len(segments):
                        segments = np.concatenate((segments, np.empty_like(segments)))
                    segments[count] = row
                    count += 1
    return False, segments[:count].copy()


@njit(cache=True, inline="always")
def _write_ids(row, face, triangle, face_edges, triangles, count):
    """Replace the local numbers in a row of `_intersect_triangles` by those of edges and triangles."""
    row[0], row[1] = face, triangle
    for end in (2, 4):
        n = row[end + 1]
        if row[end] == 0:
            row[end], row[end + 1] = ~face_edges[face, n], triangle
        else:
            row[end], row[end + 1] = edge_code(triangles[triangle, n], triangles[triangle, (n + 1) % 3], count), face


@njit(cache=True)
def _planes(points, triangles, first, last, planes):
    """A corner, the normal, and a bound on the normal's rounding error, of some triangles."""
    for t in range(first, last):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            one = (points[b, y] - points[a, y]) * (points[c, z] - points[a, z])
            two = (points[b, z] - points[a, z]) * (points[c, y] - points[a, y])
            planes[t - first, x], planes[t - first, 3 + x] = points[a, x], one - two
            planes[t - first, 6 + x] = HEIGHT_ERROR * (abs(one) + abs(two))


@njit(cache=True, inline="always")
def _on_one_side(points, faces, face, planes, row):
    """Whether a triangle certainly lies on one side of a plane."""
    above, below = 0, 0
    for n in range(3):
        v = faces[face, n]
        where = _plane_side(planes, row, points[v, 0], points[v, 1], points[v, 2])
        above += where > 0
        below += where < 0
    return above == 3 or below == 3


@njit(cache=True, inline="always")
def _plane_side(planes, row, x, y, z):
    """1 above a plane, -1 below it, 0 if undecided (a floating-point filter)."""
    x, y, z = x - planes[row, 0], y - planes[row, 1], z - planes[row, 2]
    height = x * planes[row, 3] + y * planes[row, 4] + z * planes[row, 5]
    doubt = abs(x) * planes[row, 6] + abs(y) * planes[row, 7] + abs(z) * planes[row, 8]
    return (1 if height > doubt else 0) - (1 if height < -doubt else 0)


@njit(cache=True, inline="always")
def _bounding_box(points, triangles, first, last, box):
    """Lowest and highest coordinates of some triangles."""
    for x in range(3):
        box[0, x], box[1, x] = np.inf, -np.inf
    for t in range(first, last):
        for n in range(3):
            for x in range(3):
                value = points[triangles[t, n], x]
                box[0, x], box[1, x] = min(box[0, x], value), max(box[1, x], value)


@njit(cache=True, inline="always")
def _boxes_disjoint(points, triangles, t, box):
    """Whether a triangle's box is disjoint from another."""
    for x in range(3):
        one, two, three = points[triangles[t, 0], x], points[triangles[t, 1], x], points[triangles[t, 2], x]
        if max(one, two, three) < box[0, x] or min(one, two, three) > box[1, x]:
            return True
    return False


@njit(cache=True, inline="always")
def _copy_triangle(points, triangles, t, out):
    for n in range(3):
        for x in range(3):
            out[n, x] = points[triangles[t, n], x]


@njit(cache=True)
def _intersect_triangles(s, c, planes, plane, row):
    """Whether a face s and a crack triangle c meet: 1, 0 if not, -1 if rounding hides it. If they do, row[2:4] and
    row[4:6] are tail and head of the segment: 0 and an edge of the face, or 1 and an edge of the triangle.

    `planes`: that of c in the row `plane`, that of s in row 4."""
    s0, s1, s2 = (
        _vertex_side(c, planes, plane, s, 0),
        _vertex_side(c, planes, plane, s, 1),
        _vertex_side(c, planes, plane, s, 2),
    )
    if s0 == s1 == s2:
        return 0 if s0 != 0 else -1
    if s0 * s1 * s2 == 0:
        return -1
    c0, c1, c2 = _vertex_side(s, planes, 4, c, 0), _vertex_side(s, planes, 4, c, 1), _vertex_side(s, planes, 4, c, 2)
    # A face without area has no sides: only its edges can hit the triangle.
    flat = c0 == 0 and c1 == 0 and c2 == 0
    if not flat:
        if c0 * c1 * c2 == 0:
            return -1
        if c0 == c1 == c2:
            return 0
    # A segment starts where an edge of the face leaves the space below the crack, or where an edge of the triangle
    # leaves the outside, so that these are on its left.
    tails, heads = 0, 0
    if flat:
        for i in range(3):
            here, there = (s0, s1) if i == 0 else ((s1, s2) if i == 1 else (s2, s0))
            hit = 0 if here == there else _edge_hits_triangle(s, i, c)
            if hit < 0:
                return -1
            if hit:
                at = 2 if here < 0 else 4
                tails, heads = tails + (at == 2), heads + (at == 4)
                row[at], row[at + 1] = 0, i
        return 0 if tails + heads == 0 else (1 if tails == 1 and heads == 1 else -1)
    # Each triangle crosses the plane of the other with the two edges at one corner, and so covers an interval of the
    # line common to both planes. The orientation of each pair of these edges orders the ends of the two intervals, and
    # so tells how they overlap, without constructing a point (Guigue and Devillers 2003).
    k, m = _odd_one_out(s0, s1, s2), _odd_one_out(c0, c1, c2)
    edges = ((k + 2) % 3, k), ((m + 2) % 3, m)
    line_sides = (
        (_line_side(s, edges[0][0], c, edges[1][0]), _line_side(s, edges[0][0], c, edges[1][1])),
        (_line_side(s, edges[0][1], c, edges[1][0]), _line_side(s, edges[0][1], c, edges[1][1])),
    )
    if line_sides[0][0] == 0 or line_sides[0][1] == 0 or line_sides[1][0] == 0 or line_sides[1][1] == 0:
        return -1
    for n in range(2):
        i = edges[0][n]
        if line_sides[n][0] == line_sides[n][1]:
            at = 2 if (s0 if i == 0 else (s1 if i == 1 else s2)) < 0 else 4
            tails, heads = tails + (at == 2), heads + (at == 4)
            row[at], row[at + 1] = 0, i
        i = edges[1][n]
        if line_sides[0][n] == line_sides[1][n]:
            at = 2 if (c0 if i == 0 else (c1 if i == 1 else c2)) > 0 else 4
            tails, heads = tails + (at == 2), heads + (at == 4)
            row[at], row[at + 1] = 1, i
    if tails + heads == 0:
        return 0
    return 1 if tails == 1 and heads == 1 else -1


@njit(cache=True, inline="always")
def _odd_one_out(a, b, c):
    """Which of three corners lies on another side than the two others."""
    return 2 if a == b else (0 if b == c else 1)


@njit(cache=True)
def _line_side(one, i, two, n):
    """On which side the line along edge i of a triangle passes that along edge n of another."""
    j, m = (i + 1) % 3, (n + 1) % 3
    return orient3d(
        one[i, 0], one[i, 1], one[i, 2], one[j, 0], one[j, 1], one[j, 2],
        two[n, 0], two[n, 1], two[n, 2], two[m, 0], two[m, 1], two[m, 2],
    )  # fmt: skip


@njit(cache=True, inline="always")
def _vertex_side(t, planes, row, other, n):
    """`side_of_triangle` for a corner of another triangle, by the plane of t where that decides it."""
    where = _plane_side(planes, row, other[n, 0], other[n, 1], other[n, 2])
    if where != 0:
        return where
    return orient3d(
        t[0, 0], t[0, 1], t[0, 2], t[1, 0], t[1, 1], t[1, 2], t[2, 0], t[2, 1], t[2, 2],
        other[n, 0], other[n, 1], other[n, 2],
    )  # fmt: skip


@njit(cache=True)
def _edge_hits_triangle(one, i, two):
    """`line_hits_triangle` for edge i of a triangle."""
    first, second, third = _line_side(one, i, two, 0), _line_side(one, i, two, 1), _line_side(one, i, two, 2)
    if first == 0 or second == 0 or third == 0:
        return -1
    return 1 if first == second == third else 0


@njit(cache=True, inline="always")
def side_of_triangle(t, p):
    """Sign of the side of a triangle (3, 3) on which a point lies (`orient3d`)."""
    return orient3d(t[0, 0], t[0, 1], t[0, 2], t[1, 0], t[1, 1], t[1, 2], t[2, 0], t[2, 1], t[2, 2], p[0], p[1], p[2])


@njit(cache=True)
def line_hits_triangle(a, b, t):
    """Whether the line through a and b passes through a triangle: 1, 0, or -1 if through its boundary."""
    first = 0
    for n in range(3):
        m = (n + 1) % 3
        sign = orient3d(
            a[0], a[1], a[2], b[0], b[1], b[2], t[n, 0], t[n, 1], t[n, 2], t[m, 0], t[m, 1], t[m, 2]
        )  # fmt: skip
        if sign == 0:
            return -1
        if n == 0:
            first = sign
        elif sign != first:
            return 0
    return 1


@njit(cache=True, nogil=True)
def _place_vertices(surface, crack, vertices, ends, t, sides, first, last):
    """Of some intersection vertices: the ends of their edges, the parameters along them, and what the edge is in before
    and after each vertex."""
    corners = np.empty((3, 3))
    for n in range(first, last):
        edge, triangle = vertices[n]
        if edge < 0:
            ends[n, 0], ends[n, 1] = surface.edges[~edge, 0], surface.edges[~edge, 1]
            _copy_triangle(crack.points, crack.triangles, triangle, corners)
            one = _signed_volume(corners, surface.points[ends[n, 0]])
            two = _signed_volume(corners, surface.points[ends[n, 1]])
            sides[n, 0], sides[n, 1] = crack.cells[triangle, 0], crack.cells[triangle, 1]
        else:
            ends[n, 0], ends[n, 1] = edge // len(crack.points), edge % len(crack.points)
            _copy_triangle(surface.points, surface.faces, triangle, corners)
            one = _signed_volume(corners, crack.points[ends[n, 0]])
            two = _signed_volume(corners, crack.points[ends[n, 1]])
            sides[n, 0], sides[n, 1] = INSIDE, OUTSIDE
        if one >= 0:
            sides[n, 0], sides[n, 1] = sides[n, 1], sides[n, 0]
        t[n] = one / (one - two)


@njit(cache=True, inline="always")
def _signed_volume(t, p):
    return orient3d_value(
        t[0, 0], t[0, 1], t[0, 2], t[1, 0], t[1, 1], t[1, 2], t[2, 0], t[2, 1], t[2, 2], p[0], p[1], p[2]
    )
