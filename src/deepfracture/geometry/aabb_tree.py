"""Compiled point-triangle geometry and the box tree that the distance queries share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from deepfracture.types import Floats, Ints

LEAF = 4
"""Triangles in a leaf of the box tree, at most."""

SLIVER = 1e-8
"""Squared sine between two sides below which a triangle is a sliver: weights then keep < 8 digits."""

FLAT = 1e-16
"""Squared sine below which only the sides count: 1e-8 of their length is as wide as its normal is then off."""

STACK = 128
"""Scratch entries for a walk through the tree, which is balanced: enough for any mesh in memory."""


class AABBTree(NamedTuple):
    """A balanced tree of boxes over triangles, in the order in which its leaves hold them."""

    corners: Floats
    """Triangles in leaf order, shape (m, 3, 3)."""
    order: Ints
    """Index of each of them in the mesh, shape (m,)."""
    boxes: Floats
    """Lower and upper corner of each node, shape (nodes, 2, 3)."""
    spans: Ints
    """First and one past the last triangle of each node, shape (nodes, 2)."""
    children: Ints
    """First of the two neighbouring child nodes, -1 for a leaf, shape (nodes,)."""


@njit(cache=True)
def _quickselect(keys: Floats, order: Ints, start: int, stop: int, middle: int) -> None:  # pragma: no cover
    """Quickselect: order[start:middle] get the smaller keys, order[middle:stop] the larger."""
    low, high = start, stop - 1
    while low < high:
        pivot = keys[order[(low + high) // 2]]
        i, j = low, high
        while i <= j:
            while keys[order[i]] < pivot:
                i += 1
            while keys[order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit(cache=True)
def _build(triangles: Floats):  # pragma: no cover
    m = len(triangles)
    order = np.arange(m)
    centroids = np.empty((3, m))
    for t in range(m):
        for x in range(3):
            centroids[x, t] = triangles[t, 0, x] + triangles[t, 1, x] + triangles[t, 2, x]
    nodes = 2 * m + 1
    boxes = np.empty((nodes, 2, 3))
    spans = np.empty((nodes, 2), np.int64)
    children = np.full(nodes, -1)
    spans[0, 0], spans[0, 1] = 0, m
    count, node = 1, 0
    while node < count:
        start, stop = spans[node]
        boxes[node, 0] = np.inf
        boxes[node, 1] = -np.inf
        axis, widest = 0, -1.0
        for x in range(3):
            low, high = np.inf, -np.inf
            for s in range(start, stop):
                t = order[s]
                low, high = min(low, centroids[x, t]), max(high, centroids[x, t])
                for corner in range(3):
                    boxes[node, 0, x] = min(boxes[node, 0, x], triangles[t, corner, x])
                    boxes[node, 1, x] = max(boxes[node, 1, x], triangles[t, corner, x])
            if high - low > widest:
                axis, widest = x, high - low
        if stop - start > LEAF:
            middle = (start + stop) // 2
            _quickselect(centroids[axis], order, start, stop, middle)
            children[node] = count
            spans[count, 0], spans[count, 1] = start, middle
            spans[count + 1, 0], spans[count + 1, 1] = middle, stop
            count += 2
        node += 1
    corners = np.empty_like(triangles)
    for s in range(m):
        corners[s] = triangles[order[s]]
    return corners, order, boxes[:count].copy(), spans[:count].copy(), children[:count].copy()


def build_tree(triangles: Floats) -> AABBTree:
    """The box tree of triangles of shape (m, 3, 3), m >= 1."""
    return AABBTree(*_build(np.array(triangles, float)))


@njit(cache=True, inline="always")
def _offset_from_segment(px: float, py: float, pz: float, a: Floats, b: Floats):  # pragma: no cover
    """Offset from the nearest point of segment ab to p."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = px - a[0], py - a[1], pz - a[2]
    length = ux * ux + uy * uy + uz * uz
    t = 0.0
    if length > 0:
        t = min(1.0, max(0.0, (ux * wx + uy * wy + uz * wz) / length))
    return wx - t * ux, wy - t * uy, wz - t * uz


@njit(cache=True)
def _offset_from_sides(px: float, py: float, pz: float, corners: Floats):  # pragma: no cover
    """Offset from the nearest point of a triangle's three sides to p."""
    x, y, z = _offset_from_segment(px, py, pz, corners[0], corners[1])
    for side in range(1, 3):
        x2, y2, z2 = _offset_from_segment(px, py, pz, corners[side], corners[(side + 1) % 3])
        if x2 * x2 + y2 * y2 + z2 * z2 < x * x + y * y + z * z:
            x, y, z = x2, y2, z2
    return x, y, z


