"""Smooths a closed surface where it runs through itself, and nowhere else, until it does not."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.intersect import self_intersections
from deepfracture.geometry.normalise import normalise
from deepfracture.types import Ints, Mesh

ROUNDS = 12
"""Times that what crosses is smoothed and looked at again."""
ROUNDS_PER_RING = 3
"""Rounds after which the smoothed places reach one ring of faces farther."""
STEPS = 3
"""Smoothing steps a round: each vertex goes halfway to the mean of its neighbours."""
MAX_PAIRS_PER_FACE = 8
"""Crossings a face beyond which a mesh is a heap."""
MAX_SHARE = 0.2
"""Share of faces that cross beyond which there is no point in trying."""
MAX_MOVE = 0.1
"""Way that a vertex may go, as a share of the longest side: beyond it the tangle is no small one."""


def self_intersecting_faces(mesh: Mesh, piece: Ints | None = None) -> Ints:
    """Faces that run through another, ascending, by `self_intersections` in the body frame.

    piece: with it, only what runs through faces of its own piece counts, shape (m,). With more than MAX_PAIRS_PER_FACE
    pairs a face all count."""
    most = MAX_PAIRS_PER_FACE * len(mesh.faces)
    pairs = self_intersections(normalise(mesh, "the mesh").mesh, most=most)
    if len(pairs) >= most:
        return np.arange(len(mesh.faces))
    return np.unique(pairs if piece is None else pairs[piece[pairs[:, 0]] == piece[pairs[:, 1]]])


def untangle(mesh: Mesh, piece: Ints) -> tuple[Mesh, int] | None:
    """The closed mesh with its vertices moved where a piece (number of each face, shape (m,)) crosses itself, so that
    it does not, and how many faces did; None where that takes more than small moves."""
    vertices, faces = mesh.vertices, mesh.faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])  # closed: each both ways
    degree = np.bincount(edges[:, 0], minlength=len(vertices))
    limit = MAX_MOVE * float(np.ptp(mesh.bounds, axis=0).max())
    first = 0
    for count in range(ROUNDS):
        bad = self_intersecting_faces(Mesh(vertices, faces), piece)
        first = first or len(bad)
        if not len(bad):
            return Mesh(vertices, faces), first
        if len(bad) > MAX_SHARE * len(faces):
            return None
        loose = np.zeros(len(vertices), bool)
        loose[faces[bad]] = True
        for _ in range(count // ROUNDS_PER_RING):
            loose[faces[loose[faces].any(axis=1)]] = True
        own = edges[loose[edges[:, 0]]]
        moved = np.array(vertices)
        for _ in range(STEPS):
            sums = np.column_stack([np.bincount(own[:, 0], moved[own[:, 1], x], len(moved)) for x in range(3)])
            moved[loose] = 0.5 * (moved[loose] + sums[loose] / degree[loose, None])
        if np.linalg.norm(moved - mesh.vertices, axis=1).max() > limit:
            return None
        vertices = moved
    return None
