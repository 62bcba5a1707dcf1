"""Crack sheets: one shared, smoothed surface between each two cells (surface nets, Gibson 1998)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import Floats, FracturePattern, Ints, Labels

SMOOTHING_STEPS = 3
TRUST = 0.5
"""Pull of a vertex towards the crack crossings around it, against that of its neighbours."""
REACH = 0.49
"""A vertex stays in its own cube: it moves at most this many voxels from the middle along each axis."""
EDGE = 0.05
"""Crossings keep this fraction of a grid edge away from its ends."""
JITTER = 1e-6
"""Vertices are moved by up to this [voxels], so that no four points of crack and surface lie in one plane."""


@dataclass(frozen=True, eq=False)
class Sheets:
    """All sheets of a label field, in the voxels of its box. They do not cross themselves or each other: see
    `_turns`. They end only where labels do."""

    points: Floats
    """Shape (v, 3)."""
    cubes: Ints
    """Flat index of the first corner of the cube that holds each of the first vertices, shape (u,), u <= v; the
    others lie on grid edges."""
    number: Labels
    """One more than the index of each cube of the box in `cubes`, 0 for the others, flat."""
    triangles: Ints
    """Counter-clockwise seen from the cell above, shape (t, 3)."""
    sides: Labels
    """Cells below and above each triangle, shape (t, 2)."""
    quads: Ints
    """The first triangle of each grid edge between two cells, and their number at the end, shape (q + 1,)."""
    around: Ints
    """The four cubes around that edge, as indices into `cubes`, shape (q, 4): they hold all of its triangles."""
    plain: NDArray[np.bool_]
    """Points around which the triangles of each cell are one fan, shape (v,)."""


def crack_sheets(
    labels: Labels, edges: Ints, pattern: FracturePattern, low: Ints, *, grain: float = 0.0, seed: int = 0
) -> Sheets:
    """The surfaces between cells.

    A vertex stands in every cube that a sheet passes. It starts at the mean of the cracks' crossings of the cube's
    edges, then relaxes along the sheet (along junction lines where three cells meet) without leaving its cube.

    Args:
        labels, edges: From `cell_labels`.
        pattern: Where its distances are known, they say where cracks cross grid edges.
        low: Grid index of the first voxel of `labels`.
        grain: Vertices are scattered by up to this [voxels], still without leaving their cubes.
        seed: Of grain and jitter.
    """
    number = np.zeros(labels.size, np.int32)
    around, cubes = _cubes(labels.shape, edges, number)
    start, trusted = np.zeros((len(cubes) + 1, 3)), np.empty(len(cubes))
    links = np.empty((len(cubes), 6), np.int32)
    plain, odd = np.empty(len(cubes), np.bool_), np.empty(len(cubes), np.bool_)
    parallel_for(
        lambda first, last: _place(
            labels, pattern.labels, pattern.distance, low, cubes, number, start, trusted, links, plain, odd, first,
            last,
        ),
        len(cubes), least=2048,
    )  # fmt: skip
    points = _relaxed(start, trusted, links, odd)
    if grain > 0:
        rng = np.random.default_rng([seed, 1])
        middle = np.floor(start[:-1]) + 0.5
        points = np.clip(points + rng.uniform(-grain, grain, points.shape), middle - REACH, middle + REACH)
    jitter = _jitter(seed, 1 << (len(points) + len(edges)).bit_length())
    points += jitter[: len(points)]
    turns = np.empty(len(edges), np.int8)
    parallel_for(lambda first, last: _turns(points, around, edges, turns, first, last), len(edges), least=2048)
    quads, middles = _starts(turns)
    every = np.empty((len(points) + middles[-1], 3))
    every[: len(points)] = points
    triangles, sides = np.empty((quads[-1], 3), np.int64), np.empty((quads[-1], 2), np.int32)
    parallel_for(
        lambda first, last: _triangles(
            labels, points, around, edges, turns, jitter[len(points) :], quads, middles, len(points), every, triangles,
            sides, first, last,
        ),
        len(edges), least=4096,
    )  # fmt: skip
    plain = np.concatenate([plain, np.ones(middles[-1], np.bool_)])
    return Sheets(every, cubes, number, triangles, sides, quads, around, plain)


@lru_cache(maxsize=2)
def _jitter(seed: int, count: int) -> Floats:
    """The same for every cut with a seed, shape (count, 3): drawing takes as long as smoothing."""
    jitter = np.random.default_rng(seed).uniform(-JITTER, JITTER, (count, 3))
    jitter.setflags(write=False)
    return jitter


@njit(cache=True)
def _cubes(shape, edges, number):
    """The four cubes around each edge, counter-clockwise seen from its second voxel, by index into all cubes; these.
    `number` becomes one more than that index for them and stays 0 for all other cubes of the box."""
    strides = (shape[1] * shape[2], shape[2], 1)
    around = np.empty((len(edges), 4), np.int64)
    cubes = np.empty(4 * len(edges), np.int64)
    count = 0
    for n in range(len(edges)):
        v, axis = edges[n]
        p, q = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
        for corner in range(4):
            cube = v - (p if corner == 0 or corner == 3 else 0) - (q if corner < 2 else 0)
            if number[cube] == 0:
                cubes[count] = cube
                count += 1
                number[cube] = count
            around[n, corner] = number[cube] - 1
    return around, cubes[:count].copy()


def _one_loop(corners: int) -> bool:
    """Whether the surface around some of a cube's eight corners (bits) is one fan around a point in its middle.

    On a face of the cube it crosses two edges, or none: edges that share faces make up its loops."""
    crossed = [(n, axis) for n in range(8) for axis in range(3) if corners >> n & 1 != corners >> (n ^ 1 << axis) & 1]
    crossed = [(n, axis) for n, axis in crossed if not n >> axis & 1]
    seen, ahead = set(), crossed[:1]
    while ahead:
        n, axis = ahead.pop()
        if (n, axis) in seen:
            continue
        seen.add((n, axis))
        for other in range(3):  # the faces beside the edge lie across the two other axes
            face = [edge for edge in crossed if edge[1] != other and (edge[0] ^ n) >> other & 1 == 0]
            if other != axis and len(face) != 2:
                return False
            ahead += face if other != axis else []
    return len(seen) == len(crossed)


ONE_LOOP = np.array([_one_loop(corners) for corners in range(256)])
"""For each set of corners, as the bits of a number: see `_one_loop`."""
EDGES = tuple((n, n | 1 << bit, bit) for n in range(8) for bit in range(3) if not n >> bit & 1)
"""Corners at both ends of a cube's edges, numbered as in `FACES`, and which bit of their numbers differs."""
FACES = np.array([[sum(1 << n for n in range(8) if n >> 2 - axis & 1 == high) for high in (0, 1)] for axis in range(3)])
"""The corners on a cube's faces as bits, corner n at (n >> 2, n >> 1 & 1, n & 1)."""


