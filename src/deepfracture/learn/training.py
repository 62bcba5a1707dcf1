"""Training: decoder and segment codes together (an autodecoder), the impulse encoder frozen.

The only user of torch. A run lives in a folder: `checkpoint.safetensors` while it lasts, then
`model.safetensors`, `card.txt`, `curve.csv` and `curve.png`.
"""

from __future__ import annotations

import json
import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  (this module is imported by `learn.train` alone)

from deepfracture.compare import describe
from deepfracture.dataset import Dataset
from deepfracture.geometry import signed_distance
from deepfracture.learn.checkpoint import read, write
from deepfracture.learn.distributed import pick_device, refuse_team
from deepfracture.learn.memory_map import on_disk, spilt
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.partition import network
from deepfracture.learn.partition.config import Config
from deepfracture.learn.partition.field import Body
from deepfracture.learn.partition.model import Model, save_model
from deepfracture.learn.partition.selector import Choice, fit, mean_distance
from deepfracture.learn.partition.targets import anchors, target_of
from deepfracture.learn.reconstruction import Probe, Recall, recall
from deepfracture.learn.report import Card, Point, card_text, write_card, write_curve
from deepfracture.runtime.lock import exclusive
from deepfracture.runtime.progress import log, stage, track
from deepfracture.types import BadInput, Grid

KIND = "training checkpoint"
PROBES = 10
"""Training patterns whose memory is watched."""
LOOKS = 8
"""Times that it is measured during a training."""
KEEP_EVERY = 60.0
"""Seconds between checkpoints."""


@dataclass(frozen=True)
class Budget:
    """How long to train: passes over the data, or minutes of training time."""

    epochs: int | None
    minutes: float | None

    def __post_init__(self) -> None:
        given = [value for value in (self.epochs, self.minutes) if value is not None]
        if len(given) != 1 or not 0 < given[0] < np.inf:
            raise BadInput(f"give epochs or minutes, positive, got epochs={self.epochs}, minutes={self.minutes}")

    def part(self, epoch: int, seconds: float) -> float:
        """Share of the training that is over, 0 to 1."""
        if self.epochs is not None:
            return min(1.0, epoch / self.epochs)
        assert self.minutes is not None
        return min(1.0, seconds / (60 * self.minutes))

    def __str__(self) -> str:
        return f"--epochs {self.epochs}" if self.epochs is not None else f"--minutes {self.minutes:g}"


def train(
    dataset: Dataset, out: Path, config: Config, *,
    epochs: int | None, minutes: float | None, resume: bool, device: str, seed: int,
) -> Card:  # fmt: skip
    """Train on all samples and store the model in the folder `out`.

    With `epochs`, a run that was interrupted and resumed ends with the same weights as an unbroken one
    on the same device; with `minutes` the learning rate follows the clock.

    Args:
        resume: Go on from the checkpoint in `out` if there is one, else start anew.
        device: A torch device, or "auto" for the GPU if there is one.

    Raises:
        BadInput: The data set is empty, the budget makes no sense, the checkpoint is another run's, or another process
            trains in `out`.
    """
    refuse_team()
    budget = Budget(epochs, minutes)
    with exclusive(out):
        return _trained(dataset, out, config, budget, resume, device, seed)


def _trained(dataset: Dataset, out: Path, config: Config, budget: Budget, resume: bool, device: str, seed: int) -> Card:
    with stage("training data"):
        lesson = _Lesson.of(dataset, config, out)
    run = _Run(lesson, config, seed, pick_device(device))
    file = out / "checkpoint.safetensors"
    if resume and file.is_file():
        run.restore(file)
    elif file.is_file():
        file.unlink()
    with interrupt_later() as interrupted:
        _train(run, budget, file, interrupted)
    model = run.model()
    found = recall(model, model.codebook, lesson.probes)
    command = f"deepfracture train {dataset.name} --out {out.name} {budget} --seed {seed}"
    about = {
        "command": command,
        "seed": seed,
        "material": dataset.material.name,
        "loss": run.loss,
        "epochs": run.epoch,
        "counts": found.counts,
    }
    path = out / "model.safetensors"
    save_model(path, replace(model, about=about))
    last = run.point(found)
    write_curve(out, run.curve)
    text = card_text(dataset, config, command, seed, path.stat().st_size, last, found)
    write_card(out / "card.txt", text)
    return Card(path, last, found, text)


