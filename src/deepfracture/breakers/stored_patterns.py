"""The simulated patterns of a data set, and the weakest baseline: any of them, whatever the impact."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from deepfracture.dataset import Dataset
from deepfracture.learn import normalise_impact
from deepfracture.runtime.progress import stage, track
from deepfracture.types import Floats, FracturePattern, Grid, Impact, Shape


@dataclass(frozen=True, eq=False)
class StoredPatterns:
    """The patterns of a data set: each read from disk once and kept, packed without loss (0.5 MB at r = 64)."""

    dataset: Dataset
    _packed: dict[int, tuple[bytes, NDArray[np.float16]]] = field(default_factory=dict)

    @cached_property
    def impacts(self) -> list[Impact]:
        return self.dataset.impacts()

    @cached_property
    def rows(self) -> Floats:
        """The strongest impulse of every pattern, normalised as for the network, shape (n, 7)."""
        largest = self.dataset.max_impulse
        return np.stack([normalise_impact(impact, largest) for impact in self.impacts])

    def pattern(self, index: int) -> FracturePattern:
        grid = Grid(self.dataset.settings.resolution)
        if index not in self._packed:
            self._packed[index] = _pack(self.dataset[index].pattern)
        labels, distance = self._packed[index]
        unpacked = np.frombuffer(zlib.decompress(labels), np.uint16).reshape(grid.shape)
        return FracturePattern(grid, unpacked.astype(np.int32), distance.astype(np.float32))

    def load(self) -> None:
        """Read all patterns, so that no later call waits for the disk."""
        for index in track(range(len(self.dataset)), name="recall"):
            self.pattern(index)

    @cached_property
    def counts(self) -> Floats:
        """Fragments of every pattern, shape (n,)."""
        return np.array([self.pattern(index).count for index in range(len(self.dataset))], float)


def _pack(pattern: FracturePattern) -> tuple[bytes, NDArray[np.float16]]:
    """Labels compress well; distances do not, but data sets store them as float16, so nothing is lost."""
    return zlib.compress(pattern.labels.astype(np.uint16).tobytes(), 1), pattern.distance.astype(np.float16)


@dataclass(frozen=True)
class RandomPattern:
    """Any simulated pattern, with equal probability."""

    patterns: StoredPatterns

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("recall"):
            return self.patterns.pattern(int(rng.integers(len(self.patterns.dataset))))
