"""Training of the partition network: decoder and segment codes together (an autodecoder, Park et al. 2019), the
impulse encoder frozen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  (the room of torch)
from numpy.typing import NDArray

from deepfracture.compare import describe
from deepfracture.dataset import Dataset, Sample
from deepfracture.learn.codes import encode_impulses
from deepfracture.learn.data import TrainingData, surface_distance
from deepfracture.learn.memory_map import memory_map, memory_mapped
from deepfracture.learn.optimiser import adam_state, load_adam_state
from deepfracture.learn.partition import network
from deepfracture.learn.partition.config import PartitionConfig
from deepfracture.learn.partition.field import SplineDomain
from deepfracture.learn.partition.model import PartitionModel
from deepfracture.learn.partition.selector import MinimumRiskSelector, fit_kernel, pairwise_distances
from deepfracture.learn.partition.targets import anchors, target_of
from deepfracture.learn.report import CROSS_ENTROPY
from deepfracture.types import Floats32

LEAST_RATE = 0.005
"""Least learning rate, relative to the highest: the end of the cosine."""


class PartitionTrainStep:
    """Cross-entropy between the channels of random voxels and the fragments that they belong to."""

    checkpoint_kind = "training checkpoint"
    objective = CROSS_ENTROPY
    options = ""

    def __init__(
        self, dataset: Dataset, config: PartitionConfig, seed: int, device: torch.device, scratch: Path
    ) -> None:
        self.config, self.device = config, device
        self.domain = SplineDomain.of(*surface_distance(dataset))
        self._read(dataset, scratch)
        rng = np.random.default_rng(seed)
        drawn = network.draw_weights(config, self.channels, rng)
        segment = rng.standard_normal((len(self.data.impulses), config.segment_size), np.float32)
        codes = encode_impulses(drawn, self.data.impulses).astype(np.float32)
        self.impulse_codes = self._tensor(codes)
        self.weights = {name: self._tensor(value) for name, value in drawn.items()}
        self.weights["codes"] = self._tensor(segment)
        self.parameters = {name: value for name, value in self.weights.items() if name not in network.FROZEN}
        for value in self.parameters.values():
            value.requires_grad_()
        self.optimiser = torch.optim.Adam(list(self.parameters.values()), lr=config.learning_rate, fused=True)
        self.points = self._tensor(self.domain.points.astype(np.float32))

    def _read(self, dataset: Dataset, scratch: Path) -> None:
        """The data, the targets of all samples, and the selector, whose segment codes are learned later."""
        config, domain = self.config, self.domain
        self.channels = min(config.channels, max(record.fragments for record in dataset.samples))
        places = anchors(domain.points, self.channels)
        targets = {
            name: memory_map(scratch, (len(dataset), len(domain.points)), kind)
            for name, kind in {"channel": "u1", "next": "u1", "share": "f2", "weight": "f2"}.items()
        }
        descriptors, anywhere = [], dataset.impacts()[0]

        def add_target(index: int, sample: Sample) -> None:
            found = describe(sample.pattern, anywhere)  # only differences between patterns matter
            descriptors.append(replace(found, partition=memory_mapped(scratch, found.partition)))
            target = target_of(sample.pattern, domain.voxels, places)
            for name, array in targets.items():
                array[index] = getattr(target, name)

        self.data = TrainingData.read(dataset, domain.surface, config.features, add_target, cuts=True)
        self.targets = {name: torch.from_numpy(value) for name, value in targets.items()}
        impulses, pairwise = self.data.impulses, pairwise_distances(descriptors)
        segment = np.zeros((len(impulses), config.segment_size), np.float32)
        self.selector = MinimumRiskSelector(impulses, segment, pairwise, fit_kernel(impulses, pairwise))

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

    def learning_rate(self, fraction: float, step: int) -> float:
        """Linear warm-up, then a cosine (Loshchilov and Hutter 2017)."""
        warm = min(1.0, step / self.config.warm_up)
        return self.config.learning_rate * warm * max(0.5 * (1 + math.cos(math.pi * fraction)), LEAST_RATE)

    def __call__(self, batch: torch.Tensor, generator: torch.Generator, rate: float) -> float:
        """One update: all samples of the batch at the same random voxels, so that one product gives all logits."""
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        where = torch.randint(len(self.points), (self.config.points,), generator=generator)
        rows = batch[None, :], where[:, None]
        truth = {name: values[rows].to(self.device) for name, values in self.targets.items()}
        batch, where = batch.to(self.device), where.to(self.device)
        codes = torch.cat([self.impulse_codes[batch], self.weights["codes"][batch]], dim=1)
        mixing = network.mixing_matrices(self.weights, codes, torch).transpose(0, 1)  # (basis, samples, channels)
        logits = network.fourier_features(self.weights, self.points[where], torch) @ mixing.reshape(len(mixing), -1)
        logits = logits.view(len(where), len(batch), -1)
        own, beyond = (logits.gather(2, truth[name].long()[..., None])[..., 0] for name in ("channel", "next"))
        share, weight = truth["share"].float(), truth["weight"].float()
        loss = (weight * (logits.logsumexp(dim=-1) - share * own - (1 - share) * beyond)).mean()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()
        return loss.item()

    def model(self, epoch: int) -> tuple[PartitionModel, Floats32]:
        weights = {name: value.detach().cpu().numpy().copy() for name, value in self.weights.items()}
        selector = replace(self.selector, segment=weights.pop("codes"))
        data = self.data
        model = PartitionModel(
            data.dataset.shape.name, self.config, data.normaliser, self.domain, {}, weights, selector
        )
        return model, model.codebook

    def state(self) -> tuple[dict[str, NDArray], dict[str, Any]]:
        arrays = {f"weights.{name}": value.detach().cpu().numpy() for name, value in self.weights.items()}
        return {**arrays, **adam_state(self.optimiser, self.parameters)}, {}

    def load_state(self, arrays: Mapping[str, NDArray], progress: Mapping[str, Any]) -> None:
        with torch.no_grad():
            for name, value in self.weights.items():
                value.copy_(torch.from_numpy(arrays[f"weights.{name}"]))
        load_adam_state(self.optimiser, self.parameters, arrays)
