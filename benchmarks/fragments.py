"""Random label fields of many kinds cut out of every shape, each set of fragments checked.

For every field: no crash; every fragment is one closed 2-manifold solid without self-intersection; the volumes add up;
the outside is the original's; each inner face has its mirror image in one neighbour. See
`deepfracture.validation.fragments` for what is measured and for the limits. Files that are not closed, or whose surface
runs through itself, are repaired, or named as refused.

The fields: what a model predicts, what was simulated, Voronoi cells, Voronoi cells blurred by noise in their
distances and flooded, blobs and white noise of labels, scraps, checkerboards, and hostile ones. Field n of a kind
depends on (shape, kind, --seed, n) alone. Finished fields are kept in --out and not repeated: use another folder once
the cut has changed. A field that fails is kept as .npz beside its row.
"""

from __future__ import annotations

import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from degenerate import DEGENERATE
from harness import DATA, ROOT, SPEEDS, kept, mesh_files, start, table, throw, write_json, write_text

from deepfracture.carve import cut, encode, segment, voronoi_pattern
from deepfracture.dataset import Dataset, open_dataset
from deepfracture.fracture import material
from deepfracture.geometry import BUILTIN, load_shape, signed_distance
from deepfracture.geometry.untangle import self_intersecting_faces
from deepfracture.learn import PartitionModel, embedded_model, load_partition_model
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log, track
from deepfracture.types import BadInput, Floats32, FracturePattern, Grid, Ints, Shape, Volume
from deepfracture.validation.fragments import FragmentReport, check_fragments

HEAD = ("shape", "faces", "fields", "failed", "fragments min/median/max", "volume error",
        "lowest altitude [voxels] min/5 %/median", "low faces", "outside [m]", "ms median/99 %")  # fmt: skip
KIND_HEAD = ("kind", "fields", "failed", "fragments median/max", "lowest altitude [voxels] min/5 %/median",
             "bends [degrees] 50/90/99 %", "roughness [voxels] median/max", "ms median/99 %")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Source:
    """What the fields of one shape are made from."""

    shape: Shape
    grid: Grid
    model: PartitionModel | None
    dataset: Dataset | None

    @cached_property
    def surface(self) -> Floats32:
        """Signed distance [m] of the voxel centres, positive inside, shape (r, r, r)."""
        return signed_distance(self.shape.mesh, self.grid)

    @cached_property
    def inside(self) -> Ints:
        """Voxels whose centre lies inside, shape (n, 3)."""
        return np.argwhere(self.surface > 0)

    @property
    def kinds(self) -> list[str]:
        """The kinds of fields that there can be."""
        missing = {"predicted": self.model is None, "simulated": self.dataset is None}
        return [kind for kind in KINDS if not missing.get(kind, False)]

    def distances(self, rng: np.random.Generator) -> Floats32:
        """Distances to cracks that have nothing to do with any crack."""
        return rng.uniform(0, self.grid.spacing, self.grid.shape).astype(np.float32)


