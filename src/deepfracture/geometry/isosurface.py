"""The closed surface where a lattice of values changes its sign, by marching tetrahedra.

Each cell is six tetrahedra round its main diagonal (Kuhn 1960), which fit those of its neighbours: unlike marching
cubes there are no cases that two cells could read differently, so the surface is a closed 2-manifold always."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.types import BadInput, Floats, Floats32, Ints, Mesh

PATHS = np.array([[1, 3, 7], [2, 6, 7], [4, 5, 7], [1, 5, 7], [2, 3, 7], [4, 6, 7]])
"""Tetrahedra of a cell: the corners after corner 0, bits 1, 2, 4 for a step along x, y, z. The first three wind to the
right, the others to the left."""
EVEN = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
"""Even orders of four corners, by the first."""
PAIRS = np.array([[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0], [2, 3, 0, 1]])
"""Even orders of four corners, by the first two."""
CLEAR = 0.05
"""Share of an edge that crossings keep away from its ends, so that there are no slivers."""


def isosurface(values: Floats32, origin: Floats, spacing: float) -> Mesh:
    """The surface between what is positive (outside) and what is not, of values [m] that change about as fast as
    distances; values[i, j, k] is that at origin + spacing * (i, j, k).

    Raises BadInput if the border of the lattice is not all positive: the surface would be open there."""
    inner = values <= 0
    if any(side.any() for n in range(3) for side in (inner.take(0, n), inner.take(-1, n))):
        raise BadInput("values must be positive all round the lattice")
    edges = _march(inner).reshape(-1, 3)
    used, faces = np.unique(edges, return_inverse=True)
    start, way = np.divmod(used, 8)
    low = np.stack(np.unravel_index(start, values.shape), axis=1)
    step = way[:, None] >> np.arange(3) & 1
    near, far = values[tuple(low.T)].astype(float), values[tuple((low + step).T)].astype(float)
    share = np.clip(near / (near - far), CLEAR, 1 - CLEAR)
    return Mesh(origin + spacing * (low + share[:, None] * step), faces.reshape(-1, 3))


@njit(cache=True)
def _march(inner) -> Ints:  # pragma: no cover
    """Corners of all triangles, three in a row, as the lattice edges they lie on: 8 * lower end + way."""
    nx, ny, nz = inner.shape
    found, count = np.empty(1 << 12, np.int64), 0
    steps = np.array([((c & 1) * ny + (c >> 1 & 1)) * nz + (c >> 2) for c in range(8)])
    corner, state = np.empty(4, np.int64), np.empty(4, np.bool_)
    for i in range(nx - 1):
        for j in range(ny - 1):
            for k in range(nz - 1):
                base = (i * ny + j) * nz + k
                whole = 0
                for c in range(8):
                    whole += inner[i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)]
                if whole == 0 or whole == 8:
                    continue
                if count + 36 > len(found):
                    found = np.concatenate((found, np.empty_like(found)))
                for t in range(6):
                    corner[0] = 0
                    corner[1:] = PATHS[t]
                    for n in range(4):
                        c = corner[n]
                        state[n] = inner[i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)]
                    count = _triangles(corner, state, base, steps, t >= 3, found, count)
    return found[:count].copy()


@njit(cache=True)
def _triangles(corner: Ints, state, base: int, steps: Ints, left: bool, found: Ints, count: int):  # pragma: no cover
    """Append the triangles of one tetrahedron that parts inner from outer corners; returns the new count."""
    inside = int(state.sum())
    if inside == 0 or inside == 4:
        return count
    if inside == 2:
        for p in range(6):
            a, b, c, d = PAIRS[p]
            if state[a] and state[b]:
                fan = ((a, c), (a, d), (b, d), (a, c), (b, d), (b, c))
                for n in range(6):
                    found[count + n] = _edge(corner[fan[n][0]], corner[fan[n][1]], base, steps)
                if left:
                    found[count + 1], found[count + 2] = found[count + 2], found[count + 1]
                    found[count + 4], found[count + 5] = found[count + 5], found[count + 4]
                return count + 6
    for p in range(4):
        a, b, c, d = EVEN[p]
        if state[a] == (inside == 1):
            found[count] = _edge(corner[a], corner[b], base, steps)
            # Seen from the lone corner the others wind to the right; it is inside or outside.
            second, third = (d, c) if left != (inside == 3) else (c, d)
            found[count + 1] = _edge(corner[a], corner[second], base, steps)
            found[count + 2] = _edge(corner[a], corner[third], base, steps)
            return count + 3
    return count


@njit(cache=True, inline="always")
def _edge(one, other, base, steps):  # pragma: no cover
    """The lattice edge between two corners of one tetrahedron: of these one holds all bits of the other."""
    low, high = min(one, other), max(one, other)
    return (base + steps[low]) * 8 + (high - low)
