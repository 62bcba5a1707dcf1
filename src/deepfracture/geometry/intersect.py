"""Faces of one mesh that run through each other."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.geometry.aabb_tree import STACK, AABBTree, build_tree
from deepfracture.types import BadInput, Floats, Ints, Mesh

TOUCH_TOL = 2e-9
"""Depth [m] up to which faces merely touch: 1e-9 of a shape's box, far above the noise of float64 (1e-15)."""
PLANE_TOL = 1e-13
"""Distance [m] from a common plane up to which faces lie in it: what rounding leaves of a plane."""
MIN_ALTITUDE = 1e-6
"""Altitude [m] from which a face has a plane that others can be told to lie beside."""
MIN_SIDE = 1e-3
"""Side of a box [m] from which faces beyond it do not lie in one plane with the face but for rounding, nor cross it."""
HUB_VALENCE = 64
"""Faces round a vertex from which they are told apart by direction: all their boxes meet in the vertex."""
ARC_TOL = 1e-6
"""Angle between faces round a hub beyond which they meet in the hub alone: far above what rounding does to an angle."""


def self_intersections(mesh: Mesh, *, tolerance: float = TOUCH_TOL, most: int | None = None) -> Ints:
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
    tree, hub = build_tree(mesh.triangles), _hubs(mesh)
    pairs = _intersecting_pairs(tree, tree.corners, *_boxes(tree.corners, tolerance), hub[tree.order], tolerance, limit)
    for vertex in np.unique(hub[hub >= 0]):
        near = _pairs_around_hub(mesh, vertex, np.flatnonzero(hub == vertex), tolerance, limit - len(pairs))
        pairs = np.concatenate([pairs, near])
    pairs = np.sort(pairs, axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _hubs(mesh: Mesh) -> Ints:
    """For each face its vertex with the most faces, if that is a hub, else -1, shape (m,)."""
    degrees = np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices))[mesh.faces]
    corner = degrees.argmax(axis=1)
    rows = np.arange(len(corner))
    return np.where(degrees[rows, corner] >= HUB_VALENCE, mesh.faces[rows, corner], -1)


def _pairs_around_hub(mesh: Mesh, hub: int, faces: Ints, tolerance: float, most: int) -> Ints:
    """Pairs among faces that have a hub as a corner.

    They fill cones whose tip is the hub, so they have more than it in common only where these do: where the arcs meet
    in which they are seen from the hub. A tree of the boxes of arcs finds these."""
    low, high = _boxes(mesh.triangles[faces], tolerance)
    faces = faces[low[:, 0] <= high[:, 0]]
    others = mesh.faces[faces]
    first = (others == hub).argmax(axis=1)[:, None]
    ends = mesh.vertices[np.take_along_axis(others, (first + np.arange(1, 3)) % 3, axis=1)] - mesh.vertices[hub]
    ends /= np.linalg.norm(ends, axis=2, keepdims=True)
    # As far as the middle of an arc of the unit circle is from that of its chord.
    bulge = 1 - 0.5 * np.linalg.norm(ends.sum(axis=1), axis=1)[:, None] + ARC_TOL
    low, high = ends.min(axis=1) - bulge, ends.max(axis=1) + bulge
    if len(faces) < 2:
        return np.zeros((0, 2), np.int64)
    tree = build_tree(np.stack([low, high, high], axis=1))
    corners, none = mesh.triangles[faces[tree.order]], np.full(len(faces), -1)
    return faces[_intersecting_pairs(tree, corners, low[tree.order], high[tree.order], none, tolerance, most)]


@njit(cache=True)
def _intersecting_pairs(
    tree: AABBTree, corners: Floats, low: Floats, high: Floats, hub: Ints, tolerance: float, most: int
):  # pragma: no cover
    """Unordered pairs of crossing faces, up to `most`, but for those with a hub in common. Each leaf position looks for
    partners behind itself.

    corners, low, high, hub: The faces, their boxes and hubs (-1: none) in the order of the leaves."""
    found, count = np.empty((64, 2), np.int64), 0
    stack = np.empty(STACK, np.int64)
    normals = _unit_normals(corners)
    inner_low, inner_high = _open_boxes(low, high)
    same = np.arange(1, len(hub) + 1)  # the end of the run of faces with one hub
    for s in range(len(hub) - 2, -1, -1):
        if hub[s] == hub[s + 1]:
            same[s] = same[s + 1]
    for s in range(len(corners)):
        if low[s, 0] > high[s, 0]:
            continue
        depth, stack[0] = 1, 0
        while depth > 0:
            depth -= 1
            node = stack[depth]
            start, stop = max(s + 1, tree.spans[node, 0]), tree.spans[node, 1]
            if stop <= start or not _boxes_overlap(
                tree.boxes[node, 0], tree.boxes[node, 1], inner_low[s], inner_high[s]
            ):
                continue
            if hub[s] >= 0 and hub[start] == hub[s] and same[start] >= stop:
                continue
            child = tree.children[node]
            if child >= 0:
                stack[depth], stack[depth + 1] = child, child + 1
                depth += 2
                continue
            for t in range(start, stop):
                if (
                    (hub[s] < 0 or hub[s] != hub[t])
                    and _boxes_overlap(low[t], high[t], inner_low[s], inner_high[s])
                    and not _on_one_side(normals, corners, s, t, tolerance)
                    and not _on_one_side(normals, corners, t, s, tolerance)
                    and _triangles_intersect(corners[s], corners[t], tolerance)
                ):
                    if count == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[count, 0], found[count, 1] = tree.order[s], tree.order[t]
                    count += 1
                    if count >= most:
                        return found[:count].copy()
    return found[:count].copy()


