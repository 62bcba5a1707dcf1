"""The crack mesh: one shared, smoothed surface between each two cells (surface nets, Gibson 1998)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import Floats, Floats32, FracturePattern, Ints, Labels

SMOOTHING_STEPS = 3
DATA_WEIGHT = 0.5
"""Weight of the crack positions known around a vertex against the mean of its neighbours, in smoothing."""
MAX_OFFSET = 0.49
"""A vertex stays in its own cube: it moves at most this far [voxels] from the centre along each axis."""
EDGE_MARGIN = 0.05
"""Intersections keep this fraction of a grid edge away from its ends."""
JITTER = 1e-6
"""Vertices are perturbed by up to this [voxels], so that no four points of crack and surface are coplanar."""


@dataclass(frozen=True, eq=False)
class CrackMesh:
    """The interfaces between all cells of a label field, in the voxels of its box.

    They do not intersect themselves or each other (see `_choose_diagonals`), and end only where labels do."""

    points: Floats
    """Shape (v, 3)."""
    cubes: Ints
    """Flat index of the first corner of the cube that holds each of the first vertices, shape (u,), u <= v; the others
    lie on grid edges."""
    cube_index: Labels
    """For each cube of the box, one more than its index in `cubes`, 0 if it is not there; flat."""
    triangles: Ints
    """Counter-clockwise seen from the cell above, shape (t, 3)."""
    cells: Labels
    """Cells below and above each triangle, shape (t, 2)."""
    quad_start: Ints
    """The first triangle of each grid edge between two cells, and their number, shape (q + 1,)."""
    quad_cubes: Ints
    """The four cubes around that edge, as indices into `cubes`, shape (q, 4): they contain all of its triangles."""
    manifold: NDArray[np.bool_]
    """Points around which the triangles of each cell are a single fan, shape (v,)."""


def crack_mesh(
    labels: Labels, edges: Ints, pattern: FracturePattern, low: Ints, *, roughness: float = 0.0, seed: int = 0
) -> CrackMesh:
    """The surfaces between cells.

    A vertex stands in every cube that a crack passes. It starts at the mean of the cracks' intersections with the
    cube's edges, then is smoothed along the crack (along junction lines, where three cells meet) without leaving its
    cube.

    Args:
        labels, edges: From `cell_labels`.
        pattern: Its distances, where known, locate the cracks on grid edges.
        low: Grid index of the first voxel of `labels`.
        roughness: Vertices are scattered by up to this [voxels], still without leaving their cubes.
        seed: Of roughness and jitter.
    """
    cube_index = np.zeros(labels.size, np.int32)
    quad_cubes, cubes = _cubes_around_edges(labels.shape, edges, cube_index)
    initial = CubeVertices(
        np.zeros((len(cubes) + 1, 3)), np.empty(len(cubes)), np.empty((len(cubes), 6), np.int32),
        np.empty(len(cubes), np.bool_), np.empty(len(cubes), np.bool_),
    )  # fmt: skip
    known = KnownDistances(pattern.labels, pattern.distance, low)
    parallel_for(
        lambda first, last: _place_vertices(labels, known, cubes, cube_index, initial, first, last),
        len(cubes), least=2048,
    )  # fmt: skip
    points = _smoothed(initial)
    if roughness > 0:
        rng = np.random.default_rng([seed, 1])
        middle = np.floor(initial.points[:-1]) + 0.5
        points = np.clip(
            points + rng.uniform(-roughness, roughness, points.shape), middle - MAX_OFFSET, middle + MAX_OFFSET
        )
    jitter = _jitter(seed, 1 << (len(points) + len(edges)).bit_length())
    points += jitter[: len(points)]
    diagonals = np.empty(len(edges), np.int8)
    parallel_for(
        lambda first, last: _choose_diagonals(points, quad_cubes, edges, diagonals, first, last), len(edges), least=2048
    )
    quads = Quads(edges, quad_cubes, diagonals, *_triangle_offsets(diagonals))
    count, centres = quads.start[-1], quads.centres[-1]
    triangles = Triangles(
        np.empty((len(points) + centres, 3)), np.empty((count, 3), np.int64), np.empty((count, 2), np.int32)
    )
    triangles.points[: len(points)] = points
    parallel_for(
        lambda first, last: _triangulate(labels, points, quads, jitter[len(points) :], triangles, first, last),
        len(edges), least=4096,
    )  # fmt: skip
    manifold = np.concatenate([initial.manifold, np.ones(centres, np.bool_)])
    return CrackMesh(
        triangles.points, cubes, cube_index, triangles.triangles, triangles.cells, quads.start, quad_cubes, manifold
    )


class KnownDistances(NamedTuple):
    """A pattern's distances to its cracks, for kernels."""

    labels: Labels
    """Shape (r, r, r)."""
    distance: Floats32
    """[m], known where there is a label."""
    low: Ints
    """Index of the box's first voxel in them, shape (3,)."""


