"""The simulator as a pattern source."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from deepfracture.fracture import FractureBody, prepare_body, simulate
from deepfracture.progress import stage
from deepfracture.types import FracturePattern, Grid, Impact, Material, Shape


@dataclass(frozen=True)
class Physical:
    """Boundary elements and crack growth; a shape is prepared at its first hit."""

    material: Material
    grid: Grid
    _bodies: dict[int, FractureBody] = field(default_factory=dict)

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        key = id(shape)
        if key not in self._bodies:
            with stage("prepare body"):
                self._bodies[key] = prepare_body(shape, self.material, self.grid)
        cracking = simulate(self._bodies[key], impact, rng)
        return cracking.pattern if cracking else None
