"""A mesh on a voxel grid: what every cut of it needs, whatever the cracks. Computed once and cached with the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry import winding_lattice
from deepfracture.types import BadInput, Floats, Grid, Ints, Mesh

MARGIN = 3
"""Voxels of the box beyond the mesh, on every side."""


@dataclass(frozen=True, eq=False)
class MeshOnGrid:
    """A closed mesh on the voxels of its own box, which may line_bounds past the grid. Lengths are in voxels, and voxel
    centres have integer coordinates; a *cube* has eight of them as its corners."""

    low: Ints
    """Grid index of the box's first voxel, shape (3,)."""
    points: Floats
    """The mesh's vertices, shape (n, 3)."""
    faces: Ints
    """Shape (m, 3)."""
    edges: Ints
    """Vertices of each edge, the lower first, shape (e, 2)."""
    face_edges: Ints
    """The edge from each corner of a face to the next, shape (m, 3)."""
    manifold: NDArray[np.bool_]
    """Vertices around which the faces are a single fan, shape (n,)."""
    inside: NDArray[np.bool_]
    """Which voxel centres lie inside the mesh, shape (a, b, c)."""
    spans: NDArray[np.int32]
    """The voxels that need a label, as runs along the last axis, shape (u, 3): flat index of the first voxel, length,
    and flat index of the first voxel on the grid, -1 past its border. They are the voxels inside and all corners of the
    cubes that the mesh touches, so that every crack in the body is bounded by the surface."""
    line_bounds: NDArray[np.int32]
    """First and one past the last of those voxels on each line along the last axis, (0, 0) for none, shape (a b, 2)."""
    cubes: Ints
    """Pairs of a cube and a face that touches it: flat index of the cube's first corner, ascending, shape (p,) ..."""
    cube_faces: Ints
    """... and the face, shape (p,)."""


_cache: WeakKeyDictionary[Mesh, dict[int, MeshOnGrid]] = WeakKeyDictionary()


def mesh_on_grid(mesh: Mesh, grid: Grid, name: str) -> MeshOnGrid:
    """The mesh on the grid. Raises BadInput, with the shape's name, unless it is closed and faces outward."""
    cached = _cache.setdefault(mesh, {})
    if grid.resolution not in cached:
        cached[grid.resolution] = _place(mesh, grid, name)
    return cached[grid.resolution]


def _place(mesh: Mesh, grid: Grid, name: str) -> MeshOnGrid:
    edges, face_edges = _mesh_edges(mesh, name)
    index = grid.to_index(mesh.vertices[mesh.faces])
    low = np.floor(index.min(axis=(0, 1))).astype(np.int64) - MARGIN
    a, b, c = (np.ceil(index.max(axis=(0, 1))).astype(np.int64) + MARGIN + 1 - low).tolist()
    points = grid.to_index(mesh.vertices) - low
    cubes, cube_faces = _touched_cubes(points[mesh.faces], np.array([a, b, c]))
    order = np.argsort(cubes, kind="stable")
    inside = winding_lattice(mesh, grid.to_world(low), grid.spacing, (a, b, c)) > 0
    spans, line_bounds = _label_spans(inside, cubes, low, grid.resolution)
    faces = np.array(mesh.faces)
    manifold = _manifold_vertices(faces, face_edges, len(edges), len(points))
    return MeshOnGrid(
        low, points, faces, edges, face_edges, manifold, inside, spans, line_bounds, cubes[order], cube_faces[order]
    )