@njit(cache=True)
def _open_boxes(low: Floats, high: Floats):  # pragma: no cover
    """Boxes without their sides, where these are WIDE apart: what only touches those does not cross.

    In a flat one nearly all faces of a common plane touch."""
    slack = np.where(high - low > MIN_SIDE, PLANE_TOL, 0.0)
    return low + slack, high - slack


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
def _unit_normals(corners: Floats):  # pragma: no cover
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
        if length * length > MIN_ALTITUDE * MIN_ALTITUDE * longest:
            normals[t, 0], normals[t, 1], normals[t, 2] = x / length, y / length, z / length
    return normals


@njit(cache=True, inline="always")
def _on_one_side(normals: Floats, corners: Floats, s: int, t: int, tolerance: float):  # pragma: no cover
    """Whether triangle t lies on one side of the plane of s, if s has one: then `_triangles_intersect` is False.

    Fast: in a fan of n faces all n^2 pairs come this far."""
    x, y, z = normals[s, 0], normals[s, 1], normals[s, 2]
    base = x * corners[s, 0, 0] + y * corners[s, 0, 1] + z * corners[s, 0, 2]
    a = x * corners[t, 0, 0] + y * corners[t, 0, 1] + z * corners[t, 0, 2] - base
    b = x * corners[t, 1, 0] + y * corners[t, 1, 1] + z * corners[t, 1, 2] - base
    c = x * corners[t, 2, 0] + y * corners[t, 2, 1] + z * corners[t, 2, 2] - base
    low, high = min(a, b, c), max(a, b, c)
    # A face that lies in the plane of a smaller one leaves it by less than FIRM.
    return high - low > 4 * MIN_ALTITUDE and (low > -0.5 * tolerance or high < 0.5 * tolerance)


@njit(cache=True, inline="always")
def _boxes_overlap(low: Floats, high: Floats, other_low: Floats, other_high: Floats):  # pragma: no cover
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
def _projection(x: float, y: float, z: float, t: Floats, origin: Floats):  # pragma: no cover
    """Least and greatest coordinate of a triangle along an axis."""
    a = x * (t[0, 0] - origin[0]) + y * (t[0, 1] - origin[1]) + z * (t[0, 2] - origin[2])
    b = x * (t[1, 0] - origin[0]) + y * (t[1, 1] - origin[1]) + z * (t[1, 2] - origin[2])
    c = x * (t[2, 0] - origin[0]) + y * (t[2, 1] - origin[1]) + z * (t[2, 2] - origin[2])
    return min(a, b, c), max(a, b, c)


@njit(cache=True)
def _triangles_intersect(p: Floats, q: Floats, tolerance: float):  # pragma: no cover
    """Whether triangles that are not degenerate cross or overlap.

    By the axes that can part two convex bodies (Gottschalk, Lin & Manocha 1996): the two normals and the products of
    their sides. The origin lies as deep in the Minkowski difference as the shallowest of them says."""
    origin, limit, parted = p[0], tolerance * tolerance, False
    for n in range(2):
        t = p if n == 0 else q
        x, y, z = _cross_product(t[0], t[1], t[0], t[2])
        square = x * x + y * y + z * z
        low_p, high_p = _projection(x, y, z, p, origin)
        low_q, high_q = _projection(x, y, z, q, origin)
        thick = max(high_p, high_q) - min(low_p, low_q)
        if thick * thick <= PLANE_TOL * PLANE_TOL * square:
            return _coplanar_overlap(x, y, z, p, q, limit)
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
            low_p, high_p = _projection(x, y, z, p, origin)
            low_q, high_q = _projection(x, y, z, q, origin)
            deep = min(high_p - low_q, high_q - low_p)
            if deep <= 0 or deep * deep <= limit * square:
                return False
    return True


@njit(cache=True)
def _coplanar_overlap(x: float, y: float, z: float, p: Floats, q: Floats, limit: float):  # pragma: no cover
    """Whether triangles in one plane with this normal have more in common than a line, by the normals of all sides."""
    for n in range(6):
        t = p if n < 3 else q
        a, b = t[n % 3], t[(n + 1) % 3]
        vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        ux, uy, uz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
        low_p, high_p = _projection(ux, uy, uz, p, p[0])
        low_q, high_q = _projection(ux, uy, uz, q, p[0])
        common = min(high_p, high_q) - max(low_p, low_q)
        if common <= 0 or common * common <= limit * (ux * ux + uy * uy + uz * uz):
            return False
    return True