class CubeVertices(NamedTuple):
    """The vertex in each cube that cracks pass, before smoothing."""

    points: Floats
    """Shape (u + 1, 3); the last row, which stands for an absent neighbour, is zero."""
    confidence: Floats
    """Fraction of the cube's cut edges on which the distances locate the crack, shape (u,)."""
    neighbours: NDArray[np.int32]
    """The vertices that each is smoothed towards, u for none, shape (u, 6)."""
    manifold: NDArray[np.bool_]
    """As in `CrackMesh`."""
    odd: NDArray[np.bool_]
    """Whether the sum of the cube's indices is odd, shape (u,)."""


class Quads(NamedTuple):
    """The quadrilaterals of the crack mesh, one across each grid edge between two cells."""

    edges: Ints
    """Flat index of the edge's first voxel, and axis, shape (q, 2)."""
    cubes: Ints
    """The vertices, which are numbered as their cubes, shape (q, 4)."""
    diagonals: NDArray[np.int8]
    """See `_choose_diagonals`."""
    start: Ints
    """First triangle of each, and their cube_index, shape (q + 1,)."""
    centres: Ints
    """Number of quadrilaterals before each that have a vertex in the middle, shape (q + 1,)."""


class Triangles(NamedTuple):
    """What `_triangulate` writes, as in `CrackMesh`."""

    points: Floats
    triangles: Ints
    cells: Labels


@lru_cache(maxsize=2)
def _jitter(seed: int, count: int) -> Floats:
    """The same for every cut with a seed, shape (count, 3): drawing takes as long as smoothing."""
    jitter = np.random.default_rng(seed).uniform(-JITTER, JITTER, (count, 3))
    jitter.setflags(write=False)
    return jitter


@njit(cache=True)
def _cubes_around_edges(shape, edges, cube_index):
    """The four cubes around each edge, counter-clockwise seen from its second voxel, by index into all cubes; and
    these. `cube_index` becomes one more than that index for them and stays 0 for all other cubes of the box."""
    strides = (shape[1] * shape[2], shape[2], 1)
    quad_cubes = np.empty((len(edges), 4), np.int64)
    cubes = np.empty(4 * len(edges), np.int64)
    count = 0
    for n in range(len(edges)):
        v, axis = edges[n]
        p, q = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
        for corner in range(4):
            cube = v - (p if corner == 0 or corner == 3 else 0) - (q if corner < 2 else 0)
            if cube_index[cube] == 0:
                cubes[count] = cube
                count += 1
                cube_index[cube] = count
            quad_cubes[n, corner] = cube_index[cube] - 1
    return quad_cubes, cubes[:count].copy()


