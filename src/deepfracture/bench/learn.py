"""Load a trained model and predict."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepfracture.bench.hits import random_hits
from deepfracture.bench.paper import paper_seconds
from deepfracture.bench.rows import Row, measure
from deepfracture.fracture import material
from deepfracture.geometry import load_shape
from deepfracture.learn import embedded_model, load_model
from deepfracture.types import Shape

SHIPPED = "pot"
"""The shape whose model is measured where the one asked for has none of its own."""


def bench_learn(shape: Shape, resolution: int, path: Path | None = None) -> list[Row]:
    """Load and predict with the model in `path`, or the shipped one of `shape`, or that of the pot; `resolution` is
    the model's own."""
    path = path or embedded_model(shape.name)
    if path is None:
        shape, path = load_shape(SHIPPED), embedded_model(SHIPPED)
    assert path is not None, "the shipped model is part of the package"
    model = load_model(path)
    impact = random_hits(shape, material("plaster"), 1)[0]
    own = model.domain.grid.resolution
    jobs = {
        "load": lambda: load_model(path),
        "predict": lambda: model.predict(impact, np.random.default_rng(0)),
    }
    return [measure(name, shape.name, own, job, paper_seconds(name, shape.name, own)) for name, job in jobs.items()]
