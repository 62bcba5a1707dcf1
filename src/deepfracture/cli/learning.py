"""`simulate` and `train`: from a shape to a model."""

from __future__ import annotations

from pathlib import Path

from deepfracture import api
from deepfracture.learn.options import TrainOptions
from deepfracture.runtime.progress import log


def simulate(
    name: str, *, out: Path | None, collisions: int, material: str, resolution: int, speed: tuple[float, float],
    scene: str, refracture: int, frames: int, repeats: int, workers: int | None, executor: str, address: str | None,
    limit: float, memory: float | None, retry: bool, seed: int, repair: bool,
) -> None:  # fmt: skip
    """Fill the data set `out` with simulated collisions of the shape `name`; goes on where it stopped."""
    shape = api.load(name, repair=repair)
    out = out or Path("data") / shape.name
    dataset = api.simulate(
        shape, out, collisions=collisions, material=material, resolution=resolution, speed=speed, scene=scene,
        refracture=refracture, frames=frames, repeats=repeats, workers=workers, executor=executor, address=address,
        limit=limit, memory=memory, retry=retry, seed=seed,
    )  # fmt: skip
    log.info(
        "%s: %d patterns from %d collisions (%d broke nothing, %d failed)%s",
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
