"""The industry's baseline: Voronoi cells, denser near the hit and more of them for stronger hits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.carve import voronoi_pattern
from deepfracture.fracture import critical_stress
from deepfracture.geometry import signed_distance
from deepfracture.progress import stage
from deepfracture.types import FracturePattern, Grid, Impact, Material, Shape

CELLS_AT_THRESHOLD = 4
MOST_CELLS = 60
NEAR = 0.35
"""Standard deviation of the distance of a site from the hit [m], for the half of the sites near it."""


@dataclass(frozen=True)
class Voronoi:
    """Half of the sites uniform in the body, half around the hit; their number grows with the stress."""

    material: Material
    grid: Grid

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("distance field"):
            surface = signed_distance(shape.mesh, self.grid)
        with stage("voronoi"):
            inside = self.grid.centres()[surface > 0]
            area = float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
            over = critical_stress(impact, self.material, area) / self.material.strength
            count = int(np.clip(CELLS_AT_THRESHOLD * over, CELLS_AT_THRESHOLD, MOST_CELLS))
            away = np.linalg.norm(inside - impact.position[0], axis=1)
            near = np.exp(-0.5 * (away / NEAR) ** 2) + 1e-12
            around = rng.choice(len(inside), count - count // 2, p=near / near.sum())
            anywhere = rng.choice(len(inside), count // 2)
            sites = np.unique(inside[np.concatenate([around, anywhere])], axis=0)
            return voronoi_pattern(sites, surface, self.grid)
