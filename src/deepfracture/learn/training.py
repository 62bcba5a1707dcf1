"""One training run for every network: epochs, checkpoints, monitoring, and the finished model.

A run lives in a folder: `checkpoint.safetensors` while it lasts, then `model.safetensors`, `card.txt`, `curve.csv` and
`curve.png`. Under torchrun the processes share each batch, and the main one writes.
"""

from __future__ import annotations

import json
import math
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch  # noqa: TID253  (this module is imported by `learn.train` alone)
from numpy.typing import NDArray
from torch import Tensor  # noqa: TID253

from deepfracture.dataset import Dataset
from deepfracture.learn.checkpoint import read, write
from deepfracture.learn.data import TrainingData
from deepfracture.learn.distributed import DistributedContext, init_distributed, pick_device, refuse_distributed
from deepfracture.learn.model import Model
from deepfracture.learn.options import TrainOptions
from deepfracture.learn.partition.config import PartitionConfig
from deepfracture.learn.published.config import PublishedConfig
from deepfracture.learn.reconstruction import Reconstruction, reconstruct
from deepfracture.learn.report import CurvePoint, Objective, TrainingReport, write_card, write_curve
from deepfracture.runtime.lock import exclusive
from deepfracture.runtime.progress import log, stage, track
from deepfracture.types import BadInput, Floats32

EVALUATIONS = 8
"""Times that the reconstruction is measured during a training."""
CHECKPOINT_SECONDS = 60.0
"""Between checkpoints."""


class TrainStep(Protocol):
    """A network in training: its data, loss, optimiser and learning-rate schedule."""

    data: TrainingData
    config: Any
    objective: Objective
    checkpoint_kind: str

    @property
    def options(self) -> str:
        """The command-line options that distinguish this network, each followed by a space."""
        ...

    def learning_rate(self, fraction: float, step: int) -> float:
        """At a fraction of the whole training and after so many steps."""
        ...

    def __call__(self, batch: Tensor, generator: torch.Generator, rate: float) -> float | Tensor:
        """One update with the samples `batch`; returns this process's share of the mean loss."""
        ...

    def model(self, epoch: int) -> tuple[Model, Floats32]:
        """The model with its present weights, and the latent code of every sample, shape (n, code_size)."""
        ...

    def state(self) -> tuple[dict[str, NDArray], dict[str, Any]]:
        """Weights and optimiser moments, and what json holds: all that the next step depends on."""
        ...

    def load_state(self, arrays: Mapping[str, NDArray], progress: Mapping[str, Any]) -> None:
        """The inverse of `state`; any of KeyError, TypeError, ValueError and RuntimeError if it is damaged."""
        ...


@dataclass(frozen=True)
class Budget:
    """How long to train: passes over the data, or minutes of training time."""

    epochs: int | None
    minutes: float | None

    def __post_init__(self) -> None:
        given = [value for value in (self.epochs, self.minutes) if value is not None]
        if len(given) != 1 or not 0 < given[0] < np.inf:
            raise BadInput(f"give epochs or minutes, positive, got epochs={self.epochs}, minutes={self.minutes}")

    def fraction(self, epoch: int, seconds: float) -> float:
        """Fraction of the training that is over, 0 to 1."""
        if self.epochs is not None:
            return min(1.0, epoch / self.epochs)
        assert self.minutes is not None
        return min(1.0, seconds / (60 * self.minutes))

    def __str__(self) -> str:
        return f"--epochs {self.epochs}" if self.epochs is not None else f"--minutes {self.minutes:g}"


