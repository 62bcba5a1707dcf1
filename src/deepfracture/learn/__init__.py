"""The generative model: impulse and random code to GS-SDF. Only training needs torch."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deepfracture.learn.normaliser import Normaliser, normalise_impact
from deepfracture.learn.partition.config import Config, need_training
from deepfracture.learn.partition.model import (
    AS_PUBLISHED,
    OURS,
    Model,
    Way,
    embedded_model,
    load_model,
    predict,
    predictions,
)

if TYPE_CHECKING:
    from deepfracture.dataset import Dataset
    from deepfracture.learn.report import Card

__all__ = [
    "AS_PUBLISHED",
    "OURS",
    "Config",
    "Model",
    "Normaliser",
    "Way",
    "embedded_model",
    "load_model",
    "normalise_impact",
    "predict",
    "predictions",
    "train",
]


def train(
    dataset: Dataset,
    out: Path | str,
    config: Config | None = None,
    *,
    epochs: int | None = None,
    minutes: float | None = None,
    resume: bool = True,
    device: str = "auto",
    seed: int = 0,
) -> Card:
    """Train a model on `dataset` in the run folder `out`: see `learn.training.train`."""
    need_training()
    from deepfracture.learn.training import train as run

    return run(
        dataset,
        Path(out),
        config or Config(),
        epochs=epochs,
        minutes=minutes,
        resume=resume,
        device=device,
        seed=seed,
    )
