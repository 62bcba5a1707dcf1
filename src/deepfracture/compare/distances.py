"""Distances between two fracture patterns of the same body under the same impact, by eight measures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from deepfracture.compare.chamfer import mean_chamfer
from deepfracture.compare.descriptors import Descriptors
from deepfracture.compare.partition import contingency_table, table_variation
from deepfracture.types import BadInput, Floats

MEASURES = ("count", "volumes", "normals", "area", "centre", "size", "chamfer", "division")
"""In the order of `distances`: fragment count (relative), fragment volumes (Kolmogorov-Smirnov), crack normals (total
variation), crack area (relative), centre of the shattered region [m] and its size (relative), mean chamfer distance of
fragments [m], variation of information between the partitions [bits]."""


def distances(a: Descriptors, b: Descriptors, measures: Sequence[str] = MEASURES) -> dict[str, float]:
    """Some or all of MEASURES: symmetric, zero for equal patterns, larger for less similar ones.

    Relative differences are |a - b| over the mean of a and b, so 2 at most.

    Raises:
        BadInput: The patterns have different resolutions.
    """
    if a.grid != b.grid:
        raise BadInput(f"patterns must have one resolution, got {a.grid.resolution} and {b.grid.resolution}")
    return {name: _MEASURES[name](a, b) for name in measures}


def kolmogorov_smirnov(a: Floats, b: Floats) -> float:
    """Largest difference between the empirical distributions of two ascending samples."""
    at = np.concatenate([a, b])
    below_a, below_b = (np.searchsorted(sample, at, side="right") / len(sample) for sample in (a, b))
    return float(np.abs(below_a - below_b).max())


def _relative(a: float, b: float) -> float:
    return 0.0 if a == b else float(2 * abs(a - b) / (a + b))


def _total_variation(a: Floats, b: Floats) -> float:
    """Of two distributions; 1 if exactly one pattern has no crack, 0 if neither has one."""
    if not a.any() or not b.any():
        return float(a.any() != b.any())
    return float(0.5 * np.abs(a - b).sum())


_MEASURES: dict[str, Callable[[Descriptors, Descriptors], float]] = {
    "count": lambda a, b: _relative(a.count, b.count),
    "volumes": lambda a, b: kolmogorov_smirnov(a.volumes, b.volumes),
    "normals": lambda a, b: _total_variation(a.normals, b.normals),
    "area": lambda a, b: _relative(a.area, b.area),
    "centre": lambda a, b: float(np.linalg.norm(a.centre - b.centre)),
    "size": lambda a, b: _relative(a.size, b.size),
    "chamfer": lambda a, b: mean_chamfer(a.points, a.starts, b.points, b.starts),
    "division": lambda a, b: table_variation(contingency_table(a.partition, b.partition, a.count, b.count)),
}
