"""`export-onnx`: a trained model for programs without Python."""

from __future__ import annotations

from pathlib import Path

from deepfracture.learn import embedded_model, load_model
from deepfracture.learn.partition.onnx import export_onnx as export
from deepfracture.learn.published import kind_of
from deepfracture.runtime.progress import log, stage
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput


def export_onnx(name: str, *, out: Path) -> None:
    """Write the model `name`, a file or a built-in shape with shipped weights, to `out`."""
    path = _file(name)
    if kind_of(path) == "field model":
        raise BadInput(f"{path}: a network that predicts the field itself; only the preset waves is exported to ONNX")
    model = load_model(path)
    with stage(f"write {out.name}"):
        size = export(model, out)
    log.info(
        "%s: %s at r = %d, %d codes, up to %d fragments, %.1f MB; how to use it: docs/reference/onnx.md",
        out, model.shape_name, model.body.grid.resolution, len(model.choice.rows), model.channels, size / 1e6,
    )  # fmt: skip


def _file(name: str) -> Path:
    path = Path(name)
    if path.is_file() or path.suffix:
        return path
    shipped = embedded_model(name)
    if shipped is None:
        from deepfracture.learn.partition.model import SHIPPED

        known = sorted(file.stem for file in SHIPPED.glob("*.safetensors"))
        raise BadInput(
            f"{name!r}: neither a file nor a shape whose model ships, which are {', '.join(known)}"
            f"{did_you_mean(name, known)}"
        )
    return shipped