def train(
    dataset: Dataset, out: Path, config: PartitionConfig | PublishedConfig, options: TrainOptions, *, resume: bool
) -> TrainingReport:
    """Train on all samples and store the model in the folder `out`.

    With `epochs`, a run that was interrupted and resumed ends with the same weights as an unbroken one on the same
    device; with `minutes` the learning rate follows the clock.

    Args:
        options: Budget, device and seed; preset, width and features are those of `config`.
        resume: Continue from the checkpoint in `out` if there is one.

    Raises:
        BadInput: The data set is empty, the budget or a setting makes no sense, the checkpoint belongs to another run,
            or another process trains in `out`.
    """
    if isinstance(config, PartitionConfig):
        refuse_distributed()
    budget, where = Budget(options.epochs, options.minutes), pick_device(options.device)
    checkpoint = out / "checkpoint.safetensors"
    with init_distributed(where) as distributed, exclusive(out) if distributed.is_main else nullcontext():
        with stage("training data"):
            step = _train_step(dataset, config, options.seed, distributed, out)
        run = Run(step, options.seed, distributed)
        if resume and checkpoint.is_file():
            run.load_checkpoint(checkpoint)
        elif distributed.is_main:
            checkpoint.unlink(missing_ok=True)
        with interrupt_event() as interrupted:
            _train(run, budget, checkpoint, interrupted)
        return _finish(run, out, budget)


def _train_step(
    dataset: Dataset, config: PartitionConfig | PublishedConfig, seed: int, distributed: DistributedContext, out: Path
) -> TrainStep:
    if isinstance(config, PartitionConfig):
        from deepfracture.learn.partition.train_step import PartitionTrainStep

        return PartitionTrainStep(dataset, config, seed, distributed.device, out)
    from deepfracture.learn.published.train_step import PublishedTrainStep

    return PublishedTrainStep(dataset, config, seed, distributed, out)


def _train(run: Run, budget: Budget, checkpoint: Path, interrupted: threading.Event) -> None:
    """Epochs until the budget is spent, with an evaluation and a checkpoint now and then."""

    def percents() -> Iterator[None]:
        done = int(100 * budget.fraction(run.epoch, run.seconds))
        saved = time.monotonic()
        while (before := budget.fraction(run.epoch, run.seconds)) < 1:
            stop = run.train_epoch(budget, interrupted)
            after = budget.fraction(run.epoch, run.seconds)
            if int(after * EVALUATIONS) > int(before * EVALUATIONS):
                run.evaluate()
            due = stop or after >= 1 or time.monotonic() - saved > CHECKPOINT_SECONDS
            if run.distributed.is_main and due:
                run.save_checkpoint(checkpoint)
                saved = time.monotonic()
            if stop:
                raise KeyboardInterrupt
            while done < int(100 * after):
                done += 1
                yield

    start = int(100 * budget.fraction(run.epoch, run.seconds))
    for _ in track(percents(), name="training", total=100 - start) if run.distributed.is_main else percents():
        pass


def _finish(run: Run, out: Path, budget: Budget) -> TrainingReport:
    """Model, curve and card."""
    step, dataset = run.step, run.step.data.dataset
    model, codes = step.model(run.epoch)
    found = reconstruct(model, codes, step.data.monitored)
    command = f"deepfracture train {dataset.name} --out {out.name} {step.options}{budget} --seed {run.seed}"
    metadata = {
        "command": command,
        "seed": run.seed,
        "material": dataset.material.name,
        "loss": run.loss,
        "epochs": run.epoch,
        "counts": found.counts,
    }
    path = out / "model.safetensors"
    report = TrainingReport(path, run.point(found), found)
    if run.distributed.is_main:
        replace(model, metadata=metadata).save(path)
        write_curve(out, run.curve, step.objective)
        write_card(out / "card.txt", dataset, step.config, command, step.objective, report)
    return report


