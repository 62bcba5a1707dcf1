"""A data set as the networks that predict the GS-SDF see it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.carve import encode, segment
from deepfracture.compare import variation_of_information
from deepfracture.dataset import Dataset
from deepfracture.geometry import signed_distance
from deepfracture.learn.memory_map import on_disk
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.partition.field import Body
from deepfracture.learn.published.config import FieldConfig
from deepfracture.learn.reconstruction import Probe
from deepfracture.runtime.progress import track
from deepfracture.types import BadInput, Floats32, FracturePattern, Grid, Volume

PROBES = 10
"""Training patterns whose memory is watched."""
RIDGE = 2.0
"""Voxels over which the extra weight of a crack falls to zero."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """Impulses in memory and GS-SDFs on disk: each sample is read once."""

    dataset: Dataset
    body: Body
    normaliser: Normaliser
    impulses: Floats32
    """J^norm, shape (n, features, 7)."""
    fields: list[Tensor]
    """The GS-SDF at each resolution [m], float16, shapes (n, r, r, r), clipped to what the networks can say."""
    surfaces: list[Tensor]
    """The distance to the surface at each resolution [m], shape (r, r, r)."""
    probes: list[Probe]

    @staticmethod
    def of(dataset: Dataset, config: FieldConfig, scratch: Path) -> Lesson:
        """Read and encode all samples; `config` has its resolutions spelt out, `scratch` is the folder of the run.

        Raises:
            BadInput: The data set is empty."""
        if len(dataset) == 0:
            raise BadInput(f"{dataset.path}: no collision broke the shape yet; simulate more or faster ones")
        grid = Grid(dataset.settings.resolution)
        body = Body.of(grid, signed_distance(dataset.shape.mesh, grid))
        normaliser = Normaliser(dataset.max_impulse, config.features)
        assert config.resolutions is not None
        count = len(dataset)
        watched = {int(i) for i in np.linspace(0, count - 1, PROBES)}
        fields = [torch.from_numpy(on_disk(scratch, (count, r, r, r), np.float16)) for r in config.resolutions]
        impulses, probes = [], []
        for index, sample in enumerate(track(dataset, name="targets", total=count)):
            impulses.append(normaliser(sample.impact))
            exact = encode(sample.pattern, body.surface, cuts=False)
            for field in fields:
                field[index] = _coarser(torch.tensor(exact.values), field.shape[-1]).clamp(-1, 1)
            if index in watched:
                probes.append(_probe(index, sample.pattern, exact))
        surface = torch.tensor(body.surface)
        surfaces = [_coarser(surface, r) for r in config.resolutions]
        rows = np.stack(impulses).astype(np.float32)
        return Lesson(dataset, body, normaliser, rows, fields, surfaces, probes)


def squared_error(found: Tensor, truth: Tensor, surface: Tensor, ridge_weight: float) -> Tensor:
    """Mean squared error of each pattern [m^2], shape (b,), weighted towards the cracks if asked.

    Args:
        found: Predicted GS-SDF [m], shape (b, r, r, r).
        truth: What was to be predicted.
        surface: Distance to the surface [m], shape (r, r, r): where the truth lies below it, a crack is nearer.
    """
    error = (found - truth) ** 2
    if ridge_weight == 0:
        return error.mean(dim=(1, 2, 3))
    reach = RIDGE * 2 / len(surface)
    crack = (truth > 0) & (truth < 0.99 * surface)
    weight = 1 + ridge_weight * crack * (1 - truth / reach).clamp(min=0)
    return (weight * error).mean(dim=(1, 2, 3)) / weight.mean(dim=(1, 2, 3))


def _probe(index: int, pattern: FracturePattern, exact: Volume) -> Probe:
    """A pattern that is watched, with the ceiling of what is predicted here: distances alone."""
    found = segment(exact)
    apart = variation_of_information(pattern.labels, found.labels, pattern.labels > 0)
    return Probe(index, pattern, exact, found.count, apart)


def _coarser(field: Tensor, resolution: int) -> Tensor:
    """The field at the centres of a coarser grid: the mean of the voxels in each of its voxels."""
    step = field.shape[-1] // resolution
    return nn.functional.avg_pool3d(field[None], step)[0] if step > 1 else field