@njit(cache=True)
def _label_spans(inside, cubes, low, resolution):
    """See `MeshOnGrid.spans` and `MeshOnGrid.line_bounds`."""
    needed = inside.copy()
    flat, lines, size = needed.reshape(-1), needed.shape[1], needed.shape[2]
    for cube in cubes:
        for n in range(8):
            flat[cube + (n >> 2) * lines * size + (n >> 1 & 1) * size + (n & 1)] = True
    spans, line_bounds = np.empty((64, 3), np.int32), np.zeros((needed.shape[0] * lines, 2), np.int32)
    count = 0
    for line in range(len(line_bounds)):
        i, j = line // lines + low[0], line % lines + low[1]
        span_grid = -2  # -2: no open span; else the grid index that the open span starts with, -1 past the border
        for k in range(size):
            v = line * size + k
            if not flat[v]:
                span_grid = -2
                continue
            grid_index = -1
            if min(i, j, k + low[2]) >= 0 and max(i, j, k + low[2]) < resolution:
                grid_index = (i * resolution + j) * resolution + k + low[2]
            if span_grid == -2 or (span_grid < 0) != (grid_index < 0):
                if count == len(spans):
                    spans = np.concatenate((spans, np.empty_like(spans)))
                spans[count, 0], spans[count, 1], spans[count, 2] = v, 0, grid_index
                count += 1
            span_grid = grid_index
            spans[count - 1, 1] += 1
            if line_bounds[line, 1] == 0:
                line_bounds[line, 0] = k
            line_bounds[line, 1] = k + 1
    return spans[:count].copy(), line_bounds


def _mesh_edges(mesh: Mesh, name: str) -> tuple[Ints, Ints]:
    refusal = f"{name}: cannot be cut, its mesh is not closed and oriented; try --repair"
    if not len(mesh.faces):
        raise BadInput(refusal)
    ends = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys = ends.min(axis=1) * len(mesh.vertices) + ends.max(axis=1)
    unique, which, count = np.unique(keys, return_inverse=True, return_counts=True)
    along = np.bincount(which.ravel(), weights=np.sign(ends[:, 1] - ends[:, 0]))
    if (count != 2).any() or along.any() or not mesh.volume > 0:
        raise BadInput(refusal)
    return np.stack(np.divmod(unique, len(mesh.vertices)), axis=1), which.reshape(-1, 3)


@njit(cache=True)
def _manifold_vertices(faces, face_edges, edges, vertices):
    """Whether the faces around each vertex form a single fan: a walk from edge to edge meets all of them."""
    first, twin = np.full(edges, -1), np.empty(3 * len(faces), np.int64)
    for corner in range(3 * len(faces)):
        edge = face_edges[corner // 3, corner % 3]
        if first[edge] < 0:
            first[edge] = corner
        else:
            twin[corner], twin[first[edge]] = first[edge], corner
    valence, start = np.zeros(vertices, np.int64), np.full(vertices, -1)
    for corner in range(3 * len(faces)):
        vertex = faces[corner // 3, corner % 3]
        valence[vertex] += 1
        start[vertex] = corner
    manifold = np.zeros(vertices, np.bool_)
    for vertex in range(vertices):
        at, count = start[vertex], 0
        while at >= 0 and (count == 0 or at != start[vertex]):
            back = twin[at]
            at = back - 2 if back % 3 == 2 else back + 1
            count += 1
        manifold[vertex] = count == valence[vertex]
    return manifold


@njit(cache=True)
def _touched_cubes(triangles, size):
    """Pairs of cubes and triangles that may touch: box against box, then plane against box (Akenine-Möller 2001)."""
    slack = 0.5 + 1e-6
    low, high, normal = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3)
    cubes, faces = np.empty(8, np.int64), np.empty(8, np.int64)
    count = 0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for x in range(3):
            low[x] = max(int(np.ceil(min(a[x], b[x], c[x]) - 0.5 - slack)), 0)
            high[x] = min(int(np.floor(max(a[x], b[x], c[x]) - 0.5 + slack)), size[x] - 2)
            y, z = (x + 1) % 3, (x + 2) % 3
            normal[x] = (b[y] - a[y]) * (c[z] - a[z]) - (b[z] - a[z]) * (c[y] - a[y])
        radius = slack * (abs(normal[0]) + abs(normal[1]) + abs(normal[2]))
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    off = (i + 0.5 - a[0]) * normal[0] + (j + 0.5 - a[1]) * normal[1] + (k + 0.5 - a[2]) * normal[2]
                    if abs(off) > radius:
                        continue
                    if count == len(cubes):
                        cubes = np.concatenate((cubes, np.empty_like(cubes)))
                        faces = np.concatenate((faces, np.empty_like(faces)))
                    cubes[count], faces[count] = (i * size[1] + j) * size[2] + k, t
                    count += 1
    return cubes[:count].copy(), faces[:count].copy()
