"""Edges too short to matter, taken out where a crack passes close by a vertex of the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from deepfracture.carve.solids import Faces

PASSES = 6
"""Rounds of collapses: in one, no two that have a face in common."""
TURN = 0.5
"""Least cosine of the angle by which a collapse may turn a face that is no sliver."""
MANY = 64
"""Faces at a vertex above which its edges stay."""


def without_short_edges(faces: Faces, shortest: float, originals: int) -> Faces:
    """The same faces with no edge below `shortest` [m] that can go: both its points become one.

    The first `originals` points, the surface's own vertices, never move, and outer faces stay in the plane of their
    source. An edge goes only if the cells on both sides of it remain what they were: every cell that meets at one of
    its points meets along all of it, and no two faces become one (link condition, Dey et al. 1999)."""
    corners = np.concatenate([faces.outer, faces.inner])
    outside = np.zeros((len(faces.outer), 1), np.int64)
    sides = np.concatenate([np.concatenate([outside, faces.cell[:, None]], axis=1), faces.sides])
    source = np.concatenate([faces.source, np.full(len(faces.inner), -1)])
    changed = False
    for _ in range(PASSES):
        short = _short_edges(faces.positions, corners, shortest, originals)
        if not len(short) or not _collapse(faces.positions, corners, sides, source, short, shortest, originals):
            break
        changed = True
    if not changed:
        return faces
    left = corners[:, 0] >= 0
    outer, inner = left[: len(faces.outer)], left[len(faces.outer) :]
    return replace(
        faces,
        outer=corners[: len(outer)][outer],
        source=faces.source[outer],
        cell=faces.cell[outer],
        inner=corners[len(outer) :][inner],
        sides=faces.sides[inner],
    )


@njit(cache=True)
def _short_edges(positions, corners, shortest, originals):
    """Edges below the length, the shortest first, without those of the original, shape (s, 2)."""
    found, lengths = np.empty((16, 2), np.int64), np.empty(16)
    count = 0
    for f in range(len(corners)):
        for n in range(3):
            a, b = corners[f, n], corners[f, (n + 1) % 3]
            if a > b or a < 0 or b < originals:
                continue
            square = 0.0
            for x in range(3):
                square += (positions[a, x] - positions[b, x]) ** 2
            if square >= shortest * shortest:
                continue
            if count == len(found):
                found, lengths = np.concatenate((found, found)), np.concatenate((lengths, lengths))
            found[count, 0], found[count, 1], lengths[count] = a, b, square
            count += 1
    return found[:count][np.argsort(lengths[:count], kind="mergesort")]


@njit(cache=True)
def _collapse(positions, corners, sides, source, short, shortest, originals):
    """Collapse what can go; rows of `corners` that are gone become -1. Returns how many edges went."""
    slot = np.full(len(positions), -1, np.int32)
    used = 0
    for e in range(len(short)):
        for n in range(2):
            if slot[short[e, n]] < 0:
                slot[short[e, n]] = used
                used += 1
    around = np.empty((used, MANY), np.int64)
    size = np.zeros(used, np.int64)
    for f in range(len(corners)):
        if corners[f, 0] < 0:
            continue
        for n in range(3):
            at = slot[corners[f, n]]
            if at >= 0:
                if size[at] < MANY:
                    around[at, size[at]] = f
                size[at] += 1
    busy = np.zeros(len(corners), np.bool_)
    gone = 0
    for e in range(len(short)):
        a, b = short[e]
        own, other = around[slot[a], : size[slot[a]]], around[slot[b], : size[slot[b]]]
        if size[slot[a]] > MANY or size[slot[b]] > MANY or busy[own].any() or busy[other].any():
            continue
        if not _is_whole(corners, sides, own, other, a, b):
            continue
        # The higher point goes to the lower: those of the original come first.
        if _may_move(positions, corners, source, other, own, b, a, shortest):
            stays, goes, faces = a, b, other
        elif a >= originals and _may_move(positions, corners, source, own, other, a, b, shortest):
            stays, goes, faces = b, a, own
        else:
            continue
        for f in own:
            busy[f] = True
        for f in other:
            busy[f] = True
        for f in faces:
            if corners[f, 0] == stays or corners[f, 1] == stays or corners[f, 2] == stays:
                corners[f] = -1
                continue
            for n in range(3):
                if corners[f, n] == goes:
                    corners[f, n] = stays
        gone += 1
    return gone


@njit(cache=True)
def _is_whole(corners, sides, own, other, a, b):
    """Whether the edge a b can go without a change of what meets what."""
    cells = np.empty(2 * len(own), np.int64)
    count, shared = 0, 0
    for f in own:
        if corners[f, 0] == b or corners[f, 1] == b or corners[f, 2] == b:
            cells[count], cells[count + 1] = sides[f, 0], sides[f, 1]
            count += 2
            shared += 1
    along = cells[:count]
    if not (_within(sides, own, along) or _within(sides, other, along)):
        return False
    beside = 0
    for f in own:
        for n in range(3):
            v = corners[f, n]
            if v in (a, b):
                continue
            first = True
            for g in own:
                if g == f:
                    break
                first = first and not (corners[g, 0] == v or corners[g, 1] == v or corners[g, 2] == v)
            if not first:
                continue
            for g in other:
                if corners[g, 0] == v or corners[g, 1] == v or corners[g, 2] == v:
                    beside += 1
                    break
    return beside == shared


@njit(cache=True, inline="always")
def _within(sides, faces, cells):
    """Whether all cells at the faces are among `cells`."""
    for f in faces:
        for n in range(2):
            found = False
            for cell in cells:
                found = found or cell == sides[f, n]
            if not found:
                return False
    return True


@njit(cache=True)
def _may_move(positions, corners, source, faces, others, goes, stays, shortest):
    """Whether `goes` may move to `stays`: outer faces keep their planes, no face turns, none becomes flat."""
    old, new = np.empty((3, 3)), np.empty((3, 3))
    for f in faces:
        if source[f] >= 0:
            found = False
            for g in others:
                found = found or source[g] == source[f]
            if not found:
                return False
        if corners[f, 0] == stays or corners[f, 1] == stays or corners[f, 2] == stays:
            continue
        for n in range(3):
            v = corners[f, n]
            for x in range(3):
                old[n, x] = positions[v, x]
                new[n, x] = positions[stays, x] if v == goes else positions[v, x]
        before, height = _normal(old)
        after, lower = _normal(new)
        if lower <= 0 or lower < min(height, 0.5 * shortest):
            return False
        dot = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
        if dot < (TURN if height >= shortest else 0.0):
            return False
    return True


@njit(cache=True, inline="always")
def _normal(t):
    """Unit normal of a triangle and its lowest altitude."""
    ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    longest = np.sqrt(max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz))
    if area == 0 or longest == 0:
        return (0.0, 0.0, 0.0), 0.0
    return (nx / area, ny / area, nz / area), area / longest
