"""From an impact to fragments: prediction, field, segmentation, cut, and the usual way on the same field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from deepfracture.bench.hits import random_hits
from deepfracture.bench.paper import paper_seconds
from deepfracture.bench.pieces import DENSITY, cells
from deepfracture.bench.reference import installed, reference_cut, reference_labels, reference_surfaces
from deepfracture.bench.rows import RUNS, Row, measure, seconds, stage_totals
from deepfracture.carve import cut, encode, segment, segment_as_published
from deepfracture.fracture import material
from deepfracture.geometry import signed_distance
from deepfracture.learn import PartitionModel, embedded_model, load_partition_model
from deepfracture.runtime.memory import peak_mb
from deepfracture.runtime.progress import StageTimer, collect_stages, log
from deepfracture.types import BadInput, Floats32, FracturePattern, Grid, Impact, Shape, Volume

HITS = 24
"""Random collisions, of which the one that is predicted to leave about `FRAGMENTS` is measured."""
SPEEDS = (15.0, 60.0)
"""Slowest and fastest ball of those [m/s]."""
FRAGMENTS = 20
"""The paper's patterns have about as many."""
REFERENCE_RUNS = 3
"""Runs of the usual way whose median counts: it takes half a minute at r = 256."""
MISSING = "scikit-image is not installed, so the reference's way is left out; pip install 'deepfracture[bench]'"


@dataclass(frozen=True, eq=False)
class _Field:
    """The one GS-SDF that everything is measured on."""

    volume: Volume
    surface: Floats32
    """Distance to the shape's surface [m], shape (r, r, r)."""
    predict: Callable[[], Volume] | None = None
    """Makes the volume; None if it was not predicted."""
    prepared: tuple[Row, ...] = ()
    """What had to be done once for the shape."""


def bench_carve(shape: Shape, resolution: int, path: Path | None = None) -> list[Row]:
    """Each stage from an impact to fragments, the stages inside the cut, and the usual way.

    The field is a prediction of the model in `path`, or of the one shipped for the shape; where there is none, a
    pattern of `pieces.CELLS` Voronoi cells.

    Raises:
        BadInput: The model is of another shape.
    """

    def row(stage: str, job: Callable[[], object]) -> Row:
        return measure(stage, shape.name, resolution, job, paper_seconds(stage, shape.name, resolution))

    path = path or embedded_model(shape.name)
    field = _drawn(shape, resolution) if path is None else _predicted(shape, resolution, path)
    plain, pattern = Volume(field.volume.grid, field.volume.values), segment(field.volume)
    rows = [
        row("encode", lambda: encode(pattern, field.surface)),
        row("segment", lambda: segment(field.volume)),
        row("segment, distances alone", lambda: segment(plain)),
        row("segment, as published", lambda: segment_as_published(plain)),
        *_cut_rows(shape, pattern),
    ]
    if (make := field.predict) is not None:
        whole = row(_named("whole", pattern.count), lambda: cut(shape, segment(make()), density=DENSITY))
        rows = [row("predict", make), *rows, whole]
    return [*field.prepared, *rows, *_reference_rows(shape, plain)]


def _named(stage: str, fragments: int) -> str:
    return f"{stage}, {fragments} fragments"


def _drawn(shape: Shape, resolution: int) -> _Field:
    surface = signed_distance(shape.mesh, Grid(resolution))
    return _Field(encode(cells(surface > 0, Grid(resolution), np.random.default_rng(0)), surface), surface)


def _predicted(shape: Shape, resolution: int, path: Path) -> _Field:
    """The prediction for the one of `HITS` random collisions whose fragments number nearest to `FRAGMENTS`."""
    own = load_partition_model(path)
    if not own.matches_shape(shape):
        raise BadInput(f"{path}: trained on {own.shape_name}, not on {shape.name}; give a model of this shape")
    hits = random_hits(shape, material("plaster"), HITS, speeds=SPEEDS)
    chosen = min(hits, key=lambda hit: abs(segment(_draw(own, hit)).count - FRAGMENTS))
    watch = StageTimer()
    with watch("prepare, once a shape"):
        model = own.at(shape, resolution)
    make = partial(_draw, model, chosen)
    prepared = _medians(shape, Grid(resolution), [watch.seconds], {})
    return _Field(make(), model.domain.surface, make, tuple(prepared))


def _draw(model: PartitionModel, impact: Impact) -> Volume:
    return model.predict(impact, np.random.default_rng(0))


def _cut_rows(shape: Shape, pattern: FracturePattern) -> list[Row]:
    """The cut, and the stages inside it that it tells of."""
    runs = []
    for _ in range(RUNS + 1):
        with collect_stages() as stages:
            spent = seconds(lambda: cut(shape, pattern, density=DENSITY))
        runs.append({"cut": spent} | {f"cut / {name}": took for name, took in stage_totals(stages).items()})
    source = paper_seconds("cut", shape.name, pattern.grid.resolution)
    return _medians(shape, pattern.grid, runs[1:], {"cut": source})


def _reference_rows(shape: Shape, volume: Volume) -> list[Row]:
    if not installed():
        log.warning("bench carve: %s", MISSING)
        return []
    return _medians(shape, volume.grid, [_reference_run(shape, volume) for _ in range(REFERENCE_RUNS)], {})


def _reference_run(shape: Shape, volume: Volume) -> dict[str, float]:
    watch = StageTimer()
    with watch("reference / segment"):
        labels = reference_labels(volume)
    with watch("reference / surfaces"):
        surfaces = reference_surfaces(labels, volume.grid)
    with watch("reference / cut"):
        pieces, refused = reference_cut(shape, surfaces)
    name = _named("reference", len(pieces)) + (f", {refused} refused" if refused else "")
    return watch.seconds | {name: sum(watch.seconds.values())}


def _medians(
    shape: Shape, grid: Grid, runs: list[dict[str, float]], sources: dict[str, tuple[str, float | None]]
) -> list[Row]:
    """A row for each name that the runs have times of."""
    spent = {name: float(np.median([run[name] for run in runs])) for name in runs[0]}
    none = ("", None)
    return [Row(n, shape.name, grid.resolution, s, peak_mb(), *sources.get(n, none)) for n, s in spent.items()]
