"""Networks that predict the GS-SDF itself: the paper's, and the ones that the paper compares with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from deepfracture.learn.checkpoint import KEY
from deepfracture.learn.partition.config import need_training
from deepfracture.learn.published.config import PRESETS, FieldConfig, preset
from deepfracture.runtime.extras import require
from deepfracture.types import BadInput

if TYPE_CHECKING:
    from deepfracture.dataset import Dataset
    from deepfracture.learn.published.model import FieldModel
    from deepfracture.learn.report import Card

__all__ = ["PRESETS", "FieldConfig", "kind_of", "load_field_model", "preset", "train_field"]


def train_field(
    dataset: Dataset, out: Path | str, config: FieldConfig | None = None, *,
    epochs: int | None = None, minutes: float | None = None, resume: bool = True, device: str = "auto", seed: int = 0,
) -> Card:  # fmt: skip
    """Train a network on `dataset` in the run folder `out`: see `learn.published.training.train_field`."""
    need_training()
    from deepfracture.learn.published.training import train_field as run

    return run(
        dataset, Path(out), config or FieldConfig(),
        epochs=epochs, minutes=minutes, resume=resume, device=device, seed=seed,
    )  # fmt: skip


def load_field_model(path: Path | str, *, device: str = "auto") -> FieldModel:
    """Read a field model and check all of it before use.

    Raises:
        BadInput: In one line, what is missing, damaged, or of another format; torch or the device is not there.
    """
    require("torch", extra="train", to=f"predict with the field model {path}")
    from deepfracture.learn.distributed import pick_device
    from deepfracture.learn.published.model import load_field_model as load

    return load(Path(path), pick_device(device))


def kind_of(path: Path | str) -> str:
    """What a file written by `deepfracture train` holds: "model", "field model", or a kind of checkpoint.

    Raises:
        BadInput: No such file, or not written by deepfracture.
    """
    from safetensors import SafetensorError, safe_open

    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such file; expected a model written by deepfracture train")
    try:
        with safe_open(path, framework="numpy") as file:
            return str(json.loads((file.metadata() or {})[KEY])["kind"])
    except (SafetensorError, ValueError, KeyError, TypeError, OSError, RecursionError) as error:
        raise BadInput(f"{path}: not a model of deepfracture, or damaged; train it again") from error
