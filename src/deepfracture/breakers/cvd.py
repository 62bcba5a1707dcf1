"""Centroidal Voronoi cells, small near the hit (the paper compares with them; Schvartzman and Otaduy 2014)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from deepfracture.breakers.inside import InsideMask
from deepfracture.breakers.stored_patterns import StoredPatterns
from deepfracture.breakers.voronoi import CELLS_AT_THRESHOLD, MOST_CELLS, NEAR
from deepfracture.carve import voronoi_pattern
from deepfracture.fracture.simulate import MIN_FRAGMENT_VOXELS
from deepfracture.runtime.progress import stage
from deepfracture.types import Floats, FracturePattern, Grid, Impact, Shape
from deepfracture.voxels import merge_small_components

ROUNDS = 20
"""Of Lloyd's algorithm; the cells hardly change any more."""
SAMPLES = 8000
"""Voxels that stand for the body in it."""


@dataclass(frozen=True)
class CentroidalVoronoi:
    """Sites spread evenly by Lloyd's algorithm: half of them over the body, half around the hit."""

    count: Callable[[Shape, Impact], float]
    """Fragments that an impact should give."""
    grid: Grid

    @cached_property
    def _inside(self) -> InsideMask:
        return InsideMask(self.grid)

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        inside, points = self._inside(shape), self._inside.points(shape)
        with stage("centroidal voronoi"):
            if not len(points):
                return None
            count = round(float(np.clip(self.count(shape, impact), CELLS_AT_THRESHOLD // 2, MOST_CELLS)))
            pattern = self._cells(spread(points, impact.position[0], count, rng), inside)
            if pattern.count > count:  # the body's arms cut cells into several parts: so many sites too many
                fewer = max(2, 2 * count - pattern.count)
                pattern = self._cells(spread(points, impact.position[0], fewer, rng), inside)
            return pattern

    def _cells(self, sites: Floats, inside: NDArray[np.bool_]) -> FracturePattern:
        """Voronoi cells; what the voxels part from them as dust joins a neighbour, as in the simulator."""
        pattern = voronoi_pattern(sites, inside, self.grid)
        smallest = min(MIN_FRAGMENT_VOXELS, round(MIN_FRAGMENT_VOXELS * (self.grid.resolution / 64) ** 3))
        return replace(pattern, labels=merge_small_components(pattern.labels, smallest))


def fitted_count(patterns: StoredPatterns) -> Callable[[Shape, Impact], float]:
    """The mean number of fragments as a power of the strongest impulse, fitted to simulated patterns.

    Least squares of the logarithms, scaled to the mean of the counts themselves (Duan 1983): the mean of the
    logarithms alone is that of fewer fragments."""
    impulses = np.log([impact.magnitude[0] for impact in patterns.impacts])
    slope, start = _line(impulses, np.log(patterns.counts))
    start += float(np.log(patterns.counts.mean() / np.exp(start + slope * impulses).mean()))
    return lambda shape, impact: float(np.exp(start + slope * np.log(impact.magnitude[0])))


def spread(points: Floats, hit: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Sites at the centres of their own cells.

    Args:
        points: Voxel centres of the body [m], shape (n, 3).
        hit: Where it was hit [m], shape (3,).
        count: Sites wanted.

    Returns:
        Distinct points [m], shape (count or fewer, 3).
    """
    from scipy.spatial import KDTree

    points = rng.permutation(points)[:SAMPLES]
    near = np.exp(-0.5 * (np.linalg.norm(points - hit, axis=1) / NEAR) ** 2) + 1e-12
    wanted = 0.5 / len(points) + 0.5 * near / near.sum()
    # In three dimensions cells of a density w are spread as w^(3/5) (Du, Faber and Gunzburger 1999, section 6).
    weight = wanted ** (5 / 3)
    sites = points[rng.choice(len(points), min(count, len(points)), replace=False, p=wanted / wanted.sum())]
    for _ in range(ROUNDS):
        owner = KDTree(sites).query(points)[1]
        mass = np.bincount(owner, weight, len(sites))
        sums = np.stack([np.bincount(owner, weight * points[:, k], len(sites)) for k in range(3)], axis=1)
        sites = sums[mass > 0] / mass[mass > 0, None]
    return np.unique(sites, axis=0)


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope and start of the line through points; flat if they have one x."""
    away = x - x.mean()
    slope = float(away @ y / (away @ away)) if away.any() else 0.0
    return slope, float(y.mean() - slope * x.mean())
