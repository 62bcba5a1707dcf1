"""Convex parts of a fragment: the planes are found on few triangles, the hulls are of all vertices.

A part is what planes leave of a solid. Its triangles are a closed soup (see `convex.clip`), which keeps the
volume exact; the fans that close it also cover empty space, so only the surface has a say in the hull.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.geometry.convex.polytope import clip, corners, quickhull, set_triangle, volume

CELLS = 16
"""Planes are found on a fragment clustered to about this many vertices along its longest side ..."""
PLAN_TOL = 0.005
"""... with hulls out of which this share of that side may stand."""


@njit(cache=True, nogil=True)
def decompose(vertices, faces, max_parts, tolerance, hull_tol, shrink, gap):
    """Hulls that cover a closed mesh with at most `tolerance` of its volume too much, but at most `max_parts` of them.

    The part with the most excess volume is halved across its longest axis until that is so, on the clustered mesh.

    Args:
        hull_tol: What may stand out of a hull [m].
        shrink, gap: A hull ends up nearer to its own centre by this share, but by at most `gap` [m].

    Returns:
        (triangles of all hulls, shape (t, 3, 3); where each begins, and the end, shape (k + 1,); volume of the
        mesh [m^3])
    """
    total = _volume(vertices, faces)
    coarse, coarse_faces, size = _clustered(vertices, faces)
    plan_tol = max(hull_tol, PLAN_TOL * size)
    soups, surfaces = [_triangles(coarse, coarse_faces)], [np.ones(len(coarse_faces), np.bool_)]
    boundaries = [np.empty((0, 3))]  # where planes have cut the surface of each part
    hulls = [quickhull(coarse, plan_tol)]
    excess = [volume(hulls[0]) - total]
    of, part_of_vertex = np.zeros(len(coarse), np.int64), np.zeros(len(vertices), np.int64)  # part of each vertex
    hull_volume = volume(hulls[0])
    while len(hulls) < max_parts and hull_volume > (1 + tolerance) * total and max(excess) > 0:
        largest = 0
        for i in range(len(excess)):
            if excess[i] > excess[largest]:
                largest = i
        normal, offset = _bisecting_plane(hulls[largest])
        below, above, boundary = clip(soups[largest], surfaces[largest], normal, offset)
        if below[1].sum() < 2 or above[1].sum() < 2:
            excess[largest] = 0.0  # no plane through it leaves two solids
            continue
        new = len(hulls)
        _assign_side(coarse, of, largest, new, normal, offset)
        _assign_side(vertices, part_of_vertex, largest, new, normal, offset)
        old = boundaries[largest] @ normal < offset
        boundaries.append(np.concatenate((boundaries[largest][~old], boundary)))
        boundaries[largest] = np.concatenate((boundaries[largest][old], boundary))
        hull_volume -= volume(hulls[largest])
        hulls[largest] = _part_hull(coarse, of, largest, boundaries[largest], plan_tol)
        hulls.append(_part_hull(coarse, of, new, boundaries[new], plan_tol))
        hull_volume += volume(hulls[largest]) + volume(hulls[new])
        soups[largest], surfaces[largest] = below
        soups.append(above[0])
        surfaces.append(above[1])
        excess[largest] = volume(hulls[largest]) - volume(below[0])
        excess.append(volume(hulls[new]) - volume(above[0]))
    for i in range(len(hulls)):
        hulls[i] = _part_hull(vertices, part_of_vertex, i, boundaries[i], hull_tol)
    starts = np.zeros(len(hulls) + 1, np.int64)
    for i in range(len(hulls)):
        starts[i + 1] = starts[i] + len(hulls[i])
    triangles = np.empty((starts[-1], 3, 3))
    for i in range(len(hulls)):
        triangles[starts[i] : starts[i + 1]] = _shrunk(hulls[i], shrink, gap)
    return triangles, starts, total


@njit(cache=True, nogil=True)
def _shrunk(triangles, shrink, gap):
    points = corners(triangles)
    centre = np.zeros(3)
    for i in range(len(points)):
        centre += points[i] / len(points)
    farthest = 0.0
    for i in range(len(points)):
        away = points[i] - centre
        farthest = max(farthest, away @ away)
    return centre + (1 - min(shrink, gap / np.sqrt(farthest))) * (triangles - centre)


@njit(cache=True, nogil=True)
def _assign_side(vertices, of, low, high, normal, offset):
    """Move the vertices of part `low` that lie above a plane into part `high`."""
    x, y, z = normal[0], normal[1], normal[2]
    for i in range(len(vertices)):
        if of[i] == low and vertices[i, 0] * x + vertices[i, 1] * y + vertices[i, 2] * z >= offset:
            of[i] = high


@njit(cache=True, nogil=True)
def _part_hull(vertices, of, part, boundary, hull_tol):
    """Hull of a part: its vertices, and the boundaries where planes have cut it."""
    points = np.empty((len(vertices) + len(boundary), 3))
    m = 0
    for i in range(len(vertices)):
        if of[i] == part:
            for k in range(3):
                points[m, k] = vertices[i, k]
            m += 1
    for i in range(len(boundary)):
        for k in range(3):
            points[m, k] = boundary[i, k]
        m += 1
    return quickhull(points[:m], hull_tol)


@njit(cache=True, nogil=True)
def _bisecting_plane(triangles):
    """The plane across the longest principal axis of a hull's corners, in its middle."""
    points = corners(triangles)
    centre = np.zeros(3)
    for i in range(len(points)):
        centre += points[i] / len(points)
    spread = np.zeros((3, 3))
    for i in range(len(points)):
        for a in range(3):
            for b in range(3):
                spread[a, b] += (points[i, a] - centre[a]) * (points[i, b] - centre[b])
    axes = np.linalg.eigh(spread)[1]
    best, middle, axis = -1.0, 0.0, 0
    for a in range(3):
        low, high = np.inf, -np.inf
        for i in range(len(points)):
            reach = points[i, 0] * axes[0, a] + points[i, 1] * axes[1, a] + points[i, 2] * axes[2, a]
            low, high = min(low, reach), max(high, reach)
        if high - low > best:
            best, middle, axis = high - low, 0.5 * (low + high), a
    return axes[:, axis].copy(), middle


