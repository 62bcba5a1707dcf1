"""Faces of one mesh that run through each other."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.geometry.kernels import STACK, Tree, tree_of
from deepfracture.types import BadInput, Floats, Ints, Mesh

TOUCH = 2e-9
"""Depth [m] up to which faces merely touch: 1e-9 of a shape's box, far above the noise of float64 (1e-15)."""
FLAT = 1e-13
"""Distance [m] from a common plane up to which faces lie in it: what rounding leaves of a plane."""
FIRM = 1e-6
"""Altitude [m] from which a face has a plane that others can be told to lie beside."""


def self_intersections(mesh: Mesh, *, tolerance: float = TOUCH, most: int | None = None) -> Ints:
    """Pairs of faces that cross each other, or overlap in one plane.

    Two faces cross when no shift of `tolerance` or less would part them. So whatever they share does not count, be it
    an edge, a vertex, or merely a position: neighbours cross only elsewhere than in what they share, and surfaces that
    touch - in a pinch point, a vertex on a face, an edge on an edge - do not cross. Faces within FLAT of one plane
    overlap when what they have in common is wider than `tolerance`; doubled faces and flat folds do. Faces that are
    lower than `tolerance` are left out: they have no inside to cross, and their neighbours have the same edges. A
    surface that passes through another in nothing but whole edges, each lying in the other to within `tolerance`,
    touches it by this rule.

    Args:
        tolerance: [m]
        most: Pairs after which the search ends, whatever is left; None: all are found. In a heap of n faces in one
            plane there may be n^2.

    Returns:
        Faces i < j of each pair, in ascending order, shape (k, 2).

    Raises:
        BadInput: `tolerance` is not positive.
    """
    if not tolerance > 0:
        raise BadInput(f"tolerance must be positive, got {tolerance}")
    if len(mesh.faces) < 2:
        return np.zeros((0, 2), np.int64)
    limit = np.iinfo(np.int64).max if most is None else most
    pairs = np.sort(_crossings(tree_of(mesh.triangles), tolerance, limit), axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


@njit(cache=True)
def _crossings(tree: Tree, tolerance: float, most: int):  # pragma: no cover
    """Unordered pairs of crossing faces, up to `most`. Each leaf position looks for partners behind itself."""
    found, count = np.empty((64, 2), np.int64), 0
    corners = tree.corners
    stack = np.empty(STACK, np.int64)
    low, high = _boxes(corners, tolerance)
    normals = _planes(corners)
    for s in range(len(corners)):
        if low[s, 0] > high[s, 0]:
            continue
        depth, stack[0] = 1, 0
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if tree.spans[node, 1] <= s + 1 or not _meet(tree.boxes[node, 0], tree.boxes[node, 1], low[s], high[s]):
                continue
            child = tree.children[node]
            if child >= 0:
                stack[depth], stack[depth + 1] = child, child + 1
                depth += 2
                continue
            for t in range(max(s + 1, tree.spans[node, 0]), tree.spans[node, 1]):
                if (
                    _meet(low[t], high[t], low[s], high[s])
                    and not _beside(normals, corners, s, t, tolerance)
                    and _cross(corners[s], corners[t], tolerance)
                ):
                    if count == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[count, 0], found[count, 1] = tree.order[s], tree.order[t]
                    count += 1
                    if count >= most:
                        return found[:count].copy()
    return found[:count].copy()


@njit(cache=True)
def _boxes(corners: Floats, tolerance: float):  # pragma: no cover
    """Lower and upper corner of each triangle's box; the wrong way round for triangles to leave out."""
    low, high = np.empty((len(corners), 3)), np.empty((len(corners), 3))
    for t in range(len(corners)):
        p = corners[t]
        longest = 0.0
        for a in range(3):
            low[t, a], high[t, a] = min(p[0, a], p[1, a], p[2, a]), max(p[0, a], p[1, a], p[2, a])
            side = 0.0
            for x in range(3):
                side += (p[(a + 1) % 3, x] - p[a, x]) ** 2
            longest = max(longest, side)
        x, y, z = _cross_product(p[0], p[1], p[0], p[2])
        if x * x + y * y + z * z <= tolerance * tolerance * longest:
            low[t], high[t] = np.inf, -np.inf
    return low, high


@njit(cache=True)
def _planes(corners: Floats):  # pragma: no cover
    """Unit normals of the faces; zero where they are not FIRM."""
    normals = np.zeros((len(corners), 3))
    for t in range(len(corners)):
        p, longest = corners[t], 0.0
        for a in range(3):
            side = 0.0
            for x in range(3):
                side += (p[(a + 1) % 3, x] - p[a, x]) ** 2
            longest = max(longest, side)
        x, y, z = _cross_product(p[0], p[1], p[0], p[2])
        length = np.sqrt(x * x + y * y + z * z)
        if length * length > FIRM * FIRM * longest:
            normals[t, 0], normals[t, 1], normals[t, 2] = x / length, y / length, z / length
    return normals


@njit(cache=True, inline="always")
def _beside(normals: Floats, corners: Floats, s: int, t: int, tolerance: float):  # pragma: no cover
    """Whether triangle t lies on one side of the plane of s, if that is firm, and not in it: `_cross` would say no.

    Quick, for in a fan of n faces all n^2 pairs come as far as this."""
    x, y, z = normals[s, 0], normals[s, 1], normals[s, 2]
    base = x * corners[s, 0, 0] + y * corners[s, 0, 1] + z * corners[s, 0, 2]
    a = x * corners[t, 0, 0] + y * corners[t, 0, 1] + z * corners[t, 0, 2] - base
    b = x * corners[t, 1, 0] + y * corners[t, 1, 1] + z * corners[t, 1, 2] - base
    c = x * corners[t, 2, 0] + y * corners[t, 2, 1] + z * corners[t, 2, 2] - base
    low, high = min(a, b, c), max(a, b, c)
    # A face that lies in the plane of a smaller one leaves it by less than FIRM.
    return high - low > 4 * FIRM and (low > -0.5 * tolerance or high < 0.5 * tolerance)


@njit(cache=True, inline="always")
def _meet(low: Floats, high: Floats, other_low: Floats, other_high: Floats):  # pragma: no cover
    apart = False
    for a in range(3):
        apart = apart or low[a] > other_high[a] or other_low[a] > high[a]
    return not apart


@njit(cache=True, inline="always")
def _cross_product(a: Floats, b: Floats, c: Floats, d: Floats):  # pragma: no cover
    """(b - a) x (d - c)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = d[0] - c[0], d[1] - c[1], d[2] - c[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@njit(cache=True, inline="always")
def _span(x: float, y: float, z: float, t: Floats, origin: Floats):  # pragma: no cover
    """Least and greatest coordinate of a triangle along an axis."""
    a = x * (t[0, 0] - origin[0]) + y * (t[0, 1] - origin[1]) + z * (t[0, 2] - origin[2])
    b = x * (t[1, 0] - origin[0]) + y * (t[1, 1] - origin[1]) + z * (t[1, 2] - origin[2])
    c = x * (t[2, 0] - origin[0]) + y * (t[2, 1] - origin[1]) + z * (t[2, 2] - origin[2])
    return min(a, b, c), max(a, b, c)


@njit(cache=True)
def _cross(p: Floats, q: Floats, tolerance: float):  # pragma: no cover
    """Whether triangles that are not degenerate cross or overlap.

    By the axes that can part two convex bodies (Gottschalk, Lin & Manocha 1996): the two normals and the products of
    their sides. The origin lies as deep in the Minkowski difference as the shallowest of them says."""
    origin, limit, parted = p[0], tolerance * tolerance, False
    for n in range(2):
        t = p if n == 0 else q
        x, y, z = _cross_product(t[0], t[1], t[0], t[2])
        square = x * x + y * y + z * z
        low_p, high_p = _span(x, y, z, p, origin)
        low_q, high_q = _span(x, y, z, q, origin)
        thick = max(high_p, high_q) - min(low_p, low_q)
        if thick * thick <= FLAT * FLAT * square:
            return _overlap(x, y, z, p, q, limit)
        deep = min(high_p - low_q, high_q - low_p)
        parted = parted or deep <= 0 or deep * deep <= limit * square
    if parted:
        return False
    for a in range(3):
        for b in range(3):
            x, y, z = _cross_product(p[a], p[(a + 1) % 3], q[b], q[(b + 1) % 3])
            square = x * x + y * y + z * z
            if square == 0:
                continue
            low_p, high_p = _span(x, y, z, p, origin)
            low_q, high_q = _span(x, y, z, q, origin)
            deep = min(high_p - low_q, high_q - low_p)
            if deep <= 0 or deep * deep <= limit * square:
                return False
    return True


@njit(cache=True)
def _overlap(x: float, y: float, z: float, p: Floats, q: Floats, limit: float):  # pragma: no cover
    """Whether triangles in one plane with this normal have more in common than a line, by the normals of all sides."""
    normal, nothing = np.array((x, y, z)), np.zeros(3)
    for n in range(6):
        t = p if n < 3 else q
        ux, uy, uz = _cross_product(nothing, normal, t[n % 3], t[(n + 1) % 3])
        low_p, high_p = _span(ux, uy, uz, p, p[0])
        low_q, high_q = _span(ux, uy, uz, q, p[0])
        common = min(high_p, high_q) - max(low_p, low_q)
        if common <= 0 or common * common <= limit * (ux * ux + uy * uy + uz * uz):
            return False
    return True