def predicted(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    assert source.model is not None
    seed = int(rng.integers(2**31))
    hit = throw(source.shape, material("plaster"), number, seed=seed, speed=SPEEDS)
    return segment(source.model.predict(hit.impact, rng))


def simulated(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    assert source.dataset is not None
    return source.dataset[number % len(source.dataset)].pattern


def cells(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    count = int(rng.integers(2, 40))
    sites = rng.choice(source.inside, count, replace=False) + rng.uniform(-0.5, 0.5, (count, 3))
    return voronoi_pattern(source.grid.to_world(sites), source.surface > 0, source.grid)


def noisy(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    """Voronoi cells behind a field with noise of up to a voxel, as a bad network would give it."""
    from scipy.ndimage import gaussian_filter

    volume = encode(cells(source, number, rng), source.surface, cuts=False)
    noise = gaussian_filter(rng.normal(size=source.grid.shape), rng.choice([0.0, 1.0, 2.0]))
    values = volume.values + rng.uniform(0.1, 1.0) * source.grid.spacing * noise / noise.std()
    return segment(Volume(source.grid, values))


def blobs(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    return _labels(source, rng, blur=float(rng.choice([0.5, 1.0, 2.0, 4.0, 8.0])), holes=float(rng.choice([0.0, 0.3])))


def white(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    return _labels(source, rng, blur=0.0, holes=float(rng.choice([0.0, 0.3])))


def scraps(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    return _labels(source, rng, blur=float(rng.choice([0.0, 1.0, 3.0])), holes=float(rng.choice([0.9, 0.99, 0.999])))


def checkerboard(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    edge, start_at = int(rng.integers(2, 17)), rng.integers(0, 16, 3)
    index = np.indices(source.grid.shape) + start_at[:, None, None, None]
    labels = 1 + (index // edge).sum(axis=0) % int(rng.integers(2, 4))
    known = np.zeros(source.grid.shape) if rng.random() < 0.5 else source.distances(rng)
    return FracturePattern(source.grid, labels, known)


def hostile(source: Source, number: int, rng: np.random.Generator) -> FracturePattern:
    """By number: no label, one label, one labelled voxel, layers of one voxel, sticks of one voxel."""
    index = np.indices(source.grid.shape)
    one = np.zeros(source.grid.shape, np.int32)
    one[tuple(rng.choice(source.inside))] = 1
    labels = (
        np.zeros(source.grid.shape), np.ones(source.grid.shape), one, 1 + index[int(rng.integers(3))] % 2,
        1 + (index[0] + index[1]) % 2,
    )[number % 5]  # fmt: skip
    return FracturePattern(source.grid, labels, source.distances(rng))


def _labels(source: Source, rng: np.random.Generator, *, blur: float, holes: float) -> FracturePattern:
    """The greatest of several random functions, each smoothed over `blur` voxels; a share of `holes` is unknown."""
    from scipy.ndimage import gaussian_filter

    noise = rng.normal(size=(int(rng.integers(2, 7)), *source.grid.shape))
    labels = 1 + np.argmax([gaussian_filter(field, blur) for field in noise], axis=0)
    labels[rng.random(source.grid.shape) < holes] = 0
    return FracturePattern(source.grid, labels, source.distances(rng))


KINDS: Mapping[str, Callable[[Source, int, np.random.Generator], FracturePattern]] = {
    make.__name__: make for make in (predicted, simulated, cells, noisy, blobs, white, scraps, checkerboard, hostile)
}
"""Every kind of field by name."""


def fragments(
    shapes: tuple[str, ...] = (),
    fields: int = 200,
    resolution: int = 64,
    kinds: tuple[str, ...] = (),
    models: tuple[Path, ...] = (),
    datasets: tuple[Path, ...] = (),
    seed: int = 0,
    data: Path = DATA,
    out: Path = ROOT / "runs" / "fragments",
) -> Path:
    """Cut random fields out of every shape and check the fragments; writes fragments.json and fragments.md into --out.

    Args:
        shapes: only these: built-in names, file stems of --data, degenerate cases; built-in ones and files by default.
        fields: per shape, its kinds in turn.
        resolution: voxels along each axis.
        kinds: only these kinds of fields.
        models: trained models, beside those that are shipped.
        datasets: folders made by `deepfracture simulate` at this resolution.
        seed: of the fields.
        data: folder of meshes.
        out: folder of finished fields and of the tables.
    """
    if unknown := set(kinds) - set(KINDS):
        raise BadInput(f"kinds: there is no {min(unknown)!r}; choose from {', '.join(KINDS)}")
    sources = shapes_by_name(data)
    if unknown := set(shapes) - set(sources):
        raise BadInput(f"shapes: nothing is called {min(unknown)!r}; choose from {', '.join(sources)}")
    grid = Grid(resolution)
    rows: dict[str, dict[str, Any]] = {}
    for name in shapes or [name for name in sources if name not in DEGENERATE]:
        try:
            shape, how = sources[name]()
        except BadInput as refusal:
            rows[name] = {"refused": str(refusal).replace(f"{data}/", ""), "fields": []}
            continue
        source = Source(shape, grid, _model(shape, grid, models), _dataset(shape, grid, datasets))
        done = run(source, fields, kinds, seed, out / f"r{resolution}-s{seed}" / name)
        rows[name] = {"faces": len(shape.mesh.faces), "read": how, "fields": done}
        write_json(out / "fragments.json", rows)
    write_json(out / "fragments.json", rows)
    text = summary(rows)
    write_text(out / "fragments.md", text)
    log.warning("%s", text)
    return out / "fragments.md"


def shapes_by_name(data: Path) -> dict[str, Callable[[], tuple[Shape, str]]]:
    """What makes each shape, and says how: as it is, or repaired."""

    def opened(path: Path) -> tuple[Shape, str]:
        try:
            shape = load_shape(str(path))
        except BadInput:
            return load_shape(str(path), repair=True), "repaired"
        if len(self_intersecting_faces(shape.mesh)):  # as the warning says that it is to be done
            return load_shape(str(path), repair=True), "repaired"
        return shape, "closed"

    made: dict[str, Callable[[], tuple[Shape, str]]] = {}
    made.update({name: lambda name=name: (load_shape(name), "built in") for name in BUILTIN})
    made.update({name: lambda path=path: opened(path) for name, path in mesh_files(data).items()})
    made.update({name: lambda make=make: (make(), "degenerate") for name, make in DEGENERATE.items()})
    return made


def _model(shape: Shape, grid: Grid, models: Sequence[Path]) -> PartitionModel | None:
    shipped = embedded_model(shape.name)
    for path in (*models, *([shipped] if shipped else [])):
        model = load_partition_model(path)
        if model.shape_name == shape.name:
            return model if model.domain.grid == grid else model.at(shape, grid.resolution)
    return None


def _dataset(shape: Shape, grid: Grid, paths: Sequence[Path]) -> Dataset | None:
    for path in paths:
        dataset = open_dataset(path)
        if dataset.shape.name == shape.name and dataset.settings.resolution == grid.resolution and len(dataset):
            return dataset
    return None


def run(source: Source, fields: int, kinds: Sequence[str], seed: int, folder: Path) -> list[dict[str, Any]]:
    """All fields of one shape; those whose row is in `folder` are read from there."""
    chosen = [kind for kind in source.kinds if not kinds or kind in kinds]
    if not chosen:
        return []
    todo = [(chosen[n % len(chosen)], n // len(chosen)) for n in range(fields)]
    paths = [folder / f"{kind}-{number:03d}.json" for kind, number in todo]
    if not all(path.is_file() for path in paths):
        # What is compiled or prepared once is no part of the time.
        check_field(source, *todo[0], seed, folder)
    rows = []
    for (kind, number), path in track(list(zip(todo, paths, strict=True)), name=source.shape.name):
        rows.append(kept(path, lambda kind=kind, number=number: check_field(source, kind, number, seed, folder)))
    return rows


def field(source: Source, kind: str, number: int, seed: int) -> FracturePattern:
    """Field `number` of a kind."""
    names = [zlib.crc32(name.encode()) for name in (source.shape.name, kind)]
    return KINDS[kind](source, number, np.random.default_rng([*names, seed, number]))


def check_field(source: Source, kind: str, number: int, seed: int, folder: Path) -> dict[str, Any]:
    """Cut one field: its figures, and what is wrong with the fragments (`failures`, empty if nothing)."""
    pattern = field(source, kind, number, seed)
    row: dict[str, Any] = {"kind": kind, "number": number, "labels": pattern.count}
    try:
        begin = time.perf_counter()
        pieces = cut(source.shape, pattern, density=1000)
        row["ms"] = 1e3 * (time.perf_counter() - begin)
        row["smallest_voxels"] = min(piece.volume for piece in pieces) / source.grid.spacing**3
        row |= figures(check_fragments(source.shape, pieces, voxel=source.grid.spacing))
    except Exception as crash:  # what a crash looks like is what this program is here to tell
        reason = f"{type(crash).__name__}: {(str(crash).splitlines() or [''])[0]}"
        row |= {"failures": {"crash": 1}, "crash": reason, "traceback": traceback.format_exc()}
    if row["failures"]:
        with atomic_file(folder / f"{kind}-{number:03d}.npz") as temporary:
            np.savez_compressed(temporary, labels=pattern.labels, distance=pattern.distance)
    return row


def figures(report: FragmentReport) -> dict[str, Any]:
    """What is kept of the report on one field."""
    pieces = report.pieces
    faces = sum(piece.faces for piece in pieces)
    return {
        "failures": report.failures,
        "fragments": len(pieces),
        "faces": faces,
        "volume_error": report.volume_error,
        "lowest": min(piece.lowest for piece in pieces),
        "shortest": min(piece.shortest for piece in pieces),
        "low": sum(piece.low * piece.faces for piece in pieces) / faces,
        "outside": report.outside.distance,
        "area_error": report.outside.area_error,
        "bends": report.cracks.bends,
        "roughness": report.cracks.roughness,
    }


def summary(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The tables by shape and by kind, and under them every failure."""
    lines, failures = [], []
    for name, case in rows.items():
        if "refused" in case:
            lines.append((name, *[""] * (len(HEAD) - 2), f"refused: {case['refused']}"))
            continue
        done = case["fields"]
        label = name if case["read"] != "repaired" else f"{name} (repaired)"
        lines.append((
            label, case["faces"], len(done), _failed(done), _quantiles(done, "fragments", (0, 0.5, 1), ".0f"),
            _worst(done, "volume_error"), _quantiles(done, "lowest", (0, 0.05, 0.5), ".1e"),
            _worst(done, "low"), _worst(done, "outside"), _quantiles(done, "ms", (0.5, 0.99), ".0f"),
        ))  # fmt: skip
        failures += [
            f"- {name} {row['kind']}-{row['number']:03d}: {row.get('crash') or _kinds(row['failures'])}"
            for row in done if row["failures"]
        ]  # fmt: skip
    every = [row for case in rows.values() for row in case["fields"]]
    kinds = [_kind_line(kind, [row for row in every if row["kind"] == kind]) for kind in KINDS]
    total = Counter(kind for row in every for kind in row["failures"])
    found = f"Fields that failed, by what is wrong: {_kinds(total)}.\n\n" if total else "No failure.\n"
    return "\n".join([table(HEAD, lines), table(KIND_HEAD, [line for line in kinds if line]), found, *failures]) + "\n"


def _kind_line(kind: str, rows: Sequence[Mapping[str, Any]]) -> tuple[Any, ...]:
    if not rows:
        return ()
    bends = np.array([row["bends"] for row in rows if "bends" in row]).reshape(-1, 3)
    return (
        kind, len(rows), _failed(rows), _quantiles(rows, "fragments", (0.5, 1), ".0f"),
        _quantiles(rows, "lowest", (0, 0.05, 0.5), ".1e"),
        " / ".join(f"{b:.1f}" for b in np.median(bends, axis=0)) if len(bends) else "",
        _quantiles(rows, "roughness", (0.5, 1), ".3f"), _quantiles(rows, "ms", (0.5, 0.99), ".0f"),
    )  # fmt: skip


def _failed(rows: Sequence[Mapping[str, Any]]) -> int:
    return sum(bool(row["failures"]) for row in rows)


def _kinds(failures: Mapping[str, int]) -> str:
    return ", ".join(f"{kind} {count}" for kind, count in failures.items())


def _quantiles(rows: Sequence[Mapping[str, Any]], key: str, at: Sequence[float], form: str) -> str:
    values = [row[key] for row in rows if key in row]
    return " / ".join(format(float(q), form) for q in np.quantile(values, at)) if values else ""


def _worst(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    values = [abs(row[key]) for row in rows if key in row]
    return f"{max(values):.1e}" if values else ""


if __name__ == "__main__":
    start(fragments)