def _one_loop(corners: int) -> bool:
    """Whether the surface around some of a cube's eight corners (bits) is a single fan around a point in its centre.

    On a face of the cube it crosses two edges, or none: edges that share faces make up its loops."""
    crossed = [(n, axis) for n in range(8) for axis in range(3) if corners >> n & 1 != corners >> (n ^ 1 << axis) & 1]
    crossed = [(n, axis) for n, axis in crossed if not n >> axis & 1]
    seen, ahead = set(), crossed[:1]
    while ahead:
        n, axis = ahead.pop()
        if (n, axis) in seen:
            continue
        seen.add((n, axis))
        for other in range(3):  # faces at this edge lie across the two other axes
            face = [edge for edge in crossed if edge[1] != other and (edge[0] ^ n) >> other & 1 == 0]
            if other != axis and len(face) != 2:
                return False
            ahead += face if other != axis else []
    return len(seen) == len(crossed)


ONE_LOOP = np.array([_one_loop(corners) for corners in range(256)])
"""For each set of corners, as the bits of a number: see `_one_loop`."""
CUBE_EDGES = tuple((n, n | 1 << bit, bit) for n in range(8) for bit in range(3) if not n >> bit & 1)
"""Corners at both ends of a cube's edges, numbered as in `CUBE_FACES`, and the bit of their numbers that differs."""
CUBE_FACES = np.array(
    [[sum(1 << n for n in range(8) if n >> 2 - axis & 1 == high) for high in (0, 1)] for axis in range(3)]
)
"""The corners on a cube's faces as bits, corner n at (n >> 2, n >> 1 & 1, n & 1)."""


@njit(cache=True, nogil=True)
def _place_vertices(labels, known, cubes, cube_index, vertices, first, last):
    """Write the initial `vertices` of some cubes."""
    s0, s1 = labels.shape[1] * labels.shape[2], labels.shape[2]
    flat, strides = labels.reshape(-1), (s0, s1, 1)
    low, manifold = known.low, vertices.manifold
    corner_labels, distances, names, bits = (
        np.empty(8, np.int32),
        np.empty(8),
        np.empty(8, np.int32),
        np.empty(8, np.int64),
    )
    for v in range(first, last):
        i, j, k = cubes[v] // s0, cubes[v] % s0 // s1, cubes[v] % s1
        vertices.odd[v] = (i + j + k) & 1 == 1
        for n in range(8):
            corner_labels[n] = flat[cubes[v] + (n >> 2) * s0 + (n >> 1 & 1) * s1 + (n & 1)]
        cells = _corner_cells(corner_labels, names, bits)
        _corner_distances(known, i + low[0], j + low[1], k + low[2], distances)
        vertices.confidence[v] = _mean_intersection(corner_labels, distances, (i, j, k), vertices.points[v])
        manifold[v] = True
        for c in range(cells):
            manifold[v] &= ONE_LOOP[bits[c]]
        _link_neighbours(bits[:cells], cubes[v], strides, cube_index, len(cubes), vertices.neighbours[v])


@njit(cache=True, inline="always")
def _corner_cells(corner_labels, names, bits):
    """Number of cells at a cube's corners; writes the label of each and its corners as bits."""
    cells = 0
    for n in range(8):
        if corner_labels[n] == 0:
            continue
        c = 0
        while c < cells and names[c] != corner_labels[n]:
            c += 1
        if c == cells:
            names[c], bits[c] = corner_labels[n], 0
            cells += 1
        bits[c] |= 1 << n
    return cells


@njit(cache=True, inline="always")
def _corner_distances(known, i, j, k, distances):
    """Distances to the cracks at a cube's corners, 0 where unknown."""
    r = known.distance.shape[0]
    for n in range(8):
        x, y, z = i + (n >> 2), j + (n >> 1 & 1), k + (n & 1)
        labelled = 0 <= x < r and 0 <= y < r and 0 <= z < r and known.labels[x, y, z] > 0
        distances[n] = known.distance[x, y, z] if labelled else 0.0


