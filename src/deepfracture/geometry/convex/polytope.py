"""Convex polytopes as kernels: the hull of points, a solid or a polytope cut by a plane, planes between neighbours.

A polytope is a soup of outward triangles (closed: a cycle), so a cut needs neither neighbours nor order. Hulls
are quickhull (Barber, Dobkin, Huhdanpaa 1996), the farthest point first, until nothing lies farther outside than
a given tolerance: a hull has no more corners than it needs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.types import Floats, Ints

MAX_CORNERS = 448
"""Most corners of a hull."""
START_POINTS = 300
"""About as many points say where the hull begins."""
JOGGLE = 2e-5
"""While the hull is found, points are taken to lie up to so much elsewhere [m], at random: then no four lie in a
plane and no three on a line, and what is in front of a face is never a matter of rounding."""


class _Faces(NamedTuple):
    """Faces of a growing hull, in rows that are used again."""

    corners: Ints
    """Numbers in the list of corners, shape (n, 3)."""
    planes: Floats
    """Outward unit normals, and minus their offsets, shape (n, 4)."""
    alive: NDArray[np.bool_]
    head: Ints
    """First point that stands out of each face; the next ones are in `after`."""
    far: Floats
    farthest: Ints
    """How far out the farthest is, and which."""
    after: Ints
    """Of points."""
    free_rows: Ints
    """Rows that are free, the next one last."""
    counters: Ints
    """One past the last row in use; number of free rows."""


@njit(cache=True, nogil=True)
def set_triangle(triangles, n, a, b, c):
    """Write the corners of triangle `n`."""
    for d in range(3):  # to assign whole rows is several times slower
        triangles[n, 0, d], triangles[n, 1, d], triangles[n, 2, d] = a[d], b[d], c[d]


@njit(cache=True, nogil=True)
def volume(triangles):
    """Enclosed volume of a closed soup [m^3], shape (n, 3, 3)."""
    total = 0.0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        total += a[0] * (b[1] * c[2] - b[2] * c[1])
        total += a[1] * (b[2] * c[0] - b[0] * c[2])
        total += a[2] * (b[0] * c[1] - b[1] * c[0])
    return total / 6


@njit(cache=True, nogil=True)
def quickhull(points, tolerance):
    """Triangles of the convex hull of `points`, shape (m, 3, 3), but for what stands out less than `tolerance` [m].

    What is flat (thinner than `tolerance`) becomes its box, `tolerance` thick at least: an engine needs a solid."""
    extremes = _extremes(points)
    first = _simplex(points, extremes, tolerance)
    if first[3] < 0:
        first = _simplex(points, np.arange(len(points)), tolerance)
    if first[3] < 0:
        return _box(points, tolerance)
    given, points = points, _joggled(points)
    corner = np.empty(MAX_CORNERS, np.int64)
    corner[:4] = first
    most = 4 * MAX_CORNERS
    faces = _Faces(
        np.empty((most, 3), np.int64), np.empty((most, 4)), np.zeros(most, np.bool_), np.full(most, -1),
        np.zeros(most), np.full(most, -1), np.full(len(points), -1), np.arange(most)[::-1].copy(),
        np.array([0, most]),
    )  # fmt: skip
    fresh = np.empty(most, np.int64)
    for f, (a, b, c) in enumerate(((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))):
        fresh[f] = _add_face(points, corner, faces, a, b, c)
    ahead = np.full((MAX_CORNERS, MAX_CORNERS), False)  # directed edges of the faces that a point sees
    waiting = np.empty(len(points), np.int64)
    waiting_count = len(extremes)
    waiting[:waiting_count] = extremes
    count = _expand(points, corner, faces, fresh, 4, ahead, waiting, waiting_count, 4, tolerance)
    for stride in (1 + len(points) // START_POINTS, 1):  # what a hull of some hundreds leaves outside is little
        fresh_count = 0
        for k in range(faces.counters[0]):
            if faces.alive[k]:
                fresh[fresh_count] = k
                fresh_count += 1
        rest = _points_outside(points[::stride], faces.planes[fresh[:fresh_count]], tolerance) * stride
        waiting[: len(rest)] = rest
        count = _expand(points, corner, faces, fresh, fresh_count, ahead, waiting, len(rest), count, tolerance)
    triangles = np.empty((faces.alive.sum(), 3, 3))
    m = 0
    for k in range(faces.counters[0]):
        if faces.alive[k]:
            a, b, c = corner[faces.corners[k, 0]], corner[faces.corners[k, 1]], corner[faces.corners[k, 2]]
            set_triangle(triangles, m, given[a], given[b], given[c])
            m += 1
    return triangles


@njit(cache=True, nogil=True)
def _expand(points, corner, faces, fresh, fresh_count, ahead, waiting, waiting_count, count, tolerance):
    """Take in the points that wait, until none stands out further than `tolerance`. Returns the number of corners."""
    far = faces.far
    while True:
        _assign_points(points, waiting[:waiting_count], fresh[:fresh_count], faces, tolerance)
        best = 0  # what is not alive has far = 0
        for k in range(faces.counters[0]):
            if far[k] > far[best]:
                best = k
        if far[best] <= tolerance or count == MAX_CORNERS:
            return count
        assert faces.counters[1] >= MAX_CORNERS  # a polytope has twice as many faces as corners
        p = faces.farthest[best]
        corner[count] = p
        waiting_count, fresh_count = _remove_visible(points, p, faces, ahead, waiting, fresh)
        for m in range(fresh_count):
            fresh[m] = _add_face(points, corner, faces, fresh[m] // MAX_CORNERS, fresh[m] % MAX_CORNERS, count)
        count += 1


@njit(cache=True, nogil=True)
def _remove_visible(points, p, faces, ahead, waiting, edges):
    """Remove the faces that point `p` sees; what stood out of them waits, and `edges` says where they ended.

    Returns (how many wait, how many edges)."""
    x, y, z = points[p, 0], points[p, 1], points[p, 2]
    corners, planes, alive, head, after = faces.corners, faces.planes, faces.alive, faces.head, faces.after
    seen = np.empty(faces.counters[0], np.int64)
    sees, waiting_count, fresh_count = 0, 0, 0
    for k in range(faces.counters[0]):
        if alive[k] and planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z + planes[k, 3] > 0:
            seen[sees] = k
            sees += 1
    for k in seen[:sees]:
        for e in range(3):
            ahead[corners[k, e], corners[k, (e + 1) % 3]] = True
        i = head[k]
        while i >= 0:
            if i != p:
                waiting[waiting_count] = i
                waiting_count += 1
            i = after[i]
    for k in seen[:sees]:
        for e in range(3):
            a, b = corners[k, e], corners[k, (e + 1) % 3]
            if not ahead[b, a]:
                edges[fresh_count] = a * MAX_CORNERS + b
                fresh_count += 1
    for k in seen[:sees]:
        for e in range(3):
            ahead[corners[k, e], corners[k, (e + 1) % 3]] = False
        alive[k], head[k], faces.far[k], faces.farthest[k] = False, -1, 0.0, -1
        faces.free_rows[faces.counters[1]] = k
        faces.counters[1] += 1
    return waiting_count, fresh_count


@njit(cache=True, nogil=True)
def _add_face(points, corner, faces, a, b, c):
    """A new face; returns its row."""
    faces.counters[1] -= 1
    k = faces.free_rows[faces.counters[1]]
    faces.counters[0] = max(faces.counters[0], k + 1)
    faces.corners[k, 0], faces.corners[k, 1], faces.corners[k, 2] = a, b, c
    faces.alive[k] = True
    _plane(points[corner[a]], points[corner[b]], points[corner[c]], faces.planes[k])
    return k


@njit(cache=True, nogil=True)
def _joggled(points):
    moved = np.empty((len(points), 3))
    for i in range(len(points)):
        for k in range(3):
            h = (3 * i + k + 1) * 2654435761
            h = (h ^ (h >> 15)) * 2246822519
            moved[i, k] = points[i, k] + JOGGLE * (((h >> 13) & 4095) / 4095 - 0.5)
    return moved


@njit(cache=True, nogil=True, fastmath=True)
def _points_outside(points, planes, tolerance):
    """The points that stand out of any of the planes: all planes at once, so that the loop becomes vectors."""
    x, y, z = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    reach = np.full(len(x), -1.0)
    for k in range(len(planes)):
        a, b, c, d = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
        for i in range(len(x)):
            reach[i] = max(reach[i], a * x[i] + b * y[i] + c * z[i] + d)
    return np.flatnonzero(reach > tolerance)


@njit(cache=True, nogil=True)
def _extremes(points):
    """The farthest points both ways along the 13 axes of a cube, among some hundreds of `points`."""
    index = np.zeros(26, np.int64)
    reach = np.full(26, -np.inf)
    for i in range(0, len(points), 1 + len(points) // START_POINTS):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        along = (x, y, z, x + y, x - y, y + z, y - z, z + x, z - x, x + y + z, x + y - z, x - y + z, y + z - x)
        for d in range(13):
            if along[d] > reach[2 * d]:
                reach[2 * d], index[2 * d] = along[d], i
            if -along[d] > reach[2 * d + 1]:
                reach[2 * d + 1], index[2 * d + 1] = -along[d], i
    return np.unique(index)


@njit(cache=True, nogil=True)
def corners(triangles):
    """The different corners of a soup, shape (k, 3)."""
    n = 3 * len(triangles)
    size = 16
    while size < 2 * n:
        size *= 2
    slots = np.full(size, -1, np.int64)  # an open hash table
    kept = np.empty((n, 3))
    count = 0
    for i in range(n):
        x, y, z = triangles[i // 3, i % 3, 0], triangles[i // 3, i % 3, 1], triangles[i // 3, i % 3, 2]
        at = (np.int64(x * 1e7) * 73856093 ^ np.int64(y * 1e7) * 19349663 ^ np.int64(z * 1e7) * 83492791) & (size - 1)
        while slots[at] >= 0:
            k = slots[at]
            if kept[k, 0] == x and kept[k, 1] == y and kept[k, 2] == z:
                break
            at = (at + 1) & (size - 1)
        if slots[at] < 0:
            slots[at] = count
            kept[count, 0], kept[count, 1], kept[count, 2] = x, y, z
            count += 1
    return kept[:count].copy()


@njit(cache=True, nogil=True)
def _simplex(points, among, tolerance):
    """Four of the points `among` that span a solid, the last one below the plane of the first three.

    The last is -1 if all lie in a plane."""
    found = np.full(4, -1, np.int64)
    low, high = np.full(3, among[0]), np.full(3, among[0])
    for i in among:
        for k in range(3):
            if points[i, k] < points[low[k], k]:
                low[k] = i
            if points[i, k] > points[high[k], k]:
                high[k] = i
    axis = 0
    for k in range(3):
        if points[high[k], k] - points[low[k], k] > points[high[axis], axis] - points[low[axis], axis]:
            axis = k
    found[0], found[1] = low[axis], high[axis]
    a = points[found[0]]
    u = points[found[1]] - a
    length = np.sqrt(u @ u)
    if length <= tolerance:
        return found
    u = u / length
    most = tolerance * tolerance
    for i in among:
        x, y, z = points[i, 0] - a[0], points[i, 1] - a[1], points[i, 2] - a[2]
        t = x * u[0] + y * u[1] + z * u[2]
        reach = x * x + y * y + z * z - t * t
        if reach > most:
            most, found[2] = reach, i
    if found[2] < 0:
        return found
    v = points[found[2]] - a
    normal = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    normal /= np.sqrt(normal @ normal)
    most, side = tolerance, 0.0
    for i in among:
        x, y, z = points[i, 0] - a[0], points[i, 1] - a[1], points[i, 2] - a[2]
        reach = x * normal[0] + y * normal[1] + z * normal[2]
        if abs(reach) > most:
            most, side, found[3] = abs(reach), reach, i
    if side > 0:
        found[1], found[2] = found[2], found[1]
    return found


@njit(cache=True, nogil=True)
def _box(points, tolerance):
    low, high = points[0].copy(), points[0].copy()
    for i in range(len(points)):
        low, high = np.minimum(low, points[i]), np.maximum(high, points[i])
    for k in range(3):
        lack = max(tolerance - (high[k] - low[k]), 0.0)
        low[k] -= 0.5 * lack
        high[k] += 0.5 * lack
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = np.empty((12, 3, 3))
    for q in range(6):
        for half in range(2):
            order = (quads[q][0], quads[q][1 + half], quads[q][2 + half])
            for v in range(3):
                for k in range(3):
                    triangles[2 * q + half, v, k] = high[k] if (order[v] >> (2 - k)) & 1 else low[k]
    return triangles


@njit(cache=True, nogil=True)
def _plane(a, b, c, plane):
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(x * x + y * y + z * z)
    plane[0], plane[1], plane[2] = x / length, y / length, z / length
    plane[3] = -(plane[0] * a[0] + plane[1] * a[1] + plane[2] * a[2])


@njit(cache=True, nogil=True)
def _assign_points(points, waiting, fresh, faces, tolerance):
    """Hand each point that waits to the first new face that it stands out from."""
    planes, head, far, farthest, after = faces.planes, faces.head, faces.far, faces.farthest, faces.after
    for i in waiting:
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for k in fresh:
            reach = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z + planes[k, 3]
            if reach > tolerance:
                after[i] = head[k]
                head[k] = i
                if reach > far[k]:
                    far[k], farthest[k] = reach, i
                break


@njit(cache=True, nogil=True)
def clip(triangles, surface, normal, offset):
    """Both sides of the plane x . normal = offset, each closed in the plane.

    Args:
        surface: Which triangles lie in the original surface and not in a cut, shape (n,).

    Returns:
        (below, above, boundary): a side is (triangles, surface); the boundary is where the plane crosses the surface,
        shape (k, 3)
    """
    n = len(triangles)
    sides = np.empty((2, 3 * n, 3, 3))
    surfaces = np.zeros((2, 3 * n), np.bool_)
    count = np.zeros(2, np.int64)
    cuts, boundary = np.empty((n, 2, 3)), np.empty((2 * n, 3))
    cut, met = 0, 0
    reach = np.empty(3)
    for t in range(n):
        for v in range(3):
            reach[v] = triangles[t, v, 0] * normal[0] + triangles[t, v, 1] * normal[1]
            reach[v] += triangles[t, v, 2] * normal[2] - offset
        above = reach >= 0
        if above[0] == above[1] and above[1] == above[2]:
            side = 1 if above[0] else 0
            set_triangle(sides[side], count[side], triangles[t, 0], triangles[t, 1], triangles[t, 2])
            surfaces[side, count[side]] = surface[t]
            count[side] += 1
            continue
        p, q = _split_triangle(triangles[t], reach, surface[t], sides, surfaces, count, cuts[cut])
        cut += 1
        if surface[t]:
            boundary[met], boundary[met + 1] = p, q
            met += 2
    _cap(sides, count, cuts[:cut])
    below = sides[0, : count[0]].copy(), surfaces[0, : count[0]].copy()
    above = sides[1, : count[1]].copy(), surfaces[1, : count[1]].copy()
    return below, above, boundary[:met].copy()


@njit(cache=True, nogil=True)
def _split_triangle(triangle, reach, surface, sides, surfaces, count, cut):
    """A triangle that a plane crosses: three, and the segment `cut` as each side's boundary runs along it."""
    above = reach >= 0
    i = 0  # the corner alone on its side
    if above[0] == above[2]:
        i = 1
    elif above[0] == above[1]:
        i = 2
    j, k = (i + 1) % 3, (i + 2) % 3
    a, b, c = triangle[i], triangle[j], triangle[k]
    p = a + (b - a) * (reach[i] / (reach[i] - reach[j]))
    q = a + (c - a) * (reach[i] / (reach[i] - reach[k]))
    side = 1 if above[i] else 0
    other = 1 - side
    m, o = count[side], count[other]
    set_triangle(sides[side], m, a, p, q)
    set_triangle(sides[other], o, p, b, c)
    set_triangle(sides[other], o + 1, p, c, q)
    surfaces[side, m], surfaces[other, o], surfaces[other, o + 1] = surface, surface, surface
    count[side] += 1
    count[other] += 2
    # The boundary of the side below runs from p to q where it holds the lone corner, else back.
    cut[side], cut[other] = p, q
    return p, q


