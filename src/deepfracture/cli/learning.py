"""`simulate` and `train`: from a shape to a model."""

from __future__ import annotations

from pathlib import Path

from deepfracture.progress import log

EPOCHS = 400
"""Passes over the data when nothing else is asked for: some ten minutes for 200 patterns at r = 64 on two cores."""


def simulate(
    name: str, *, out: Path | None, collisions: int, material: str, resolution: int, speed: tuple[float, float],
    scene: str, refracture: int, frames: int, workers: int, seed: int, repair: bool,
) -> None:  # fmt: skip
    """Fill the data set `out` with simulated collisions of the shape `name`; goes on where it stopped."""
    from deepfracture.dataset import simulate_collisions
    from deepfracture.fracture import material as preset
    from deepfracture.geometry import load_shape

    shape = load_shape(name, repair=repair)
    out = out or Path("data") / shape.name
    dataset = simulate_collisions(
        shape, preset(material), out, collisions=collisions, workers=workers, resolution=resolution, seed=seed,
        speed_range=speed, scene=scene, refracture=refracture, frames=frames,
    )  # fmt: skip
    log.info(
        "%s: %d patterns from %d collisions (%d broke nothing, %d failed), largest impulse %.0f N s",
        out, len(dataset), dataset.tried, dataset.unbroken, dataset.failed, dataset.max_impulse,
    )  # fmt: skip


def train(path: Path, *, out: Path, epochs: int | None, minutes: float | None, device: str, seed: int) -> None:
    """Train on the data set `path` into the run folder `out`; goes on where it stopped."""
    from deepfracture.dataset import open_dataset
    from deepfracture.learn import train as run

    if epochs is None and minutes is None:
        epochs = EPOCHS
    finished = run(open_dataset(path), out, epochs=epochs, minutes=minutes, device=device, seed=seed)
    log.info("%s", finished)