@njit(cache=True, inline="always")
def _mean_intersection(corner_labels, distances, base, point):
    """Write the mean intersection of cracks and cube edges, at most `MAX_OFFSET` from the cube's centre; the fraction
    of the cut edges on which it is known."""
    crossings, cut = 0, 0
    x, y, z = 0.0, 0.0, 0.0
    for n, m, bit in CUBE_EDGES:
        if corner_labels[m] == corner_labels[n] or corner_labels[n] == 0 or corner_labels[m] == 0:
            continue
        cut += 1
        if distances[n] > 0 and distances[m] > 0:
            crossings += 1
            t = min(max(distances[n] / (distances[n] + distances[m]), EDGE_MARGIN), 1 - EDGE_MARGIN)
            x += t if bit == 2 else n >> 2
            y += t if bit == 1 else n >> 1 & 1
            z += t if bit == 0 else n & 1
    for a in range(3):
        mean = (x if a == 0 else y if a == 1 else z) / crossings if crossings else 0.5
        value, middle = base[a] + mean, base[a] + 0.5
        point[a] = min(max(value, middle - MAX_OFFSET), middle + MAX_OFFSET)
    return crossings / cut if cut else 0.0


@njit(cache=True, inline="always")
def _link_neighbours(bits, cube, strides, cube_index, none, neighbours):
    """The neighbours towards which a cube's vertex is smoothed: along the interface of two cells or the junction line
    of three, across faces of the cube that touch all of them. Points where more cells meet, and ends of junction lines,
    have `none`."""
    linked = 0
    for n in range(6):
        neighbours[n] = none
        touching = 0
        for corners in bits:
            touching += corners & CUBE_FACES[n >> 1, n & 1] != 0
        if len(bits) <= 3 and touching == len(bits):
            adjacent = cube_index[cube + (strides[n >> 1] if n & 1 else -strides[n >> 1])]
            if adjacent > 0:
                neighbours[n] = adjacent - 1
                linked += 1
    if len(bits) == 3 and linked < 2:
        neighbours[:] = none


def _smoothed(initial: CubeVertices) -> Floats:
    """The vertices after `SMOOTHING_STEPS` of Gauss-Seidel relaxation in red-black order.

    Cubes with an even sum of indices have odd neighbours only, so each half may be shared by threads, and converges
    twice as fast as Jacobi steps."""
    points = initial.points.copy()
    for odd in [False, True] * SMOOTHING_STEPS:
        parallel_for(partial(_smooth, points, initial, odd), len(initial.odd), least=4096)
    return points[:-1]


@njit(cache=True, nogil=True)
def _smooth(points, initial, odd, first, last):
    """Move some vertices of one parity to the weighted mean of their neighbours and their initial position.

    Absent neighbours add a zero row, which is faster than a branch."""
    none, neighbours = len(initial.neighbours), initial.neighbours
    for v in range(first, last):
        if initial.odd[v] != odd:
            continue
        count = 0
        x, y, z = 0.0, 0.0, 0.0
        for n in range(6):
            u = neighbours[v, n]
            x += points[u, 0]
            y += points[u, 1]
            z += points[u, 2]
            count += u < none
        if count == 0:
            continue
        weight = DATA_WEIGHT * initial.confidence[v]
        for a in range(3):
            mean = (x if a == 0 else y if a == 1 else z) / count
            target, middle = weight * initial.points[v, a] + (1 - weight) * mean, np.floor(initial.points[v, a]) + 0.5
            points[v, a] = min(max(target, middle - MAX_OFFSET), middle + MAX_OFFSET)


@njit(cache=True, nogil=True)
def _choose_diagonals(points, quad_cubes, edges, diagonals, first, last):
    """From which of its four vertices (0 or 1) the diagonal of each of some quadrilaterals starts; -1: it has none.

    This keeps surface nets free of self-intersections. Each vertex lies in its own cube and each edge between two
    vertices crosses the face between their cubes, so what a crack leaves in a cube is a fan from the vertex to curves
    on the cube's faces. Fans cannot intersect as long as each quadrilateral stays in the four tetrahedra of its grid
    edge and two neighbouring vertices (Ju and Udeshi 2006). Two triangles do if their diagonal does; four triangles
    around a point of the grid edge always do."""
    for n in range(first, last):
        axis = edges[n, 1]
        quad = quad_cubes[n]
        own = points[quad[2]]  # in the cube whose first corner the edge's first voxel is
        corner = (np.floor(own[0]), np.floor(own[1]), np.floor(own[2]))
        longer = 0.0
        for x in range(3):
            longer += (points[quad[0], x] - points[quad[2], x]) ** 2 - (points[quad[1], x] - points[quad[3], x]) ** 2
        diagonal = 1 if longer > 0 else 0
        if not _is_valid(points, quad, corner, axis, diagonal):
            diagonal = 1 - diagonal
            if not _is_valid(points, quad, corner, axis, diagonal):
                diagonal = -1
        diagonals[n] = diagonal


