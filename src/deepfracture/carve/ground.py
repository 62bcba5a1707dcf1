"""What every cut of one mesh on one grid needs, whatever the cracks: made once, kept as long as the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry import winding_lattice
from deepfracture.types import BadInput, Floats, Grid, Ints, Mesh

ROOM = 3
"""Voxels of the box beyond the mesh, on every side."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A closed mesh on the voxels of its own box, which may reach past the grid. Lengths are in voxels, and voxel
    centres have integer coordinates; a *cube* has eight of them as its corners."""

    low: Ints
    """Grid index of the box's first voxel, shape (3,)."""
    points: Floats
    """The mesh's vertices, shape (n, 3)."""
    faces: Ints
    """Shape (m, 3)."""
    edges: Ints
    """Vertices of each edge, the lower first, shape (e, 2)."""
    edge_of: Ints
    """The edge from each corner of a face to the next, shape (m, 3)."""
    inside: NDArray[np.bool_]
    """Which voxel centres lie inside the mesh, shape (a, b, c)."""
    voxels: NDArray[np.int32]
    """Flat indices of the voxels that need a label, ascending: those inside, and all corners of the cubes that the
    mesh touches, for then every crack in the body is closed. Shape (u,)."""
    on_grid: NDArray[np.int32]
    """Flat index of each of them on the grid, -1 past its border, shape (u,)."""
    cubes: Ints
    """Flat index of a touched cube's first corner, ascending, shape (p,) ..."""
    touching: Ints
    """... and the face that touches it, shape (p,)."""


_known: WeakKeyDictionary[Mesh, dict[int, Ground]] = WeakKeyDictionary()


def ground_of(mesh: Mesh, grid: Grid, name: str) -> Ground:
    """The mesh on the grid. Raises BadInput, with the shape's name, unless it is closed and faces outward."""
    grounds = _known.setdefault(mesh, {})
    if grid.resolution not in grounds:
        grounds[grid.resolution] = _ground(mesh, grid, name)
    return grounds[grid.resolution]


def _ground(mesh: Mesh, grid: Grid, name: str) -> Ground:
    edges, edge_of = _edges(mesh, name)
    index = grid.to_index(mesh.vertices[mesh.faces])
    low = np.floor(index.min(axis=(0, 1))).astype(np.int64) - ROOM
    a, b, c = (np.ceil(index.max(axis=(0, 1))).astype(np.int64) + ROOM + 1 - low).tolist()
    points = grid.to_index(mesh.vertices) - low
    cubes, touching = _touched(points[mesh.faces], np.array([a, b, c]))
    order = np.argsort(cubes, kind="stable")
    inside = winding_lattice(mesh, grid.to_world(low), grid.spacing, (a, b, c)) > 0
    voxels, on_grid = _needed(inside, cubes, low, grid.resolution)
    faces = np.array(mesh.faces)
    return Ground(low, points, faces, edges, edge_of, inside, voxels, on_grid, cubes[order], touching[order])


@njit(cache=True)
def _needed(inside, cubes, low, resolution):
    """See `Ground.voxels` and `Ground.on_grid`."""
    needed = inside.copy()
    flat, s1, s0 = needed.reshape(-1), needed.shape[2], needed.shape[1] * needed.shape[2]
    for cube in cubes:
        for n in range(8):
            flat[cube + (n >> 2) * s0 + (n >> 1 & 1) * s1 + (n & 1)] = True
    voxels = np.empty(flat.sum(), np.int32)
    on_grid = np.full(len(voxels), -1, np.int32)
    count = 0
    for v in range(len(flat)):
        if flat[v]:
            i, j, k = v // s0 + low[0], v // s1 % needed.shape[1] + low[1], v % s1 + low[2]
            if min(i, j, k) >= 0 and max(i, j, k) < resolution:
                on_grid[count] = (i * resolution + j) * resolution + k
            voxels[count] = v
            count += 1
    return voxels, on_grid


def _edges(mesh: Mesh, name: str) -> tuple[Ints, Ints]:
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
def _touched(triangles, size):
    """Pairs of cubes and the triangles that may touch them: those in its box, less what its plane misses."""
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
        reach = slack * (abs(normal[0]) + abs(normal[1]) + abs(normal[2]))
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    off = (i + 0.5 - a[0]) * normal[0] + (j + 0.5 - a[1]) * normal[1] + (k + 0.5 - a[2]) * normal[2]
                    if abs(off) > reach:
                        continue
                    if count == len(cubes):
                        cubes = np.concatenate((cubes, np.empty_like(cubes)))
                        faces = np.concatenate((faces, np.empty_like(faces)))
                    cubes[count], faces[count] = (i * size[1] + j) * size[2] + k, t
                    count += 1
    return cubes[:count].copy(), faces[:count].copy()
