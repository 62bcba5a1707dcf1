"""Convex parts that stand for a mesh in collisions: one hull, or several where one lies too much.

A hull of a part of a solid needs no boolean: the extreme points of `solid ∩ half-space` are vertices
of the solid and points where its edges cross the plane. So a solid is a *cycle* of triangles, a plane
clips it, and each cut is closed by a fan of signed triangles in the plane, which keeps the volume exact.
The fans also cover air, so only the skin (what is left of the mesh) has a say in the hull; where three
cuts meet inside the solid a corner is lost, which nothing can touch. Parts on two sides of a plane cannot
overlap.
"""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.types import Floats, Mesh

WHOLE_PARTS, WHOLE_EXCESS = 64, 0.05
"""Most parts of a whole shape, and how much hull volume [of the mesh volume] may be air."""
PIECE_PARTS, PIECE_EXCESS = 8, 0.20
"""The same for a fragment."""
SHRINK, GAP = 0.02, 0.002
"""How much nearer to its own centre the hull of a fragment is: this share, but at most `GAP` [m]. Hulls of
rough crack surfaces poke into their neighbours; without this gap they would push each other apart."""
DIRECTIONS = 64
"""A hull starts from the extreme points in this many directions ..."""
SAG = 0.001
"""... and takes in points that stand out further than this [m]: what a fragment may sink into a floor ..."""
ROUNDS = 3
"""... in this many rounds at most."""
LONG = 0.8
"""A part is cut across axes along which it is at least this fraction of its greatest length."""
CELLS = 48
"""Fragments are thinned to about this many vertices along their longest side before decomposition."""
MANY_FACES = 3000
"""Only meshes with more faces are thinned."""

_whole: WeakKeyDictionary[Mesh, Hulls] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Hulls:
    """Convex parts in the frame of the mesh that they stand for."""

    points: tuple[Floats, ...]
    """Extreme points of each part, shape (k, 3)."""
    excess: float
    """Total volume of the parts over the volume of the mesh, minus one."""


def whole_hulls(mesh: Mesh) -> Hulls:
    """Parts of an unbroken shape; computed once a mesh and process."""
    if mesh not in _whole:
        _whole[mesh] = _decompose(_thinned(mesh), WHOLE_PARTS, WHOLE_EXCESS)
    return _whole[mesh]