@njit(cache=True)
def offset_from_triangle(px: float, py: float, pz: float, corners: Floats):  # pragma: no cover
    """Vector from the nearest point of a triangle (3, 3) to p (Ericson 2005, section 5.1.5).

    Slivers are measured by their sides as well, and triangles without area by nothing else: barycentric
    weights and the normal are lost to rounding."""
    a, b, c = corners[0], corners[1], corners[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = px - a[0], py - a[1], pz - a[2]
    d1, d2 = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    if d1 <= 0 and d2 <= 0:
        return wx, wy, wz
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    d3, d4 = d1 - uu, d2 - uv
    if d3 >= 0 and d4 <= d3:
        return px - b[0], py - b[1], pz - b[2]
    d5, d6 = d1 - uv, d2 - vv
    if d6 >= 0 and d5 <= d6:
        return px - c[0], py - c[1], pz - c[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nn = nx * nx + ny * ny + nz * nz
    sliver = nn <= SLIVER * uu * vv
    tc, tb, ta = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if not sliver:
        if tc <= 0 and d1 >= 0 and d3 <= 0:
            t = d1 / uu
            return wx - t * ux, wy - t * uy, wz - t * uz
        if tb <= 0 and d2 >= 0 and d6 <= 0:
            t = d2 / vv
            return wx - t * vx, wy - t * vy, wz - t * vz
        if ta <= 0 and d4 >= d3 and d5 >= d6:
            t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
            return wx - ux - t * (vx - ux), wy - uy - t * (vy - uy), wz - uz - t * (vz - uz)
    if not sliver or (nn > FLAT * uu * vv and ta > 0 and tb > 0 and tc > 0):
        t = (nx * wx + ny * wy + nz * wz) / nn
        return t * nx, t * ny, t * nz
    return _offset_from_sides(px, py, pz, corners)


@njit(cache=True, inline="always")
def _box_distance2(px: float, py: float, pz: float, box: Floats):  # pragma: no cover
    """Squared distance from p to a box (2, 3)."""
    x = max(box[0, 0] - px, 0.0, px - box[1, 0])
    y = max(box[0, 1] - py, 0.0, py - box[1, 1])
    z = max(box[0, 2] - pz, 0.0, pz - box[1, 2])
    return x * x + y * y + z * z


@njit(cache=True)
def nearest_triangle(
    px: float, py: float, pz: float, tree: AABBTree, guess: int, limit: float, stack: Ints
):  # pragma: no cover
    """Leaf position of the triangle nearest to p and its squared distance, or guess and limit
    when nothing is nearer than that.

    guess: any leaf position; a near one (the neighbour's answer) prunes the search.
    limit: squared distance beyond which nobody asks.
    stack: scratch, at least the depth of the tree."""
    x, y, z = offset_from_triangle(px, py, pz, tree.corners[guess])
    best, found = min(limit, x * x + y * y + z * z), guess
    depth, node = 0, 0
    while True:
        child = tree.children[node]
        if child >= 0:
            first = _box_distance2(px, py, pz, tree.boxes[child])
            second = _box_distance2(px, py, pz, tree.boxes[child + 1])
            near, far = child, child + 1
            if second < first:
                near, far, first, second = far, near, second, first
            if second < best:
                stack[depth] = far
                depth += 1
            if first < best:
                node = near
                continue
        else:
            for s in range(tree.spans[node, 0], tree.spans[node, 1]):
                x, y, z = offset_from_triangle(px, py, pz, tree.corners[s])
                square = x * x + y * y + z * z
                if square < best:
                    best, found = square, s
        node = -1
        while depth > 0:
            depth -= 1
            if _box_distance2(px, py, pz, tree.boxes[stack[depth]]) < best:
                node = stack[depth]
                break
        if node < 0:
            return found, best


@njit(cache=True, inline="always")
def _segment_at(a: Floats, b: Floats, y: float):  # pragma: no cover
    """Where segment ab meets the plane at y: (x, z). The same bits for ab and ba, so that
    neighbouring triangles agree on where their shared edge is."""
    if b[1] < a[1] or (b[1] == a[1] and (b[0] < a[0] or (b[0] == a[0] and b[2] < a[2]))):
        a, b = b, a
    t = (y - a[1]) / (b[1] - a[1])
    return a[0] + t * (b[0] - a[0]), a[2] + t * (b[2] - a[2])


@njit(cache=True)
def slice_triangle(corners: Floats, y: float):  # pragma: no cover
    """The directed piece of a triangle in the plane at y: (there, x0, z0, x1, z1).

    A side counts when one end is below y and the other is not; so the pieces of a closed mesh
    form closed polygons whatever vertices and sides lie in the plane."""
    x0 = z0 = x1 = z1 = 0.0
    there = False
    for side in range(3):
        a, b = corners[side], corners[(side + 1) % 3]
        if a[1] < y and b[1] >= y:
            x0, z0 = _segment_at(a, b, y)
            there = True
        elif a[1] >= y and b[1] < y:
            x1, z1 = _segment_at(a, b, y)
            there = True
    return there, x0, z0, x1, z1


@njit(cache=True, inline="always")
def segment_height(x0: float, z0: float, x1: float, z1: float, x: float):  # pragma: no cover
    """Height at x of a piece that passes it. Clamped: a steep piece must not overshoot."""
    z = z0 + (x - x0) / (x1 - x0) * (z1 - z0)
    return min(max(z, min(z0, z1)), max(z0, z1))


@njit(cache=True)
def winding_number(px: float, py: float, pz: float, tree: AABBTree, stack: Ints):  # pragma: no cover
    """How many times the surface winds round p: signed crossings of the ray from p towards +z."""
    depth, turns = 1, 0
    stack[0] = 0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        box = tree.boxes[node]
        if px < box[0, 0] or px > box[1, 0] or py < box[0, 1] or py > box[1, 1] or pz > box[1, 2]:
            continue
        child = tree.children[node]
        if child >= 0:
            stack[depth], stack[depth + 1] = child, child + 1
            depth += 2
            continue
        for s in range(tree.spans[node, 0], tree.spans[node, 1]):
            there, x0, z0, x1, z1 = slice_triangle(tree.corners[s], py)
            if there and (x0 < px) != (x1 < px) and segment_height(x0, z0, x1, z1, px) > pz:
                turns += 1 if x1 < px else -1
    return turns
