"""The generative model: impulse and random code to GS-SDF. Only training needs torch."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deepfracture.learn.options import TrainOptions as TrainOptions
from deepfracture.learn.partition.config import Config as Config
from deepfracture.learn.partition.config import need_training
from deepfracture.runtime.lazy import lazy_names

if TYPE_CHECKING:
    from deepfracture.dataset import Dataset
    from deepfracture.learn.normaliser import Normaliser as Normaliser
    from deepfracture.learn.normaliser import normalise_impact as normalise_impact
    from deepfracture.learn.partition.model import AS_PUBLISHED as AS_PUBLISHED
    from deepfracture.learn.partition.model import OURS as OURS
    from deepfracture.learn.partition.model import Model as Model
    from deepfracture.learn.partition.model import Way as Way
    from deepfracture.learn.partition.model import embedded_model as embedded_model
    from deepfracture.learn.partition.model import load_model as load_model
    from deepfracture.learn.partition.model import predict as predict
    from deepfracture.learn.partition.model import predictions as predictions
    from deepfracture.learn.report import Card

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "normaliser": ("Normaliser", "normalise_impact"),
        "partition.model": (
            "AS_PUBLISHED", "OURS", "Model", "Way", "embedded_model", "load_model", "predict", "predictions",
        ),
    },
)  # fmt: skip


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
