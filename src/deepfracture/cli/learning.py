"""`simulate` and `train`: from a shape to a model."""

from __future__ import annotations

from pathlib import Path

from deepfracture.progress import log
from deepfracture.types import BadInput

EPOCHS = 400
"""Passes over the data when nothing else is asked for: some ten minutes for 200 patterns at r = 64 on two cores."""
WAVES = "waves"
"""The preset of our own model."""
PAPER_EPOCHS = 1000
"""The same for the networks that predict the field itself, as in the paper."""


def simulate(
    name: str, *, out: Path | None, collisions: int, material: str, resolution: int, speed: tuple[float, float],
    scene: str, refracture: int, frames: int, repeats: int, workers: int, seed: int, repair: bool,
) -> None:  # fmt: skip
    """Fill the data set `out` with simulated collisions of the shape `name`; goes on where it stopped."""
    from deepfracture.dataset import simulate_collisions
    from deepfracture.fracture import material as preset
    from deepfracture.geometry import load_shape

    shape = load_shape(name, repair=repair)
    out = out or Path("data") / shape.name
    dataset = simulate_collisions(
        shape, preset(material), out, collisions=collisions, workers=workers, resolution=resolution, seed=seed,
        speed_range=speed, scene=scene, refracture=refracture, frames=frames, repeats=repeats,
    )  # fmt: skip
    log.info(
        "%s: %d patterns from %d collisions (%d broke nothing, %d failed), largest impulse %.0f N s",
        out, len(dataset), dataset.tried, dataset.unbroken, dataset.failed, dataset.max_impulse,
    )  # fmt: skip


def train(
    path: Path, *, out: Path, preset: str, width: float, features: int,
    epochs: int | None, minutes: float | None, device: str, seed: int,
) -> None:  # fmt: skip
    """Train on the data set `path` into the run folder `out`; goes on where it stopped."""
    from deepfracture.dataset import open_dataset
    from deepfracture.learn import Config, fields
    from deepfracture.learn import train as train_waves

    ours = preset == WAVES
    if ours and width != 1:
        raise BadInput(f"width {width:g}: only for the presets {', '.join(fields.PRESETS)}; leave it out")
    if not ours and preset not in fields.PRESETS:
        raise BadInput(f"preset must be one of {WAVES}, {', '.join(fields.PRESETS)}, got {preset!r}")
    if epochs is None and minutes is None:
        epochs = EPOCHS if ours else PAPER_EPOCHS
    dataset = open_dataset(path)
    if ours:
        config = Config(features=features)
        finished = train_waves(dataset, out, config, epochs=epochs, minutes=minutes, device=device, seed=seed)
    else:
        chosen = fields.preset(preset, width=width, features=features)
        finished = fields.train_field(dataset, out, chosen, epochs=epochs, minutes=minutes, device=device, seed=seed)
    log.info("%s", finished)
