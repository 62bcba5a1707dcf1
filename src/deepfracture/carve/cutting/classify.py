"""Which cell each vertex of the surface lies in, and which vertices of the crack mesh lie inside the body."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from deepfracture.carve.cutting.interfaces import CrackMesh
from deepfracture.carve.cutting.intersect import (
    INSIDE,
    OUTSIDE,
    DegenerateIntersection,
    EdgeVertices,
    Intersections,
    edge_code,
    line_hits_triangle,
    side_of_triangle,
)
from deepfracture.carve.cutting.mesh_on_grid import MeshOnGrid
from deepfracture.geometry.disjoint_sets import flatten, union
from deepfracture.geometry.hashing import lookup, table_of
from deepfracture.types import Floats, Ints, Labels

CORNERS = np.array([[n >> 2, n >> 1 & 1, n & 1] for n in range(8)])


def surface_cells(on_grid: MeshOnGrid, crack: CrackMesh, intersections: Intersections, labels: Labels) -> Ints:
    """The cell of each vertex of the surface, shape (n,).

    Known where the crack mesh intersects edges, and constant along all other edges. A shell that no crack intersects
    lies in one cell: that of a corner of one of its cubes, as seen from the surface.

    Raises DegenerateIntersection if intersections contradict each other."""
    vertices = intersections.on_mesh_edges
    cut = np.zeros(len(on_grid.edges), np.bool_)
    cut[vertices.edges] = True
    group = _connected_vertices(len(on_grid.points), on_grid.edges[~cut])
    cells = _labels_from_edges(group, on_grid.edges[vertices.edges], vertices)

    def faces_in(cube: Ints) -> tuple[Floats, Ints]:
        number = crack.cube_index[np.ravel_multi_index(tuple(cube), labels.shape)] - 1
        quads = np.flatnonzero((crack.quad_cubes == number).any(axis=1)) if number >= 0 else np.empty(0, np.int64)
        found = np.flatnonzero(
            np.isin(np.searchsorted(crack.quad_start, np.arange(len(crack.cells)), "right") - 1, quads)
        )
        return crack.points[crack.triangles[found]], crack.cells[found].astype(np.int64)

    _label_the_rest(cells, group, on_grid.points, lambda corners: labels[corners].astype(np.int64), faces_in)
    return cells[group]


def crack_sides(on_grid: MeshOnGrid, crack: CrackMesh, intersections: Intersections) -> Ints:
    """OUTSIDE or INSIDE for each vertex of the crack mesh, shape (v,), by the same steps."""
    vertices = intersections.on_crack_edges
    crossed = np.zeros(len(crack.triangles), np.bool_)
    crossed[intersections.crack_segments.triangle] = True
    group = _connected_crack_vertices(
        len(crack.points), crack.triangles, crack.quad_start, crack.quad_cubes, crossed, vertices.edges
    )
    sides = _labels_from_edges(group, np.stack(np.divmod(vertices.edges, len(crack.points)), axis=1), vertices)

    def faces_in(cube: Ints) -> tuple[Floats, Ints]:
        flat = np.ravel_multi_index(tuple(cube), on_grid.inside.shape)
        faces = on_grid.cube_faces[slice(*np.searchsorted(on_grid.cubes, np.array([flat, flat + 1])))]
        return on_grid.points[on_grid.faces[faces]], np.tile([INSIDE, OUTSIDE], (len(faces), 1))

    _label_the_rest(
        sides, group, crack.points, lambda corners: np.where(on_grid.inside[corners], INSIDE, OUTSIDE), faces_in
    )
    return sides[group]


def _labels_from_edges(group: Ints, ends: Ints, vertices: EdgeVertices) -> Ints:
    """The label of each group (indexed by its root vertex), 0 if no intersection determines it."""
    labels_of = np.zeros(len(group), np.int64)
    if _label_groups(
        labels_of, group[ends], vertices.before[vertices.start[:-1]], vertices.after[vertices.start[1:] - 1]
    ):
        raise DegenerateIntersection
    return labels_of


@njit(cache=True, nogil=True)
def _connected_vertices(count, edges):
    """The lowest vertex that each vertex connects to along edges."""
    parent = np.arange(count).astype(np.int32)
    for n in range(len(edges)):
        union(parent, edges[n, 0], edges[n, 1])
    flatten(parent)
    return parent


@njit(cache=True, nogil=True)
def _connected_crack_vertices(count, triangles, quad_start, quad_cubes, crossed, cut):
    """The same along the edges of triangles without intersections; `cut` are the codes of the other edges, all of them
    of triangles that are `crossed`."""
    parent, table = np.arange(count).astype(np.int32), table_of(cut)
    for q in range(len(quad_cubes)):
        whole = quad_start[q + 1] - quad_start[q] == 2
        for t in range(quad_start[q], quad_start[q + 1]):
            whole = whole and not crossed[t]
        if whole:
            for n in range(3):
                union(parent, quad_cubes[q, n], quad_cubes[q, n + 1])
            continue
        for t in range(quad_start[q], quad_start[q + 1]):
            for n in range(3):
                a, b = triangles[t, n], triangles[t, (n + 1) % 3]
                if not crossed[t] or lookup(table, cut, edge_code(a, b, count)) < 0:
                    union(parent, a, b)
    flatten(parent)
    return parent


@njit(cache=True, nogil=True)
def _label_groups(labels_of, groups, first, last):
    """Label the groups at both ends of edges; whether they contradict each other."""
    for n in range(len(groups)):
        for group, label in ((groups[n, 0], first[n]), (groups[n, 1], last[n])):
            if labels_of[group] != 0 and labels_of[group] != label:
                return True
            labels_of[group] = label
    return False


def _label_the_rest(
    labels_of: Ints,
    group: Ints,
    points: Floats,
    labels_at: Callable[[tuple[Ints, ...]], Ints],
    faces_in: Callable[[Ints], tuple[Floats, Ints]],
) -> None:
    """Label the groups without intersections, by the labels at voxels and the faces in a cube."""
    unlabelled = np.flatnonzero(labels_of[group] == 0)
    if not len(unlabelled):
        return
    base = np.floor(points[unlabelled]).astype(np.int64)
    near = labels_at(tuple(np.moveaxis(base[:, None] + CORNERS, -1, 0)))  # (n, 8)
    same = (near == near[:, :1]).all(axis=1)
    for which in np.flatnonzero(same):
        # One label at all corners of a cube says nothing about a cube that faces pass twice.
        if labels_of[group[unlabelled[which]]] == 0 and not len(faces_in(base[which])[0]):
            labels_of[group[unlabelled[which]]] = near[which, 0]
    for v, cube, corners in zip(unlabelled, base, near, strict=True):
        if labels_of[group[v]] == 0:
            labels_of[group[v]] = _label_by_ray(points[v], cube, corners, *faces_in(cube))


def _label_by_ray(point: Floats, cube: Ints, corners: Ints, triangles: Floats, sides: Ints) -> int:
    """The label at a point in a cube: that of a visible corner, or of the side of the first face on the way to one."""
    for corner, label in zip(cube + CORNERS, corners, strict=True):
        hit, above = _first_hit(point, corner.astype(float), triangles)
        if hit >= 0:
            return int(sides[hit, above])
        if hit == -1:
            return int(label)
    raise DegenerateIntersection


@njit(cache=True)
def _first_hit(a, b, triangles):
    """The triangle first hit on the way from a to b, and whether a lies above it; -1 for none, -2 if undecidable."""
    best, nearest, which = -1, np.inf, 0
    for n in range(len(triangles)):
        triangle = triangles[n]
        side_a, side_b = side_of_triangle(triangle, a), side_of_triangle(triangle, b)
        if side_a == 0 or side_b == 0:
            return -2, 0
        if side_a == side_b:
            continue
        hit = line_hits_triangle(a, b, triangle)
        if hit < 0:
            return -2, 0
        if hit:
            u, v = triangle[1] - triangle[0], triangle[2] - triangle[0]
            normal = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
            t = ((triangle[0] - a) * normal).sum() / ((b - a) * normal).sum()
            if t < nearest:
                best, nearest, which = n, t, 1 if side_a > 0 else 0
    return best, which