@njit(cache=True, nogil=True)
def _place(
    labels, source, distance, low, cubes, number, points, trusted, links, plain, odd, first, last
):  # fmt: skip
    """What is known of some cubes: see `_mean_crossing`, `_neighbours` and `Sheets.plain`; and whether the sum of the
    indices is odd."""
    s0, s1 = labels.shape[1] * labels.shape[2], labels.shape[2]
    flat, strides = labels.reshape(-1), (s0, s1, 1)
    near, gap, names, bits = np.empty(8, np.int32), np.empty(8), np.empty(8, np.int32), np.empty(8, np.int64)
    for v in range(first, last):
        i, j, k = cubes[v] // s0, cubes[v] % s0 // s1, cubes[v] % s1
        odd[v] = (i + j + k) & 1 == 1
        for n in range(8):
            near[n] = flat[cubes[v] + (n >> 2) * s0 + (n >> 1 & 1) * s1 + (n & 1)]
        cells = _cells(near, names, bits)
        _gaps(source, distance, i + low[0], j + low[1], k + low[2], gap)
        trusted[v] = _mean_crossing(near, gap, (i, j, k), points[v])
        plain[v] = True
        for c in range(cells):
            plain[v] &= ONE_LOOP[bits[c]]
        _neighbours(bits[:cells], cubes[v], strides, number, len(cubes), links[v])


