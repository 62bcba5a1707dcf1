"""Training of the networks that predict the GS-SDF, with the loss and the optimisers of each preset."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  (the room of torch)
from numpy.typing import NDArray
from torch import Tensor, nn  # noqa: TID253

from deepfracture.dataset import Dataset
from deepfracture.learn.codes import draw_siren
from deepfracture.learn.data import TrainingData, surface_distance
from deepfracture.learn.distributed import DistributedContext
from deepfracture.learn.domain import VoxelDomain
from deepfracture.learn.optimiser import adam_state, load_adam_state
from deepfracture.learn.published.config import PIX2PIX, PublishedConfig
from deepfracture.learn.published.data import FieldTargets, squared_error
from deepfracture.learn.published.mlp import CoordinateMLP
from deepfracture.learn.published.model import PublishedModel, build, encode, to_device
from deepfracture.learn.published.pix2pix import Discriminator, Pix2Pix
from deepfracture.learn.report import L2
from deepfracture.types import Floats32

L1_WEIGHT = 100.0
"""Weight of the absolute error against the discriminator's loss (Isola et al. 2017)."""
GAN_BETA = 0.5
"""Adam's first decay rate in adversarial training (Radford et al. 2016)."""
TRIALS = 4
"""Times that a precision is measured; the first does not count."""
SPEEDUP = 1.2
"""How many times as fast bfloat16 must be to be worth its rounding."""
AUTODECODER, DISCRIMINATOR = "student", "judge"
"""The modules, by their names in checkpoints."""


class Autodecoder(nn.Module):
    """A network with the segment codes that it learns (Park et al. 2019): from sample numbers to fields."""

    def __init__(self, network: nn.Module, segment: Tensor | None) -> None:
        super().__init__()
        self.network = network
        self.segment = None if segment is None else nn.Parameter(segment)

    def forward(self, impulse: Tensor, noise: Tensor, batch: Tensor, points: Tensor | None) -> list[Tensor]:
        """Fields (or distances at `points`, shape (p, 3)) of the samples with numbers `batch`, shape (b,).

        Args:
            impulse: Z^impulse of each, shape (b, condition_size).
            noise: A random code for each, in place of segment codes if none are learned.
        """
        codes = torch.cat([impulse, noise if self.segment is None else self.segment[batch]], dim=1)
        if points is not None:
            return [self.network(codes, points)]
        fields = self.network(codes)
        return [fields] if isinstance(fields, Tensor) else fields


