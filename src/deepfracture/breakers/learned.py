"""The trained generative model as a pattern source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.carve import segment
from deepfracture.learn import predict
from deepfracture.progress import stage
from deepfracture.types import FracturePattern, Impact, Shape

if TYPE_CHECKING:
    from deepfracture.learn import Model


@dataclass(frozen=True)
class Learned:
    """Predict the GS-SDF, then flood it."""

    model: Model

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("predict"):
            volume = predict(self.model, impact, rng)
        with stage("segment"):
            return segment(volume)
