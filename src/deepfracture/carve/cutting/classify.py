"""Which cell each vertex of the surface lies in, and which vertices of the sheets lie inside the body."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from deepfracture.carve.cutting.interfaces import Sheets
from deepfracture.carve.cutting.intersect import (
    INSIDE,
    OUTSIDE,
    Crossing,
    EdgeNodes,
    NotGeneral,
    edge_code,
    over,
    pierces,
)
from deepfracture.carve.cutting.mesh_on_grid import Ground
from deepfracture.geometry.disjoint_sets import flatten, union
from deepfracture.geometry.hashing import lookup, table_of
from deepfracture.types import Floats, Ints, Labels

CORNERS = np.array([[n >> 2, n >> 1 & 1, n & 1] for n in range(8)])


def surface_cells(ground: Ground, sheets: Sheets, crossing: Crossing, labels: Labels) -> Ints:
    """The cell of each vertex of the surface, shape (n,).

    Known where sheets cross edges, and the same along all other edges. A shell that no sheet crosses lies in one
    cell: that of a corner of one of its cubes, as seen from the surface. Raises NotGeneral if crossings contradict
    each other."""
    nodes = crossing.surface_nodes
    cut = np.zeros(len(ground.edges), np.bool_)
    cut[nodes.edges] = True
    group = _groups(len(ground.points), ground.edges[~cut])
    cells = _names(group, ground.edges[nodes.edges], nodes)

    def walls(cube: Ints) -> tuple[Floats, Ints]:
        number = sheets.number[np.ravel_multi_index(tuple(cube), labels.shape)] - 1
        quads = np.flatnonzero((sheets.around == number).any(axis=1)) if number >= 0 else np.empty(0, np.int64)
        around = np.flatnonzero(
            np.isin(np.searchsorted(sheets.quads, np.arange(len(sheets.sides)), "right") - 1, quads)
        )
        return sheets.points[sheets.triangles[around]], sheets.sides[around].astype(np.int64)

    _complete(cells, group, ground.points, lambda corners: labels[corners].astype(np.int64), walls)
    return cells[group]


def sheet_walls(ground: Ground, sheets: Sheets, crossing: Crossing) -> Ints:
    """OUTSIDE or INSIDE for each vertex of the sheets, shape (v,), found in the same way."""
    nodes = crossing.sheet_nodes
    touched = np.zeros(len(sheets.triangles), np.bool_)
    touched[crossing.on_sheets.triangle] = True
    group = _groups_of_triangles(
        len(sheets.points), sheets.triangles, sheets.quads, sheets.around, touched, nodes.edges
    )
    sides = _names(group, np.stack(np.divmod(nodes.edges, len(sheets.points)), axis=1), nodes)

    def walls(cube: Ints) -> tuple[Floats, Ints]:
        flat = np.ravel_multi_index(tuple(cube), ground.inside.shape)
        faces = ground.touching[slice(*np.searchsorted(ground.cubes, np.array([flat, flat + 1])))]
        return ground.points[ground.faces[faces]], np.tile([INSIDE, OUTSIDE], (len(faces), 1))

    _complete(sides, group, sheets.points, lambda corners: np.where(ground.inside[corners], INSIDE, OUTSIDE), walls)
    return sides[group]


def _names(group: Ints, ends: Ints, nodes: EdgeNodes) -> Ints:
    """The name of each group (that of a vertex whose number is the group's), 0 if no node tells it."""
    names = np.zeros(len(group), np.int64)
    if _tell(names, group[ends], nodes.before[nodes.start[:-1]], nodes.after[nodes.start[1:] - 1]):
        raise NotGeneral
    return names


@njit(cache=True, nogil=True)
def _groups(count, edges):
    """The lowest vertex that each vertex hangs together with along edges."""
    parent = np.arange(count).astype(np.int32)
    for n in range(len(edges)):
        union(parent, edges[n, 0], edges[n, 1])
    flatten(parent)
    return parent


@njit(cache=True, nogil=True)
def _groups_of_triangles(count, triangles, quads, around, touched, cut):
    """The same along the edges of triangles that no node lies on; `cut` are the codes of the others, all of them of
    triangles that are `touched`."""
    parent, table = np.arange(count).astype(np.int32), table_of(cut)
    for q in range(len(around)):
        whole = quads[q + 1] - quads[q] == 2
        for t in range(quads[q], quads[q + 1]):
            whole = whole and not touched[t]
        if whole:
            for n in range(3):
                union(parent, around[q, n], around[q, n + 1])
            continue
        for t in range(quads[q], quads[q + 1]):
            for n in range(3):
                a, b = triangles[t, n], triangles[t, (n + 1) % 3]
                if not touched[t] or lookup(table, cut, edge_code(a, b, count)) < 0:
                    union(parent, a, b)
    flatten(parent)
    return parent


@njit(cache=True, nogil=True)
def _tell(names, groups, first, last):
    """Name the groups at both ends of edges; whether they contradict each other."""
    for n in range(len(groups)):
        for group, name in ((groups[n, 0], first[n]), (groups[n, 1], last[n])):
            if names[group] != 0 and names[group] != name:
                return True
            names[group] = name
    return False


def _complete(
    names: Ints,
    group: Ints,
    points: Floats,
    names_at: Callable[[tuple[Ints, ...]], Ints],
    walls: Callable[[Ints], tuple[Floats, Ints]],
) -> None:
    """Name the groups that no node has named, by the names at voxels and the walls in a cube."""
    unnamed = np.flatnonzero(names[group] == 0)
    if not len(unnamed):
        return
    base = np.floor(points[unnamed]).astype(np.int64)
    near = names_at(tuple(np.moveaxis(base[:, None] + CORNERS, -1, 0)))  # (n, 8)
    same = (near == near[:, :1]).all(axis=1)
    for which in np.flatnonzero(same):
        # One label at all corners of a cube says nothing about a cube that walls pass twice.
        if names[group[unnamed[which]]] == 0 and not len(walls(base[which])[0]):
            names[group[unnamed[which]]] = near[which, 0]
    for v, cube, corners in zip(unnamed, base, near, strict=True):
        if names[group[v]] == 0:
            names[group[v]] = _seen_from(points[v], cube, corners, *walls(cube))


def _seen_from(point: Floats, cube: Ints, corners: Ints, walls: Floats, sides: Ints) -> int:
    """The name of the place of a point in a cube: that of a corner, or of the side of the first wall on the way."""
    for corner, name in zip(cube + CORNERS, corners, strict=True):
        wall, above = _first_wall(point, corner.astype(float), walls)
        if wall >= 0:
            return int(sides[wall, above])
        if wall == -1:
            return int(name)
    raise NotGeneral


@njit(cache=True)
def _first_wall(a, b, walls):
    """The wall nearest to a on the way to b and whether a lies above it; -1 for none, -2 if rounding hides it."""
    best, nearest, which = -1, np.inf, 0
    for n in range(len(walls)):
        t = walls[n]
        one, two = over(t, a), over(t, b)
        if one == 0 or two == 0:
            return -2, 0
        if one == two:
            continue
        hit = pierces(a, b, t)
        if hit < 0:
            return -2, 0
        if hit:
            u, v = t[1] - t[0], t[2] - t[0]
            normal = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
            way = ((t[0] - a) * normal).sum() / ((b - a) * normal).sum()
            if way < nearest:
                best, nearest, which = n, way, 1 if one > 0 else 0
    return best, which
