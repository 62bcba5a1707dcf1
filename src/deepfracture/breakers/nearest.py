"""What a codebook with nearest-neighbour look-up is secretly worth: recall the closest training pattern."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.breakers.recalled import Memory
from deepfracture.learn import normalise_impact
from deepfracture.runtime.progress import stage
from deepfracture.types import FracturePattern, Impact, Shape


@dataclass(frozen=True)
class Nearest:
    """The simulated pattern whose strongest impulse, normalised as for the network, is closest."""

    memory: Memory

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("nearest"):
            wanted = normalise_impact(impact, self.memory.dataset.max_impulse)
            return self.memory.pattern(int(((self.memory.rows - wanted) ** 2).sum(axis=1).argmin()))
