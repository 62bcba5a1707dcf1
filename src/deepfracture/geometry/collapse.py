"""Takes the slivers out of a mesh, as booleans leave them along cuts."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.topology import compact
from deepfracture.types import Floats, Ints, Mesh

PASSES = 12
"""Rounds of collapses; short edges hardly ever come in longer chains."""


def collapse_short(mesh: Mesh, length: float) -> Mesh:
    """The closed mesh without edges shorter than `length`, as far as its topology and the sense of its
    faces allow. Vertices move by less than `length`."""
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    for _ in range(PASSES):
        merged = _collapses(vertices, faces, length)
        if merged is None:
            break
        faces = merged[faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
    return compact(vertices, faces)


def _collapses(vertices: Floats, faces: Ints, length: float) -> Ints | None:
    """Collapse short edges that do not touch each other's neighbourhoods, moving `vertices` in place.
    Returns the vertex that stands for each, or None when none can go."""
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    short = edges[lengths < length][np.argsort(lengths[lengths < length])]
    at = np.argsort(faces.ravel(), kind="stable") // 3
    first = np.searchsorted(np.sort(faces.ravel()), np.arange(len(vertices) + 1))
    stands = np.arange(len(vertices))
    busy = np.zeros(len(vertices), bool)
    for a, b in short.tolist():
        around = np.union1d(at[first[a] : first[a + 1]], at[first[b] : first[b + 1]])
        ring = np.unique(faces[around])
        if busy[ring].any():
            continue
        place = _place(vertices, faces[around], a, b)
        if place is None:
            continue
        vertices[a] = place
        stands[b] = a
        busy[ring] = True
    return None if (stands == np.arange(len(stands))).all() else stands


def _place(vertices: Floats, around: Ints, a: int, b: int) -> Floats | None:
    """Where a and b can become one: an end or the middle, or None.

    around: the faces at a or b. Only the two vertices opposite the edge may neighbour both (the
    link condition), and no face may turn over."""
    with_a, with_b = (around == a).any(axis=1), (around == b).any(axis=1)
    common = np.intersect1d(around[with_a], around[with_b])
    if len(common) != 4 or (with_a & with_b).sum() != 2:
        return None
    rest = around[with_a != with_b]
    before = _areas(vertices[rest])
    large = np.linalg.norm(before, axis=1) > 0
    best, found = 0.3, None
    for place in (vertices[a], vertices[b], (vertices[a] + vertices[b]) / 2):
        corners = np.where(((rest == a) | (rest == b))[..., None], place, vertices[rest])
        after = _areas(corners)
        norms = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        turn = np.einsum("ni,ni->n", before, after)[large] / np.maximum(norms[large], 1e-300)
        if turn.min(initial=1.0) > best:
            best, found = turn.min(initial=1.0), place.copy()
    return found


def _areas(corners: Floats) -> Floats:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
