"""The simulator as a pattern source, for whole shapes and for fragments that break again."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from deepfracture.fracture import FractureBody, FragmentSimulator, prepare_body, simulate
from deepfracture.runtime.progress import stage
from deepfracture.types import FracturePattern, Grid, Impact, Material, Shape


@dataclass(frozen=True)
class Physical:
    """Boundary elements and crack growth; a shape is prepared at its first hit."""

    material: Material
    grid: Grid
    _bodies: dict[Shape, FractureBody] = field(default_factory=dict)

    @cached_property
    def _pieces(self) -> FragmentSimulator:
        return FragmentSimulator(self.material, self.grid)

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        if shape.whole is not None:
            return self._pieces(shape, impact, rng)
        cracking = simulate(self.body(shape), impact, rng)
        return cracking.pattern if cracking else None

    def body(self, shape: Shape) -> FractureBody:
        """A whole shape prepared for impacts: seconds at the first call, cached afterwards."""
        if shape not in self._bodies:
            with stage("prepare body"):
                self._bodies[shape] = prepare_body(shape, self.material, self.grid)
        return self._bodies[shape]