class PublishedTrainStep:
    """Squared error of the GS-SDF; for pix2pix absolute error and a discriminator's loss."""

    checkpoint_kind = "field training checkpoint"
    objective = L2

    def __init__(
        self, dataset: Dataset, config: PublishedConfig, seed: int, distributed: DistributedContext, scratch: Path
    ) -> None:
        self.config = config = config.at(dataset.settings.resolution)
        self.seed, self.distributed, self.device = seed, distributed, distributed.device
        self.domain = VoxelDomain(*surface_distance(dataset))
        assert config.resolutions is not None
        self.targets = FieldTargets(self.domain.surface, config.resolutions, len(dataset), scratch)
        self.data = TrainingData.read(dataset, self.domain.surface, config.features, self.targets.add, cuts=False)
        self.precision = config.precision
        if self.precision == "auto":
            fast = float(faster_precision(self.device) == "bfloat16")
            self.precision = "bfloat16" if distributed.broadcast([fast])[0] else "float32"
        rng = np.random.default_rng(seed)
        self.siren = {} if config.preset == PIX2PIX else draw_siren(config.impulse_size, rng)
        self.impulse_codes = encode(self.siren, self.data.impulses)
        drawn = rng.standard_normal((len(self.impulse_codes), config.segment_size), np.float32)
        with _seeded(seed):
            self._build(torch.from_numpy(drawn) if config.learns_codes else None)
        self.impulses = torch.from_numpy(self.impulse_codes).to(self.device)
        self.surfaces = [surface.to(self.device) for surface in self.targets.surfaces]
        self.points = torch.from_numpy(self.domain.points).float().to(self.device)
        self.voxels = [torch.from_numpy(axis).to(self.device) for axis in self.domain.voxels]

    def _build(self, segment: Tensor | None) -> None:
        """Networks with random weights, and their optimisers."""
        config = self.config
        self.network = to_device(build(config, self.domain.surface), self.device)
        self.autodecoder = Autodecoder(self.network, segment).to(self.device)
        self.modules: dict[str, nn.Module] = {AUTODECODER: self.autodecoder}
        if isinstance(self.network, Pix2Pix):
            self.modules[DISCRIMINATOR] = to_device(Discriminator(config), self.device)
        self.wrapped = {name: self.distributed.wrap(module) for name, module in self.modules.items()}
        if config.compile:
            self.wrapped = {name: torch.compile(module) for name, module in self.wrapped.items()}
        betas = (GAN_BETA if len(self.modules) > 1 else 0.9, 0.999)
        self.parameters = {name: trainable(name, module) for name, module in self.modules.items()}
        self.optimisers = {
            name: torch.optim.Adam(parameters.values(), lr=config.learning_rate, betas=betas, fused=True)
            for name, parameters in self.parameters.items()
        }

    @property
    def options(self) -> str:
        return f"--preset {self.config.preset} --width {self.config.width:g} --features {self.config.features} "

    def learning_rate(self, fraction: float, step: int) -> float:
        """One step down, late in the training (paper, section 5.4)."""
        return self.config.late_rate if fraction >= self.config.late_from else self.config.learning_rate

    def __call__(self, batch: Tensor, generator: torch.Generator, rate: float) -> Tensor:
        noise = torch.randn(len(self.impulses), self.config.segment_size, generator=generator)
        points = where = None
        if isinstance(self.network, CoordinateMLP):
            where = torch.randint(len(self.points), (self.config.points,), generator=generator).to(self.device)
            points = self.points[where]
        own, weights = self.distributed.shard(batch)
        truth = [field[own].to(self.device).float() for field in self.targets.fields]
        own, weights, noise = own.to(self.device), weights.to(self.device), noise[own].to(self.device)
        if where is not None:
            i, j, k = (axis[where] for axis in self.voxels)
            truth = [truth[0][:, i, j, k]]
        for optimiser in self.optimisers.values():
            for group in optimiser.param_groups:
                group["lr"] = rate
        with self._autocast():
            found = self.wrapped[AUTODECODER](self.impulses[own], noise, own, points)
        if DISCRIMINATOR in self.modules:
            return self._adversarial_step(found[0], truth[0], torch.cat([self.impulses[own], noise], dim=1), weights)
        loss = (weights * self._losses(found, truth, inside=points is not None)).sum()
        self._update(AUTODECODER, loss)
        return loss.detach()

    def _losses(self, found: list[Tensor], truth: list[Tensor], *, inside: bool) -> Tensor:
        """The L2 of each sample, the mean over the resolutions, shape (b,)."""
        if inside:
            return ((found[0] - truth[0]) ** 2).mean(dim=1)
        triples = zip(found, truth, self.surfaces, strict=True)
        return torch.stack([squared_error(*triple, self.config.ridge_weight) for triple in triples]).mean(dim=0)

    def _adversarial_step(self, found: Tensor, truth: Tensor, codes: Tensor, weights: Tensor) -> Tensor:
        """Update the discriminator, then the generator (Isola et al. 2017); returns the L2."""
        assert isinstance(self.network, Pix2Pix)
        with torch.no_grad():
            condition = self.network.condition(codes)
        both = torch.cat([condition, condition])
        with self._autocast():
            real, fake = self.wrapped[DISCRIMINATOR](both, torch.cat([truth, found.detach()])).chunk(2)
        loss = 0.5 * ((weights * _gan_loss(real, True)).sum() + (weights * _gan_loss(fake, False)).sum())
        self._update(DISCRIMINATOR, loss)
        discriminator = self.modules[DISCRIMINATOR].requires_grad_(False)
        with self._autocast():
            logits = discriminator(condition, found)
        error = (found - truth).abs().mean(dim=(1, 2, 3))
        self._update(AUTODECODER, (weights * (L1_WEIGHT * error + _gan_loss(logits, True))).sum())
        discriminator.requires_grad_(True)
        return (weights * ((found - truth) ** 2).mean(dim=(1, 2, 3))).sum().detach()

    def _update(self, name: str, loss: Tensor) -> None:
        self.optimisers[name].zero_grad(set_to_none=True)
        loss.backward()
        self.optimisers[name].step()

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.precision == "bfloat16")

    def model(self, epoch: int) -> tuple[PublishedModel, Floats32]:
        """Its embedding space is a sample of this epoch's codes (paper, eq. 6)."""
        rng = np.random.default_rng((self.seed, epoch))
        segment = self.autodecoder.segment
        if segment is None:  # each step draws its own
            drawn = rng.standard_normal((len(self.impulse_codes), self.config.segment_size), np.float32)
            rng = np.random.default_rng((self.seed, epoch))
        else:
            drawn = segment.detach().cpu().numpy().copy()
        codes = np.concatenate([self.impulse_codes, drawn], axis=1)
        kept = rng.permutation(len(codes))[: self.config.space]
        data = self.data
        model = PublishedModel(
            data.dataset.shape.name, self.config, data.normaliser, self.domain, {}, self.siren, self.network,
            codes[np.sort(kept)],
        )  # fmt: skip
        return model, codes

    def state(self) -> tuple[dict[str, NDArray], dict[str, Any]]:
        arrays = {}
        for name, module in self.modules.items():
            arrays |= {f"{name}.{key}": value.cpu().numpy() for key, value in module.state_dict().items()}
            arrays |= adam_state(self.optimisers[name], self.parameters[name])
        return arrays, {"precision": self.precision}

    def load_state(self, arrays: Mapping[str, NDArray], progress: Mapping[str, Any]) -> None:
        for name, module in self.modules.items():
            module.load_state_dict({key: torch.from_numpy(arrays[f"{name}.{key}"]) for key in module.state_dict()})
            load_adam_state(self.optimisers[name], self.parameters[name], arrays)
        self.precision = str(progress["precision"])


