"""`export-onnx`: a trained model for programs without Python."""

from __future__ import annotations

from pathlib import Path

from deepfracture.learn import embedded_model, load_partition_model, model_kind
from deepfracture.learn.loading import PUBLISHED, shipped_models
from deepfracture.learn.partition.onnx import export_onnx as export
from deepfracture.runtime.progress import log, stage
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput


def export_onnx(name: str, *, out: Path) -> None:
    """Write the model `name`, a file or a built-in shape with shipped weights, to `out`."""
    path = _file(name)
    if model_kind(path) == PUBLISHED:
        raise BadInput(f"{path}: a network that predicts the field itself; only the preset waves is exported to ONNX")
    model = load_partition_model(path)
    with stage(f"write {out.name}"):
        size = export(model, out)
    log.info(
        "%s: %s at r = %d, %d codes, up to %d fragments, %.1f MB; how to use it: docs/reference/onnx.md",
        out, model.shape_name, model.domain.grid.resolution, len(model.codebook), model.channels, size / 1e6,
    )  # fmt: skip


def _file(name: str) -> Path:
    path = Path(name)
    if path.is_file() or path.suffix:
        return path
    shipped = embedded_model(name)
    if shipped is None:
        known = shipped_models()
        raise BadInput(
            f"{name!r}: neither a file nor a shape whose model ships, which are {', '.join(known)}"
            f"{did_you_mean(name, known)}"
        )
    return shipped
