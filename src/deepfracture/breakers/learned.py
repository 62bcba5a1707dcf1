"""A trained generative model as a pattern source."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.breakers.recalled import Memory
from deepfracture.breakers.restrict import on_whole, restricted
from deepfracture.carve import segment
from deepfracture.runtime.progress import log, stage
from deepfracture.types import FracturePattern, Impact, Shape, Volume

if TYPE_CHECKING:
    from deepfracture.learn import Model

ATTEMPTS = 5
"""Codes that are tried before the shape holds."""


@dataclass(frozen=True)
class Learned:
    """Predict the GS-SDF, then segment it; what would leave the shape whole gives way to the next answer.

    A model knows one shape. A fragment of it is carved by a fresh prediction of the whole, for a blow at the
    place where it meets the fragment and as strong as it is for the fragment (by dynamic similarity), of which
    the fragment takes what lies within it. It holds where `ATTEMPTS` answers part it nowhere, and where the
    blow is weaker than any that has broken the whole in training: of those a model knows nothing."""

    answers: Callable[[Impact, np.random.Generator], Iterator[Volume]]
    """Predictions for an impact, the best first."""
    weakest: float = 0.0
    """Impulse that broke the whole in training with the least effort [N s]."""

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        if shape.whole is not None:
            if impact.magnitude[0] < self.weakest:
                return None
            impact = on_whole(impact, shape)
        found = self.answers(impact, rng)
        for attempt in range(ATTEMPTS):
            with stage("predict"):
                volume = next(found, None)
            if volume is None:
                break
            with stage("segment"):
                pattern = segment(volume)
            if shape.whole is not None and pattern.count > 1:
                with stage("restrict"):
                    pattern = restricted(pattern, shape)
            if pattern.count > 1:
                return pattern
            tell = log.warning if shape.whole is None else log.info
            tell("%s: prediction %d is of one piece; the next code is tried", shape.name, attempt + 1)
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