@njit(cache=True, nogil=True)
def _clustered(vertices, faces):
    """Vertices merged by the cells of a grid: (the outermost of each, faces, longest side [m]). A closed cycle stays
    one."""
    low, high = vertices[0].copy(), vertices[0].copy()
    for i in range(len(vertices)):
        for k in range(3):
            low[k], high[k] = min(low[k], vertices[i, k]), max(high[k], vertices[i, k])
    side = (high - low).max() / CELLS
    middle = 0.5 * (low + high)
    wide = ((high - low) / side).astype(np.int64) + 1
    number = np.full(wide[0] * wide[1] * wide[2], -1)
    outermost = np.empty(len(vertices), np.int64)
    reach = np.empty(len(vertices))
    of = np.empty(len(vertices), np.int64)
    count = 0
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        at = int((x - low[0]) / side) * wide[1] + int((y - low[1]) / side)
        at = at * wide[2] + int((z - low[2]) / side)
        away = (x - middle[0]) ** 2 + (y - middle[1]) ** 2 + (z - middle[2]) ** 2
        if number[at] < 0:
            number[at] = count
            outermost[count], reach[count] = i, away
            count += 1
        of[i] = number[at]
        if away > reach[of[i]]:
            outermost[of[i]], reach[of[i]] = i, away
    coarse_faces = np.empty((len(faces), 3), np.int64)
    m = 0
    for t in range(len(faces)):
        a, b, c = of[faces[t, 0]], of[faces[t, 1]], of[faces[t, 2]]
        if a != b and b != c and c != a:
            coarse_faces[m, 0], coarse_faces[m, 1], coarse_faces[m, 2] = a, b, c
            m += 1
    return vertices[outermost[:count]], coarse_faces[:m], side * CELLS


@njit(cache=True, nogil=True)
def _triangles(vertices, faces):
    triangles = np.empty((len(faces), 3, 3))
    for t in range(len(faces)):
        set_triangle(triangles, t, vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]])
    return triangles


@njit(cache=True, nogil=True)
def _volume(vertices, faces):
    """Enclosed volume of a mesh [m^3]."""
    total = 0.0
    for t in range(len(faces)):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        bx, by, bz = vertices[j, 0], vertices[j, 1], vertices[j, 2]
        cx, cy, cz = vertices[k, 0], vertices[k, 1], vertices[k, 2]
        total += vertices[i, 0] * (by * cz - bz * cy)
        total += vertices[i, 1] * (bz * cx - bx * cz)
        total += vertices[i, 2] * (bx * cy - by * cx)
    return total / 6
