"""Whether predictions differ where simulations do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from deepfracture.compare.partition import contingency_table, normalized_mutual_information
from deepfracture.evaluate.collision import Measurement
from deepfracture.types import Floats

SIMULATION = "simulation"
"""Stands for the other repeats: the score of a source with the variability of the simulator itself."""


def sensitivities(measured: Sequence[Measurement]) -> dict[str, float]:
    """Rank correlation, over all pairs of collisions, between how far apart the predictions are and how far apart the
    simulations are: Mantel's statistic (1967), mean over every draw beside every repeat.

    The distance is one minus the shared information of two divisions, which does not grow with the number of
    fragments: what counts is where they are, so how the breaking answers to position and direction. Zero for fewer
    than three collisions."""
    repeats = min(len(one.repeats) for one in measured)
    truth = [_pairs([one.repeats[repeat] for one in measured]) for repeat in range(repeats)]
    found = {SIMULATION: _mean(combinations(truth, 2))}
    for name, draws in measured[0].draws.items():
        guessed = [_pairs([one.draws[name][draw] for one in measured]) for draw in range(len(draws))]
        found[name] = _mean(product(guessed, truth))
    return found


def rank_correlation(x: Floats, y: Floats) -> Floats:
    """Spearman's, over the last axis; zero where one side is constant."""
    from scipy.stats import rankdata

    a, b = (rankdata(values, axis=-1) - (values.shape[-1] + 1) / 2 for values in (x, y))
    spread = np.sqrt((a * a).sum(axis=-1) * (b * b).sum(axis=-1))
    return np.divide((a * b).sum(axis=-1), spread, out=np.zeros(spread.shape), where=spread > 0)


def _mean(beside: Iterable[tuple[Floats, Floats]]) -> float:
    return float(np.mean([rank_correlation(a, b) for a, b in beside]))


def _pairs(divisions: Sequence[NDArray[np.uint16]]) -> Floats:
    """Distance of every pair of divisions."""
    counts = [int(division.max()) for division in divisions]
    return np.array(
        [
            1 - normalized_mutual_information(contingency_table(divisions[i], divisions[j], counts[i], counts[j]))
            for i, j in combinations(range(len(divisions)), 2)
        ]
    )