def piece_hulls(meshes: Iterable[Mesh]) -> list[Hulls]:
    """Parts of each fragment, slightly shrunk towards their own centres."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        return list(pool.map(_piece, meshes))


def _piece(mesh: Mesh) -> Hulls:
    hulls = _decompose(_thinned(mesh), PIECE_PARTS, PIECE_EXCESS)
    return Hulls(tuple(_shrunk(points) for points in hulls.points), hulls.excess)


def _shrunk(points: Floats) -> Floats:
    centre = points.mean(axis=0)
    reach = np.linalg.norm(points - centre, axis=1).max()
    return centre + (1 - min(SHRINK, GAP / reach)) * (points - centre)


@dataclass(frozen=True, eq=False)
class _Part:
    triangles: Floats
    skin: NDArray[np.bool_]
    """Which triangles lie in the mesh, not in a cut."""
    points: Floats
    excess: float
    """Volume of the hull that is not solid [m^3]."""


def _decompose(triangles: Floats, most: int, tolerance: float) -> Hulls:
    """Halve the part with the most air until the air left is `tolerance` of the volume."""
    volume = _volume(triangles)
    parts = [_part(triangles, np.ones(len(triangles), bool))]
    done: list[_Part] = []
    while parts and len(parts) + len(done) < most:
        if sum(part.excess for part in parts + done) <= tolerance * volume:
            break
        worst = max(range(len(parts)), key=lambda i: parts[i].excess)
        part = parts.pop(worst)
        halves = _halve(part)
        if len(halves) < 2:
            done.append(part)  # no plane through it leaves two solids
        else:
            parts += halves
    parts += done
    filled = [_filled(part) for part in parts]
    return Hulls(tuple(points for points, _ in filled), sum(hull for _, hull in filled) / volume - 1)


def _halve(part: _Part) -> list[_Part]:
    """The two sides of the middle plane across the axis (principal or frame) with the least air left.

    Only long axes are tried: slices of a hollow body are no easier than the whole, blocks of it are."""
    centred = part.points - part.points.mean(axis=0)
    axes = np.concatenate([np.linalg.eigh(centred.T @ centred)[1].T, np.eye(3)])
    along = part.points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    best: list[_Part] = []
    for i in np.flatnonzero(high - low >= LONG * (high - low).max()):
        sides = _clip(part.triangles, part.skin, np.ascontiguousarray(axes[i]), 0.5 * (low[i] + high[i]))
        halves = [_part(*side) for side in sides if side[1].sum() >= 2]
        if len(halves) == 2 and (not best or _air(halves) < _air(best)):
            best = halves
    return best


def _air(parts: list[_Part]) -> float:
    return sum(part.excess for part in parts)


def _part(triangles: Floats, skin: NDArray[np.bool_]) -> _Part:
    points, hull = _hull(triangles[skin].reshape(-1, 3))
    return _Part(triangles, skin, points, max(hull - _volume(triangles), 0.0))


def _hull(points: Floats) -> tuple[Floats, float]:
    """Extreme points among `points` in evenly spread directions, and the volume of their hull."""
    from scipy.spatial import ConvexHull

    extreme = points[np.unique(_support(np.ascontiguousarray(points), _sphere(DIRECTIONS)))]
    hull = ConvexHull(np.unique(extreme, axis=0), qhull_options="QJ")  # QJ: flat parts are parts too
    return hull.points[hull.vertices], float(hull.volume)


def _filled(part: _Part) -> tuple[Floats, float]:
    """The hull of a part with the points that its few directions have missed, and its volume."""
    from scipy.spatial import ConvexHull

    points = part.triangles[part.skin].reshape(-1, 3)
    corners = part.points
    volume = 0.0
    for _ in range(ROUNDS + 1):
        hull = ConvexHull(corners, qhull_options="QJ")
        faces = hull.equations  # x . n + d <= 0 inside
        volume = float(hull.volume)
        farthest = _support(points, np.ascontiguousarray(faces[:, :3]))
        over = np.einsum("fi,fi->f", points[farthest], faces[:, :3]) + faces[:, 3] > SAG
        if not over.any():
            break
        corners = np.unique(np.concatenate([corners, points[farthest[over]]]), axis=0)
    return corners, volume


def _sphere(n: int) -> Floats:
    """Evenly spread unit vectors (Fibonacci spiral)."""
    i = np.arange(n) + 0.5
    polar, turn = np.arccos(1 - 2 * i / n), np.pi * (1 + 5**0.5) * i
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)


def _volume(triangles: Floats) -> float:
    a, b, c = np.moveaxis(triangles, 1, 0)
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def _thinned(mesh: Mesh) -> Floats:
    """Triangles after merging the vertices of each cell of a grid. A closed cycle stays one."""
    if len(mesh.faces) <= MANY_FACES:
        return mesh.triangles
    low, high = mesh.bounds
    cell = np.floor((mesh.vertices - low) / ((high - low).max() / CELLS)).astype(np.int64)
    _, first, inverse = np.unique(cell @ np.array([1, 1 << 10, 1 << 20]), return_index=True, return_inverse=True)
    faces = first[inverse.reshape(-1)][mesh.faces]
    a, b, c = faces.T
    return mesh.vertices[faces[(a != b) & (b != c) & (c != a)]]


@njit(cache=True, nogil=True)
def _support(points, directions):
    """Index of the farthest point in each direction."""
    best = np.full(len(directions), -np.inf)
    index = np.zeros(len(directions), np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for d in range(len(directions)):
            reach = x * directions[d, 0] + y * directions[d, 1] + z * directions[d, 2]
            if reach > best[d]:
                best[d], index[d] = reach, i
    return index


@njit(cache=True, nogil=True)
def _clip(triangles, skin, normal, offset):
    """Both sides of the plane x . normal = offset, each closed in the plane: (below, above)."""
    n = len(triangles)
    sides = np.empty((2, 3 * n, 3, 3))
    skins = np.zeros((2, 3 * n), np.bool_)
    count = np.zeros(2, np.int64)
    cuts = np.empty((n, 2, 3))
    cut = 0
    reach = np.empty(3)
    for t in range(n):
        for v in range(3):
            reach[v] = triangles[t, v, 0] * normal[0] + triangles[t, v, 1] * normal[1]
            reach[v] += triangles[t, v, 2] * normal[2] - offset
        above = reach >= 0
        if above[0] == above[1] and above[1] == above[2]:
            side = 1 if above[0] else 0
            sides[side, count[side]] = triangles[t]
            skins[side, count[side]] = skin[t]
            count[side] += 1
            continue
        i = 0  # the corner alone on its side
        if above[0] == above[2]:
            i = 1
        elif above[0] == above[1]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        a, b, c = triangles[t, i], triangles[t, j], triangles[t, k]
        p = a + (b - a) * (reach[i] / (reach[i] - reach[j]))
        q = a + (c - a) * (reach[i] / (reach[i] - reach[k]))
        side = 1 if above[i] else 0
        other = 1 - side
        m, o = count[side], count[other]
        sides[side, m, 0], sides[side, m, 1], sides[side, m, 2] = a, p, q
        sides[other, o, 0], sides[other, o, 1], sides[other, o, 2] = p, b, c
        sides[other, o + 1, 0], sides[other, o + 1, 1], sides[other, o + 1, 2] = p, c, q
        skins[side, m], skins[other, o], skins[other, o + 1] = skin[t], skin[t], skin[t]
        count[side] += 1
        count[other] += 2
        # The boundary of the side below runs from p to q where it holds the lone corner, else back.
        cuts[cut, side], cuts[cut, other] = p, q
        cut += 1
    _close(sides, count, cuts[:cut])
    low, high = count[0], count[1]
    return (sides[0, :low].copy(), skins[0, :low].copy()), (sides[1, :high].copy(), skins[1, :high].copy())


@njit(cache=True, nogil=True)
def _close(sides, count, cuts):
    """Close both sides of a plane with a fan over the segments in which it cut."""
    apex = np.zeros(3)
    for s in range(len(cuts)):
        apex += (cuts[s, 0] + cuts[s, 1]) / (2 * len(cuts))
    for s in range(len(cuts)):
        p, q = cuts[s, 0], cuts[s, 1]
        m, o = count[0], count[1]
        sides[0, m, 0], sides[0, m, 1], sides[0, m, 2] = q, p, apex
        sides[1, o, 0], sides[1, o, 1], sides[1, o, 2] = p, q, apex
        count += 1
