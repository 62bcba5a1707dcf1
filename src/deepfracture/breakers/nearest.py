"""The nearest-neighbour baseline: the training pattern with the closest impulse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.breakers.stored_patterns import StoredPatterns
from deepfracture.learn import normalise_impact
from deepfracture.runtime.progress import stage
from deepfracture.types import FracturePattern, Impact, Shape


@dataclass(frozen=True)
class NearestPattern:
    """The simulated pattern whose strongest impulse, normalised as for the network, is closest."""

    patterns: StoredPatterns

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("nearest"):
            wanted = normalise_impact(impact, self.patterns.dataset.max_impulse)
            return self.patterns.pattern(int(((self.patterns.rows - wanted) ** 2).sum(axis=1).argmin()))
