"""Re-fracture: the pattern some frames after the hit, when fragments that were hit have broken again.

The paper's data are captured after one second of the rigid-body simulation, in which fragments that collide with each
other or the ball break again. The pattern on the grid of the whole is that of the last generation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deepfracture.carve import cut
from deepfracture.fracture import FragmentSimulator
from deepfracture.geometry import closest_points, signed_distance_points
from deepfracture.types import FracturePattern, Fragment, Fragments, Impact, Material, Mesh, Shape
from deepfracture.world import Outcome, Scene
from deepfracture.world import simulate as run_world

BOX_MARGIN = 2.0
"""Margin around the box of a fragment within which voxels may belong to it [voxels]."""


@dataclass(frozen=True)
class _Breaker:
    """Breaks the whole into given fragments, and simulates the fracture of those."""

    first: Fragments
    pieces: FragmentSimulator

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments | None:
        if shape.whole is None:
            return self.first
        pattern = self.pieces(shape, impact, rng)
        return None if pattern is None else cut_apart(shape, pattern, self.pieces.material)


def refracture(
    scene: Scene, shape: Shape, material: Material, pattern: FracturePattern, rng: np.random.Generator, *,
    frames: int, generations: int,
) -> FracturePattern:  # fmt: skip
    """The pattern of the fragments that exist `frames` frames after the last ball should have arrived.

    Args:
        scene: One shape and what hits it.
        pattern: How the first hit breaks the whole.
        generations: Generations of fragments that may break again.
    """
    first = cut_apart(shape, pattern, material)
    if first is None:
        return pattern
    arrival = max(ball.delay + np.linalg.norm(ball.position) / np.linalg.norm(ball.velocity) for ball in scene.balls)
    scene = replace(scene, refracture=generations, duration=float(arrival) + frames / scene.frame_rate)
    breaker = _Breaker(first, FragmentSimulator(material, pattern.grid))
    outcome = run_world(scene, [shape], breaker, rng, materials={material.name: material})
    if not any(collision.generation for collision in outcome.breaks):
        return pattern
    return voxelize(final_fragments(outcome), pattern)


def cut_apart(shape: Shape, pattern: FracturePattern, material: Material) -> Fragments | None:
    """The shape cut along a pattern; None if the cut leaves one fragment, as small components are merged."""
    fragments = cut(shape, pattern, density=material.density)
    return fragments if len(fragments) > 1 else None


def final_fragments(outcome: Outcome) -> list[Fragment]:
    """All fragments that did not break again, sorted by name."""
    final: dict[str, Fragment] = {}
    for collision in outcome.breaks:
        assert collision.fragments is not None
        final.pop(collision.body, None)
        final |= {f"{collision.body}.{i:03d}": piece for i, piece in enumerate(collision.fragments)}
    return [final[name] for name in sorted(final)]


def voxelize(fragments: list[Fragment], whole: FracturePattern) -> FracturePattern:
    """Fragments of a shape as a pattern on the grid of `whole`, whose labels mark the voxels of the shape.

    Each voxel belongs to the fragment whose signed distance at its centre is largest. Distances are exact, to the
    nearest crack surface of any fragment."""
    grid = whole.grid
    voxels = np.argwhere(whole.labels > 0)
    centres = grid.to_world(voxels)
    depth, owner = np.full(len(voxels), -np.inf), np.zeros(len(voxels), np.int64)
    for number, piece in enumerate(fragments):
        low, high = piece.mesh.bounds + BOX_MARGIN * grid.spacing * np.array([[-1.0], [1.0]])
        near = np.flatnonzero(((centres >= low) & (centres <= high)).all(axis=1))
        deeper = signed_distance_points(piece.mesh, centres[near])
        won = deeper > depth[near]
        depth[near[won]], owner[near[won]] = deeper[won], number
    assert np.isfinite(depth).all()
    labels, distance = np.zeros(grid.shape, np.int32), np.zeros(grid.shape, np.float32)
    labels[tuple(voxels.T)] = np.unique(owner, return_inverse=True)[1].reshape(-1) + 1
    distance[tuple(voxels.T)] = closest_points(_crack_surfaces(fragments), centres).distance
    return FracturePattern(grid, labels, distance)


def _crack_surfaces(fragments: list[Fragment]) -> Mesh:
    """The crack surfaces of all fragments as one triangle soup."""
    corners = np.concatenate([piece.mesh.triangles[piece.source < 0] for piece in fragments]).reshape(-1, 3)
    return Mesh(corners, np.arange(len(corners)).reshape(-1, 3))
