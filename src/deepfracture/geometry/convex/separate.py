"""Hulls of neighbours, cut back until they no longer overlap.

Fragments do not overlap but their hulls do, wherever a crack is not flat. An engine takes that for a deep
contact and throws them apart. So between two overlapping hulls of different fragments a plane is laid across
the direction in which they overlap least, in the middle of the overlap, and each keeps its own side.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.geometry.convex.polytope import (
    MAX_CORNERS,
    corners,
    face_planes,
    least_overlap_plane,
    quickhull,
    set_triangle,
    volume,
)
from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import Floats, Ints

CORNER_TOL = 0.003
"""Corners that stand out less are dropped after the cuts [m]."""
MIN_OVERLAP = 0.0005
"""Overlaps that engines leave alone [m]."""
MAX_TRIANGLES = 2000
"""Triangles that a hull may have while it is cut."""


def separate(triangles: Floats, starts: Ints, owners: Ints) -> tuple[Floats, Ints, Floats]:
    """Cut hulls back.

    Two that are so deep in each other that the plane would take the middle of one are left as they are: they
    are interlocked, and no plane is right.

    Args:
        triangles: Of all hulls, shape (t, 3, 3).
        starts: Where each begins, and the end, shape (k + 1,).
        owners: Fragment of each, shape (k,).

    Returns:
        (corners of all hulls, shape (n, 3); where each begins, and the end, shape (k + 1,); volume of each [m^3])
    """
    boxes, points, ends = _corners(triangles, starts)
    faces, count = face_planes(triangles), len(owners)
    met = parallel_for(
        lambda low, high: _separating_planes(faces, starts, owners, boxes, points, ends, low, high), count, least=1
    )  # fmt: skip
    first, second, cuts = (np.concatenate(column) for column in zip(*met, strict=True))
    left = parallel_for(lambda low, high: _cut_back(triangles, starts, first, second, cuts, low, high), count, least=1)
    kept, counts, volumes = (np.concatenate(column) for column in zip(*left, strict=True))
    return kept, np.append(0, np.cumsum(counts)), volumes


@njit(cache=True, nogil=True)
def _corners(triangles, starts):
    """Boxes and middles of hulls, shape (k, 9); the corners of all; where those of each begin, and the end."""
    count = len(starts) - 1
    boxes, points, ends = np.empty((count, 9)), np.empty((3 * len(triangles), 3)), np.zeros(count + 1, np.int64)
    for i in range(count):
        own = corners(triangles[starts[i] : starts[i + 1]])
        ends[i + 1] = ends[i] + len(own)
        points[ends[i] : ends[i + 1]] = own
        for k in range(3):
            boxes[i, k], boxes[i, 3 + k], boxes[i, 6 + k] = own[:, k].min(), own[:, k].max(), own[:, k].mean()
    return boxes, points[: ends[-1]], ends


@njit(cache=True, nogil=True)
def _separating_planes(faces, starts, owners, boxes, points, ends, from_hull, to_hull):
    """The pairs of some hulls and later ones that overlap, and the planes between: (first, second, planes, (n, 5))."""
    count = len(owners)
    room = (to_hull - from_hull) * count
    first, second, cuts = np.empty(room, np.int64), np.empty(room, np.int64), np.empty((room, 5))
    met = 0
    for i in range(from_hull, to_hull):
        for j in range(i + 1, count):
            if owners[i] == owners[j] or not _boxes_overlap(boxes[i], boxes[j]):
                continue
            cut = cuts[met]
            cut[4] = np.inf
            least_overlap_plane(faces[starts[i] : starts[i + 1]], points[ends[j] : ends[j + 1]], cut)
            if cut[4] > 0 and least_overlap_plane(faces[starts[j] : starts[j + 1]], points[ends[i] : ends[i + 1]], cut):
                cut[:4] *= -1
            if cut[4] > MIN_OVERLAP and cut[:3] @ boxes[i, 6:] < cut[3] < cut[:3] @ boxes[j, 6:]:
                first[met], second[met] = i, j
                met += 1
    return first[:met], second[:met], cuts[:met]


@njit(cache=True, nogil=True)
def _cut_back(triangles, starts, first, second, cuts, from_hull, to_hull):
    """Corners of some hulls after the cuts, how many each has, and the volume of each."""
    count = to_hull - from_hull
    volumes, left, counts = np.empty(count), np.empty((count * MAX_CORNERS, 3)), np.empty(count, np.int64)
    room, used = np.empty((2, MAX_TRIANGLES, 3, 3)), 0
    for i in range(from_hull, to_hull):
        n = starts[i + 1] - starts[i]
        room[0, :n] = triangles[starts[i] : starts[i + 1]]
        now, whole = 0, True
        for m in range(len(cuts)):
            if first[m] != i and second[m] != i:
                continue
            n = _clip_convex(room[now, :n], cuts[m], 1.0 if first[m] == i else -1.0, room[1 - now])
            now, whole = 1 - now, False
            if 2 * n > MAX_TRIANGLES:
                simplified = quickhull(corners(room[now, :n]), CORNER_TOL)
                n = len(simplified)
                room[now, :n] = simplified
        solid = room[now, :n] if whole else quickhull(corners(room[now, :n]), CORNER_TOL)
        own = corners(solid)
        left[used : used + len(own)] = own
        used += len(own)
        counts[i - from_hull], volumes[i - from_hull] = len(own), volume(solid)
    return left[:used].copy(), counts, volumes


@njit(cache=True, nogil=True)
def _clip_convex(triangles, plane, side, kept):
    """What of a polytope lies below a plane (above it where `side` is -1), closed by a fan, written to `kept`.

    Returns how many triangles that is."""
    x, y, z, offset = side * plane[0], side * plane[1], side * plane[2], side * plane[3]
    reach = np.empty(3)
    boundary = np.empty((len(triangles), 2, 3))
    n, cut = 0, 0
    for t in range(len(triangles)):
        inside = 0
        for v in range(3):
            reach[v] = triangles[t, v, 0] * x + triangles[t, v, 1] * y + triangles[t, v, 2] * z - offset
            inside += reach[v] < 0
        if inside == 3:
            set_triangle(kept, n, triangles[t, 0], triangles[t, 1], triangles[t, 2])
            n += 1
        if inside == 3 or inside == 0:
            continue
        i = 0  # the corner alone on its side
        for v in range(3):
            if (reach[v] < 0) == (inside == 1):
                i = v
        j, k = (i + 1) % 3, (i + 2) % 3
        p, q = boundary[cut, 0], boundary[cut, 1]
        for d in range(3):
            p[d] = triangles[t, i, d] + (triangles[t, j, d] - triangles[t, i, d]) * (reach[i] / (reach[i] - reach[j]))
            q[d] = triangles[t, i, d] + (triangles[t, k, d] - triangles[t, i, d]) * (reach[i] / (reach[i] - reach[k]))
        if inside == 1:
            set_triangle(kept, n, triangles[t, i], p, q)
            n += 1
        else:
            set_triangle(kept, n, p, triangles[t, j], triangles[t, k])
            set_triangle(kept, n + 1, p, triangles[t, k], q)
            n += 2
            for d in range(3):  # the boundary runs the other way
                p[d], q[d] = q[d], p[d]
        cut += 1
    for c in range(1, cut):  # a fan from one point of the rim: the cut is convex
        set_triangle(kept, n, boundary[0, 0], boundary[c, 1], boundary[c, 0])
        n += 1
    return n


@njit(cache=True, nogil=True)
def _boxes_overlap(one, two):
    """Whether two boxes (lower corner, upper corner, ...) meet."""
    near = True
    for k in range(3):
        near &= one[k] <= two[3 + k] and two[k] <= one[3 + k]
    return near