def _train(run: _Run, budget: Budget, file: Path, interrupted: threading.Event) -> None:
    """Epochs until the budget is spent, with a look at the memory and a checkpoint now and then."""

    def percents() -> Iterator[None]:
        done = int(100 * budget.part(run.epoch, run.seconds))
        kept = time.monotonic()
        while (part := budget.part(run.epoch, run.seconds)) < 1:
            run.train_epoch(budget)
            now = budget.part(run.epoch, run.seconds)
            if int(now * LOOKS) > int(part * LOOKS):
                run.look()
            if interrupted.is_set() or now >= 1 or time.monotonic() - kept > KEEP_EVERY:
                run.keep(file)
                kept = time.monotonic()
            if interrupted.is_set():
                raise KeyboardInterrupt
            while done < int(100 * now):
                done += 1
                yield

    start = int(100 * budget.part(run.epoch, run.seconds))
    for _ in track(percents(), name="training", total=100 - start):
        pass


@contextmanager
def interrupt_later() -> Iterator[threading.Event]:
    """Turn Ctrl-C into an event, for a checkpoint between epochs, from where the run can go on exactly."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event  # only the main thread receives signals
        return
    before = signal.signal(signal.SIGINT, lambda *_: event.set())
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, before)


@dataclass(frozen=True, eq=False)
class _Lesson:
    """The data set as the network sees it: each sample is read once, and what grows with their number lies on disk."""

    dataset: Dataset
    body: Body
    normaliser: Normaliser
    choice: Choice
    """The impulses, shape (n, features, 7), and how alike what they did is; segment codes are not learnt yet."""
    targets: dict[str, np.ndarray]
    """Fields of `Target`, shape (n, voxels) each."""
    channels: int
    probes: list[Probe]

    @staticmethod
    def of(dataset: Dataset, config: Config, scratch: Path) -> _Lesson:
        if len(dataset) == 0:
            raise BadInput(f"{dataset.path}: no collision broke the shape yet; simulate more or faster ones")
        grid = Grid(dataset.settings.resolution)
        body = Body.of(grid, signed_distance(dataset.shape.mesh, grid))
        normaliser = Normaliser(dataset.max_impulse, config.features)
        watched = {int(i) for i in np.linspace(0, len(dataset) - 1, PROBES)}
        channels = min(config.channels, max(record.fragments for record in dataset.samples))
        places = anchors(body.points, channels)
        targets = {
            name: on_disk(scratch, (len(dataset), len(body.points)), kind)
            for name, kind in {"channel": "u1", "next": "u1", "share": "f2", "weight": "f2"}.items()
        }
        impulses, probes, traits, somewhere = [], [], [], dataset.impacts()[0]
        for index, sample in enumerate(track(dataset, name="targets", total=len(dataset))):
            impulses.append(normaliser(sample.impact))
            found = describe(sample.pattern, somewhere)  # only differences between patterns matter
            traits.append(replace(found, partition=spilt(scratch, found.partition)))
            target = target_of(sample.pattern, body.voxels, places)
            for name, array in targets.items():
                array[index] = getattr(target, name)
            if index in watched:
                probes.append(Probe.of(index, sample.pattern, body))
        rows, apart = np.stack(impulses).astype(np.float32), mean_distance(traits)
        choice = Choice(rows, np.zeros((len(rows), config.segment_size), np.float32), apart, fit(rows, apart))
        return _Lesson(dataset, body, normaliser, choice, targets, channels, probes)


class _Run:
    """The state of a training: everything that a checkpoint holds."""

    def __init__(self, lesson: _Lesson, config: Config, seed: int, device: torch.device) -> None:
        self.lesson, self.config, self.seed, self.device = lesson, config, seed, device
        rng = np.random.default_rng(seed)
        drawn = network.draw_weights(config, lesson.channels, rng)
        rows = lesson.choice.rows
        segment = rng.standard_normal((len(rows), config.segment_size), np.float32)
        self.impulse = self._put(network.encode_impulses(drawn, rows, np).astype(np.float32))
        self.weights = {name: self._put(value) for name, value in drawn.items()}
        self.weights["codes"] = self._put(segment)
        self.learned = [name for name in self.weights if name not in network.FROZEN]
        for name in self.learned:
            self.weights[name].requires_grad_()
        self.optimiser = torch.optim.Adam(
            [self.weights[name] for name in self.learned], lr=config.learning_rate, fused=True
        )
        self.points = self._put(lesson.body.points.astype(np.float32))
        self.targets = {name: torch.from_numpy(value) for name, value in lesson.targets.items()}
        self.generator = torch.Generator().manual_seed(seed)
        self.epoch, self.seconds, self.loss, self.rate = 0, 0.0, math.nan, 0.0
        self.curve: list[Point] = []

    def _put(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

    def train_epoch(self, budget: Budget) -> None:
        """One pass over the patterns, each seen at random voxels."""
        start = time.perf_counter()
        count = len(self.impulse)
        per_epoch = math.ceil(count / self.config.batch)
        total = 0.0
        for step, chosen in enumerate(torch.randperm(count, generator=self.generator).split(self.config.batch)):
            part = budget.part(self.epoch, self.seconds)
            warm = min(1.0, (self.epoch * per_epoch + step + 1) / self.config.warm_up)
            self.rate = self.config.learning_rate * warm * max(0.5 * (1 + math.cos(math.pi * part)), 0.005)
            for group in self.optimiser.param_groups:
                group["lr"] = self.rate
            total += self._step(chosen) * len(chosen)
        self.epoch += 1
        self.loss = total / count
        self.seconds += time.perf_counter() - start
        if not math.isfinite(self.loss):
            raise RuntimeError(f"training diverged in epoch {self.epoch}; try a lower learning rate")

    def _step(self, chosen: torch.Tensor) -> float:
        """One update: the chosen patterns at the same random voxels, so that one product gives all scores."""
        where = torch.randint(len(self.points), (self.config.points,), generator=self.generator)
        rows = chosen[None, :], where[:, None]
        truth = {name: values[rows].to(self.device) for name, values in self.targets.items()}
        chosen, where = chosen.to(self.device), where.to(self.device)
        codes = torch.cat([self.impulse[chosen], self.weights["codes"][chosen]], dim=1)
        mixing = network.compose(self.weights, codes, torch).transpose(0, 1)  # (basis, patterns, channels)
        scores = network.basis(self.weights, self.points[where], torch) @ mixing.reshape(len(mixing), -1)
        scores = scores.view(len(where), len(chosen), -1)
        mine, beyond = (scores.gather(2, truth[name].long()[..., None])[..., 0] for name in ("channel", "next"))
        share, weight = truth["share"].float(), truth["weight"].float()
        loss = (weight * (scores.logsumexp(dim=-1) - share * mine - (1 - share) * beyond)).mean()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()
        return loss.item()

    def model(self) -> Model:
        """The model as it is now; its embedding space holds every latent code of the epoch."""
        weights = {name: value.detach().cpu().numpy().copy() for name, value in self.weights.items()}
        lesson = self.lesson
        choice = replace(lesson.choice, segment=weights.pop("codes"))
        return Model(lesson.dataset.shape.name, self.config, lesson.normaliser, lesson.body, weights, choice, {})

    def look(self) -> None:
        """Measure the memory and put it on the curve."""
        model = self.model()
        self.curve.append(self.point(recall(model, model.codebook, self.lesson.probes)))
        log.info("%s", self.curve[-1])

    def point(self, found: Recall) -> Point:
        return Point(
            self.epoch,
            self.seconds,
            self.loss,
            self.rate,
            found.count_error,
            found.bits,
            found.ceiling,
            found.error,
        )

    def _facts(self) -> dict[str, Any]:
        """What a checkpoint must share with the run that goes on from it."""
        return {
            "config": asdict(self.config),
            "seed": self.seed,
            "data": json.loads(json.dumps(self.lesson.dataset.settings.manifest())),
            "samples": list(self.lesson.dataset.names),
        }

    def keep(self, path: Path) -> None:
        """Write everything that the rest of the run depends on."""
        arrays = {f"weights.{name}": value.detach().cpu().numpy() for name, value in self.weights.items()}
        for name in self.learned:
            for key, value in self.optimiser.state[self.weights[name]].items():
                arrays[f"adam.{name}.{key}"] = value.cpu().numpy()
        arrays["generator"] = self.generator.get_state().numpy()
        progress = {
            "epoch": self.epoch,
            "seconds": self.seconds,
            "loss": self.loss,
            "curve": [point.row for point in self.curve],
        }
        write(path, KIND, arrays, {**self._facts(), "progress": progress})

    def restore(self, path: Path) -> None:
        """Go on from a checkpoint of the same run.

        Raises:
            BadInput: It is damaged, or belongs to other data, settings or seed.
        """
        arrays, facts = read(path, KIND)
        for key, value in self._facts().items():
            if facts.get(key) != value:
                raise BadInput(f"{path}: of a run with other {key}; use another folder, or start anew without resume")
        try:
            with torch.no_grad():
                for name, value in self.weights.items():
                    value.copy_(torch.from_numpy(arrays[f"weights.{name}"]))
            for name in self.learned:
                self.optimiser.state[self.weights[name]] = {
                    key: torch.from_numpy(arrays[f"adam.{name}.{key}"]).to("cpu" if key == "step" else self.device)
                    for key in ("step", "exp_avg", "exp_avg_sq")
                }
            self.generator.set_state(torch.from_numpy(arrays["generator"]))
            progress = facts["progress"]
            self.epoch, self.seconds = int(progress["epoch"]), float(progress["seconds"])
            self.loss = float(progress["loss"])
            self.curve = [Point(*row) for row in progress["curve"]]
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise BadInput(f"{path}: damaged checkpoint ({error}); delete it to start anew") from error
