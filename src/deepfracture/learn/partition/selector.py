"""Which code of the embedding space answers an impact: the one of least expected distance to what could happen.

The paper takes the code nearest to [impulse, random] (`codebook`). That recalls one training pattern, and one
pattern is one throw of dice: the same blow on the same shape breaks it differently each time. Here all patterns that
similar blows gave are witnesses, weighted by a Gaussian of how similar the blow was, and each code is judged by its
mean distance to them (minimum Bayes risk, Kumar & Byrne 2004); the most typical wins. The random code still decides:
witnesses whose segment codes resemble it weigh more, so other random codes make other patterns typical. With narrow
Gaussians the rule becomes the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from deepfracture.compare import MEASURES, Descriptors, distances
from deepfracture.runtime.progress import track
from deepfracture.types import Floats, Floats32, Ints

VARIETY = 2.0
"""Width of the Gaussian over segment codes: smaller ones make random codes matter more."""
QUICK = tuple(name for name in MEASURES if name != "chamfer")
"""Measures of the distance between patterns; chamfer costs twenty times the others together."""
DIRECTION_WEIGHTS = (0.0, 0.5, 1.0)
IMPULSE_WEIGHTS = (0.5, 1.0, 2.0, 4.0)
WIDTHS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
"""What `fit` tries."""


@dataclass(frozen=True)
class Similarity:
    """How alike two normalised impulses [p, d, 2 I / I_max - 1] are: a Gaussian of their weighted difference."""

    direction: float
    """Weight of a difference of directions against one of positions."""
    impulse: float
    """Weight of a difference of impulses."""
    width: float
    """Standard deviation, in metres of the position."""

    def __call__(self, rows: Floats32, row: Floats32) -> Floats:
        """Of rows, shape (n, features, 7), with one, shape (features, 7): in [0, 1], shape (n,)."""
        scale = np.array([1, 1, 1, *3 * [self.direction], self.impulse]) / self.width
        return np.exp(-0.5 * (((rows - row) * scale) ** 2).sum(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class Choice:
    """What the choice among n codes is made from."""

    rows: Floats32
    """Normalised impulses of the training patterns, shape (n, features, 7)."""
    segment: Floats32
    """Their segment codes, shape (n, segment_size)."""
    apart: Floats32
    """Mean distance between each two of them, 1 for two taken at random, shape (n, n)."""
    similarity: Similarity

    def __call__(self, row: Floats32, random: Floats32, *, variety: float = VARIETY) -> Ints:
        """All codes, the most typical first, shape (n,).

        Args:
            row: The impact's normalised impulses, shape (features, 7).
            random: Z_random, shape (segment_size,).
        """
        unlike = ((self.segment - random) ** 2).sum(axis=1) / (2 * variety**2)
        weights = (self.similarity(self.rows, row) + FAINT) * np.exp(unlike.min() - unlike)
        return np.argsort(weights @ self.apart, kind="stable")


FAINT = 1e-6
"""Weight of what is nothing like it: far from all witnesses the mean of all decides."""


def mean_distance(traits: list[Descriptors]) -> Floats32:
    """Mean over QUICK of the distances between each two patterns, each measure in units of its own mean."""
    n = len(traits)
    table = np.zeros((n, n, len(QUICK)))
    for i in track(range(1, n), name="patterns against each other"):
        for j in range(i):
            found = distances(traits[i], traits[j], QUICK)
            table[i, j] = table[j, i] = [found[name] for name in QUICK]
    means = table.sum(axis=(0, 1)) / max(n * (n - 1), 1)
    return (table / np.where(means > 0, means, 1)).mean(axis=2).astype(np.float32)


def fit(rows: Floats32, apart: Floats32) -> Similarity:
    """The similarity with which patterns are best guessed from all others (leave one out)."""
    tried = [Similarity(*values) for values in product(DIRECTION_WEIGHTS, IMPULSE_WEIGHTS, WIDTHS)]
    return min(tried, key=lambda similarity: _left_out(similarity, rows, apart))


def _left_out(similarity: Similarity, rows: Floats32, apart: Floats32) -> float:
    """Mean distance between each pattern and the most typical of the others for its impulse."""
    n = len(rows)
    if n < 2:
        return 0.0
    weights = np.stack([similarity(rows, row) for row in rows]) + FAINT
    np.fill_diagonal(weights, 0)
    risk = weights @ apart / weights.sum(axis=1, keepdims=True)
    np.fill_diagonal(risk, np.inf)
    return float(apart[np.arange(n), risk.argmin(axis=1)].mean())
