"""Harness of the benchmark programs: command line, shapes and random hits, cached results, tables, figures.

A program is one typed function that `start` puts on the command line. What users may want is a command of deepfracture
(`bench`, `soak`, `validate`); the programs here write pages of docs/ or check the program on a developer's machine."""

from __future__ import annotations

import json
import logging
import sys
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepfracture.bench.hits import SPEEDS as SPEEDS
from deepfracture.bench.rows import seconds
from deepfracture.geometry import load_shape
from deepfracture.render.picture import exploded
from deepfracture.runtime.files import atomic_file, scratch_folder
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, FracturePattern, Fragments, Impact, Ints, Material, Shape
from deepfracture.world import first_impact, single_ball_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]
"""Root of the repository."""
DATA = ROOT.parent / "shared" / "data"
"""Meshes that are not part of the repository."""
REFERENCE = ROOT.parent / "shared" / "reference"
"""Results of FractureRB (Hahn and Wojtan 2016)."""
MISSES = 50
"""Consecutive misses after which a shape counts as impossible to hit."""
MESH_FILES = ("*.obj", "*.stl", "*.ply", "*.off")


@dataclass(frozen=True, eq=False)
class Hit:
    """One collision of the learning scene."""

    impact: Impact
    seed: int
    """`np.random.default_rng(seed)` draws the material after it has drawn the scene, as in a data set."""
    rng: np.random.Generator
    """In the state in which the fracture simulator receives it."""


def throw(
    shape: Shape, material: Material, number: int, *, seed: int, speed: tuple[float, float], radius: float = 0.2
) -> Hit:
    """Hit `number` on a shape; it depends on (name of the shape, seed, number) alone.

    `speed`: slowest and fastest ball [m/s]; `radius` of the steel ball [m]."""
    name = zlib.crc32(shape.name.encode())  # not the same balls at every shape
    for attempt in range(MISSES):
        own = int(np.random.SeedSequence([name, seed, number, attempt]).generate_state(1, np.uint64)[0])
        rng = np.random.default_rng(own)
        scene = single_ball_scene(shape.name, shape, rng, material=material.name, speed=speed, radius=radius)
        impact = first_impact(scene, shape, materials={material.name: material})
        if impact is not None:
            return Hit(impact, own, rng)
    raise BadInput(f"{shape.name}: {MISSES} balls in a row missed it")


def shape_named(name: str, data: Path) -> Shape | None:
    """A built-in shape, or that of the file data/NAME.obj; None, with a line in the log, where neither is there."""
    file = data / f"{name}.obj"
    if file.is_file():
        return load_shape(str(file))
    try:
        return load_shape(name)
    except BadInput as absent:
        log.warning("%s: skipped: no %s, and %s", name, file.name, absent)
        return None


def fragment_volumes(pattern: FracturePattern) -> tuple[np.ndarray, np.ndarray]:
    """Volume [m^3] and centre [m] of each fragment, shapes (n,) and (n, 3), counted in voxels."""
    where: Ints = np.argwhere(pattern.labels > 0)
    labels = pattern.labels[tuple(where.T)]
    counts = np.bincount(labels)[1:]
    sums = np.stack([np.bincount(labels, weights=where[:, k])[1:] for k in range(3)], axis=1)
    there = counts > 0
    centres = pattern.grid.to_world(sums[there] / counts[there, None])
    return counts[there] * pattern.grid.spacing**3, centres


def mesh_files(folder: Path) -> dict[str, Path]:
    """The mesh files of a folder by their stem, in order of name."""
    return {path.stem: path for path in sorted(path for pattern in MESH_FILES for path in folder.glob(pattern))}


def write_json(path: Path, value: Any) -> None:
    """Write `value` atomically."""
    write_text(path, json.dumps(value, indent=1, default=_plain) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write `text` atomically."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def kept(path: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The result stored in `path`; `make` computes and stores it where it is missing, so that a rerun resumes."""
    if not path.is_file():
        write_json(path, make())
    return json.loads(path.read_text(encoding="utf-8"))


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def quickest(job: Callable[[], object], runs: int) -> float:
    """Milliseconds of the quickest of `runs` calls after two that do not count."""
    return 1000 * min([seconds(job) for _ in range(2 + runs)][2:])


def row_of_axes(count: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure of `size` [inch] with `count` axes side by side, drawn without a display."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, list(np.atleast_1d(figure.subplots(1, count)))


def save_figure(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write a PNG atomically."""
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi)


def exploded_view(
    fragments: Fragments, shape: Shape, size: tuple[int, int], *, azimuth: float, factor: float
) -> NDArray[np.uint8]:
    """An exploded view as pixels, shape (height, width, 3)."""
    from PIL import Image

    with scratch_folder() as folder:
        exploded(fragments, folder / "view.png", shape=shape, size=size, azimuth=azimuth, factor=factor)
        with Image.open(folder / "view.png") as picture:
            return np.asarray(picture.convert("RGB"))


def start(program: Callable[..., Any]) -> None:
    """Run a typed function from the command line; invalid input ends it with one line."""
    import tyro

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    try:
        tyro.cli(program)
    except BadInput as problem:
        sys.stderr.write(f"{Path(sys.argv[0]).name}: {problem}\n")
        sys.exit(2)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")
