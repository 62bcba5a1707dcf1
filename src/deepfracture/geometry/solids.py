"""Ways to make solids: turned on a lathe, rounded boxes, tubes, and their unions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from deepfracture.geometry.topology import compact, weld
from deepfracture.types import Floats, Mesh


def resample(points: ArrayLike, length: float) -> Floats:
    """A curve through `points` (n, d) in even steps of about `length`, both ends kept."""
    points = np.asarray(points, float)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, along[-1], max(2, round(along[-1] / length) + 1))
    return np.column_stack([np.interp(at, along, column) for column in points.T])


def spline(points: ArrayLike) -> Floats:
    """A smooth curve through `points` (n, d), finely sampled."""
    from scipy.interpolate import CubicSpline

    points = np.asarray(points, float)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return CubicSpline(along, points)(np.linspace(0, along[-1], 400))


def fillet(before: ArrayLike, corner: ArrayLike, after: ArrayLike) -> Floats:
    """A quadratic curve that rounds `corner` between two points, finely sampled."""
    t = np.linspace(0, 1, 40)[:, None]
    before, corner, after = (np.asarray(p, float) for p in (before, corner, after))
    return (1 - t) ** 2 * before + 2 * t * (1 - t) * corner + t**2 * after


def _stitch_rings(inner: Floats, outer: Floats, first: int, second: int) -> list[tuple[int, int, int]]:
    """Triangles between two rings of vertices given by their angles, numbered from first and second."""
    if len(inner) == 1:
        return [(first, second + i, second + (i + 1) % len(outer)) for i in range(len(outer))]
    if len(outer) == 1:
        return [(first + (i + 1) % len(inner), first + i, second) for i in range(len(inner))]
    made, i, j = [], 0, 0
    while i < len(inner) or j < len(outer):
        a, b = first + i % len(inner), second + j % len(outer)
        next_inner = _next_angle(inner, i)
        next_outer = _next_angle(outer, j)
        if next_outer <= next_inner:
            made.append((a, b, second + (j + 1) % len(outer)))
            j += 1
        else:
            made.append((a, b, first + (i + 1) % len(inner)))
            i += 1
    return made


def _next_angle(ring: Floats, index: int) -> float:
    if index >= len(ring):
        return np.inf
    return ring[index + 1] if index + 1 < len(ring) else ring[0] + 2 * np.pi


def revolve(pieces: Sequence[Floats], length: float) -> Mesh:
    """A solid of revolution about z with triangles of about one size.

    pieces: curves (n, 2) of (radius, z) that join end to end from the axis at the bottom, round
    the outside, back to the axis; corners where they join stay sharp. length: edge length."""
    profile = np.concatenate([resample(piece, length * np.sqrt(3) / 2)[:-1] for piece in pieces] + [pieces[-1][-1:]])
    rings: list[Floats] = []
    vertices: list[Floats] = []
    faces: list[tuple[int, int, int]] = []
    start = 0
    for n, (radius, z) in enumerate(profile):
        count = 1 if radius < 1e-9 else max(6, round(2 * np.pi * radius / length))
        # Every second ring is turned by half a step, so that triangles come out equilateral.
        angles = (np.arange(count) + 0.5 * (n % 2)) * 2 * np.pi / count
        vertices.append(np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, z)]))
        if n:
            faces += _stitch_rings(rings[-1], angles, start - len(rings[-1]), start)
        rings.append(angles)
        start += count
    mesh = Mesh(np.concatenate(vertices), np.array(faces))
    return mesh if mesh.volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def box(size: ArrayLike, length: float) -> Mesh:
    """A box round the origin with a regular triangulation of about `length`."""
    half = np.asarray(size, float) / 2
    vertices, faces, start = [], [], 0
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        nu, nv = (max(1, round(2 * half[x] / length)) for x in (u, v))
        gu, gv = np.meshgrid(
            np.linspace(-half[u], half[u], nu + 1), np.linspace(-half[v], half[v], nv + 1), indexing="ij"
        )
        index = np.arange(gu.size).reshape(gu.shape)
        a, b, c, d = (x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
        sheet = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
        for side in (-1, 1):
            points = np.empty((gu.size, 3))
            points[:, axis], points[:, u], points[:, v] = side * half[axis], gu.ravel(), gv.ravel()
            vertices.append(points)
            faces.append((sheet if side > 0 else sheet[:, ::-1]) + start)
            start += gu.size
    return weld(np.concatenate(vertices), np.concatenate(faces))


def extruded_quads(quads: Sequence[tuple[ArrayLike, int, int]], depth: float, layers: int) -> Mesh:
    """A plate in the xz plane, centred on y = 0, from quads with regular triangulations.

    quads: (corners (4, 2) of (x, z), counter-clockwise; steps along the first side; along the
    second). Quads that share a side must divide it alike. layers: steps through the depth."""
    points, quadrangles, start = [], [], 0
    for corners, nu, nv in quads:
        p = np.asarray(corners, float)
        u, v = np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1), indexing="ij")
        u, v = u[..., None], v[..., None]
        grid = (1 - v) * ((1 - u) * p[0] + u * p[1]) + v * ((1 - u) * p[3] + u * p[2])
        index = np.arange(grid[..., 0].size).reshape(nu + 1, nv + 1) + start
        points.append(grid.reshape(-1, 2))
        quadrangles.append(
            np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)
        )
        start += (nu + 1) * (nv + 1)
    flat = np.concatenate(points)
    flat, same = np.unique(flat.round(9), axis=0, return_inverse=True)
    quad = same.reshape(-1)[np.concatenate(quadrangles)]
    sides = quad[:, [0, 1, 1, 2, 2, 3, 3, 0]].reshape(-1, 2)
    shared = set(map(tuple, sides.tolist()))
    rim = np.array([side for side in sides.tolist() if (side[1], side[0]) not in shared])
    y = np.linspace(-depth / 2, depth / 2, layers + 1)
    vertices = np.concatenate([np.column_stack([flat[:, 0], np.full(len(flat), at), flat[:, 1]]) for at in y])
    last = layers * len(flat)
    square = [quad, quad[:, ::-1] + last]
    for layer in range(layers):
        a, b = rim[:, 0] + layer * len(flat), rim[:, 1] + layer * len(flat)
        square.append(np.column_stack([b, a, a + len(flat), b + len(flat)]))
    all_quads = np.concatenate(square)
    return compact(vertices, np.concatenate([all_quads[:, [0, 1, 2]], all_quads[:, [0, 2, 3]]]))


def union_of_boxes(lines: Sequence[ArrayLike], boxes: Sequence[tuple[ArrayLike, ArrayLike]]) -> Mesh:
    """The union of boxes whose sides lie on the planes of a grid, with that grid as triangulation.

    lines: the planes' positions along x, y, z. boxes: lower and upper corners."""
    lines = [np.asarray(line, float) for line in lines]
    middles = np.stack(np.meshgrid(*[(x[1:] + x[:-1]) / 2 for x in lines], indexing="ij"), axis=-1)
    filled = np.zeros(middles.shape[:3], bool)
    for low, high in boxes:
        filled |= ((middles > np.asarray(low)) & (middles < np.asarray(high))).all(axis=-1)
    filled = np.pad(filled, 1)
    counts = [len(x) for x in lines]
    quads = []
    for axis in range(3):
        step = np.eye(3, dtype=int)
        u, v = step[(axis + 1) % 3], step[(axis + 2) % 3]
        change = np.diff(filled.astype(int), axis=axis)
        for sign in (-1, 1):
            # The lattice point at a cell's lower corner has the cell's index less the padding.
            at = np.argwhere(change == sign) - 1 + step[axis]
            ring = [at, at + u, at + u + v, at + v]
            quads.append(np.stack([np.ravel_multi_index(p.T, counts) for p in (ring if sign < 0 else ring[::-1])], 1))
    quad = np.concatenate(quads)
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    return compact(points, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]))


def tube(path: ArrayLike, across: ArrayLike, thickness: tuple[float, float], length: float) -> Mesh:
    """A closed tube with an elliptical section along a plane curve.

    path: points (n, 3). across: unit normal of the curve's plane (3,). thickness: diameters in
    the plane and across it."""
    path = resample(path, length)
    across = np.asarray(across, float)
    tangent = np.gradient(path, axis=0)
    inward = np.cross(across, tangent)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    count = max(8, round(np.pi * sum(thickness) / 2 / length))
    angle = np.arange(count) * 2 * np.pi / count
    rings = path[:, None] + 0.5 * (
        thickness[0] * np.cos(angle)[:, None] * inward[:, None] + thickness[1] * np.sin(angle)[:, None] * across
    )
    vertices = np.concatenate([rings.reshape(-1, 3), path[[0, -1]]])
    index = np.arange(len(path) * count).reshape(len(path), count)
    a, b = index[:-1].ravel(), np.roll(index, -1, axis=1)[:-1].ravel()
    c, d = np.roll(index, -1, axis=1)[1:].ravel(), index[1:].ravel()
    first, last = len(vertices) - 2, len(vertices) - 1
    caps = [
        np.column_stack([np.full(count, first), np.roll(index[0], -1), index[0]]),
        np.column_stack([np.full(count, last), index[-1], np.roll(index[-1], -1)]),
    ]
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d]), *caps])
    mesh = Mesh(vertices, faces)
    return mesh if mesh.volume > 0 else Mesh(vertices, faces[:, ::-1])


def union(parts: Sequence[Mesh]) -> Mesh:
    """The union of closed meshes, in double precision. Raises ValueError when one is not a manifold."""
    from manifold3d import Manifold, Mesh64, OpType

    solids = []
    for part in parts:
        solid = Manifold(Mesh64(np.array(part.vertices), np.asarray(part.faces, np.uint64)))
        if solid.is_empty():
            raise ValueError(f"not a solid ({solid.status()})")
        solids.append(solid)
    raw = Manifold.batch_boolean(solids, OpType.Add).to_mesh64()
    return compact(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, np.int64))
