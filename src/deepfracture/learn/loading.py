"""Reading any model file."""

from __future__ import annotations

import json
from pathlib import Path

from deepfracture.learn.checkpoint import KEY
from deepfracture.learn.model import Model
from deepfracture.learn.partition.model import load_partition_model
from deepfracture.runtime.extras import require
from deepfracture.types import BadInput

MODELS = Path(__file__).parent / "models"
PUBLISHED = "field model"
"""Kind of the files that `published.model` writes; that module needs torch."""


def load_model(path: Path | str, *, device: str = "auto") -> Model:
    """Read a model of any preset and check all of it before use.

    Args:
        device: Where a network of `published` runs; the project's own needs no torch and runs on the CPU.

    Raises:
        BadInput: In one line, what is missing, damaged, or of another format; torch or the device is not available.
    """
    path = Path(path)
    if model_kind(path) != PUBLISHED:
        return load_partition_model(path)
    require("torch", extra="train", to=f"predict with the model {path}")
    from deepfracture.learn.distributed import pick_device
    from deepfracture.learn.published.model import load_published_model

    return load_published_model(path, pick_device(device))


def model_kind(path: Path | str) -> str:
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


def shipped_models() -> list[str]:
    """Names of the built-in shapes whose trained models are part of the package."""
    return sorted(file.stem for file in MODELS.glob("*.safetensors"))


def embedded_model(shape_name: str) -> Path | None:
    """The shipped weights for a built-in shape, if there are any."""
    path = MODELS / f"{shape_name}.safetensors"
    return path if path.is_file() else None
