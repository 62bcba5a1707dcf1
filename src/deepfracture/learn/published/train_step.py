"""One step of training, for each preset: what the network answers, its loss, and which weights move."""

from __future__ import annotations

import time

import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.learn.distributed import Team
from deepfracture.learn.published.config import FieldConfig
from deepfracture.learn.published.data import Lesson, squared_error
from deepfracture.learn.published.mlp import CoordinateMLP
from deepfracture.learn.published.model import prepared
from deepfracture.learn.published.pix2pix import Discriminator, Pix2Pix

FIELD_WEIGHT = 100.0
"""Weight of the absolute error against the discriminator's verdict (Isola et al. 2017)."""
GAN_BETA = 0.5
"""Adam's first decay rate where two networks play against each other (Radford et al. 2016)."""
TRIALS = 4
"""Times that a precision is measured; the first does not count."""
WORTH = 1.2
"""How many times as fast bfloat16 must be to be worth its rounding."""


class Student(nn.Module):
    """A network with the segment codes that it learns: from the patterns `chosen` to codes and answers."""

    def __init__(self, network: nn.Module, segment: Tensor | None) -> None:
        super().__init__()
        self.network = network
        self.segment = None if segment is None else nn.Parameter(segment)

    def forward(self, impulse: Tensor, noise: Tensor, chosen: Tensor, points: Tensor | None) -> list[Tensor]:
        """Fields (or distances at `points`, shape (p, 3)) of the patterns with numbers `chosen`, shape (b,).

        Args:
            impulse: Z^impulse of each, shape (b, condition_size).
            noise: A random code for each, which takes the place of segment codes if none are learned.
        """
        codes = torch.cat([impulse, noise if self.segment is None else self.segment[chosen]], dim=1)
        if points is not None:
            return [self.network(codes, points)]
        fields = self.network(codes)
        return [fields] if isinstance(fields, Tensor) else fields


class Teacher:
    """Everything that moves in training: the student, its opponent if it has one, and their optimisers."""

    def __init__(
        self, network: nn.Module, segment: Tensor | None, lesson: Lesson, impulse: Tensor, config: FieldConfig,
        device: torch.device, team: Team, precision: str,
    ) -> None:  # fmt: skip
        self.lesson, self.config, self.device, self.team, self.precision = lesson, config, device, team, precision
        self.impulse = impulse.to(device)
        self.surfaces = [surface.to(device) for surface in lesson.surfaces]
        self.points = torch.from_numpy(lesson.body.points).float().to(device)
        self.voxels = [torch.from_numpy(axis).to(device) for axis in lesson.body.voxels]
        self.student = Student(network, segment).to(device)
        self.modules: dict[str, nn.Module] = {"student": self.student}
        if isinstance(network, Pix2Pix):
            self.modules["judge"] = prepared(Discriminator(config), device)
        self.wrapped = {name: team.wrap(module, device) for name, module in self.modules.items()}
        if config.compile:
            self.wrapped = {name: torch.compile(module) for name, module in self.wrapped.items()}
        betas = (GAN_BETA if len(self.modules) > 1 else 0.9, 0.999)
        self.optimisers = {
            name: torch.optim.Adam(learned(module).values(), lr=config.learning_rate, betas=betas, fused=True)
            for name, module in self.modules.items()
        }

    def step(self, chosen: Tensor, noise: Tensor, where: Tensor | None, rate: float) -> Tensor:
        """One update with the patterns `chosen` of all processes. Returns this process's share of the loss.

        Args:
            noise: Random codes of all patterns, shape (n, segment_size).
            where: Random voxels inside, for the coordinate network, shape (p,).
        """
        mine, weights = self.team.part(chosen)
        truth = [field[mine].to(self.device).float() for field in self.lesson.fields]
        mine, weights, noise = mine.to(self.device), weights.to(self.device), noise[mine].to(self.device)
        points = None
        if where is not None:
            where = where.to(self.device)
            points, truth = self.points[where], [_at(truth[0], self.voxels, where)]
        for optimiser in self.optimisers.values():
            for group in optimiser.param_groups:
                group["lr"] = rate
        with self._autocast():
            answer = self.wrapped["student"](self.impulse[mine], noise, mine, points)
        if "judge" in self.modules:
            return self._play(answer[0], truth[0], torch.cat([self.impulse[mine], noise], dim=1), weights)
        loss = (weights * self._losses(answer, truth, inside=points is not None)).sum()
        self._move("student", loss)
        return loss.detach()

    def _losses(self, answers: list[Tensor], truths: list[Tensor], *, inside: bool) -> Tensor:
        """The L2 of each pattern, the mean over the resolutions, shape (b,)."""
        if inside:
            return ((answers[0] - truths[0]) ** 2).mean(dim=1)
        triples = zip(answers, truths, self.surfaces, strict=True)
        return torch.stack([squared_error(*triple, self.config.ridge_weight) for triple in triples]).mean(dim=0)

    def _play(self, answer: Tensor, truth: Tensor, codes: Tensor, weights: Tensor) -> Tensor:
        """The discriminator learns to tell, then the network to be like the truth and to be taken for it."""
        network = self.student.network
        assert isinstance(network, Pix2Pix)
        with torch.no_grad():
            condition = network.condition(codes)
        both = torch.cat([condition, condition])
        with self._autocast():
            real, fake = self.wrapped["judge"](both, torch.cat([truth, answer.detach()])).chunk(2)
        self._move("judge", 0.5 * ((weights * _verdict(real, True)).sum() + (weights * _verdict(fake, False)).sum()))
        judge = self.modules["judge"].requires_grad_(False)
        with self._autocast():
            verdict = judge(condition, answer)
        error = (answer - truth).abs().mean(dim=(1, 2, 3))
        self._move("student", (weights * (FIELD_WEIGHT * error + _verdict(verdict, True))).sum())
        judge.requires_grad_(True)
        return (weights * ((answer - truth) ** 2).mean(dim=(1, 2, 3))).sum().detach()

    def _move(self, name: str, loss: Tensor) -> None:
        self.optimisers[name].zero_grad(set_to_none=True)
        loss.backward()
        self.optimisers[name].step()

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.precision == "bfloat16")


def learned(module: nn.Module) -> dict[str, nn.Parameter]:
    """The parameters that training moves."""
    return {name: parameter for name, parameter in module.named_parameters() if parameter.requires_grad}


def faster_precision(device: torch.device) -> str:
    """float32 or bfloat16, whichever convolves volumes faster on `device`: units for it (AMX, tensor cores)
    make it several times as fast, without them it is slower than float32."""
    layer = prepared(nn.ConvTranspose3d(64, 32, 4, 2, 1), device)
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
    return "bfloat16" if seconds["bfloat16"] * WORTH < seconds["float32"] else "float32"


def reads_points(network: nn.Module) -> bool:
    """Whether the network answers for positions, not for the whole grid."""
    return isinstance(network, CoordinateMLP)


def _at(fields: Tensor, voxels: list[Tensor], where: Tensor) -> Tensor:
    i, j, k = (axis[where] for axis in voxels)
    return fields[:, i, j, k]


def _verdict(looks: Tensor, real: bool) -> Tensor:
    """Cross-entropy of the discriminator's opinion on each pattern, shape (b,)."""
    wanted = torch.full_like(looks, float(real))
    return nn.functional.binary_cross_entropy_with_logits(looks, wanted, reduction="none").mean(dim=1)