@contextmanager
def interrupt_event() -> Iterator[threading.Event]:
    """Turn Ctrl-C into an event, for a checkpoint between epochs from which the run can resume exactly."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event  # only the main thread receives signals
        return
    before = signal.signal(signal.SIGINT, lambda *_: event.set())
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, before)


class Run:
    """The state of a training: everything that a checkpoint holds."""

    def __init__(self, step: TrainStep, seed: int, distributed: DistributedContext) -> None:
        self.step, self.seed, self.distributed = step, seed, distributed
        self.generator = torch.Generator().manual_seed(seed)
        self.epoch, self.seconds, self.loss, self.rate = 0, 0.0, math.nan, 0.0
        self.curve: list[CurvePoint] = []

    def train_epoch(self, budget: Budget, interrupted: threading.Event) -> bool:
        """One pass over the samples, or what is left of the minutes; returns whether to stop after it, because the
        main process was interrupted."""
        start, before = time.perf_counter(), self.seconds
        order = torch.randperm(len(self.step.data.impulses), generator=self.generator)
        batches = order.split(self.step.config.batch)
        seen, total = 0, 0.0
        for number, batch in enumerate(batches, 1):
            if budget.minutes is not None:
                (self.seconds,) = self.distributed.broadcast([before + time.perf_counter() - start])
            fraction = budget.fraction(self.epoch, self.seconds)
            if fraction >= 1 and seen > 0:
                break
            self.rate = self.step.learning_rate(fraction, self.epoch * len(batches) + number)
            total = total + self.step(batch, self.generator, self.rate) * len(batch)  # a tensor stays on its device
            seen += len(batch)
        self.loss = self.distributed.mean(float(total) / seen)
        spent = before + time.perf_counter() - start
        self.seconds, stop = self.distributed.broadcast([spent, float(interrupted.is_set())])
        self.epoch += 1
        if not math.isfinite(self.loss):
            raise RuntimeError(f"training diverged in epoch {self.epoch}; try a lower learning rate")
        return bool(stop)

    def evaluate(self) -> None:
        """Measure the reconstruction of the monitored samples, and add it to the curve."""
        model, codes = self.step.model(self.epoch)
        self.curve.append(self.point(reconstruct(model, codes, self.step.data.monitored)))
        if self.distributed.is_main:
            log.info("%s", self.curve[-1])

    def point(self, found: Reconstruction) -> CurvePoint:
        return CurvePoint(
            self.epoch, self.seconds, self.loss, self.rate, found.count_error, found.bits, found.ceiling, found.error
        )

    def _identity(self) -> dict[str, Any]:
        """What a checkpoint must share with the run that resumes from it."""
        dataset = self.step.data.dataset
        identity = {
            "config": asdict(self.step.config),
            "seed": self.seed,
            "data": dataset.settings.manifest(),
            "samples": list(dataset.names),
        }
        return json.loads(json.dumps(identity))

    def save_checkpoint(self, path: Path) -> None:
        """Write everything that the rest of the run depends on."""
        arrays, more = self.step.state()
        progress = {
            "epoch": self.epoch,
            "seconds": self.seconds,
            "loss": self.loss,
            "rate": self.rate,
            **more,
            "curve": [point.row for point in self.curve],
        }
        arrays["generator"] = self.generator.get_state().numpy()
        write(path, self.step.checkpoint_kind, arrays, {**self._identity(), "progress": progress})

    def load_checkpoint(self, path: Path) -> None:
        """Resume from a checkpoint of the same run.

        Raises:
            BadInput: It is damaged, or belongs to other data, settings or seed.
        """
        arrays, metadata = read(path, self.step.checkpoint_kind)
        for key, value in self._identity().items():
            if metadata.get(key) != value:
                raise BadInput(
                    f"{path}: belongs to a run with other {key}; use another folder, or start over without resume"
                )
        try:
            progress = metadata["progress"]
            self.step.load_state(arrays, progress)
            self.generator.set_state(torch.from_numpy(arrays["generator"]))
            self.epoch, self.seconds = int(progress["epoch"]), float(progress["seconds"])
            self.loss, self.rate = float(progress["loss"]), float(progress.get("rate", 0.0))
            self.curve = [CurvePoint(*row) for row in progress["curve"]]
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise BadInput(f"{path}: damaged checkpoint ({reason}); delete it to start over") from error
