"""What a codebook with nearest-neighbour look-up is secretly worth: recall the closest training pattern."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.dataset import Dataset
from deepfracture.learn import normalise_impact
from deepfracture.progress import stage
from deepfracture.types import FracturePattern, Impact, Shape


@dataclass(frozen=True)
class Nearest:
    """The simulated pattern whose strongest impulse, normalised as for the network, is closest."""

    dataset: Dataset

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("nearest"):
            largest = self.dataset.max_impulse
            wanted = normalise_impact(impact, largest)
            known = np.stack([normalise_impact(found, largest) for found in self.dataset.impacts()])
            return self.dataset[int(((known - wanted) ** 2).sum(axis=1).argmin())].pattern
