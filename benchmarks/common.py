"""What the benchmark programs share: shapes by name, random hits, results kept on disk, the way they start."""

from __future__ import annotations

import json
import logging
import sys
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture.geometry import load_shape
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, FracturePattern, Impact, Ints, Material, Shape
from deepfracture.world import first_impact, single_ball_scene

ROOT = Path(__file__).parents[1]
"""The repository."""
DATA = ROOT.parent / "shared" / "data"
"""Real meshes, which are no part of the repository."""
REFERENCE = ROOT.parent / "shared" / "reference"
"""What FractureRB gave."""
MISSES = 50
"""Balls thrown in vain before a shape counts as impossible to hit."""
SPEEDS = (5.0, 30.0)
"""Slowest and fastest ball [m/s] of the learning scene."""


@dataclass(frozen=True, eq=False)
class Hit:
    """One collision of the learning scene."""

    impact: Impact
    seed: int
    """`np.random.default_rng(seed)` draws the material after it has drawn the scene, as in a data set."""
    rng: np.random.Generator
    """In the state in which the fracture simulator gets it."""


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


def write_json(path: Path, value: Any) -> None:
    """Write `value` whole or not at all."""
    write_text(path, json.dumps(value, indent=1, default=_plain) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write `text` whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def kept(path: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The result in the file `path`; where it is not there yet, `make` it and keep it."""
    if not path.is_file():
        write_json(path, make())
    return json.loads(path.read_text(encoding="utf-8"))


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def start(program: Callable[..., Any]) -> None:
    """Run a typed function from the command line; a bad value ends it in one line."""
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
