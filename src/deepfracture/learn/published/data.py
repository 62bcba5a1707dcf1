"""GS-SDFs of the training samples, and the error against them."""

from __future__ import annotations

from pathlib import Path

import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.carve import encode
from deepfracture.dataset import Sample
from deepfracture.learn.memory_map import memory_map
from deepfracture.types import Floats32

RIDGE = 2.0
"""Voxels over which the extra weight of a crack falls to zero."""


class FieldTargets:
    """The GS-SDF of every sample at each resolution, on disk."""

    def __init__(self, surface: Floats32, resolutions: tuple[int, ...], count: int, scratch: Path) -> None:
        self.surface = surface
        self.fields = [torch.from_numpy(memory_map(scratch, (count, r, r, r), "f2")) for r in resolutions]
        """[m], float16, shapes (n, r, r, r), clipped to the range of tanh, the networks' last layer."""
        self.surfaces = [coarsened(torch.tensor(surface), r) for r in resolutions]
        """The distance to the surface at each resolution [m], shape (r, r, r)."""

    def add(self, index: int, sample: Sample) -> None:
        """Encode one sample."""
        exact = torch.tensor(encode(sample.pattern, self.surface, cuts=False).values)
        for field in self.fields:
            field[index] = coarsened(exact, field.shape[-1]).clamp(-1, 1)


def squared_error(found: Tensor, truth: Tensor, surface: Tensor, ridge_weight: float) -> Tensor:
    """Mean squared error of each pattern [m^2], shape (b,), weighted towards the cracks if asked.

    Args:
        found: Predicted GS-SDF [m], shape (b, r, r, r).
        truth: The exact one.
        surface: Distance to the surface [m], shape (r, r, r): where the truth lies below it, a crack is nearer.
    """
    error = (found - truth) ** 2
    if ridge_weight == 0:
        return error.mean(dim=(1, 2, 3))
    reach = RIDGE * 2 / len(surface)
    crack = (truth > 0) & (truth < 0.99 * surface)
    weight = 1 + ridge_weight * crack * (1 - truth / reach).clamp(min=0)
    return (weight * error).mean(dim=(1, 2, 3)) / weight.mean(dim=(1, 2, 3))


def coarsened(field: Tensor, resolution: int) -> Tensor:
    """The field at the centres of a coarser grid: the mean of the voxels in each of its voxels."""
    step = field.shape[-1] // resolution
    return nn.functional.avg_pool3d(field[None], step)[0] if step > 1 else field
