"""A data set as every network sees it; what the network learns to predict is read in the same pass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deepfracture.dataset import Dataset, Sample
from deepfracture.geometry import signed_distance
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.reconstruction import MonitoredSample
from deepfracture.runtime.progress import track
from deepfracture.types import BadInput, Floats32, Grid

MONITORED = 10
"""Training patterns whose reconstruction is measured."""


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Impulses in memory; targets are kept by whoever reads them."""

    dataset: Dataset
    normaliser: Normaliser
    impulses: Floats32
    """J^norm, shape (n, features, 7)."""
    monitored: list[MonitoredSample]

    @staticmethod
    def read(
        dataset: Dataset, surface: Floats32, features: int, add_target: Callable[[int, Sample], None], *, cuts: bool
    ) -> TrainingData:
        """Read each sample once.

        Args:
            surface: Signed distance to the shape's surface [m], shape (r, r, r).
            add_target: Called with the number of each sample and the sample.
            cuts: Whether the model predicts `Volume.cuts` beside distances."""
        normaliser = Normaliser(dataset.max_impulse, features)
        chosen = {int(i) for i in np.linspace(0, len(dataset) - 1, MONITORED)}
        impulses, monitored = [], []
        for index, sample in enumerate(track(dataset, name="targets", total=len(dataset))):
            impulses.append(normaliser(sample.impact))
            add_target(index, sample)
            if index in chosen:
                monitored.append(MonitoredSample.of(index, sample.pattern, surface, cuts=cuts))
        return TrainingData(dataset, normaliser, np.stack(impulses).astype(np.float32), monitored)


def surface_distance(dataset: Dataset) -> tuple[Grid, Floats32]:
    """The grid of a data set, and the signed distance of its shape [m], shape (r, r, r).

    Raises:
        BadInput: The data set is empty."""
    if len(dataset) == 0:
        raise BadInput(f"{dataset.path}: no collision broke the shape yet; simulate more or faster ones")
    grid = Grid(dataset.settings.resolution)
    return grid, np.ascontiguousarray(signed_distance(dataset.shape.mesh, grid), np.float32)