@njit(cache=True, nogil=True)
def _triangle_offsets(diagonals):
    """The first triangle of each quadrilateral, and their number; and how many before it have a vertex in the
    middle."""
    quads, centres = np.zeros(len(diagonals) + 1, np.int64), np.zeros(len(diagonals) + 1, np.int64)
    for n in range(len(diagonals)):
        quads[n + 1] = quads[n] + (2 if diagonals[n] >= 0 else 4)
        centres[n + 1] = centres[n] + (diagonals[n] < 0)
    return quads, centres


@njit(cache=True, nogil=True)
def _triangulate(labels, points, quads, jitter, out, first, last):
    """Two triangles across each of some grid edges, or four quad_cubes a vertex on it: see `_choose_diagonals`."""
    flat, size, count = labels.reshape(-1), labels.shape, len(points)
    strides = (size[1] * size[2], size[2], 1)
    triangles = out.triangles
    for n in range(first, last):
        v, axis = quads.edges[n]
        quad, made, diagonal = quads.cubes[n], quads.start[n], quads.diagonals[n]
        for t in range(made, quads.start[n + 1]):
            out.cells[t, 0], out.cells[t, 1] = flat[v], flat[v + strides[axis]]
        if diagonal >= 0:
            for half in range(2):
                for c in range(3):
                    triangles[made + half, c] = quad[(diagonal + 2 * half + c) % 4]
            continue
        centre = count + quads.centres[n]
        corner = (v // strides[0], v // strides[1] % size[1], v % size[2])
        height = 0.0
        for c in range(4):
            height += 0.25 * (points[quad[c], axis] - corner[axis])
            triangles[made + c, 0], triangles[made + c, 1], triangles[made + c, 2] = centre, quad[c], quad[(c + 1) % 4]
        for x in range(3):
            out.points[centre, x] = corner[x] + jitter[n, x]
        out.points[centre, axis] += min(max(height, EDGE_MARGIN), 1 - EDGE_MARGIN)


@njit(cache=True, inline="always")
def _is_valid(points, quad, corner, axis, diagonal):
    """Whether the diagonal from quad[diagonal] to quad[diagonal + 2] lies in the tetrahedra of the grid edge."""
    p, q = (axis + 1) % 3, (axis + 2) % 3
    a, b = points[quad[diagonal]], points[quad[(diagonal + 2) % 4]]
    ap, aq, bp, bq = a[p] - corner[p], a[q] - corner[q], b[p] - corner[p], b[q] - corner[q]
    # The diagonal passes the grid edge on the side of one of the other two vertices, between it and the edge.
    far = quad[(diagonal + 1) % 4] if ap * bq - aq * bp > 0 else quad[(diagonal + 3) % 4]
    fp, fq, height = points[far, p] - corner[p], points[far, q] - corner[q], points[far, axis] - corner[axis]
    one, two = ap * fq - aq * fp, bp * fq - bq * fp
    if one == two:
        return False
    t = one / (one - two)
    out = ((ap + t * (bp - ap)) * fp + (aq + t * (bq - aq)) * fq) / (fp * fp + fq * fq)
    up = a[axis] + t * (b[axis] - a[axis]) - corner[axis]
    return 0 <= t <= 1 and 0 <= out < 1 - EDGE_MARGIN and height * out < up < 1 - (1 - height) * out
