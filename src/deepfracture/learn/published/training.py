"""Train a network that predicts the GS-SDF itself: the paper's, and the ones that the paper compares with.

A run lives in one folder: `checkpoint.safetensors` while it lasts, then `model.safetensors`, `card.txt`,
`curve.csv` and `curve.png`. Under torchrun the processes share each step's patterns, and the first writes.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  (the room of torch)

from deepfracture.dataset import Dataset
from deepfracture.learn.checkpoint import read, write
from deepfracture.learn.distributed import Team, assemble, pick_device
from deepfracture.learn.published.codes import draw_siren, encode
from deepfracture.learn.published.config import PIX2PIX, FieldConfig
from deepfracture.learn.published.data import Lesson
from deepfracture.learn.published.model import FieldModel, build, prepared, save_field_model
from deepfracture.learn.published.report import FieldPoint, field_card, write_field_curve
from deepfracture.learn.published.train_step import Teacher, faster_precision, learned, reads_points
from deepfracture.learn.reconstruction import Recall, recall
from deepfracture.learn.report import Card, write_card
from deepfracture.learn.training import KEEP_EVERY, LOOKS, Budget, interrupt_later
from deepfracture.runtime.lock import exclusive
from deepfracture.runtime.progress import log, stage, track
from deepfracture.types import BadInput, Floats32

KIND = "field training checkpoint"


def train_field(
    dataset: Dataset, out: Path, config: FieldConfig, *,
    epochs: int | None, minutes: float | None, resume: bool, device: str, seed: int,
) -> Card:  # fmt: skip
    """Train on all samples and store the model in the folder `out`.

    With `epochs`, a run that was interrupted and resumed ends with the same weights as an unbroken one
    on the same device; with `minutes` the learning rate follows the clock.

    Args:
        resume: Go on from the checkpoint in `out` if there is one, else start anew.
        device: A torch device, or "auto" for the GPU if there is one.

    Raises:
        BadInput: The data set is empty, the budget or a setting makes no sense, the checkpoint is another run's, or
            another process trains in `out`.
    """
    budget, where = Budget(epochs, minutes), pick_device(device)
    config = config.at(dataset.settings.resolution)
    file = out / "checkpoint.safetensors"
    with assemble(where) as team, exclusive(out) if team.leads else nullcontext():
        with stage("training data"):
            lesson = Lesson.of(dataset, config, out)
        run = _Run(lesson, config, seed, where, team)
        if resume and file.is_file():
            run.restore(file)
        with interrupt_later() as interrupted:
            _train(run, budget, file, interrupted)
        return _finish(run, out, f"{budget} --seed {seed}")


def _train(run: _Run, budget: Budget, file: Path, interrupted: threading.Event) -> None:
    """Epochs until the budget is spent, with a look at the memory and a checkpoint now and then."""

    def percents() -> Iterator[None]:
        done = int(100 * budget.part(run.epoch, run.seconds))
        kept = time.monotonic()
        while (part := budget.part(run.epoch, run.seconds)) < 1:
            stop = run.train_epoch(budget, interrupted)
            now = budget.part(run.epoch, run.seconds)
            if int(now * LOOKS) > int(part * LOOKS):
                run.look()
            if run.team.leads and (stop or now >= 1 or time.monotonic() - kept > KEEP_EVERY):
                run.keep(file)
                kept = time.monotonic()
            if stop:
                raise KeyboardInterrupt
            while done < int(100 * now):
                done += 1
                yield

    start = int(100 * budget.part(run.epoch, run.seconds))
    for _ in track(percents(), name="training", total=100 - start) if run.team.leads else percents():
        pass


def _finish(run: _Run, out: Path, budget: str) -> Card:
    """Model, curve and card."""
    config, dataset = run.config, run.lesson.dataset
    found = run.recall()
    command = (
        f"deepfracture train {dataset.name} --out {out.name} --preset {config.preset} --width {config.width:g} "
        f"--features {config.features} {budget}"
    )
    about = {
        "command": command,
        "seed": run.seed,
        "material": dataset.material.name,
        "loss": run.loss,
        "epochs": run.epoch,
        "counts": found.counts,
    }
    model, path, last = replace(run.model(), about=about), out / "model.safetensors", run.point(found)
    if not run.team.leads:
        return Card(path, last, found, "")
    save_field_model(path, model)
    write_field_curve(out, run.curve)
    text = field_card(dataset, config, command, model.weights, path.stat().st_size, last, found)
    write_card(out / "card.txt", text)
    return Card(path, last, found, text)


class _Run:
    """The state of a training: everything that a checkpoint holds."""

    def __init__(self, lesson: Lesson, config: FieldConfig, seed: int, device: torch.device, team: Team) -> None:
        self.lesson, self.config, self.seed, self.device, self.team = lesson, config, seed, device, team
        self.precision = config.precision
        if self.precision == "auto":
            fast = float(faster_precision(device) == "bfloat16")
            self.precision = "bfloat16" if team.agree([fast], device)[0] else "float32"
        rng = np.random.default_rng(seed)
        self.siren = draw_siren(config, rng)
        self.impulse = encode(self.siren, lesson.impulses)
        drawn = rng.standard_normal((len(self.impulse), config.segment_size), np.float32)
        segment = torch.from_numpy(drawn) if config.learns_codes else None
        with _seeded(seed):
            network = prepared(build(config, lesson.body.surface), device)
            self.teacher = Teacher(
                network, segment, lesson, torch.from_numpy(self.impulse), config, device, team, self.precision
            )
        self.generator = torch.Generator().manual_seed(seed)
        self.epoch, self.seconds, self.loss, self.rate = 0, 0.0, math.nan, config.learning_rate
        self.curve: list[FieldPoint] = []

    def train_epoch(self, budget: Budget, interrupted: threading.Event) -> bool:
        """One pass over the patterns, or what is left of the minutes. Whether to stop after it, for an
        interruption of the first process."""
        start, before = time.perf_counter(), self.seconds
        config, count, seen = self.config, len(self.impulse), 0
        inside = len(self.lesson.body.voxels[0])
        points = reads_points(self.teacher.student.network)
        total = torch.zeros((), device=self.device)
        for chosen in torch.randperm(count, generator=self.generator).split(config.batch):
            if budget.minutes is not None:
                (self.seconds,) = self.team.agree([before + time.perf_counter() - start], self.device)
            part = budget.part(self.epoch, self.seconds)
            if part >= 1 and seen > 0:
                break
            self.rate = config.late_rate if part >= config.late_from else config.learning_rate
            noise = torch.randn(count, config.segment_size, generator=self.generator)
            where = torch.randint(inside, (config.points,), generator=self.generator) if points else None
            total += self.teacher.step(chosen, noise, where, self.rate) * len(chosen)
            seen += len(chosen)
        loss = self.team.mean(float(total) / seen, self.device)
        spent = before + time.perf_counter() - start
        self.seconds, stop = self.team.agree([spent, float(interrupted.is_set())], self.device)
        self.epoch, self.loss = self.epoch + 1, loss
        if not math.isfinite(loss):
            raise RuntimeError(f"training diverged in epoch {self.epoch}; try a lower learning rate")
        return bool(stop)

    def codes(self) -> Floats32:
        """The latent code of every pattern, shape (n, code_size)."""
        segment = self.teacher.student.segment
        if segment is None:  # each step draws its own
            drawn = self._rng().standard_normal((len(self.impulse), self.config.segment_size), np.float32)
        else:
            drawn = segment.detach().cpu().numpy().copy()
        return np.concatenate([self.impulse, drawn], axis=1)

    def model(self) -> FieldModel:
        """The model as it is now; its embedding space is a sample of this epoch's codes (paper, eq. 6)."""
        lesson, codes = self.lesson, self.codes()
        kept = self._rng().permutation(len(codes))[: self.config.space]
        return FieldModel(
            lesson.dataset.shape.name, self.config, lesson.normaliser, lesson.body, self.siren,
            self.teacher.student.network, codes[np.sort(kept)], {}, quantised=self.config.preset != PIX2PIX,
        )  # fmt: skip

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng((self.seed, self.epoch))

    def recall(self) -> Recall:
        """What the network remembers."""
        return recall(self.model(), self.codes(), self.lesson.probes)

    def look(self) -> None:
        """Measure the memory and put it on the curve."""
        self.curve.append(self.point(self.recall()))
        if self.team.leads:
            log.info("%s", self.curve[-1])

    def point(self, found: Recall) -> FieldPoint:
        return FieldPoint(
            self.epoch, self.seconds, self.loss, self.rate, found.count_error, found.bits, found.ceiling, found.error
        )

    def _facts(self) -> dict[str, Any]:
        """What a checkpoint must share with the run that goes on from it."""
        facts = {
            "config": asdict(self.config),
            "seed": self.seed,
            "data": self.lesson.dataset.settings.manifest(),
            "samples": list(self.lesson.dataset.names),
        }
        return json.loads(json.dumps(facts))

    def keep(self, path: Path) -> None:
        """Write everything that the rest of the run depends on."""
        arrays = {"generator": self.generator.get_state().numpy()}
        for name, module in self.teacher.modules.items():
            for key, value in module.state_dict().items():
                arrays[f"{name}.{key}"] = value.cpu().numpy()
            for key, parameter in learned(module).items():
                for part, value in self.teacher.optimisers[name].state[parameter].items():
                    arrays[f"adam.{name}.{key}.{part}"] = value.cpu().numpy()
        progress = {
            "epoch": self.epoch,
            "seconds": self.seconds,
            "loss": self.loss,
            "rate": self.rate,
            "precision": self.precision,
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
            for name, module in self.teacher.modules.items():
                module.load_state_dict({key: torch.from_numpy(arrays[f"{name}.{key}"]) for key in module.state_dict()})
                for key, parameter in learned(module).items():
                    self.teacher.optimisers[name].state[parameter] = {
                        part: self._moment(part, arrays[f"adam.{name}.{key}.{part}"], parameter)
                        for part in ("step", "exp_avg", "exp_avg_sq")
                    }
            self.generator.set_state(torch.from_numpy(arrays["generator"]))
            progress = facts["progress"]
            self.epoch, self.seconds = int(progress["epoch"]), float(progress["seconds"])
            self.loss, self.rate = float(progress["loss"]), float(progress["rate"])
            self.precision = self.teacher.precision = str(progress["precision"])
            self.curve = [FieldPoint(*row) for row in progress["curve"]]
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            reason = str(error).splitlines()[0]
            raise BadInput(f"{path}: damaged checkpoint ({reason}); delete it to start anew") from error

    def _moment(self, part: str, value: np.ndarray, parameter: torch.Tensor) -> torch.Tensor:
        """An optimiser's number, where and how Adam keeps it."""
        stored = torch.from_numpy(value)
        if part == "step":
            return stored.to(parameter.device) if parameter.is_cuda else stored
        moment = torch.zeros_like(parameter, memory_format=torch.preserve_format)
        return moment.copy_(stored)


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Weights are drawn from `seed`; torch's own generator is left as it was."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield
