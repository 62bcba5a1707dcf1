"""Table of docs/reference/onnx.md: milliseconds from an impulse to labels: our prediction, torch and onnxruntime.

python benchmarks/onnx_speed.py --names pot bunny
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from harness import quickest, start, table, write_text

from deepfracture.learn import PartitionModel, embedded_model, load_partition_model
from deepfracture.learn.partition import network
from deepfracture.learn.partition.onnx import export_onnx, spline_matrix
from deepfracture.runtime.extras import require
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Impact


def random_hit(model: PartitionModel, rng: np.random.Generator) -> Impact:
    """An impulse somewhere in the box of the body."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    magnitude = float(rng.uniform(0.2, 1)) * model.normaliser.max_impulse
    return Impact([rng.uniform(-1, 1, 3)], [direction], [magnitude], [-direction], speed=9.0, radius=0.2)


def torch_labels(model: PartitionModel) -> Callable[[int], Any]:
    """The graph's decoder in torch: from the number of a code to the labels."""
    torch = require("torch", extra="train", to="compare with torch")
    lattice, channels = model.domain.lattice, model.channels
    side, r = lattice.number.shape[0], model.domain.grid.resolution
    weights = {name: torch.from_numpy(value) for name, value in model.weights.items()}
    waves, codebook = torch.from_numpy(model.node_features), torch.from_numpy(model.codebook)
    matrix = torch.from_numpy(spline_matrix(lattice))
    number = torch.from_numpy(np.where(lattice.number < 0, len(lattice.nodes), lattice.number).ravel().astype(np.int64))
    inside = torch.from_numpy(model.domain.surface > 0)
    nothing = torch.zeros(1, channels)

    def labels(index: int) -> Any:
        with torch.no_grad():
            values = torch.cat([waves @ network.mixing_matrices(weights, codebook[index][None], torch)[0], nothing])[
                number
            ]
            for shape in ((side, side * side * channels), (r, side, side * channels), (r, r, side, channels)):
                values = matrix @ values.reshape(shape)
            return (values.argmax(dim=3) + 1) * inside

    return labels


def measured(name: str, runs: int, folder: Path) -> list[object]:
    """One row of the table."""
    ort = require("onnxruntime", extra="onnx", to="run the exported graph")
    path = embedded_model(name)
    if path is None:
        raise BadInput(f"{name}: no model of this shape ships")
    model, rng = load_partition_model(path), np.random.default_rng(0)
    size = export_onnx(model, folder / f"{name}.onnx")
    session = ort.InferenceSession(str(folder / f"{name}.onnx"), providers=["CPUExecutionProvider"])
    impact, random = random_hit(model, rng), rng.standard_normal(model.config.segment_size, np.float32)
    rows = np.zeros((model.config.features, 7), np.float32)
    rows[0] = [*impact.position[0], *impact.direction[0], impact.magnitude[0]]
    feed = {"impulses": rows, "random": random, "rank": np.array(0)}
    (found, index) = session.run(["labels", "order"], feed)
    in_torch = torch_labels(model)
    assert (np.asarray(in_torch(int(index[0]))) != found).sum() < 20, "the graph and torch disagree"
    return [
        name,
        f"{size / 1e6:.1f}",
        f"{quickest(lambda: model.predict(impact, np.random.default_rng(0)), runs):.1f}",
        f"{quickest(lambda: in_torch(int(index[0])), runs):.1f}",
        f"{quickest(lambda: session.run(['labels'], feed), runs):.1f}",
    ]


def onnx_speed(
    names: Sequence[str] = ("pot", "bunny", "base", "mug"), runs: int = 20, out: Path = Path("runs/onnx_speed.md")
) -> None:
    """Measure, and write the table to `out`.

    Args:
        names: built-in shapes whose models ship.
        runs: of which the quickest counts.
        out: file for the table.
    """
    with TemporaryDirectory(prefix="deepfracture-") as folder:
        rows = [measured(name, runs, Path(folder)) for name in names]
    head = ["model", "file MB", "ours ms (labels, cuts and distances)", "torch ms (labels)", "onnxruntime ms (labels)"]
    write_text(out, table(head, rows))
    log.warning("%s", table(head, rows))


if __name__ == "__main__":
    start(onnx_speed)
