"""A small recording made by hand: an octahedron that breaks into two closed halves."""

from __future__ import annotations

import numpy as np

from deepfracture.types import Fragment, Fragments, Mesh, Recording, Track

FRAMES, HIT, REST, RATE = 61, 15, 45, 30
"""Frames in all, first frame of the halves, frame from which they lie still, frames a second."""

TIPS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
RING = [2, 4, 3, 5]
"""Tips around the x axis, counter-clockwise seen from +x."""


def octahedron() -> Mesh:
    ring = [(a, b) for a, b in zip(RING, RING[1:] + RING[:1], strict=True)]
    return Mesh(TIPS, np.array([[0, a, b] for a, b in ring] + [[1, b, a] for a, b in ring]))


def halves() -> Fragments:
    """The octahedron cut at x = 0."""
    whole, pieces = octahedron(), []
    a, b, c, d = RING
    lids = np.array([[[a, c, b], [a, d, c]], [[a, b, c], [a, c, d]]])
    for half in range(2):
        outer = np.arange(4) + 4 * half
        faces = np.concatenate([whole.faces[outer], lids[half]])
        mesh = Mesh(TIPS, faces)
        used, packed = np.unique(faces, return_inverse=True)
        mesh = Mesh(TIPS[used], packed.reshape(-1, 3))
        centre = np.array([0.25 if half == 0 else -0.25, 0, 0])
        pieces.append(Fragment(mesh, np.concatenate([outer, [-1, -1]]), 1.0, centre, 0.1 * np.eye(3)))
    return Fragments(tuple(pieces))


def broken_octahedron(user_from_world: np.ndarray | None = None) -> Recording:
    """Falls a little, is hit by a ball, flies apart in two spinning halves that then lie still."""
    still = np.array([[1.0, 0, 0, 0]])
    ball = Mesh(0.2 * TIPS, octahedron().faces)
    x, y = np.linspace(-3, 0, FRAMES), np.zeros(FRAMES)
    floor_height = np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]], float)
    tracks = [
        Track("floor", "floor", Mesh(floor_height, np.array([[0, 1, 2], [0, 2, 3]])), None, 0,
              np.zeros((FRAMES, 3)), np.repeat(still, FRAMES, axis=0)),
        Track("octahedron", "shape", octahedron(), None, 0,
              np.stack([y[:HIT], y[:HIT], 2 - 0.01 * np.arange(HIT)], axis=1), np.repeat(still, HIT, axis=0)),
        Track("ball", "ball", ball, None, 0, np.stack([x, y - 1.5, y + 1.8], axis=1),
              np.repeat(still, FRAMES, axis=0)),
    ]  # fmt: skip
    for side, piece in zip((1, -1), halves(), strict=True):
        step = np.minimum(np.arange(FRAMES - HIT), REST - HIT) / (REST - HIT)
        positions = np.stack([0.25 * side + 1.2 * side * step, 0 * step, 1.85 - 0.8 * step**2], axis=1)
        # twice around, so that the sign of a quaternion matters
        angle = 4 * np.pi * step * side
        quats = np.stack([np.cos(angle / 2), 0 * step, np.sin(angle / 2), 0 * step], axis=1)
        quats[quats[:, 0] < 0] *= -1
        mesh = piece.mesh.moved(1.0, -piece.centre)
        tracks.append(Track(f"half {side}", "fragment", mesh, piece.source, HIT, positions, quats))
    user = np.eye(4) if user_from_world is None else user_from_world
    return Recording(1 / RATE, tuple(tracks), user)
