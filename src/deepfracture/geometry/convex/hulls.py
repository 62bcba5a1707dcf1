"""Convex parts that stand for a mesh in collisions: one hull, or several where one encloses too much excess volume.

Fragments are decomposed by the kernel `decompose`; whole shapes by `_decompose`, which tries several axes for each cut.
The kernel would take a tenth of the time or less for whole shapes too (pot: 88 ms, not 1342 ms), but its hulls hold
more excess volume (a cow's 13 %, not 5 %), and other hulls change every recording.

A hull of a part of a solid needs no boolean: the extreme points of `solid ∩ half-space` are vertices
of the solid and points where its edges cross the plane. So a solid is a *cycle* of triangles, a plane
clips it, and each cut is closed by a fan of signed triangles in the plane, which keeps the volume exact.
The fans also cover empty space, so only the surface (what is left of the mesh) has a say in the hull; where three
cuts meet inside the solid a corner is lost, which nothing can touch. Parts on two sides of a plane cannot
overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry.convex.decompose import decompose
from deepfracture.geometry.convex.polytope import clip
from deepfracture.geometry.convex.separate import separate
from deepfracture.runtime.parallel import parallel_map
from deepfracture.types import Floats, Ints, Mesh

SHAPE_PARTS, SHAPE_EXCESS = 64, 0.05
"""Most parts of a whole shape, and the excess volume of its hulls [of the mesh volume] that is good enough."""
FRAGMENT_PARTS, FRAGMENT_EXCESS = 16, 0.15
"""The same for a fragment."""
SHRINK, GAP = 0.02, 0.002
"""How much nearer to its own centre the hull of a fragment is: this share, but at most `GAP` [m]. What then still
overlaps a neighbour is cut off (see `separate`)."""
DIRECTIONS = 64
"""A hull starts from the extreme points in this many directions ..."""
HULL_TOL = 0.001
"""... and takes in points that lie farther outside than this [m] ..."""
ROUNDS = 3
"""... in this many rounds at most."""
MIN_LENGTH_SHARE = 0.8
"""A part is cut across axes along which it is at least this fraction of its greatest length."""
FRAGMENT_HULL_TOL = 0.004
"""The same for a fragment: what it may penetrate a floor [m]."""
CELLS = 48
"""Shapes are thinned to about this many vertices along their longest side before decomposition."""
MANY_FACES = 3000
"""Only meshes with more faces are thinned."""

_shape_hulls: WeakKeyDictionary[Mesh, Hulls] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Hulls:
    """Convex parts in the frame of the mesh that they stand for."""

    points: tuple[Floats, ...]
    """Extreme points of each part, shape (k, 3)."""
    excess: float
    """Total volume of the parts over the volume of the mesh, minus one."""


def shape_hulls(mesh: Mesh) -> Hulls:
    """Parts of an unbroken shape; computed once a mesh and process."""
    if mesh not in _shape_hulls:
        _shape_hulls[mesh] = _decompose(_clustered(mesh), SHAPE_PARTS, SHAPE_EXCESS)
    return _shape_hulls[mesh]


def fragment_hulls(meshes: Sequence[Mesh]) -> list[Hulls]:
    """Parts of each fragment, slightly shrunk towards their own centres, that do not overlap those of another."""
    found = parallel_map(lambda n: _fragment_parts(meshes[n]), [len(mesh.faces) for mesh in meshes])
    each = np.concatenate([starts[1:] - starts[:-1] for _, starts, _ in found])
    starts = np.concatenate([[0], np.cumsum(each)])
    counts = np.array([len(starts) - 1 for _, starts, _ in found])
    triangles = np.concatenate([own for own, _, _ in found])
    points, ends, volumes = separate(triangles, starts, np.repeat(np.arange(len(found)), counts))
    hulls = [points[low:high] for low, high in pairwise(ends)]
    last = np.cumsum(counts)
    return [
        Hulls(tuple(hulls[low:high]), float(volumes[low:high].sum()) / solid - 1)
        for low, high, (_, _, solid) in zip(last - counts, last, found, strict=True)
    ]


def _fragment_parts(mesh: Mesh) -> tuple[Floats, Ints, float]:
    """Triangles of the shrunk hulls, where each begins, and the volume of the mesh."""
    return decompose(mesh.vertices, mesh.faces, FRAGMENT_PARTS, FRAGMENT_EXCESS, FRAGMENT_HULL_TOL, SHRINK, GAP)


@dataclass(frozen=True, eq=False)
class _Part:
    triangles: Floats
    surface: NDArray[np.bool_]
    """Which triangles lie in the mesh, not in a cut."""
    points: Floats
    excess: float
    """Volume of the hull that is not solid [m^3]."""


def _decompose(triangles: Floats, max_parts: int, tolerance: float) -> Hulls:
    """Halve the part with the most excess volume until what is left is `tolerance` of the volume."""
    volume = _volume(triangles)
    parts = [_part(triangles, np.ones(len(triangles), bool))]
    done: list[_Part] = []
    while parts and len(parts) + len(done) < max_parts:
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
    filled = [_refined_hull(part) for part in parts]
    return Hulls(tuple(points for points, _ in filled), sum(hull for _, hull in filled) / volume - 1)


def _halve(part: _Part) -> list[_Part]:
    """The two sides of the middle plane across the axis (principal or frame) with the least excess volume left.

    Only long axes are tried: slices of a hollow body are no easier than the whole, blocks of it are."""
    centred = part.points - part.points.mean(axis=0)
    axes = np.concatenate([np.linalg.eigh(centred.T @ centred)[1].T, np.eye(3)])
    along = part.points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    best: list[_Part] = []
    for i in np.flatnonzero(high - low >= MIN_LENGTH_SHARE * (high - low).max()):
        below, above, _ = clip(part.triangles, part.surface, np.ascontiguousarray(axes[i]), 0.5 * (low[i] + high[i]))
        halves = [_part(*side) for side in (below, above) if side[1].sum() >= 2]
        if len(halves) == 2 and (not best or _total_excess(halves) < _total_excess(best)):
            best = halves
    return best


def _total_excess(parts: list[_Part]) -> float:
    return sum(part.excess for part in parts)


def _part(triangles: Floats, surface: NDArray[np.bool_]) -> _Part:
    points, hull = _hull(triangles[surface].reshape(-1, 3))
    return _Part(triangles, surface, points, max(hull - _volume(triangles), 0.0))


def _hull(points: Floats) -> tuple[Floats, float]:
    """Extreme points among `points` in evenly spread directions, and the volume of their hull."""
    from scipy.spatial import ConvexHull

    extreme = points[np.unique(_support(np.ascontiguousarray(points), _sphere(DIRECTIONS)))]
    hull = ConvexHull(np.unique(extreme, axis=0), qhull_options="QJ")  # QJ: flat parts are parts too
    return hull.points[hull.vertices], float(hull.volume)


def _refined_hull(part: _Part) -> tuple[Floats, float]:
    """The hull of a part with the points that its few directions have missed, and its volume."""
    from scipy.spatial import ConvexHull

    points = part.triangles[part.surface].reshape(-1, 3)
    corners = part.points
    volume = 0.0
    for _ in range(ROUNDS + 1):
        hull = ConvexHull(corners, qhull_options="QJ")
        faces = hull.equations  # x . n + d <= 0 inside
        volume = float(hull.volume)
        farthest = _support(points, np.ascontiguousarray(faces[:, :3]))
        over = np.einsum("fi,fi->f", points[farthest], faces[:, :3]) + faces[:, 3] > HULL_TOL
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


def _clustered(mesh: Mesh) -> Floats:
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