@njit(cache=True, inline="always")
def _cells(near, names, bits):
    """Number of cells at a cube's corners; the corners of each as bits, its name as `names` has it."""
    cells = 0
    for n in range(8):
        if near[n] == 0:
            continue
        c = 0
        while c < cells and names[c] != near[n]:
            c += 1
        if c == cells:
            names[c], bits[c] = near[n], 0
            cells += 1
        bits[c] |= 1 << n
    return cells


@njit(cache=True, inline="always")
def _gaps(source, distance, i, j, k, gap):
    """Distances to the cracks at a cube's corners, 0 where they are not known."""
    r = distance.shape[0]
    for n in range(8):
        x, y, z = i + (n >> 2), j + (n >> 1 & 1), k + (n & 1)
        known = 0 <= x < r and 0 <= y < r and 0 <= z < r and source[x, y, z] > 0
        gap[n] = distance[x, y, z] if known else 0.0


@njit(cache=True, inline="always")
def _mean_crossing(near, gap, base, point):
    """Write the mean crossing of a cube's edges, at most `REACH` from its middle; the share of the edges whose crossing
    is known."""
    crossings, cracks = 0, 0
    x, y, z = 0.0, 0.0, 0.0
    for n, m, bit in EDGES:
        if near[m] == near[n] or near[n] == 0 or near[m] == 0:
            continue
        cracks += 1
        if gap[n] > 0 and gap[m] > 0:
            crossings += 1
            at = min(max(gap[n] / (gap[n] + gap[m]), EDGE), 1 - EDGE)
            x += at if bit == 2 else n >> 2
            y += at if bit == 1 else n >> 1 & 1
            z += at if bit == 0 else n & 1
    for a in range(3):
        mean = (x if a == 0 else y if a == 1 else z) / crossings if crossings else 0.5
        place, middle = base[a] + mean, base[a] + 0.5
        point[a] = min(max(place, middle - REACH), middle + REACH)
    return crossings / cracks if cracks else 0.0


@njit(cache=True, inline="always")
def _neighbours(bits, cube, strides, number, none, links):
    """The neighbours towards which a cube's vertex relaxes: along the sheets between cells, across a face with as many
    cells as a sheet (2) or a junction line (3) needs. Points where more meet have `none`, nor have ends of a junction
    line."""
    linked = 0
    for n in range(6):
        links[n] = none
        meet = 0
        for corners in bits:
            meet += corners & FACES[n >> 1, n & 1] != 0
        if len(bits) <= 3 and meet == len(bits):
            beside = number[cube + (strides[n >> 1] if n & 1 else -strides[n >> 1])]
            if beside > 0:
                links[n] = beside - 1
                linked += 1
    if len(bits) == 3 and linked < 2:
        links[:] = none


def _relaxed(start: Floats, trusted: Floats, links: Labels, odd: NDArray[np.bool_]) -> Floats:
    """The vertices after `SMOOTHING_STEPS`; the last row of `start`, which stands for no neighbour, is zero.

    Cubes with an even sum of indices have odd neighbours only: each half follows the other (Gauss and Seidel, red and
    black), which comes twice as far as all at once and may be shared by threads all the same."""
    points = start.copy()
    for half in [False, True] * SMOOTHING_STEPS:
        parallel_for(partial(_relax, points, start, trusted, links, odd, half), len(links), least=4096)
    return points[:-1]


@njit(cache=True, nogil=True)
def _relax(points, start, trusted, links, odd, half, first, last):
    """One step of one half of some vertices to the mean of their neighbours and their own start.

    Absent neighbours add a zero: quicker than to ask which are absent."""
    none = len(links)
    for v in range(first, last):
        if odd[v] != half:
            continue
        count = 0
        x, y, z = 0.0, 0.0, 0.0
        for n in range(6):
            u = links[v, n]
            x += points[u, 0]
            y += points[u, 1]
            z += points[u, 2]
            count += u < none
        if count == 0:
            continue
        pull = TRUST * trusted[v]
        for a in range(3):
            mean = (x if a == 0 else y if a == 1 else z) / count
            goal, middle = pull * start[v, a] + (1 - pull) * mean, np.floor(start[v, a]) + 0.5
            points[v, a] = min(max(goal, middle - REACH), middle + REACH)


