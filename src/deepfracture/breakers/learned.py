"""A trained generative model as a pattern source."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.breakers.refracture import impact_on_whole, pattern_on_fragment
from deepfracture.breakers.stored_patterns import StoredPatterns
from deepfracture.carve import segment
from deepfracture.runtime.progress import log, stage
from deepfracture.types import FracturePattern, Impact, Shape, Volume

if TYPE_CHECKING:
    from deepfracture.learn import PartitionModel

ATTEMPTS = 5
"""Codes that are tried before the shape holds."""


@dataclass(frozen=True)
class Learned:
    """Predict the GS-SDF, then segment it; where that leaves the shape whole, take the next prediction.

    A model knows one shape. A fragment of it breaks by a new prediction for the whole shape, restricted to the
    fragment: for an impact at the same place, as strong as it is for the fragment (by dynamic similarity). The fragment
    holds if `ATTEMPTS` predictions leave it whole, and if the impact is weaker than all that broke the shape in
    training, of which a model knows nothing."""

    predictions: Callable[[Impact, np.random.Generator], Iterator[Volume]]
    """For an impact, the best first."""
    weakest_impulse: float = 0.0
    """Least impulse that broke the shape in training [N s]."""

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        if shape.whole is not None:
            if impact.magnitude[0] < self.weakest_impulse:
                return None
            impact = impact_on_whole(impact, shape)
        found = self.predictions(impact, rng)
        for attempt in range(ATTEMPTS):
            with stage("predict"):
                volume = next(found, None)
            if volume is None:
                break
            with stage("segment"):
                pattern = segment(volume)
            if shape.whole is not None and pattern.count > 1:
                with stage("restrict"):
                    pattern = pattern_on_fragment(pattern, shape)
            if pattern.count > 1:
                return pattern
            tell = log.warning if shape.whole is None else log.info
            tell("%s: prediction %d is of one piece; the next code is tried", shape.name, attempt + 1)
        return None


@dataclass(frozen=True, eq=False)
class SelectedPattern:
    """The model's selection of a code without its network: the training pattern of the code.

    Measures the selection by itself; the model must have been trained on `patterns`."""

    model: PartitionModel
    patterns: StoredPatterns

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("choose"):
            impulses = self.model.normaliser(impact).astype(np.float32)
            random = rng.standard_normal(self.model.config.segment_size, np.float32)
            return self.patterns.pattern(int(self.model.selector(impulses, random)[0]))
