"""Surface nets for many labels at once: one shared, smoothed sheet between each two cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numba import njit

from deepfracture.carve.cells import CellField

SMOOTHING_STEPS = 12
TRUST = 0.5
"""Pull of a vertex towards the crack crossings around it, against that of its neighbours."""
REACH = 0.49
"""A vertex stays in its own cube: it moves at most this many voxels from the middle along each axis."""
EDGE = 0.05
"""Crossings keep this fraction of a grid edge away from its ends."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Closed meshes of all cells. Two neighbours hold the same vertices and triangles where they meet."""

    points: np.ndarray
    """Shared vertex positions in fractional indices of the padded grid, shape (v, 3)."""
    vertices: np.ndarray
    """For each vertex of each cell the shared vertex, cells one after the other, int64, shape (p,)."""
    faces: np.ndarray
    """Vertex indices within the cell, outward, int64, shape (t, 3)."""
    names: np.ndarray
    """Name of each face: the same for the two sides of a shared one, int64, shape (t,)."""
    vertex_start: np.ndarray
    """First vertex of each cell, shape (n + 1,)."""
    face_start: np.ndarray
    """First face of each cell, shape (n + 1,)."""


def surface_nets(field: CellField) -> Cells:
    """Closed surfaces of all cells of a field.

    A vertex stands in every cube of eight voxel centres with more than one label, a quadrilateral
    across every grid edge between two labels (Gibson 1998). Vertices start at the mean of the cracks'
    crossings of the cube's edges, then relax along the sheet (along junction lines where three cells
    meet) without leaving their cube. A cell passing twice through a cube gets two vertices there at one
    place, the middle, so that each cell's surface is a closed 2-manifold whatever the labels.
    """
    number, cubes = _number_cubes(field.labels)
    cycles = _cycle_table()
    middle = cubes + 0.5
    points, trusted, kind = _place(field.labels, field.distance, cubes)
    links = _links(field.labels, number, cubes, kind)
    pinched = _pinched(field.labels, cubes, cycles)
    points[pinched], links[pinched] = middle[pinched], -1
    points = start = np.clip(points, middle - REACH, middle + REACH)
    for _ in range(SMOOTHING_STEPS):
        points = _relax(points, start, trusted, links, middle)
    quads = _quads(field.labels, number)
    corner, owner = _corners(field.labels, cubes, quads, cycles)
    return Cells(points, *_assemble(points, quads, corner, owner, field.count))