@njit(cache=True, nogil=True)
def _turns(points, around, edges, turns, first, last):
    """From which of its four vertices the diagonal across each of some grid edges starts, 0 or 1; -1: it has none.

    Each vertex lies in its own cube and each edge between two vertices crosses the face between their cubes, so
    what a sheet leaves in a cube is a fan from the vertex to curves on the cube's faces, which cannot cross - if
    each quadrilateral keeps to the four tetrahedra of its grid edge and two neighbouring vertices (Ju and Udeshi
    2006). Two triangles do if their diagonal does; four around a point of the grid edge always do."""
    for n in range(first, last):
        axis = edges[n, 1]
        ring = around[n]
        own = points[ring[2]]  # in the cube whose first corner the edge's first voxel is
        corner = (np.floor(own[0]), np.floor(own[1]), np.floor(own[2]))
        longer = 0.0
        for x in range(3):
            longer += (points[ring[0], x] - points[ring[2], x]) ** 2 - (points[ring[1], x] - points[ring[3], x]) ** 2
        turn = 1 if longer > 0 else 0
        if not _keeps(points, ring, corner, axis, turn):
            turn = 1 - turn
            if not _keeps(points, ring, corner, axis, turn):
                turn = -1
        turns[n] = turn


@njit(cache=True, nogil=True)
def _starts(turns):
    """The first triangle of each grid edge, and their number; and how many edges before it have a vertex on them."""
    quads, middles = np.zeros(len(turns) + 1, np.int64), np.zeros(len(turns) + 1, np.int64)
    for n in range(len(turns)):
        quads[n + 1] = quads[n] + (2 if turns[n] >= 0 else 4)
        middles[n + 1] = middles[n] + (turns[n] < 0)
    return quads, middles


@njit(cache=True, nogil=True)
def _triangles(
    labels, points, around, edges, turns, jitter, quads, middles, count, every, triangles, sides, first, last
):  # fmt: skip
    """Two triangles across each of some grid edges, or four around a vertex on it: see `_turns`. `count`: of the
    vertices in cubes."""
    flat, size = labels.reshape(-1), labels.shape
    strides = (size[1] * size[2], size[2], 1)
    for n in range(first, last):
        v, axis = edges[n]
        ring, made, turn = around[n], quads[n], turns[n]
        for t in range(made, quads[n + 1]):
            sides[t, 0], sides[t, 1] = flat[v], flat[v + strides[axis]]
        if turn >= 0:
            for half in range(2):
                for c in range(3):
                    triangles[made + half, c] = ring[(turn + 2 * half + c) % 4]
            continue
        middle = count + middles[n]
        corner = (v // strides[0], v // strides[1] % size[1], v % size[2])
        height = 0.0
        for c in range(4):
            height += 0.25 * (points[ring[c], axis] - corner[axis])
            triangles[made + c, 0], triangles[made + c, 1], triangles[made + c, 2] = middle, ring[c], ring[(c + 1) % 4]
        for x in range(3):
            every[middle, x] = corner[x] + jitter[n, x]
        every[middle, axis] += min(max(height, EDGE), 1 - EDGE)


@njit(cache=True, inline="always")
def _keeps(points, ring, corner, axis, turn):
    """Whether the diagonal from ring[turn] to ring[turn + 2] runs inside the tetrahedra of the grid edge."""
    p, q = (axis + 1) % 3, (axis + 2) % 3
    a, b = points[ring[turn]], points[ring[(turn + 2) % 4]]
    ap, aq, bp, bq = a[p] - corner[p], a[q] - corner[q], b[p] - corner[p], b[q] - corner[q]
    # The diagonal passes the grid edge on the side of one of the other two vertices, between it and the edge.
    far = ring[(turn + 1) % 4] if ap * bq - aq * bp > 0 else ring[(turn + 3) % 4]
    fp, fq, height = points[far, p] - corner[p], points[far, q] - corner[q], points[far, axis] - corner[axis]
    one, two = ap * fq - aq * fp, bp * fq - bq * fp
    if one == two:
        return False
    t = one / (one - two)
    out = ((ap + t * (bp - ap)) * fp + (aq + t * (bq - aq)) * fq) / (fp * fp + fq * fq)
    up = a[axis] + t * (b[axis] - a[axis]) - corner[axis]
    return 0 <= t <= 1 and 0 <= out < 1 - EDGE and height * out < up < 1 - (1 - height) * out
