"""`simulate`, `copy` and `train`: from a shape to a model."""

from __future__ import annotations

from pathlib import Path

from deepfracture import api
from deepfracture.dataset.options import SimulateOptions
from deepfracture.learn.options import TrainOptions
from deepfracture.runtime.progress import log


def simulate(name: str, *, out: Path | None, material: str, repair: bool, options: SimulateOptions) -> None:
    """Fill the data set `out` with simulated collisions of the shape `name`; resumes where it stopped."""
    shape = api.load(name, repair=repair)
    dataset = api.simulate(shape, out or Path("data") / shape.name, options, material=material)
    log.info(
        "%s: %d patterns from %d collisions (%d without fracture, %d failed)%s",
        dataset.path, len(dataset), dataset.tried, dataset.unbroken, dataset.failed,
        f", largest impulse {dataset.max_impulse:.0f} N s" if len(dataset) else "",
    )  # fmt: skip


def copy(source: Path, target: Path) -> None:
    """Copy the data set `source` to `target`; resumes where it stopped."""
    from deepfracture.dataset import copy_dataset

    dataset, damaged = copy_dataset(source, target)
    lost = f", {damaged} damaged ones left out: simulate {dataset.shape.name} again to fill the gaps" if damaged else ""
    log.info("%s: %d entries, %d of them patterns%s", dataset.path, dataset.tried, len(dataset), lost)


def train(path: Path, *, out: Path, options: TrainOptions) -> None:
    """Train on the data set `path` into the run folder `out`; resumes an interrupted run."""
    log.info("%s", api.train_with_card(path, out, options))
