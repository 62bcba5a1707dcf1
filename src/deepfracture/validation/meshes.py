"""Closed meshes with known shape, for cases whose answer is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepfracture.types import Floats, Mesh

GOLDEN = (1 + 5**0.5) / 2


def icosphere(frequency: int, radius: float = 1.0) -> Mesh:
    """A sphere of 20 frequency^2 near-equilateral triangles: a subdivided icosahedron, blown up."""
    from scipy.spatial import ConvexHull

    corners = np.array(
        [(0, s, t * GOLDEN) for s in (-1, 1) for t in (-1, 1)]
        + [(s, t * GOLDEN, 0) for s in (-1, 1) for t in (-1, 1)]
        + [(t * GOLDEN, 0, s) for s in (-1, 1) for t in (-1, 1)]
    )
    faces = corners[ConvexHull(corners).simplices]
    points = []
    for a, b, c in faces:
        for i in range(frequency + 1):
            for j in range(frequency + 1 - i):
                points.append((i * a + j * b + (frequency - i - j) * c) / frequency)
    vertices = np.array(points)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    _, first = np.unique(vertices.round(6), axis=0, return_index=True)
    vertices = vertices[first]
    return Mesh(radius * vertices, _outward(vertices, ConvexHull(vertices).simplices))


def box(sides: Sequence[float], counts: Sequence[int]) -> Mesh:
    """A box centred on the origin, its sides divided into `counts` squares of two triangles each."""
    sides_, counts_ = np.asarray(sides, float), np.asarray(counts)
    vertices: list[Floats] = []
    faces: list[tuple[int, int, int]] = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1, 1):
            start = len(vertices)
            for i in range(counts_[u] + 1):
                for j in range(counts_[v] + 1):
                    point = np.empty(3)
                    point[axis], point[u], point[v] = side, 2 * i / counts_[u] - 1, 2 * j / counts_[v] - 1
                    vertices.append(point)
            for i in range(counts_[u]):
                for j in range(counts_[v]):
                    a = start + i * (counts_[v] + 1) + j
                    b, c, d = a + counts_[v] + 1, a + counts_[v] + 2, a + 1
                    # Alternate diagonals, so that the mesh has no preferred direction.
                    quads = [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
                    faces += quads if side > 0 else [(p, r, q) for p, q, r in quads]
    points = np.array(vertices)
    _, first, inverse = np.unique(points.round(9), axis=0, return_index=True, return_inverse=True)
    return Mesh(points[first] * sides_ / 2, inverse.reshape(-1)[np.array(faces)])


def cylinder(radius: float, length: float, around: int, along: int) -> Mesh:
    """A round bar along x, centred on the origin: `around` vertices a ring, `along` rings of squares."""
    rings = max(2, round(around / 6))
    outline = [(-1.0, k / rings) for k in range(1, rings)]
    outline += [(2 * i / along - 1, 1.0) for i in range(along + 1)]
    outline += [(1.0, k / rings) for k in range(rings - 1, 0, -1)]
    vertices = [(-length / 2, 0.0, 0.0)]
    for index, (x, r) in enumerate(outline):
        # Every other ring is turned by half a step: the triangles become nearly equilateral.
        angles = 2 * np.pi * (np.arange(around) + index % 2 / 2) / around
        vertices += [(x * length / 2, r * radius * np.cos(a), r * radius * np.sin(a)) for a in angles]
    last = len(vertices)
    vertices.append((length / 2, 0.0, 0.0))
    faces = []
    for i in range(around):
        j = (i + 1) % around
        faces += [(0, 1 + j, 1 + i), (last, last - around + i, last - around + j)]
        for index in range(len(outline) - 1):
            low, high = 1 + index * around, 1 + (index + 1) * around
            if index % 2:
                faces += [(low + i, high + j, high + i), (low + i, low + j, high + j)]
            else:
                faces += [(low + i, low + j, high + i), (low + j, high + j, high + i)]
    return Mesh(np.array(vertices), np.array(faces))


def jittered(mesh: Mesh, amount: float, rng: np.random.Generator) -> Mesh:
    """The mesh with every vertex moved by up to `amount` along each axis."""
    return Mesh(mesh.vertices + rng.uniform(-amount, amount, mesh.vertices.shape), mesh.faces)


def concatenated(*meshes: Mesh) -> Mesh:
    """Several shells as one mesh."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return Mesh(vertices, np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=True)]))


def inverted(mesh: Mesh) -> Mesh:
    """The same surface seen from the other side: a cavity."""
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def _outward(vertices: Floats, faces: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inwards = np.einsum("ni,ni->n", np.cross(b - a, c - a), a) < 0
    faces = faces.copy()
    faces[inwards] = faces[inwards][:, ::-1]
    return faces