def trainable(prefix: str, module: nn.Module) -> dict[str, Tensor]:
    """The parameters that training changes, as PREFIX.NAME."""
    return {f"{prefix}.{name}": value for name, value in module.named_parameters() if value.requires_grad}


def faster_precision(device: torch.device) -> str:
    """float32 or bfloat16, whichever convolves volumes faster on `device`: units for it (AMX, tensor cores)
    make it several times as fast, without them it is slower than float32."""
    layer = to_device(nn.ConvTranspose3d(64, 32, 4, 2, 1), device)
    x = torch.ones(1, 64, 16, 16, 16, device=device).contiguous(memory_format=torch.channels_last_3d)
    seconds = {}
    for name in ("float32", "bfloat16"):
        times = []
        for _ in range(TRIALS):
            start = time.perf_counter()
            with torch.autocast(device.type, torch.bfloat16, enabled=name == "bfloat16"):
                loss = layer(x).float().square().mean()
            loss.backward()
            loss.item()
            times.append(time.perf_counter() - start)
        seconds[name] = min(times[1:])
    return "bfloat16" if seconds["bfloat16"] * SPEEDUP < seconds["float32"] else "float32"


def _gan_loss(logits: Tensor, real: bool) -> Tensor:
    """Binary cross-entropy of the discriminator's patches against real or fake, shape (b,)."""
    wanted = torch.full_like(logits, float(real))
    return nn.functional.binary_cross_entropy_with_logits(logits, wanted, reduction="none").mean(dim=1)


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Weights are drawn from `seed`; torch's own generator is left as it was."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield
