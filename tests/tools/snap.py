"""A breaker for tests of the world: everything snaps in two where it is hit, as quickly as can be."""

from __future__ import annotations

import numpy as np

from deepfracture.breakers import PatternBreaker
from deepfracture.fracture import material
from deepfracture.geometry import signed_distance
from deepfracture.types import FracturePattern, Grid, Impact, Shape

GRID = Grid(32)


def snap(shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern:
    """Two halves, parted by a plane through the blow, across the longest side, a little askew."""
    normal = np.eye(3)[np.ptp(shape.mesh.bounds, axis=0).argmax()] + 0.2 * rng.standard_normal(3)
    middle = 0.5 * impact.position[0] + 0.5 * shape.mesh.bounds.mean(axis=0)
    height = (GRID.centres() - middle) @ (normal / np.linalg.norm(normal))
    inside = signed_distance(shape.mesh, GRID) > 0
    labels = np.where(inside, 1 + (height > 0), 0).astype(np.int32)
    return FracturePattern(GRID, labels, np.abs(height).astype(np.float32))


def snapper(name: str = "glass") -> PatternBreaker:
    return PatternBreaker(snap, material(name))