@njit(cache=True, nogil=True)
def _cap(sides, count, cuts):
    """Close both sides of a plane with a fan over the segments in which it cut."""
    apex = np.zeros(3)
    for s in range(len(cuts)):
        apex += (cuts[s, 0] + cuts[s, 1]) / (2 * len(cuts))
    for s in range(len(cuts)):
        p, q = cuts[s, 0], cuts[s, 1]
        m, o = count[0], count[1]
        set_triangle(sides[0], m, q, p, apex)
        set_triangle(sides[1], o, p, q, apex)
        count += 1


@njit(cache=True, nogil=True)
def face_planes(triangles):
    """Outward unit normals and offsets of the faces of a polytope, shape (n, 4); a line has the normal 0."""
    found = np.zeros((len(triangles), 4))
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(x * x + y * y + z * z)
        if length > 1e-12:
            x, y, z = x / length, y / length, z / length
            found[t, 0], found[t, 1], found[t, 2], found[t, 3] = x, y, z, x * a[0] + y * a[1] + z * a[2]
    return found


@njit(cache=True, nogil=True, fastmath=True)
def least_overlap_plane(faces, points, plane):
    """The face of a polytope along which it overlaps another least, if that is less than `plane` says.

    Only normals of faces are tried: where edges cross, the depth is slightly more than it could be.

    Args:
        faces: `face_planes` of the one, shape (n, 4).
        points: Corners of the other, shape (k, 3).
        plane: Normal, offset of the middle of the overlap, its depth [m] (< 0 if apart), shape (5,); improved.

    Returns:
        Whether it is.
    """
    better = False
    for f in range(len(faces)):
        x, y, z, top = faces[f, 0], faces[f, 1], faces[f, 2], faces[f, 3]
        if x == 0 and y == 0 and z == 0:
            continue
        low = 1e300
        for i in range(len(points)):
            low = min(low, points[i, 0] * x + points[i, 1] * y + points[i, 2] * z)
        if top - low < plane[4]:
            plane[0], plane[1], plane[2], plane[3], plane[4] = x, y, z, 0.5 * (top + low), top - low
            better = True
            if plane[4] < 0:
                break
    return better
