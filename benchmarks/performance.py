"""Writes docs/reports/performance.md: the cost of a hit against boundary elements, resolution and cracks.

    python benchmarks/performance.py ../shared/data/squirrel.obj

takes fifteen minutes on two idle cores. Any mesh file or built-in shape will do."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from harness import ROOT, row_of_axes, save_figure, start, table, write_text

from deepfracture.bench import Row, bench
from deepfracture.bench import table as bench_table
from deepfracture.bench.fracture import MATERIAL, HitCost, empty_cache, hit_cost
from deepfracture.bench.hits import SPEEDS, random_hits
from deepfracture.bench.rows import share
from deepfracture.fracture import FractureBody, material, prepare_body
from deepfracture.fracture.body import ELEMENTS
from deepfracture.geometry import load_shape
from deepfracture.runtime.memory import peak_mb
from deepfracture.runtime.progress import collect_stages, log
from deepfracture.types import Grid, Shape

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COUNTS = (500, 1000, 1500, 2000, 3000)
"""Boundary elements asked for."""
RESOLUTIONS = (32, 64, 128, 256)
RESOLUTION = 128
FEW = 4
"""Hits whose median counts for each number of elements and each resolution."""
MANY = 24
"""Hits of the plot against cracks ..."""
FAST = (SPEEDS[0], 2 * SPEEDS[1])
"""... with balls of up to twice the usual speed [m/s]."""


@dataclass(frozen=True)
class Point:
    """One size of the problem, and what it costs."""

    size: float
    """Elements, or voxels along an axis."""
    set_up: float
    """Seconds of the part of the set-up that grows with it."""
    hit: float
    """Seconds of a hit, in the median."""
    part: float
    """Seconds of the part of the hit that grows with it, in the median."""
    peak_mb: float


def performance(shape: Annotated[str, tyro.conf.Positional] = "pot", docs: Path = ROOT / "docs") -> None:
    """Measure what a hit costs; writes reports/performance.md and images/bench.

    Args:
        shape: a mesh file, or a built-in shape.
        docs: folder of the documentation.
    """
    body, load = load_shape(shape), os.getloadavg()[0]
    pictures = docs / "images" / "bench"
    pictures.mkdir(parents=True, exist_ok=True)
    rows = bench("fracture", body, RESOLUTION)
    log.warning("%s", bench_table(rows))
    scatter = costs(prepare_body(body, material(MATERIAL), Grid(RESOLUTION)), MANY, FAST)
    elements, resolutions = against_elements(body), against_resolution(body)
    _draw_shares(rows, pictures / "shares.png")
    _draw_sizes(elements, "boundary elements", ("assembly and factor", "elastic stage"), pictures / "elements.png")
    _draw_sizes(resolutions, "voxels along an axis", ("distances", "fragments"), pictures / "resolution.png")
    _draw_cracks(scatter, pictures / "cracks.png")
    page = _page(Path(shape).name, body, load, rows, scatter, elements, resolutions)
    write_text(docs / "reports" / "performance.md", page)


def costs(body: FractureBody, count: int, speeds: tuple[float, float]) -> list[HitCost]:
    """What random hits of a body cost, after one that does not count."""
    impacts = random_hits(body.shape, body.material, count, speeds=speeds)
    hit_cost(body, impacts[0], 0)
    return [hit_cost(body, impact, seed) for seed, impact in enumerate(impacts)]


def against_elements(shape: Shape) -> list[Point]:
    """The boundary elements: their set-up, and the elastic stage of a hit."""
    points = []
    for count in COUNTS:
        with empty_cache(), collect_stages() as stages:
            body = prepare_body(shape, material(MATERIAL), Grid(RESOLUTION), elements=count)
        set_up = sum(done.seconds for done in stages if done.stage == "boundary elements")
        points.append(_point(len(body.elastic.mesh.faces), set_up, costs(body, FEW, SPEEDS), "elastostatics"))
    return points


def against_resolution(shape: Shape) -> list[Point]:
    """The lattice: its distances, and the fragments of a hit."""
    points = []
    for resolution in RESOLUTIONS:
        with empty_cache(), collect_stages() as stages:
            body = prepare_body(shape, material(MATERIAL), Grid(resolution))
        set_up = sum(done.seconds for done in stages if done.stage == "distances")
        points.append(_point(resolution, set_up, costs(body, FEW, SPEEDS), "fragments"))
    return points


def _point(size: float, set_up: float, hits: Sequence[HitCost], part: str) -> Point:
    whole = float(np.median([hit.seconds for hit in hits]))
    return Point(size, set_up, whole, float(np.median([hit.stages.get(part, 0.0) for hit in hits])), peak_mb())


def _axes(x: str, y: str) -> tuple[Figure, Axes]:
    figure, (axes,) = row_of_axes(1, (5.2, 3.6))
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.3)
    return figure, axes


def _draw_shares(rows: Sequence[Row], path: Path) -> None:
    parts = [(row.stage.split(" / ")[1], row.seconds) for row in rows if share(row, rows) is not None]
    figure, axes = _axes("seconds of a median hit", "")
    names, spent = zip(*reversed(parts), strict=True)
    axes.barh(names, spent)
    save_figure(figure, path, 120)


def _draw_sizes(points: Sequence[Point], x: str, names: tuple[str, str], path: Path) -> None:
    size = [point.size for point in points]
    figure, axes = _axes(x, "seconds")
    axes.loglog(size, [point.set_up for point in points], "s--", label=f"set-up: {names[0]}")
    axes.loglog(size, [point.hit for point in points], "o-", label="hit")
    axes.loglog(size, [point.part for point in points], "^:", label=f"hit: {names[1]}")
    axes.set_xticks(size, [f"{n:g}" for n in size])
    axes.minorticks_off()
    axes.legend()
    save_figure(figure, path, 120)


def _draw_cracks(hits: Sequence[HitCost], path: Path) -> None:
    figure, axes = _axes("cracks", "seconds of a hit")
    axes.plot([hit.cracks for hit in hits], [hit.seconds for hit in hits], "o")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    save_figure(figure, path, 120)


def _slope(x: Sequence[float], y: Sequence[float]) -> float:
    """The exponent p of y ~ x^p over the two largest sizes, where what does not grow matters least."""
    return float(np.log(y[-1] / y[-2]) / np.log(x[-1] / x[-2]))


def _per_crack(hits: Sequence[HitCost]) -> tuple[float, float]:
    """Seconds of a crack and of a hit without any, by least squares."""
    slope, rest = np.polyfit([hit.cracks for hit in hits], [hit.seconds for hit in hits], 1)
    return float(slope), float(rest)


def _machine() -> str:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return f"{os.cpu_count()} cores ({platform.machine()}), {memory:.0f} GB, no GPU, Python {platform.python_version()}"


def _points_table(points: Sequence[Point], head: tuple[str, str, str]) -> str:
    rows = [(f"{p.size:g}", *(f"{t:.2f}" for t in (p.set_up, p.hit, p.part)), f"{p.peak_mb:.0f}") for p in points]
    return table((head[0], f"{head[1]} [s]", "hit [s]", f"{head[2]} [s]", "peak [MB]"), rows)


def _rows_table(rows: Sequence[Row]) -> str:
    shares = {row: "" if (part := share(row, rows)) is None else f"{part:.0%}" for row in rows}
    cells = [(row.stage, f"{row.seconds:.3f}", shares[row], f"{row.peak_mb:.0f}") for row in rows]
    return table(("stage", "seconds", "share of a hit", "peak [MB]"), cells)


def _page(
    file: str, shape: Shape, load: float, rows: Sequence[Row], hits: Sequence[HitCost],
    elements: Sequence[Point], lattices: Sequence[Point],
) -> str:  # fmt: skip
    whole = next(row for row in rows if row.stage == "hit")
    theirs = f" {whole.reference} takes {whole.reference_seconds:g} s for one." if whole.reference else ""
    crack, rest = _per_crack(hits)
    grown = _slope([p.size for p in elements], [p.set_up for p in elements])
    wider = _slope([p.size for p in lattices], [p.hit for p in lattices])
    return "\n".join(
        [
            "# Performance",
            "",
            f"Measured on {_machine()}, by",
            f"`python benchmarks/performance.py {file}`, which writes this page;",
            f"{len(shape.mesh.faces)} triangles, {MATERIAL}, r = {RESOLUTION} and {ELEMENTS} boundary elements unless",
            "said otherwise. The kernels are compiled beforehand (`deepfracture warm`).",
            "`deepfracture bench` prints the same figures for your machine and shape; `make bench` records them in",
            "`runs/bench` with the machine and the date, and marks what takes 1.25 times as long as in the last one.",
            "[Profiles](profiles.md) of the slowest parts list the functions. Load of the machine at the start, from",
            f"other jobs: {load:.1f} on average; with any load the seconds are upper bounds.",
            "",
            "## A body, and a hit",
            "",
            "The set-up belongs to the shape and is kept on disk. A hit is the median of random collisions at",
            f"{SPEEDS[0]:g} to {SPEEDS[1]:g} m/s: {whole.seconds:.2f} s.{theirs}",
            "",
            _rows_table(rows),
            "![Seconds of each stage of a hit](../images/bench/shares.png)",
            "",
            "Stages inside another stage count in both. Peak memory is that of the process so far.",
            "",
            "## Against boundary elements",
            "",
            f"Assembly and factor grow with N to the power {grown:.1f} over the two largest; a hit hardly notices.",
            "",
            _points_table(elements, ("elements", "assembly and factor", "elastic stage")),
            "![Seconds against boundary elements](../images/bench/elements.png)",
            "",
            "## Against resolution",
            "",
            f"A hit grows with r to the power {wider:.1f} over the two largest: the lattice of stress stays as it is.",
            "",
            _points_table(lattices, ("r", "distances", "fragments")),
            "![Seconds against resolution](../images/bench/resolution.png)",
            "",
            "## Against cracks",
            "",
            f"{len(hits)} hits with balls of {FAST[0]:g} to {FAST[1]:g} m/s:",
            f"{rest:.2f} s, and {crack:.3f} s more for each crack.",
            "",
            "![Seconds against cracks](../images/bench/cracks.png)",
            "",
        ]
    )


if __name__ == "__main__":
    start(performance)
