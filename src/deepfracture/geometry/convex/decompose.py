"""Convex parts of a fragment: the planes are planned on few triangles, the hulls are of all vertices.

A part is what planes leave of a solid. Its triangles are a closed soup (see `convex.clip`), which keeps the
volume exact; the fans that close it also cover air, so only the skin has a say in the hull.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.geometry.convex.polytope import clip, corners, hull, put, volume

CELLS = 16
"""Planes are planned on a fragment thinned to about this many vertices along its longest side ..."""
ROUGH = 0.005
"""... with hulls out of which this share of that side may stand."""


@njit(cache=True, nogil=True)
def parts(vertices, faces, most, tolerance, sag, shrink, gap):
    """Hulls that cover a closed mesh with at most `tolerance` of its volume too much, but at most `most` of them.

    The part with the most air is halved across its longest axis until that is so, on the thinned mesh.

    Args:
        sag: What may stand out of a hull [m].
        shrink, gap: A hull ends up nearer to its own centre by this share, but by at most `gap` [m].

    Returns:
        (triangles of all hulls, shape (t, 3, 3); where each begins, and the end, shape (k + 1,); volume of the
        mesh [m^3])
    """
    total = _volume(vertices, faces)
    few, thin, size = _thinned(vertices, faces)
    rough = max(sag, ROUGH * size)
    soups, skins = [_soup(few, thin)], [np.ones(len(thin), np.bool_)]
    rims = [np.empty((0, 3))]  # where planes have cut the skin of each part
    hulls = [hull(few, rough)]
    air = [volume(hulls[0]) - total]
    of, home = np.zeros(len(few), np.int64), np.zeros(len(vertices), np.int64)  # part of each vertex
    filled = volume(hulls[0])
    while len(hulls) < most and filled > (1 + tolerance) * total and max(air) > 0:
        worst = 0
        for i in range(len(air)):
            if air[i] > air[worst]:
                worst = i
        normal, offset = _middle(hulls[worst])
        below, above, rim = clip(soups[worst], skins[worst], normal, offset)
        if below[1].sum() < 2 or above[1].sum() < 2:
            air[worst] = 0.0  # no plane through it leaves two solids
            continue
        new = len(hulls)
        _part(few, of, worst, new, normal, offset)
        _part(vertices, home, worst, new, normal, offset)
        old = rims[worst] @ normal < offset
        rims.append(np.concatenate((rims[worst][~old], rim)))
        rims[worst] = np.concatenate((rims[worst][old], rim))
        filled -= volume(hulls[worst])
        hulls[worst] = _cover(few, of, worst, rims[worst], rough)
        hulls.append(_cover(few, of, new, rims[new], rough))
        filled += volume(hulls[worst]) + volume(hulls[new])
        soups[worst], skins[worst] = below
        soups.append(above[0])
        skins.append(above[1])
        air[worst] = volume(hulls[worst]) - volume(below[0])
        air.append(volume(hulls[new]) - volume(above[0]))
    for i in range(len(hulls)):
        hulls[i] = _cover(vertices, home, i, rims[i], sag)
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
    most = 0.0
    for i in range(len(points)):
        away = points[i] - centre
        most = max(most, away @ away)
    return centre + (1 - min(shrink, gap / np.sqrt(most))) * (triangles - centre)


@njit(cache=True, nogil=True)
def _part(vertices, of, low, high, normal, offset):
    """Move the vertices of part `low` that lie above a plane into part `high`."""
    x, y, z = normal[0], normal[1], normal[2]
    for i in range(len(vertices)):
        if of[i] == low and vertices[i, 0] * x + vertices[i, 1] * y + vertices[i, 2] * z >= offset:
            of[i] = high


@njit(cache=True, nogil=True)
def _cover(vertices, of, part, rim, sag):
    """Hull of a part: its vertices, and the rims where planes have cut it."""
    points = np.empty((len(vertices) + len(rim), 3))
    m = 0
    for i in range(len(vertices)):
        if of[i] == part:
            for k in range(3):
                points[m, k] = vertices[i, k]
            m += 1
    for i in range(len(rim)):
        for k in range(3):
            points[m, k] = rim[i, k]
        m += 1
    return hull(points[:m], sag)


@njit(cache=True, nogil=True)
def _middle(triangles):
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
def _thinned(vertices, faces):
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
    thin = np.empty((len(faces), 3), np.int64)
    m = 0
    for t in range(len(faces)):
        a, b, c = of[faces[t, 0]], of[faces[t, 1]], of[faces[t, 2]]
        if a != b and b != c and c != a:
            thin[m, 0], thin[m, 1], thin[m, 2] = a, b, c
            m += 1
    return vertices[outermost[:count]], thin[:m], side * CELLS


@njit(cache=True, nogil=True)
def _soup(vertices, faces):
    triangles = np.empty((len(faces), 3, 3))
    for t in range(len(faces)):
        put(triangles, t, vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]])
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