@njit(cache=True)
def _number_cubes(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number the cubes with more than one label: (number or -1 of each cube, lowest voxel of each)."""
    n0, n1, n2 = labels.shape
    number = np.full((n0 - 1, n1 - 1, n2 - 1), -1, np.int32)
    count = 0
    for i in range(n0 - 1):
        for j in range(n1 - 1):
            for k in range(n2 - 1):
                first = labels[i, j, k]
                for n in range(1, 8):
                    if labels[i + (n >> 2), j + (n >> 1 & 1), k + (n & 1)] != first:
                        number[i, j, k] = count
                        count += 1
                        break
    cubes = np.empty((count, 3), np.int32)
    for i in range(n0 - 1):
        for j in range(n1 - 1):
            for k in range(n2 - 1):
                if number[i, j, k] >= 0:
                    cubes[number[i, j, k], 0] = i
                    cubes[number[i, j, k], 1] = j
                    cubes[number[i, j, k], 2] = k
    return number, cubes


@njit(cache=True)
def _place(labels: np.ndarray, distance: np.ndarray, cubes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean crossing of each cube's edges, share of the edges whose crossing is known, number of cells."""
    points = np.empty((len(cubes), 3))
    trusted = np.zeros(len(cubes))
    kind = np.zeros(len(cubes), np.int32)
    for v in range(len(cubes)):
        base = cubes[v]
        known, cracks, cells = 0, 0, 0
        mean = np.zeros(3)
        seen = np.zeros(8, np.int32)
        for n in range(8):
            label = labels[base[0] + (n >> 2), base[1] + (n >> 1 & 1), base[2] + (n & 1)]
            fresh = label != 0
            for m in range(cells):
                fresh = fresh and seen[m] != label
            if fresh:
                seen[cells] = label
                cells += 1
            for bit in range(3):
                if n >> bit & 1:
                    continue
                m = n | 1 << bit
                x, y, z = base[0] + (m >> 2), base[1] + (m >> 1 & 1), base[2] + (m & 1)
                other = labels[x, y, z]
                if other == label or label == 0 or other == 0:
                    continue
                cracks += 1
                da = distance[base[0] + (n >> 2), base[1] + (n >> 1 & 1), base[2] + (n & 1)]
                db = distance[x, y, z]
                if da > 0 and db > 0:
                    known += 1
                    axis = 2 - bit
                    mean[0] += n >> 2
                    mean[1] += n >> 1 & 1
                    mean[2] += n & 1
                    mean[axis] += min(max(da / (da + db), EDGE), 1 - EDGE)
        for a in range(3):
            points[v, a] = base[a] + (mean[a] / known if known else 0.5)
        trusted[v] = known / cracks if cracks else 0.0
        kind[v] = cells
    return points, trusted, kind


@njit(cache=True)
def _links(labels: np.ndarray, number: np.ndarray, cubes: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """The neighbours each vertex relaxes towards, -1 for none, shape (v, 6).

    Only inside the sheets between cells: along a face of the cube with as many cells as a sheet (2)
    or a junction line (3) needs. Vertices of the outermost surface and junction points get none."""
    links = np.full((len(cubes), 6), -1, np.int32)
    for v in range(len(cubes)):
        need = 2 if kind[v] == 2 else 3
        if kind[v] < 2 or kind[v] > 3:
            continue
        found = 0
        for n in range(6):
            axis, side = n // 2, n % 2
            p, q = (axis + 1) % 3, (axis + 2) % 3
            seen = np.zeros(4, np.int32)
            cells = 0
            at = np.empty(3, np.int64)
            for m in range(4):
                at[axis] = cubes[v, axis] + side
                at[p] = cubes[v, p] + (m >> 1)
                at[q] = cubes[v, q] + (m & 1)
                label = labels[at[0], at[1], at[2]]
                fresh = label != 0
                for s in range(cells):
                    fresh = fresh and seen[s] != label
                if fresh:
                    seen[cells] = label
                    cells += 1
            if cells >= need:
                at[axis] = cubes[v, axis] + 2 * side - 1
                at[p], at[q] = cubes[v, p], cubes[v, q]
                links[v, n] = number[at[0], at[1], at[2]]
                found += 1
        if need == 3 and found < 2:
            links[v, :] = -1
    return links


@njit(cache=True)
def _relax(
    points: np.ndarray,
    start: np.ndarray,
    trusted: np.ndarray,
    links: np.ndarray,
    middle: np.ndarray,
) -> np.ndarray:
    """One step of every vertex towards its neighbours' mean and its own start."""
    moved = points.copy()
    for v in range(len(points)):
        count = 0
        x, y, z = 0.0, 0.0, 0.0
        for n in range(6):
            u = links[v, n]
            if u >= 0:
                x += points[u, 0]
                y += points[u, 1]
                z += points[u, 2]
                count += 1
        if count == 0:
            continue
        pull = TRUST * trusted[v]
        for a in range(3):
            mean = (x if a == 0 else y if a == 1 else z) / count
            goal = pull * start[v, a] + (1 - pull) * mean
            goal = 0.5 * (points[v, a] + goal)
            moved[v, a] = min(max(goal, middle[v, a] - REACH), middle[v, a] + REACH)
    return moved


@njit(cache=True)
def _quads(labels: np.ndarray, number: np.ndarray) -> np.ndarray:
    """One quadrilateral for each grid edge between two labels, shape (q, 7): its four cubes, counter-
    clockwise seen from the second voxel, the labels of the first and second voxel, and the axis."""
    size = labels.shape
    count = 0
    step = np.zeros(3, np.int64)
    quads = np.empty((0, 7), np.int32)
    for fill in range(2):
        if fill:
            quads = np.empty((count, 7), np.int32)
            count = 0
        for axis in range(3):
            step[:] = 0
            step[axis] = 1
            p, q = (axis + 1) % 3, (axis + 2) % 3
            for i in range(size[0] - step[0]):
                for j in range(size[1] - step[1]):
                    for k in range(size[2] - step[2]):
                        a, b = labels[i, j, k], labels[i + step[0], j + step[1], k + step[2]]
                        if a == b:
                            continue
                        if fill:
                            at = np.array([i, j, k])
                            for n in range(4):
                                cube = at.copy()
                                cube[p] -= n == 0 or n == 3
                                cube[q] -= n < 2
                                quads[count, n] = number[cube[0], cube[1], cube[2]]
                            quads[count, 4], quads[count, 5], quads[count, 6] = a, b, axis
                        count += 1
    return quads


@lru_cache(maxsize=1)
def _cycle_table() -> np.ndarray:
    """For each of the 256 ways a cell fills a cube's corners, which of its surface's passes through the
    cube crosses each of the 12 edges, uint8, shape (256, 12). Corner n is (n >> 2, n >> 1 & 1, n & 1);
    edge 4 axis + 2 p + q runs along axis at offsets p, q along the next two axes. On a face where the
    cell holds two opposite corners the passes keep them apart."""
    table = np.zeros((256, 12), np.uint8)
    for filled in range(256):
        group = list(range(12))
        for axis, side in product(range(3), range(2)):
            for pair in _face_pairs(filled, axis, side):
                a, b = (group[e] for e in pair)
                group = [a if g == b else g for g in group]
        crossed = [e for e in range(12) if len({filled >> c & 1 for c in _edge_ends(e)}) == 2]
        passes = sorted({group[e] for e in crossed})
        for e in crossed:
            table[filled, e] = passes.index(group[e])
    return table


def _corner(offsets: dict[int, int]) -> int:
    return offsets[0] << 2 | offsets[1] << 1 | offsets[2]


def _edge_ends(edge: int) -> tuple[int, int]:
    axis, p, q = edge // 4, edge // 2 % 2, edge % 2
    ends = [_corner({axis: end, (axis + 1) % 3: p, (axis + 2) % 3: q}) for end in (0, 1)]
    return ends[0], ends[1]


def _face_pairs(filled: int, axis: int, side: int) -> list[tuple[int, int]]:
    """Pairs of edges of one face of the cube that the surface connects on that face."""
    p, q = (axis + 1) % 3, (axis + 2) % 3
    edges = [4 * p + 2 * b + side for b in (0, 1)] + [4 * q + 2 * side + b for b in (0, 1)]
    crossed = [e for e in edges if len({filled >> c & 1 for c in _edge_ends(e)}) == 2]
    if len(crossed) == 2:
        return [(crossed[0], crossed[1])]
    pairs = []
    if len(crossed) == 4:
        for corner in {c for e in edges for c in _edge_ends(e)}:
            if filled >> corner & 1:
                first, second = (e for e in edges if corner in _edge_ends(e))
                pairs.append((first, second))
    return pairs


@njit(cache=True)
def _corners(
    labels: np.ndarray, cubes: np.ndarray, quads: np.ndarray, cycles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Corner ids (4 x shared vertex + pass) and owner of both sides of each quadrilateral."""
    corner = np.empty((len(quads), 2, 4), np.int64)
    owner = np.empty((len(quads), 2), np.int32)
    for n in range(len(quads)):
        axis = quads[n, 6]
        for side in range(2):
            label = quads[n, 4 + side]
            owner[n, side] = label
            if label == 0:
                continue
            for c in range(4):
                v = quads[n, c]
                filled = _filled(labels, cubes[v], label)
                # The cube that lies lower along an axis sees the edge at its upper end, and so on.
                low_p, low_q = c == 0 or c == 3, c < 2
                edge = 4 * axis + 2 * low_p + low_q
                corner[n, side, c] = 4 * v + cycles[filled, edge]
    return corner, owner


@njit(cache=True)
def _pinched(labels: np.ndarray, cubes: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Whether some cell passes twice through each cube."""
    pinched = np.zeros(len(cubes), np.bool_)
    for v in range(len(cubes)):
        for n in range(8):
            label = int(labels[cubes[v, 0] + (n >> 2), cubes[v, 1] + (n >> 1 & 1), cubes[v, 2] + (n & 1)])
            if label != 0 and cycles[_filled(labels, cubes[v], label)].max() > 0:
                pinched[v] = True
    return pinched


@njit(cache=True, inline="always")
def _filled(labels: np.ndarray, cube: np.ndarray, label: int) -> int:
    """Corners of a cube with the given label, as bits."""
    filled = 0
    for m in range(8):
        if labels[cube[0] + (m >> 2), cube[1] + (m >> 1 & 1), cube[2] + (m & 1)] == label:
            filled |= 1 << m
    return filled


@njit(cache=True)
def _assemble(
    points: np.ndarray, quads: np.ndarray, corner: np.ndarray, owner: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sort both sides of all quadrilaterals by cell, split each along its shorter diagonal."""
    face_start = np.zeros(count + 2, np.int64)
    for n in range(len(quads)):
        for side in range(2):
            face_start[owner[n, side] + 1] += 2
    face_start[1] = 0  # nobody needs the side of the outside
    for c in range(1, count + 2):
        face_start[c] += face_start[c - 1]
    corners = np.empty((face_start[-1], 3), np.int64)
    names = np.empty(face_start[-1], np.int64)
    place = face_start.copy()
    for n in range(len(quads)):
        first = ((points[quads[n, 0]] - points[quads[n, 2]]) ** 2).sum()
        flip = int(first > ((points[quads[n, 1]] - points[quads[n, 3]]) ** 2).sum())
        for side in range(2):
            if owner[n, side] == 0:
                continue
            for half in range(2):
                t = place[owner[n, side]]
                place[owner[n, side]] += 1
                first, second = (flip + 1 + 2 * half) % 4, (flip + 2 + 2 * half) % 4
                corners[t, 0] = corner[n, side, (flip + 2 * half) % 4]
                corners[t, 1] = corner[n, side, first if side == 0 else second]
                corners[t, 2] = corner[n, side, second if side == 0 else first]
                names[t] = 2 * n + half
    return _compact(corners, names, face_start[1:], len(points))


@njit(cache=True)
def _compact(
    corners: np.ndarray, names: np.ndarray, face_start: np.ndarray, shared: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Number the corners of each cell from zero."""
    count = len(face_start) - 1
    local = np.full(4 * shared, -1, np.int64)
    vertices = np.empty(3 * len(corners), np.int64)
    faces = np.empty_like(corners)
    vertex_start = np.zeros(count + 1, np.int64)
    used = 0
    for c in range(count):
        base = used
        for t in range(face_start[c], face_start[c + 1]):
            for n in range(3):
                key = corners[t, n]
                if local[key] < base:
                    local[key] = used
                    vertices[used] = key // 4
                    used += 1
                faces[t, n] = local[key] - base
        vertex_start[c + 1] = used
    return vertices[:used].copy(), faces, names, vertex_start, face_start
