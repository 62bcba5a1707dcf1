"""The industry baseline: Voronoi cells, denser near the hit, and more of them for stronger hits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deepfracture.breakers.inside import InsideMask
from deepfracture.carve import voronoi_pattern
from deepfracture.fracture import critical_stress
from deepfracture.runtime.progress import stage
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

    @cached_property
    def _inside(self) -> InsideMask:
        return InsideMask(self.grid)

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        inside, points = self._inside(shape), self._inside.points(shape)
        with stage("voronoi"):
            if not len(points):
                return None
            count = int(np.clip(count_by_stress(shape, impact, self.material), CELLS_AT_THRESHOLD, MOST_CELLS))
            away = np.linalg.norm(points - impact.position[0], axis=1)
            near = np.exp(-0.5 * (away / NEAR) ** 2) + 1e-12
            around = rng.choice(len(points), count - count // 2, p=near / near.sum())
            anywhere = rng.choice(len(points), count // 2)
            sites = np.unique(points[np.concatenate([around, anywhere])], axis=0)
            return voronoi_pattern(sites, inside, self.grid)


def count_by_stress(shape: Shape, impact: Impact, material: Material) -> float:
    """Cells, in proportion to how far the stress at the hit exceeds the strength."""
    area = float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
    return CELLS_AT_THRESHOLD * critical_stress(impact, material, area) / material.strength
