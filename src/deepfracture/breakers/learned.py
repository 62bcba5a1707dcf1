"""A trained generative model as a pattern source."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.carve import segment
from deepfracture.progress import log, stage
from deepfracture.types import FracturePattern, Impact, Shape, Volume

from .recalled import Memory

if TYPE_CHECKING:
    from deepfracture.learn import Model

ATTEMPTS = 5
"""Codes that are tried before the shape holds."""


@dataclass(frozen=True)
class Learned:
    """Predict the GS-SDF, then segment it; what would leave the shape whole gives way to the next answer."""

    answers: Callable[[Impact, np.random.Generator], Iterator[Volume]]
    """Predictions for an impact, the best first."""

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        found = self.answers(impact, rng)
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


@dataclass(frozen=True, eq=False)
class Typical:
    """The model's choice without its network: the stored pattern of the code, as it is.

    What the choice is worth by itself; the model must have been trained on the patterns of `memory`."""

    model: Model
    memory: Memory

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("choose"):
            rows = self.model.normaliser(impact).astype(np.float32)
            random = rng.standard_normal(self.model.config.segment_size, np.float32)
            return self.memory.pattern(int(self.model.choice(rows, random)[0]))
