"""Minimum-Bayes-risk selection of a code: the one of least expected distance to what the impact may cause.

The paper takes the code nearest to [impulse, random]. That recalls one training pattern, and one pattern is one sample
of a chaotic outcome: the same impact on the same shape breaks it differently each time. Minimum Bayes risk (Kumar and
Byrne 2004) takes all training patterns as evidence, weighted by a Gaussian kernel of how similar their impacts were,
and returns the hypothesis, again a training pattern, of least mean distance to the evidence (a weighted medoid). The
random code still matters: evidence whose segment codes resemble it weighs more, so that other random codes select
other patterns. With narrow kernels the rule becomes the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from deepfracture.compare import MEASURES, Descriptors, distances
from deepfracture.learn.inference import BANDWIDTH
from deepfracture.runtime.progress import track
from deepfracture.types import Floats, Floats32, Ints

SELECTION_MEASURES = tuple(name for name in MEASURES if name != "chamfer")
"""Measures of the distance between patterns; chamfer costs twenty times the others together."""
DIRECTION_WEIGHTS = (0.0, 0.5, 1.0)
IMPULSE_WEIGHTS = (0.5, 1.0, 2.0, 4.0)
WIDTHS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
"""Grid searched by `fit_kernel`."""
LEAST_WEIGHT = 1e-6
"""Of evidence unlike the impact: far from all training impacts the mean over all of them decides."""


@dataclass(frozen=True)
class ImpulseKernel:
    """Gaussian kernel between normalised impulses [p, d, 2 I / I_max - 1]."""

    direction: float
    """Weight of a difference of directions against one of positions."""
    impulse: float
    """Weight of a difference of impulses."""
    width: float
    """Standard deviation, in metres of the position."""

    def __call__(self, samples: Floats32, sample: Floats32) -> Floats:
        """Between samples, shape (n, features, 7), and one, shape (features, 7): in [0, 1], shape (n,)."""
        scale = np.array([1, 1, 1, *3 * [self.direction], self.impulse]) / self.width
        return np.exp(-0.5 * (((samples - sample) * scale) ** 2).sum(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class MinimumRiskSelector:
    """n training patterns, which are the evidence and the hypotheses."""

    impulses: Floats32
    """Their normalised impulses, shape (n, features, 7)."""
    segment: Floats32
    """Their segment codes, shape (n, segment_size)."""
    pairwise: Floats32
    """Mean distance of every pair, 1 for two taken at random, shape (n, n)."""
    kernel: ImpulseKernel

    def __call__(self, impulses: Floats32, random: Floats32, *, bandwidth: float = BANDWIDTH) -> Ints:
        """All patterns by ascending risk, shape (n,).

        Args:
            impulses: The impact's normalised impulses, shape (features, 7).
            random: Z_random, shape (segment_size,).
            bandwidth: Standard deviation of the kernel over segment codes.
        """
        exponent = ((self.segment - random) ** 2).sum(axis=1) / (2 * bandwidth**2)
        weights = (self.kernel(self.impulses, impulses) + LEAST_WEIGHT) * np.exp(exponent.min() - exponent)
        return np.argsort(weights @ self.pairwise, kind="stable")


def pairwise_distances(descriptors: list[Descriptors]) -> Floats32:
    """Mean over SELECTION_MEASURES of the distances of every pair, each measure relative to its own mean."""
    n = len(descriptors)
    table = np.zeros((n, n, len(SELECTION_MEASURES)))
    for i in track(range(1, n), name="pairwise distances"):
        for j in range(i):
            found = distances(descriptors[i], descriptors[j], SELECTION_MEASURES)
            table[i, j] = table[j, i] = [found[name] for name in SELECTION_MEASURES]
    means = table.sum(axis=(0, 1)) / max(n * (n - 1), 1)
    return (table / np.where(means > 0, means, 1)).mean(axis=2).astype(np.float32)


def fit_kernel(impulses: Floats32, pairwise: Floats32) -> ImpulseKernel:
    """The kernel of least leave-one-out error, by grid search."""
    kernels = [ImpulseKernel(*values) for values in product(DIRECTION_WEIGHTS, IMPULSE_WEIGHTS, WIDTHS)]
    return min(kernels, key=lambda kernel: _leave_one_out(kernel, impulses, pairwise))


def _leave_one_out(kernel: ImpulseKernel, impulses: Floats32, pairwise: Floats32) -> float:
    """Mean distance between each pattern and the one that the others select for its impulses."""
    n = len(impulses)
    if n < 2:
        return 0.0
    weights = np.stack([kernel(impulses, sample) for sample in impulses]) + LEAST_WEIGHT
    np.fill_diagonal(weights, 0)
    risk = weights @ pairwise / weights.sum(axis=1, keepdims=True)
    np.fill_diagonal(risk, np.inf)
    return float(pairwise[np.arange(n), risk.argmin(axis=1)].mean())
