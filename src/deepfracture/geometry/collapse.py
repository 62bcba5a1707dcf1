"""Edge collapses: take slivers out of a mesh, or coarsen it without ever tearing it."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.geometry.topology import compact
from deepfracture.types import Floats, Ints, Mesh

PASSES = 30
"""Rounds of collapses, at most."""

MIN_COSINE = 0.3
"""Least cosine of the angle by which a collapse may turn a face."""

GOOD_QUALITY = 0.3
"""Shape of a triangle (1 equilateral, 0 sliver) that a collapse may always make."""

SLIVER_QUALITY = 0.03
"""Shape below which a triangle may turn as it likes."""


def collapse_short_edges(mesh: Mesh, length: float) -> Mesh:
    """The closed mesh without edges shorter than `length`, as far as its topology and the sense of its
    faces allow. Each collapse moves vertices by less than `length`."""
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    for _ in range(PASSES):
        edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        short = edges[lengths < length][np.argsort(lengths[lengths < length])]
        corners = np.argsort(faces.ravel(), kind="stable")
        first = np.searchsorted(faces.ravel()[corners], np.arange(len(vertices) + 1))
        stands = np.arange(len(vertices))
        if not _collapse(vertices, faces, short, corners // 3, first, stands):
            break
        faces = stands[faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
    return compact(vertices, faces)


@njit(cache=True)
def _collapse(vertices: Floats, faces: Ints, short: Ints, at: Ints, first: Ints, stands: Ints):  # pragma: no cover
    """Collapse edges whose neighbourhoods do not touch; returns how many.

    at, first: the faces at each vertex, as compressed rows. Moves `vertices` and writes into
    `stands` which vertex stands for each."""
    busy = np.zeros(len(vertices), np.bool_)
    mark = np.full(len(vertices), -1)
    count = 0
    for e in range(len(short)):
        a, b = short[e]
        free = True
        for end in (a, b):
            for s in range(first[end], first[end + 1]):
                for v in faces[at[s]]:
                    free = free and not busy[v]
        if not free or not _link_condition(faces, at, first, a, b, mark, e):
            continue
        best, choice = -1.0, -1
        middle = (vertices[a] + vertices[b]) / 2
        for option in range(3):
            place = vertices[a] if option == 0 else vertices[b] if option == 1 else middle
            one = _worst_quality(vertices, faces, at, first, a, b, place)
            other = _worst_quality(vertices, faces, at, first, b, a, place)
            if min(one, other) > best:
                best, choice = min(one, other), option
        if choice < 0:
            continue
        for end in (a, b):
            for s in range(first[end], first[end + 1]):
                for v in faces[at[s]]:
                    busy[v] = True
        if choice > 0:
            vertices[a] = vertices[b] if choice == 1 else middle
        stands[b] = a
        count += 1
    return count


@njit(cache=True)
def _link_condition(faces: Ints, at: Ints, first: Ints, a: int, b: int, mark: Ints, stamp: int):  # pragma: no cover
    """The link condition: only the two vertices opposite edge ab neighbour both of its ends.
    mark: scratch that never held `stamp` at a neighbour of a."""
    for s in range(first[a], first[a + 1]):
        for v in faces[at[s]]:
            mark[v] = stamp
    mark[a] = mark[b] = -1
    shared, fan = 0, 0
    for s in range(first[b], first[b + 1]):
        fan += 1
        for v in faces[at[s]]:
            if mark[v] == stamp:
                mark[v] = -1
                shared += 1
    # Three faces at an end: its collapse would fold the surface onto itself.
    return shared == 2 and fan > 3 and first[a + 1] - first[a] > 3


@njit(cache=True)
def _worst_quality(
    vertices: Floats, faces: Ints, at: Ints, first: Ints, a: int, b: int, place: Floats
):  # pragma: no cover
    """Worst shape (1 equilateral, 0 sliver) of the faces at a, but not b, once a moves to place.
    Negative when a face turns too far, or becomes a worse sliver than any of them was."""
    worst, worst_before = 1.0, 1.0
    corners, moved = np.empty((3, 3)), np.empty((3, 3))
    for s in range(first[a], first[a + 1]):
        face = faces[at[s]]
        if face[0] == b or face[1] == b or face[2] == b:
            continue
        for corner in range(3):
            corners[corner] = vertices[face[corner]]
            moved[corner] = place if face[corner] == a else corners[corner]
        before, after = _double_area_vector(corners), _double_area_vector(moved)
        area_before, area = np.sqrt((before * before).sum()), np.sqrt((after * after).sum())
        shape = 2 * np.sqrt(3.0) * area_before / max(_sum_of_squares(corners), 1e-300)
        # The normal of a sliver says nothing.
        if shape > SLIVER_QUALITY and (before * after).sum() <= MIN_COSINE * area_before * area:
            return -1.0
        worst_before = min(worst_before, shape)
        worst = min(worst, 2 * np.sqrt(3.0) * area / max(_sum_of_squares(moved), 1e-300))
    return worst if worst > min(worst_before, GOOD_QUALITY) else -1.0


@njit(cache=True)
def _sum_of_squares(p: Floats) -> float:  # pragma: no cover
    """Sum of the squared sides of a triangle (3, 3)."""
    total = 0.0
    for x in range(3):
        total += (p[1, x] - p[0, x]) ** 2 + (p[2, x] - p[1, x]) ** 2 + (p[0, x] - p[2, x]) ** 2
    return total


@njit(cache=True)
def _double_area_vector(p: Floats):  # pragma: no cover
    """Twice the area vector of a triangle (3, 3)."""
    u, v = p[1] - p[0], p[2] - p[0]
    return np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
