"""Shared by all breakers: the paper's fracture criterion, then a pattern, then the cut of the original mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deepfracture.carve import cut, decimated
from deepfracture.fracture import breaks
from deepfracture.runtime.progress import stage
from deepfracture.types import FracturePattern, Fragments, Impact, Material, Shape


class PatternSource(Protocol):
    """The fracture pattern of a shape under an impact that meets the criterion; None if it holds."""

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None: ...


@dataclass(frozen=True)
class PatternBreaker:
    """A `Breaker` made of a pattern source: criterion (paper, eq. 2), pattern, cut."""

    source: PatternSource
    material: Material
    roughness: float = 0.0
    """Grain of the crack faces [m]."""
    max_faces: int | None = None
    """Most triangles of a fragment, as far as decimation can; None: no limit."""

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments | None:
        area = float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
        if not breaks(impact, self.material, area):
            return None
        pattern = self.source(shape, impact, rng)
        if pattern is None or pattern.count < 2:
            return None
        with stage("cut"):
            roughness = self.roughness / shape.size
            fragments = cut(shape, pattern, density=self.material.density, roughness=roughness)
        if self.max_faces is not None:
            with stage("coarsen"):
                fragments = decimated(fragments, self.max_faces)
        return fragments if len(fragments) > 1 else None  # fragments of the pattern may be small components of the mesh
