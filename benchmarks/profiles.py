"""Writes docs/reports/profiles.md: processor time of the three slowest jobs, by function.

python benchmarks/profiles.py --shape pot
"""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from harness import ROOT, start, table, write_text

from deepfracture.bench import stamp
from deepfracture.bench.fracture import empty_cache
from deepfracture.bench.hits import random_hits
from deepfracture.breakers import BreakerOptions, make_breaker
from deepfracture.fracture import MATERIALS, material, prepare_body, simulate
from deepfracture.geometry import load_shape
from deepfracture.types import Grid, Shape
from deepfracture.world import simulate as run
from deepfracture.world import throw_scene

HITS = 3
TOP = 8
"""Functions that are named, by their own time."""
HEAD = ("function", "calls", "own seconds", "share")


def profiles(shape: str = "pot", resolution: int = 128, out: Path = ROOT / "docs" / "reports" / "profiles.md") -> None:
    """Profile the set-up of a body, physical hits, and a scene with a break, by processor time.

    Args:
        shape: a mesh file or a built-in shape.
        resolution: voxels along each axis.
        out: the page to write.
    """
    body, grid = load_shape(shape), Grid(resolution)
    parts = {
        "Set-up of a body, nothing cached": lambda: _set_up(body, grid),
        f"{HITS} physical hits": _hits(body, grid),
        "A scene: a throw, Voronoi cells, until everything rests": _scene(body, grid),
    }
    made = stamp()
    lines = [
        "# Profiles",
        "",
        f"The three slowest operations of the program on the {body.name}, r = {resolution}, by the CPU time",
        f"of their functions (cProfile); kernels compiled beforehand count as one function each. {made['processor']},",
        f"Python {made['python']}; written by `python benchmarks/profiles.py`. Stages and their seconds:",
        "[performance](performance.md). Every command takes `--profile FILE` to profile a run of your own.",
        "",
    ]
    for title, job in parts.items():
        lines += [f"## {title}", "", _profile(job), ""]
    write_text(out, "\n".join(lines).rstrip() + "\n")


def _set_up(shape: Shape, grid: Grid) -> None:
    with empty_cache():
        prepare_body(shape, material("plaster"), BreakerOptions(resolution=grid.resolution))


def _hits(shape: Shape, grid: Grid) -> Callable[[], None]:
    body = prepare_body(shape, material("plaster"), BreakerOptions(resolution=grid.resolution))
    impacts = random_hits(shape, body.material, HITS)

    def job() -> None:
        for seed, impact in enumerate(impacts):
            simulate(body, impact, np.random.default_rng(seed))

    return job


def _scene(shape: Shape, grid: Grid) -> Callable[[], None]:
    scene = throw_scene(shape.name, shape, np.random.default_rng(0), material="plaster")
    breaker = make_breaker("voronoi", shape, material("plaster"), BreakerOptions(resolution=grid.resolution))
    return lambda: _drop(run(scene, [shape], breaker, np.random.default_rng(0), materials=MATERIALS))


def _drop(_: object) -> None: ...


def _profile(job: Callable[[], None]) -> str:
    """A table of the functions with the most time of their own, after a run that compiles."""
    job()
    profile = cProfile.Profile(time.process_time)
    profile.runcall(job)
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    total = sum(own for _, _, own, _, _ in stats.values())
    first = sorted(stats.items(), key=lambda item: -item[1][2])[:TOP]
    rows = [(_named(*key), calls, f"{own:.3f}", f"{own / total:.0%}") for key, (_, calls, own, _, _) in first]
    return f"{total:.2f} s in all.\n\n" + table(HEAD, rows).rstrip()


def _named(file: str, line: int, name: str) -> str:
    """`room/file.py name`, the library's where it is not ours."""
    if file == "~":
        return f"`{name}`"
    parts = Path(file).parts
    for root in ("deepfracture", "site-packages"):
        if root in parts:
            return f"`{'/'.join(parts[len(parts) - parts[::-1].index(root) :])} {name}`"
    return f"`{parts[-1]} {name}`"


if __name__ == "__main__":
    start(profiles)
