"""The trained generative model as a pattern source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.carve import segment
from deepfracture.learn import OURS, Way, predictions
from deepfracture.progress import log, stage
from deepfracture.types import FracturePattern, Impact, Shape

if TYPE_CHECKING:
    from deepfracture.learn import Model


ATTEMPTS = 5
"""Codes that are tried before the shape holds."""


@dataclass(frozen=True)
class Learned:
    """Predict the GS-SDF, then segment it; what would leave the shape whole gives way to the next code."""

    model: Model
    way: Way = OURS

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        found = predictions(self.model, impact, rng, self.way)
        for attempt in range(ATTEMPTS):
            with stage("predict"):
                volume = next(found, None)
            if volume is None:
                break
            with stage("segment"):
                pattern = segment(volume)
            if pattern.count > 1:
                return pattern
            log.warning("%s: prediction %d is of one piece; the next code is tried", shape.name, attempt + 1)
        return None
