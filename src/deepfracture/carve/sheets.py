"""Crack sheets: one shared, smoothed surface between each two cells (surface nets, Gibson 1998)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numba import njit

from deepfracture.threads import spread
from deepfracture.types import Floats, FracturePattern, Ints, Labels

SMOOTHING_STEPS = 12
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
    base, start = np.empty((len(cubes), 3), np.int64), np.zeros((len(cubes) + 1, 3))
    trusted, kind = np.empty(len(base)), np.empty(len(base), np.int32)
    spread(
        lambda first, last: _place(
            labels, pattern.labels, pattern.distance, low, cubes, base, start, trusted, kind, first, last
        ),
        len(base), least=2048,
    )  # fmt: skip
    points = _relaxed(start, trusted, _linked(labels, around, edges, base, kind))
    if grain > 0:
        rng = np.random.default_rng([seed, 1])
        middle = base + 0.5
        points = np.clip(points + rng.uniform(-grain, grain, points.shape), middle - REACH, middle + REACH)
    jitter = _jitter(seed, 1 << (len(points) + len(edges)).bit_length())
    points += jitter[: len(points)]
    turns = np.empty(len(edges), np.int8)
    spread(lambda first, last: _turns(labels.shape, points, around, edges, turns, first, last), len(edges), least=2048)
    quads, middles = _starts(turns)
    every = np.empty((len(points) + middles[-1], 3))
    every[: len(points)] = points
    triangles, sides = np.empty((quads[-1], 3), np.int64), np.empty((quads[-1], 2), np.int32)
    spread(
        lambda first, last: _triangles(
            labels, points, around, edges, turns, jitter[len(points) :], quads, middles, len(points), every, triangles,
            sides, first, last,
        ),
        len(edges), least=4096,
    )  # fmt: skip
    return Sheets(every, cubes, number, triangles, sides, quads, around)


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


@njit(cache=True, nogil=True)
def _place(labels, source, distance, low, cubes, base, points, trusted, kind, first, last):
    """First corner of some cubes, mean crossing of their edges at most `REACH` from their middle, share of the edges
    whose crossing is known, number of cells."""
    s0, s1 = labels.shape[1] * labels.shape[2], labels.shape[2]
    near, gap, seen = np.empty(8, np.int32), np.empty(8), np.empty(8, np.int32)
    r = distance.shape[0]
    for v in range(first, last):
        base[v, 0], base[v, 1], base[v, 2] = cubes[v] // s0, cubes[v] % s0 // s1, cubes[v] % s1
        for n in range(8):
            i, j, k = base[v, 0] + (n >> 2), base[v, 1] + (n >> 1 & 1), base[v, 2] + (n & 1)
            near[n] = labels[i, j, k]
            i, j, k = i + low[0], j + low[1], k + low[2]
            known = 0 <= i < r and 0 <= j < r and 0 <= k < r and source[i, j, k] > 0
            gap[n] = distance[i, j, k] if known else 0.0
        crossings, cracks, cells = 0, 0, 0
        x, y, z = 0.0, 0.0, 0.0
        for n in range(8):
            fresh = near[n] != 0
            for m in range(cells):
                fresh = fresh and seen[m] != near[n]
            if fresh:
                seen[cells] = near[n]
                cells += 1
            for bit in range(3):
                m = n | 1 << bit
                if m == n or near[m] == near[n] or near[n] == 0 or near[m] == 0:
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
            place, middle = base[v, a] + mean, base[v, a] + 0.5
            points[v, a] = min(max(place, middle - REACH), middle + REACH)
        trusted[v] = crossings / cracks if cracks else 0.0
        kind[v] = cells


def _linked(labels: Labels, around: Ints, edges: Ints, base: Ints, kind: Labels) -> Labels:
    """The neighbours each vertex relaxes towards, the number of vertices u for none, shape (u, 6).

    Only along the sheets between cells: across a face of the cube with as many cells as a sheet (2) or a junction
    line (3) needs. Points where more meet get none, nor do ends of a junction line."""
    links = np.full((len(base), 6), len(base), np.int32)
    spread(lambda first, last: _links(labels, around, edges, base, kind, links, first, last), len(edges), least=4096)
    junction = np.flatnonzero(kind == 3)
    links[junction[(links[junction] < len(base)).sum(axis=1) < 2]] = len(base)
    return links


@njit(cache=True, nogil=True)
def _links(labels, around, edges, base, kind, links, first, last):
    """Links across the faces of cubes at some edges. A face may be at several: they all say the same."""
    flat, strides = labels.reshape(-1), (labels.shape[1] * labels.shape[2], labels.shape[2], 1)
    for n in range(first, last):
        axis = edges[n, 1]
        for corner in range(4):
            one, two = around[n, corner], around[n, (corner + 1) % 4]
            # The first pair and the third lie side by side along the next axis, the others along the one after.
            across = (axis + 1) % 3 if corner % 2 == 0 else (axis + 2) % 3
            if base[one, across] > base[two, across]:
                one, two = two, one
            corner_of_face = base[two, 0] * strides[0] + base[two, 1] * strides[1] + base[two, 2]
            cells = _cells_on_face(flat, corner_of_face, strides[(across + 1) % 3], strides[(across + 2) % 3])
            for v, u, side in ((one, two, 1), (two, one, 0)):
                if (kind[v] == 2 and cells >= 2) or (kind[v] == 3 and cells >= 3):
                    links[v, 2 * across + side] = u


@njit(cache=True, inline="always")
def _cells_on_face(flat, a, p, q):
    """Number of cells among the four voxels a, a + p, a + q, a + p + q."""
    one, two, three, four = flat[a], flat[a + p], flat[a + q], flat[a + p + q]
    count = 1 if one != 0 else 0
    if two != 0 and two != one:
        count += 1
    if three != 0 and three != one and three != two:
        count += 1
    if four != 0 and four != one and four != two and four != three:
        count += 1
    return count


def _relaxed(start: Floats, trusted: Floats, links: Labels) -> Floats:
    """The vertices after `SMOOTHING_STEPS`; the last row of `start`, which stands for no neighbour, is zero."""
    points, moved = start.copy(), start.copy()
    for _ in range(SMOOTHING_STEPS):
        spread(partial(_relax, points, start, trusted, links, moved), len(links), least=4096)
        points, moved = moved, points
    return points[:-1]


@njit(cache=True, nogil=True)
def _relax(points, start, trusted, links, moved, first, last):
    """One step of some vertices towards their neighbours' mean and their own start, into `moved`.

    Absent neighbours add a zero: quicker than to ask which are absent."""
    none = len(links)
    for v in range(first, last):
        count = 0
        x, y, z = 0.0, 0.0, 0.0
        for n in range(6):
            u = links[v, n]
            x += points[u, 0]
            y += points[u, 1]
            z += points[u, 2]
            count += u < none
        if count == 0:
            continue  # stays where it started, in both arrays
        pull = TRUST * trusted[v]
        for a in range(3):
            mean = (x if a == 0 else y if a == 1 else z) / count
            goal = pull * start[v, a] + (1 - pull) * mean
            goal, middle = 0.5 * (points[v, a] + goal), np.floor(start[v, a]) + 0.5
            moved[v, a] = min(max(goal, middle - REACH), middle + REACH)


@njit(cache=True, nogil=True)
def _turns(size, points, around, edges, turns, first, last):
    """From which of its four vertices the diagonal across each of some grid edges starts, 0 or 1; -1: it has none.

    Each vertex lies in its own cube and each edge between two vertices crosses the face between their cubes, so
    what a sheet leaves in a cube is a fan from the vertex to curves on the cube's faces, which cannot cross - if
    each quadrilateral keeps to the four tetrahedra of its grid edge and two neighbouring vertices (Ju and Udeshi
    2006). Two triangles do if their diagonal does; four around a point of the grid edge always do."""
    strides = (size[1] * size[2], size[2], 1)
    for n in range(first, last):
        v, axis = edges[n]
        ring = around[n]
        corner = (v // strides[0], v // strides[1] % size[1], v % size[2])
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
